"""How deep parts of the character are in one another."""

from __future__ import annotations

import copy
import dataclasses

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclasses.dataclass(frozen=True, eq=False)
class Overlaps:
    """Where two bodies of the character overlap, one entry for each geom's contact.

    Attributes:
      frame: (n,) the frame.
      pair: (n,) the two bodies, as one number: the lower id times ``nbody`` plus the other.
      depth: (n,) how deep they are in each other [m].
    """

    frame: Index
    pair: Index
    depth: Array


class SelfOverlap:
    """The character's geoms that collide, each with all others that are to keep clear of it.

    No pair are two bodies of which one hangs from the other, two that hang from the same body (both
    thighs), and a body with that of its parent's parent where the two are in one another at
    ``qpos0``: their shapes reach over the body between them.

    Args:
      model: the model.
      geoms: ids of the character's geoms that collide.
    """

    def __init__(self, model: mujoco.MjModel, geoms: Index) -> None:
        self._model = copy.copy(model)
        owners = np.unique(model.geom_bodyid[geoms])
        for bits, own in (
            (self._model.geom_contype, geoms),
            (self._model.geom_conaffinity, geoms),
            (self._model.body_contype, owners),
            (self._model.body_conaffinity, owners),
        ):
            bits[:] = 0
            bits[own] = 1
        self._model.geom_margin[:] = 0.0
        self._model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        self._body = np.array(model.geom_bodyid, dtype=np.int64)
        self._geoms = geoms
        self._allowed = np.empty(0, np.int64)
        resting = np.unique(self.overlaps(model.qpos0[None]).pair)
        over = model.body_parentid[model.body_parentid[resting % model.nbody]]
        self._allowed = resting[over == resting // model.nbody]

    def overlaps(self, qpos: Array) -> Overlaps:
        """Return what is in one another in poses (n, nq)."""
        model, data = self._model, mujoco.MjData(self._model)
        frames, geoms, depths = [], [np.empty((0, 2), np.int64)], [np.empty(0)]
        for frame, pose in enumerate(qpos):  # MuJoCo collides one pose at a time
            data.qpos[:] = pose
            mujoco.mj_kinematics(model, data)
            mujoco.mj_collision(model, data)
            if data.ncon:
                frames.append(np.full(data.ncon, frame))
                geoms.append(np.array(data.contact.geom, dtype=np.int64))
                depths.append(-np.array(data.contact.dist))
        frame_of = np.concatenate(frames) if frames else np.empty(0, np.int64)
        both, depth = np.concatenate(geoms), np.concatenate(depths)
        body = self._body[both]
        first, second = body.min(axis=1), body.max(axis=1)
        pair = first * model.nbody + second
        weld, parent = model.body_weldid, model.body_parentid
        up = [weld[parent[weld[one]]] for one in (first, second)]
        near = (up[0] == weld[second]) | (up[1] == weld[first]) | (up[0] == up[1])
        # Pairs that the model names collide whatever their bits are, with the scene too.
        mine = np.isin(both, self._geoms).all(axis=1)
        keep = (
            mine
            & (depth > 0)
            & ~near
            & (weld[first] != weld[second])
            & ~np.isin(pair, self._allowed)
        )
        return Overlaps(frame_of[keep], pair[keep], depth[keep])

    def names(self, pair: int) -> str:
        """Return the two bodies of a pair, as words."""
        first, second = divmod(pair, self._model.nbody)
        return f"{self._model.body(first).name} in {self._model.body(second).name}"


def beyond(own: Overlaps, source: Overlaps) -> Array:
    """Return how much deeper (n,) each overlap is than its pair ever is in the source [m]."""
    pairs, place = np.unique(np.concatenate((own.pair, source.pair)), return_inverse=True)
    most = np.zeros(len(pairs))
    np.maximum.at(most, place[len(own.pair) :], source.depth)
    return np.asarray(np.maximum(own.depth - most[place[: len(own.pair)]], 0.0))
