"""The bow: how a person goes under what is low, hips and trunk first and the knees for the rest.

One curve says how far the trunk is bent forwards at each frame, another how far the root sinks.
Both are smooth, begin and end in good time, and are as small as what hangs overhead allows. The
gaze stays up and the arms hang, and the root goes back by as much as the body would else come
forwards over its feet.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.kinematics import Kinematics, Pose, level_side
from mjmotion.body.mass import centre_of_mass
from mjmotion.body.motion import Motion
from mjmotion.body.parts import Parts
from mjmotion.exceptions import ModelError
from mjmotion.ik.solver import Clearance
from mjmotion.numerics.rotations import cross, rotate
from mjmotion.numerics.smoothing import envelope
from mjmotion.numerics.tangent import oplus

Array = NDArray[np.float64]

DEEPEST = 0.9  # the most that a trunk is bent forwards [rad]
RUNG = 0.1  # steps in which it is tried how far it must be [rad]
BOW_TIME = 0.16  # scale of a bow's rise and fall [s]
EARLY = 0.1  # a bow is whole so long before and after it must be [s]
SINK_TIME = 0.16  # the same of the root's sinking [s]
HIPS = 0.35  # share of a bow that is the hips'; the rest is the spine's
GAZE = 0.45  # share of a bow by which neck and head look up again
HANG = 0.7  # share of a bow that shoulders take back
OVER_FEET = 0.8  # share of the way that the body comes forwards by which the root goes back
_ALONG = 0.7  # of the cosine: a hinge this nearly along the body's own side axis bends it forwards
_ROUNDS = 6
_SLACK = 0.002  # what is still lacking after that is left to others [m]


def bow(motion: Motion, overhead: Clearance) -> Motion:
    """Return the motion bowed under what hangs overhead; itself where nothing is in its way.

    Args:
      motion: the motion, its feet where they are to stand.
      overhead: what lacks a distance from the solids that are passed under.
    """
    frames = np.arange(motion.nframe)
    if len(overhead(motion.qpos, frames).frame) == 0:
        return motion
    try:
        body = _Bowing(motion, motion.character.parts)
    except ModelError:  # no trunk to bend
        return motion
    held, none = np.zeros(motion.nframe, dtype=bool), np.zeros(motion.nframe)
    early = max(1, round(EARLY * motion.fps))
    need, bent, sunk, lower = none, none, none, none
    for _ in range(_ROUNDS):
        qpos = body.posed(bent, sunk)
        lack = _lacking(overhead, qpos, frames)
        if lack.max() < _SLACK:
            break
        low = np.flatnonzero(lack >= _SLACK)
        most, rest = body.least(overhead, low, bent, sunk)
        need, lower = need.copy(), lower.copy()
        need[low] = np.maximum(need[low], most)
        lower[low] = np.maximum(lower[low], sunk[low] + rest)
        bent = envelope(_widened(need, early), held, BOW_TIME * motion.fps)
        sunk = envelope(_widened(lower, early), held, SINK_TIME * motion.fps)
    return motion.replace(motion.character.within_limits(body.posed(bent, sunk)))


def _widened(need: Array, frames: int) -> Array:
    """Return the greatest need within so many frames on either side (nframe,)."""
    from scipy.ndimage import maximum_filter1d

    return np.asarray(maximum_filter1d(need, 2 * frames + 1, mode="nearest"))


def _lacking(overhead: Clearance, qpos: Array, frames: NDArray[np.int64]) -> Array:
    """Return how much poses (n, nq) lack (n,) [m]; 0 where they lack nothing."""
    found = overhead(qpos, frames)
    lack = np.zeros(len(qpos))
    np.maximum.at(lack, found.frame, found.needed)
    return lack


class _Bowing:
    """A body and how it bows."""

    def __init__(self, motion: Motion, parts: Parts) -> None:
        self._motion = motion
        self._kinematics = Kinematics(motion.model, motion.nframe)
        pose = self._kinematics.forward(motion.qpos)
        side = level_side(pose)
        self._forward = cross(side, np.array((0.0, 0.0, 1.0)))
        self._unit = bend_forwards(motion, parts, pose, side)
        self._com = centre_of_mass(pose)

    def posed(self, bent: Array, sunk: Array, rows: NDArray[np.int64] | None = None) -> Array:
        """Return poses (n, nq) bowed by (n,) [rad] and sunk by (n,) [m]; of all frames, or some."""
        rows = np.arange(self._motion.nframe) if rows is None else rows
        model = self._motion.model
        qpos = oplus(model, self._motion.qpos[rows], bent[:, None] * self._unit[rows])
        moved = centre_of_mass(self._kinematics.forward(qpos, rows)) - self._com[rows]
        ahead = (moved * self._forward[rows]).sum(axis=1, keepdims=True)
        qpos[:, :3] -= OVER_FEET * ahead * self._forward[rows]
        qpos[:, 2] -= sunk
        return qpos

    def least(
        self, overhead: Clearance, rows: NDArray[np.int64], bent: Array, sunk: Array
    ) -> tuple[Array, Array]:
        """Return the least bows (n,) [rad] that clear what is overhead, and what they lack (n,)."""
        most, rest = np.array(bent[rows]), np.full(len(rows), np.inf)
        left = np.arange(len(rows))
        for rung in np.arange(1, round(DEEPEST / RUNG) + 1) * RUNG:
            tried = np.maximum(rung, bent[rows[left]])
            qpos = self.posed(tried, sunk[rows[left]], rows[left])
            lack = _lacking(overhead, qpos, rows[left])
            better = lack < rest[left] - _SLACK
            most[left[better]], rest[left[better]] = tried[better], lack[better]
            left = left[lack >= _SLACK]
            if len(left) == 0:
                break
        rest[rest < _SLACK] = 0.0
        return most, rest


def bend_forwards(motion: Motion, parts: Parts, pose: Pose, side: Array) -> Array:
    """Return the displacement (nframe, nv) of a trunk bent forwards by one radian.

    What bends a body turns about one axis of the world, the same for all, so each joint's own share
    stays right whatever the others do.

    Args:
      motion: the motion.
      parts: of its character.
      pose: its poses.
      side: (nframe, 3) the body's level axis to its left.
    """
    model = motion.model
    unit = np.zeros((motion.nframe, model.nv))
    spine = _between(model, [limb.top for limb in parts.arms], parts.trunk)
    neck = [body for body in parts.head if model.body_jntnum[body]]
    shoulders = [limb.upper[0] for limb in parts.arms if limb.upper]
    hips = HIPS if spine else 1.0
    unit[:, 3:6] = hips * np.einsum("nij,ni->nj", pose.xmat[:, model.jnt_bodyid[0]], side)
    for bodies, share in ((spine, 1.0 - hips), (neck, -GAZE)):
        for body in bodies:
            add_turn(unit, pose, body, side, share / len(bodies))
    for body in shoulders:
        add_turn(unit, pose, body, side, -HANG)
    return unit


def _between(model: mujoco.MjModel, tops: Sequence[int], trunk: Sequence[int]) -> list[int]:
    """Return the bodies of the trunk, with joints, that the arms hang from; not the root."""
    found = set()
    for top in tops:
        body = int(model.body_parentid[top])
        while body > 0:
            if model.body_jntnum[body] and body != int(model.jnt_bodyid[0]):
                found.add(body)
            body = int(model.body_parentid[body])
    return sorted(found & set(trunk))


def add_turn(unit: Array, pose: Pose, body: int, side: Array, share: float) -> None:
    """Write into a displacement what turns a body about an axis, where its joints can.

    Args:
      unit: (nframe, nv) the displacement, filled in place.
      pose: every frame.
      body: the body; hinges across the axis stay.
      side: (nframe, 3) the axis, in the world.
      share: by how much [rad].
    """
    model = pose.model
    local = np.einsum("nij,ni->nj", pose.xmat[:, body], side)
    for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
        dof = model.jnt_dofadr[joint]
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_BALL:
            unit[:, dof : dof + 3] = share * local
        elif model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE:
            along = (pose.xaxis[:, joint] * side).sum(axis=1)
            unit[:, dof] = share * np.where(np.abs(along) > _ALONG, along, 0.0)
