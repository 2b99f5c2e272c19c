"""Joint limits: swing and twist of balls, how far limits are broken, and putting joints back.

A ball joint's quaternion splits as ``q = q_swing * q_twist``: first a twist about the body's own
z-axis (the bone), then a swing whose rotation vector ``(x, y, 0)`` has no z-part. A model says a
box of limits for the three numbers ``(swing_x, swing_y, twist_z)`` with a custom numeric named
``limit_<joint>``: ``xmin xmax ymin ymax zmin zmax`` [rad]. A ball without it obeys MuJoCo's own
``range`` on its total angle; hinges and slides obey their ``range``.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.exceptions import ModelError

_BALL = int(mujoco.mjtJoint.mjJNT_BALL)
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)

LIMIT_PREFIX = "limit_"
"""Of the names of custom numerics that say the box of limits of a ball joint."""


def swing_twist(quat: ArrayLike) -> NDArray[np.float64]:
    """Split quaternions into swing and twist about the local z-axis.

    Args:
      quat: (..., 4) unit quaternions wxyz.

    Returns:
      (..., 3): swing_x, swing_y [rad] (rotation vector of the swing, length at most pi) and
      twist [rad] in (-pi, pi]. At a swing of exactly pi the twist is not defined and returned as 0.
    """
    quat = np.asarray(quat, dtype=np.float64)
    w, x, y, z = quat[..., 0], quat[..., 1], quat[..., 2], quat[..., 3]
    half = np.arctan2(z, w)
    cos, sin = np.cos(half), np.sin(half)
    # q * conj(twist); its w is hypot(w, z) >= 0, so the swing's half angle is in [0, pi/2].
    swing_x, swing_y = x * cos - y * sin, x * sin + y * cos
    length = np.hypot(swing_x, swing_y)
    angle = 2 * np.arctan2(length, np.hypot(w, z))
    factor = np.where(length > 1e-12, angle / np.maximum(length, 1e-12), 2.0)
    angles = np.empty((*factor.shape, 3))
    np.multiply(swing_x, factor, out=angles[..., 0])
    np.multiply(swing_y, factor, out=angles[..., 1])
    np.subtract(np.pi, np.mod(np.pi - 2 * half, 2 * np.pi), out=angles[..., 2])
    return angles


def from_swing_twist(angles: ArrayLike) -> NDArray[np.float64]:
    """Build quaternions from swing and twist, the inverse of :func:`swing_twist`.

    Args:
      angles: (..., 3): swing_x, swing_y, twist [rad].

    Returns:
      (..., 4) unit quaternions wxyz.
    """
    x, y, twist = np.moveaxis(np.asarray(angles, dtype=np.float64), -1, 0)
    half = np.hypot(x, y) / 2
    cos, sinc = np.cos(half), np.sinc(half / np.pi) / 2
    ct, st = np.cos(twist / 2), np.sin(twist / 2)
    sx, sy = x * sinc, y * sinc
    return np.stack([cos * ct, sx * ct + sy * st, sy * ct - sx * st, cos * st], axis=-1)


class JointLimits:
    """The limits of a model's joints, found once.

    Args:
      model: the model; limits as in the module's description.

    Attributes:
      boxes: ball joint id to (3, 2) array: lower and upper limit [rad] of swing_x, swing_y and
        twist_z, for the balls that have one.
      names: a name for each column of :meth:`excess`: the joint, and which of its angles.

    Raises:
      ModelError: a numeric ``limit_<joint>`` names no ball, or is not six ordered numbers.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        self.boxes = _ball_boxes(model)
        self._limited = [
            joint
            for joint in range(model.njnt)
            if model.jnt_type[joint] != _FREE and (joint in self.boxes or model.jnt_limited[joint])
        ]
        self._straight = [joint for joint in self._limited if model.jnt_type[joint] != _BALL]
        self._plain_balls = [
            joint
            for joint in self._limited
            if joint not in self.boxes and model.jnt_type[joint] == _BALL
        ]
        self._turns = model.jnt_qposadr[list(self.boxes)][:, None] + np.arange(4)
        self._bounds = np.array(list(self.boxes.values())).reshape(-1, 3, 2)
        self._columns: dict[int, slice] = {}
        self.names: list[str] = []
        for joint in self._limited:
            name, first = model.joint(joint).name, len(self.names)
            parts = ("swing_x", "swing_y", "twist")
            self.names += [f"{name}.{part}" for part in parts] if joint in self.boxes else [name]
            self._columns[joint] = slice(first, len(self.names))
        self._box_columns = self._columns_of(list(self.boxes))
        self._straight_columns = self._columns_of(self._straight)

    def _columns_of(self, joints: list[int]) -> NDArray[np.int64]:
        every = np.arange(len(self.names))
        return np.concatenate([every[:0], *(every[self._columns[joint]] for joint in joints)])

    def excess(self, qpos: ArrayLike) -> NDArray[np.float64]:
        """Return how far every limit is broken, 0 inside.

        Args:
          qpos: (nframe, nq), quaternions normalised.

        Returns:
          (nframe, nlimit) [rad], or [m] for slides; the columns are named by :attr:`names`:
          one per limited hinge, slide or ball with a plain range, three per ball with a box.
        """
        model = self.model
        qpos = np.atleast_2d(np.asarray(qpos, dtype=np.float64))
        found = np.empty((len(qpos), len(self.names)))
        # All joints of a kind at once: there are more joints than steps.
        if self.boxes:
            angles = swing_twist(qpos[:, self._turns])
            over = np.maximum(self._bounds[..., 0] - angles, angles - self._bounds[..., 1])
            found[:, self._box_columns] = over.reshape(len(qpos), -1)
        straight = qpos[:, model.jnt_qposadr[self._straight]]
        low, high = model.jnt_range[self._straight].T
        found[:, self._straight_columns] = np.maximum(low - straight, straight - high)
        for joint in self._plain_balls:
            at = model.jnt_qposadr[joint]
            angle = _ball_angle(qpos[:, at : at + 4])
            found[:, self._columns[joint].start] = np.maximum(
                -angle, angle - model.jnt_range[joint, 1]
            )
        return np.maximum(found, 0.0, out=found)

    def clamp(self, qpos: ArrayLike) -> NDArray[np.float64]:
        """Return ``qpos`` (nframe, nq) with every joint moved to the nearest point of its limits.

        Frames and joints already inside are returned bit for bit as they were.
        """
        model = self.model
        result = np.array(np.atleast_2d(np.asarray(qpos, dtype=np.float64)))
        columns = model.jnt_qposadr[self._straight]
        result[:, columns] = np.clip(result[:, columns], *model.jnt_range[self._straight].T)
        if self.boxes:
            # All boxes at once: frames are many and joints few, and most are inside.
            angles = swing_twist(result[:, self._turns])
            inside = np.minimum(np.maximum(angles, self._bounds[..., 0]), self._bounds[..., 1])
            frame, ball = np.nonzero((inside != angles).any(axis=2))
            if len(frame):
                where = (frame[:, None], self._turns[ball])
                result[where] = _same_side(from_swing_twist(inside[frame, ball]), result[where])
        for joint in self._plain_balls:
            quat = result[:, model.jnt_qposadr[joint] : model.jnt_qposadr[joint] + 4]
            angle, most = _ball_angle(quat), model.jnt_range[joint, 1]
            bad = angle > most
            axis = quat[bad, 1:] / np.linalg.norm(quat[bad, 1:], axis=1, keepdims=True)
            sign = np.where(quat[bad, :1] < 0, -1.0, 1.0)
            cos, sin = np.cos(most / 2), np.sin(most / 2)
            clamped = np.concatenate([np.full_like(sign, cos), axis * sign * sin], axis=1)
            quat[bad] = _same_side(clamped, quat[bad])
        return result


