"""Keeping a character clear of itself: what the source keeps apart stays apart.

A pair of bodies may come as near as it does in the source at the same frame, and no nearer than a
few millimetres where the source keeps it further apart. So nothing that the source does is
forbidden, and a pair that is one in the other there is pushed no deeper.

Balls around geoms sieve the pairs of all frames at once, boxes around them what is left;
``mj_geomDistance`` measures the few that remain, so the cost is linear in frames.
"""

from __future__ import annotations

import copy
from collections.abc import Collection

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.kinematics import Kinematics, Pose, body_dofs, character_geoms
from mjmotion.body.motion import Motion
from mjmotion.ik.solver import Inequalities

Array = NDArray[np.float64]
Index = NDArray[np.int64]

APART = 0.005  # distance kept where the source keeps more [m]
_SLACK = 5e-4  # nearer than what is kept by less than this is near enough [m]
_ROUNDING = 1e-4  # of places to single precision [m]
_STILL = 5e-5  # less of a change of a joint's numbers moves nothing that matters
_JOINED = 2  # bodies this many joints apart that touch as the model is drawn are one shape


class SelfClearance:
    """What a character lacks to be clear of itself (:class:`.clearances.BodyClearance`).

    Args:
      source: the motion, on the character alone, that says how near is near enough.
      kinematics: of the same model, with geoms, for as many frames.
      bodies: those that are to keep clear of the others, and of each other; all without.
      margin: distance to keep where the source keeps more [m].
      others: of which ``bodies`` are to keep clear, where that is not all.
    """

    def __init__(
        self,
        source: Motion,
        kinematics: Kinematics,
        bodies: Collection[int] | None = None,
        margin: float = APART,
        others: Collection[int] | None = None,
    ) -> None:
        self.model, self.margin = source.model, margin
        self._source, self._kinematics = source, kinematics
        self._data = mujoco.MjData(self.model)
        self._geoms = character_geoms(self.model, colliding=True)
        mine = np.ones(len(self._geoms), dtype=bool)
        if bodies is not None:
            mine = np.isin(self.model.geom_bodyid[self._geoms], list(bodies))
        self._mine = np.flatnonzero(mine)  # one of every pair is among these
        rest = np.ones_like(mine)
        if others is not None:
            rest = np.isin(self.model.geom_bodyid[self._geoms], list(others))
        size = self.model.geom_rbound[self._geoms]
        self._between, number = _joints_between(self.model, self._geoms)
        self._number = number[self._mine]
        first, second = np.searchsorted(self._geoms, self_pairs(self.model)).T
        wanted = (mine[first] & rest[second]) | (mine[second] & rest[first])
        first, second = first[wanted], second[wanted]
        bound = np.full((len(size), len(size)), -1.0, np.float32)  # where there is no pair
        bound[first, second] = (size[first] + size[second] + APART + _ROUNDING) ** 2
        # A pair of two of them is looked at once; one of another and one of them, turned round.
        turned = ~mine[first] & mine[second]
        bound[second[turned], first[turned]] = bound[first[turned], second[turned]]
        self._bound = bound[self._mine]

    def at_margin(self, margin: float) -> SelfClearance:
        """Return the same with another distance, up to APART, where the source keeps more [m]."""
        other = copy.copy(self)
        other.margin = margin
        return other

    def lacking(self, pose: Pose, qpos: Array, frames: Index) -> Inequalities:
        """Return what poses (n, nq) at ``frames`` (n,) of the source lack of the distances."""
        assert pose.geom_xpos is not None and pose.geom_xmat is not None
        changed = np.abs(qpos - self._source.qpos[frames]) > _STILL
        frame, pair = self._close_pairs(pose.geom_xpos, pose.geom_xmat, changed)
        distance, ends = self._distances(pose.geom_xpos, pose.geom_xmat, frame, pair)
        near = distance < self.margin - _SLACK
        frame, pair, distance, ends = frame[near], pair[near], distance[near], ends[near]
        kept = np.minimum(self._in_source(frames[frame], pair), self.margin)
        length = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
        broken = (distance < kept - _SLACK) & (length > 1e-6)
        frame, pair, distance, ends = frame[broken], pair[broken], distance[broken], ends[broken]
        normal = (ends[:, 0] - ends[:, 1]) / length[broken, None]
        normal *= np.where(distance >= 0.0, 1.0, -1.0)[:, None]
        body = self.model.geom_bodyid[pair]
        rows = pose.rows(frame, ends[:, 0], body[:, 0], normal)
        rows -= pose.rows(frame, ends[:, 1], body[:, 1], normal)
        return Inequalities(frame, rows, kept[broken] - distance, distance)

    def _in_source(self, frames: Index, pair: Index) -> Array:
        """Distances (m,) of pairs (m, 2) at frames (m,) of the source [m]."""
        wanted, row = np.unique(frames, return_inverse=True)
        if len(wanted) == 0:
            return np.empty(0)
        pose = self._kinematics.forward(self._source.qpos[wanted], np.arange(len(wanted)))
        assert pose.geom_xpos is not None and pose.geom_xmat is not None
        return self._distances(pose.geom_xpos, pose.geom_xmat, row.ravel(), pair)[0]

    def _close_pairs(
        self, xpos: Array, xmat: Array, changed: NDArray[np.bool_]
    ) -> tuple[Index, Index]:
        """Frame (m,) and geoms (m, 2) of pairs whose bounding boxes come within the margin.

        A pair with no joint between them ``changed`` (n, nq) is as far apart as in the source.
        """
        geoms = self._geoms
        place = (xpos[:, geoms] - xpos[:, geoms[:1]]).astype(np.float32)
        square = np.einsum("fgi,fgi->fg", place, place)[..., None]
        one = np.ones_like(square)
        # |a - b|² of every two geoms, as one product.
        ours = np.concatenate((-2.0 * place, square, one), axis=2)[:, self._mine]
        theirs = np.concatenate((place, one, square), axis=2)
        counts = np.asarray((self._between & changed.any(axis=0)).any(axis=1))[self._number]
        bound = np.where(counts, self._bound, -1.0).astype(np.float32)
        frame, first, second = np.nonzero(ours @ np.swapaxes(theirs, 1, 2) < bound)
        between = self._between[self._number[first, second]]
        other_than = (changed[frame] & between).any(axis=1)
        frame, first, second = frame[other_than], first[other_than], second[other_than]
        pair = np.sort(np.column_stack((geoms[self._mine[first]], geoms[second])), axis=1)
        # Boxes apart along an axis of the first, then of those that are not, of the second.
        for mine, other in ((0, 1), (1, 0)):
            near = self._along_axes(xpos, xmat, frame, pair[:, mine], pair[:, other])
            frame, pair = frame[near], pair[near]
        return frame, pair

    def _along_axes(
        self, xpos: Array, xmat: Array, frame: Index, mine: Index, other: Index
    ) -> NDArray[np.bool_]:
        """Whether boxes around geoms come within the margin along all axes of the one's box."""
        box = self.model.geom_aabb
        turn = np.swapaxes(xmat[frame, mine], 1, 2)
        mutual = turn @ xmat[frame, other]
        apart = (turn @ (xpos[frame, other] - xpos[frame, mine])[..., None])[..., 0]
        apart += (mutual @ box[other, :3, None])[..., 0] - box[mine, :3]
        extent = (np.abs(mutual) @ box[other, 3:, None])[..., 0] + box[mine, 3:]
        return np.asarray((np.abs(apart) < extent + self.margin).all(axis=1))

    def _distances(
        self, xpos: Array, xmat: Array, frame: Index, pair: Index
    ) -> tuple[Array, Array]:
        """Signed distances (m,) and nearest points (m, 2, 3) of pairs, no further than matters."""
        distance, ends = np.empty(len(frame)), np.zeros((len(frame), 6))
        model, data, limit = self.model, self._data, self.margin + 0.01
        last = -1
        # MuJoCo measures one pair a call; the pairs left here are few.
        for number, (row, (first, second)) in enumerate(
            zip(frame.tolist(), pair.tolist(), strict=True)
        ):
            if row != last:
                last = row
                data.geom_xpos[:], data.geom_xmat[:] = xpos[row], xmat[row].reshape(-1, 9)
            distance[number] = mujoco.mj_geomDistance(
                model, data, first, second, limit, ends[number]
            )
        return distance, ends.reshape(-1, 2, 3)


