"""Joints' ranges: the angles that have one, how far they are out, and how they answer to d."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.character import Character
from mjmotion.body.joint_limits import swing_twist
from mjmotion.numerics.rotations import log
from mjmotion.paper.spacetime.rotating import swing_twist_jacobian

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

_BALL, _FREE = int(mujoco.mjtJoint.mjJNT_BALL), int(mujoco.mjtJoint.mjJNT_FREE)


def turning_threes(model: mujoco.MjModel, dofs: Rows) -> Rows:
    """Return places (nball, 3) in ``dofs`` of the root's rotation and of the balls."""
    found = []
    for joint in range(model.njnt):
        first = model.jnt_dofadr[joint] + (3 if model.jnt_type[joint] == _FREE else 0)
        if model.jnt_type[joint] in (_FREE, _BALL) and first in dofs:
            found.append(np.searchsorted(dofs, first) + np.arange(3))
    return np.array(found, dtype=np.int64).reshape(-1, 3)


class Ranges:
    """Angles that have a range, of joints that serve: hinges, swings and twists, whole angles."""

    def __init__(self, character: Character, dofs: Rows, turning: Rows) -> None:
        model, boxes = character.model, character.limits.boxes
        self._width, self._turning = len(dofs), turning
        self._parts: list[tuple[int, int, int]] = []  # qpos address, place in dofs, kind
        bounds: list[Array] = [np.empty((0, 2))]
        kinds: list[int] = []
        for joint in range(model.njnt):
            first = np.flatnonzero(dofs == model.jnt_dofadr[joint])
            kind = model.jnt_type[joint]
            if len(first) == 0 or kind == _FREE:
                continue
            address, place = int(model.jnt_qposadr[joint]), int(first[0])
            if joint in boxes:
                self._parts.append((address, place, 3))
                bounds.append(boxes[joint])
                kinds += 3 * [len(self._parts) - 1]
            elif model.jnt_limited[joint]:
                ball = kind == _BALL
                self._parts.append((address, place, 2 if ball else 1))
                low, high = model.jnt_range[joint]
                bounds.append(np.array([[-1.0 if ball else low, high]]))
                kinds.append(len(self._parts) - 1)
        self.bounds = np.concatenate(bounds)
        self._part = np.array(kinds, dtype=np.int64)

    def angles(self, qpos: Array) -> Array:
        """Return the angles (n, l) of poses (n, nq) [rad]."""
        found = [np.empty((len(qpos), 0))]
        for address, _, kind in self._parts:
            if kind == 1:
                found.append(qpos[:, address : address + 1])
            elif kind == 2:
                turn = log(qpos[:, address : address + 4])
                found.append(np.linalg.norm(turn, axis=1, keepdims=True))
            else:
                found.append(swing_twist(qpos[:, address : address + 4]))
        return np.concatenate(found, axis=1)

    def out(self, angles: Array) -> Array:
        """Return how far angles are out of their ranges, negative below [rad]."""
        return np.asarray(angles - np.clip(angles, *self.bounds.T))

    def rows(self, qpos: Array, right: Array, frame: Rows, column: Rows) -> Array:
        """Return derivatives (m, k) of single angles by their frame's displacement."""
        rows = np.zeros((len(frame), self._width))
        for number, (address, place, kind) in enumerate(self._parts):
            mine = np.flatnonzero(self._part[column] == number)
            if len(mine) == 0:
                continue
            if kind == 1:
                rows[mine, place] = 1.0
                continue
            quat = qpos[frame[mine], address : address + 4]
            if kind == 2:
                turn = log(quat)
                by_turn = turn / np.maximum(np.linalg.norm(turn, axis=1, keepdims=True), 1e-12)
            else:
                first = int(np.flatnonzero(self._part == number)[0])
                by_turn = swing_twist_jacobian(quat)[np.arange(len(mine)), column[mine] - first]
            ball = int(np.flatnonzero(self._turning[:, 0] == place)[0])
            chain = (by_turn[:, None] @ right[frame[mine], ball])[:, 0]
            rows[mine[:, None], place + np.arange(3)] = chain
        return rows