def _ball_boxes(model: mujoco.MjModel) -> dict[int, NDArray[np.float64]]:
    """Return the swing and twist box of every ball that has one; see :class:`JointLimits`."""
    boxes: dict[int, NDArray[np.float64]] = {}
    for index in range(model.nnumeric):
        name = model.numeric(index).name
        if not name.startswith(LIMIT_PREFIX):
            continue
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name.removeprefix(LIMIT_PREFIX))
        if joint < 0 or model.jnt_type[joint] != _BALL:
            raise ModelError(f"numeric '{name}' names no ball joint: name it limit_<ball joint>")
        data = np.array(model.numeric(index).data, dtype=np.float64)
        if data.shape != (6,) or (data[::2] > data[1::2]).any():
            raise ModelError(
                f"numeric '{name}' must be xmin xmax ymin ymax zmin zmax [rad], each min <= max"
            )
        boxes[joint] = data.reshape(3, 2)
    return boxes


def _same_side(quat: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return quaternions with the signs that bring them close to others as numbers too."""
    flip = (quat * other).sum(axis=1, keepdims=True) < 0
    return np.where(flip, -quat, quat)


def _ball_angle(quat: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the total angle [rad] in [0, pi] of quaternions (nframe, 4)."""
    return 2 * np.arctan2(np.linalg.norm(quat[:, 1:], axis=1), np.abs(quat[:, 0]))