def self_pairs(model: mujoco.MjModel) -> Index:
    """Return the pairs (p, 2) of a character's colliding geoms that are to keep clear.

    Not those of one body, of a body and its parent, or of two bodies on one parent, which joints
    hold together; nor those with one body between them that touch as the model is drawn.
    """
    geoms = character_geoms(model, colliding=True)
    first, second = (geoms[side] for side in np.triu_indices(len(geoms), 1))
    body, other = model.geom_bodyid[first], model.geom_bodyid[second]
    parent = model.body_parentid
    held = (body == other) | (parent[body] == other) | (parent[other] == body)
    held |= parent[body] == parent[other]
    near = _tree_distance(model)[body, other] <= _JOINED
    # A thigh that hangs from the pelvis reaches into the belly above it, and the like.
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for number in np.flatnonzero(near & ~held):
        gap = mujoco.mj_geomDistance(
            model, data, int(first[number]), int(second[number]), APART, None
        )
        held[number] = gap < 0.0
    return np.column_stack((first, second))[~held]


def _tree_distance(model: mujoco.MjModel) -> Index:
    """Return how many joints' bodies are between every two bodies (nbody, nbody), plus one."""
    above = np.zeros((model.nbody, model.nbody), dtype=bool)
    for body in range(model.nbody):
        up = body
        while up > 0:
            above[body, up] = True
            up = int(model.body_parentid[up])
    shared = (above[:, None] & above[None]).sum(axis=2)
    depth = above.sum(axis=1)
    return np.asarray(depth[:, None] + depth[None] - 2 * shared)


def _joints_between(model: mujoco.MjModel, geoms: Index) -> tuple[NDArray[np.bool_], Index]:
    """Return which numbers of qpos (k, nq) are between two bodies, and k for geoms (g, g)."""
    bodies, which = np.unique(model.geom_bodyid[geoms], return_inverse=True)
    moves = np.array([body_dofs(model, int(body)) for body in bodies])
    size = np.diff([*model.jnt_qposadr.tolist(), model.nq])
    joint_moves = moves[:, model.jnt_dofadr]
    numbers = np.repeat(joint_moves, size, axis=1)
    between = numbers[:, None] ^ numbers[None]
    number = which[:, None] * len(bodies) + which[None]
    return between.reshape(-1, model.nq), number
