"""How far joints are beyond their limits.

A hinge or slide has MuJoCo's own ``range``, and a ball too: the largest angle of its whole
rotation. A custom numeric ``limit_<ball joint>`` says more of a ball: ``xmin xmax ymin ymax zmin
zmax`` [rad], bounds of its swing about x, its swing about y, and its twist about z. The twist is a
turn about the child's own z-axis, and the swing, whose rotation vector has no z, then tilts that
axis.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.exceptions import ModelError

Array = NDArray[np.float64]
_Joint = mujoco.mjtJoint
_PREFIX = "limit_"
_PARTS = (".swing_x", ".swing_y", ".twist")
_UNTURNED = 1e-14  # less of the z-axis than this aside is no direction to have swung in


def limit_excess(model: mujoco.MjModel, qpos: Array) -> tuple[Array, tuple[str, ...]]:
    """Return how far every limited joint is beyond its limits.

    Args:
      model: the model.
      qpos: (nframe, nq) poses, quaternions of unit length.

    Returns:
      excess: (nframe, nlimit) [rad], [m] for slides; 0 within the limits.
      names: (nlimit,) the joint of each column; three columns are a ball's with a numeric, and
        named ``.swing_x``, ``.swing_y`` and ``.twist`` after it.

    Raises:
      ModelError: a numeric of such a name is not a ball's, or not three ranges.
    """
    boxes = _swing_twist_ranges(model)
    angles, low, high, names = [np.empty((len(qpos), 0))], [], [], []
    for joint in range(model.njnt):
        kind, name = model.jnt_type[joint], model.joint(joint).name
        first, span = int(model.jnt_qposadr[joint]), model.jnt_range[joint]
        if joint in boxes:
            angles.append(_swing_twist(qpos[:, first : first + 4]))
            low += [least for least, _ in boxes[joint]]
            high += [most for _, most in boxes[joint]]
            names += [name + part for part in _PARTS]
        elif model.jnt_limited[joint] and kind != _Joint.mjJNT_FREE:
            ball = kind == _Joint.mjJNT_BALL
            value = _whole_angle(qpos[:, first : first + 4]) if ball else qpos[:, first]
            angles.append(value[:, None])
            low.append(0.0 if ball else float(span[0]))
            high.append(float(span[1]))
            names.append(name)
    value = np.concatenate(angles, axis=1)
    beyond = np.fmax(np.array(low) - value, value - np.array(high))
    return np.asarray(beyond.clip(min=0.0)), tuple(names)


def _swing_twist_ranges(model: mujoco.MjModel) -> dict[int, list[tuple[float, float]]]:
    """Return the three ranges [rad] of every ball joint's id that has a numeric."""
    ranges = {}
    for number in range(model.nnumeric):
        name = model.numeric(number).name
        if not name.startswith(_PREFIX):
            continue
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name[len(_PREFIX) :])
        if joint == -1 or model.jnt_type[joint] != _Joint.mjJNT_BALL:
            raise ModelError(f"numeric '{name}' is of no ball joint: name it limit_<ball joint>")
        values = model.numeric(number).data.tolist()
        pairs = list(zip(values[0::2], values[1::2], strict=False))
        if len(values) != 6 or any(least > most for least, most in pairs):
            raise ModelError(
                f"numeric '{name}' has to be three ranges, xmin xmax ymin ymax zmin zmax [rad]"
            )
        ranges[joint] = pairs
    return ranges


def _swing_twist(quat: Array) -> Array:
    """Return swing about x, swing about y and twist (n, 3) [rad] of unit quaternions (n, 4).

    The swing is the shortest turn that brings the z-axis to where the rotation brings it.
    """
    w, x, y, z = quat.T
    aside_x, aside_y = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x)
    aside = np.hypot(aside_x, aside_y)
    angle = 2.0 * np.arctan2(np.hypot(x, y), np.hypot(w, z))  # of the z-axis from upright
    # The axis is level and square to the way the z-axis goes; turned over, it goes no way at all.
    over = (aside < _UNTURNED) & (angle > 1.0)
    axis_x, axis_y = np.where(over, x, -aside_y), np.where(over, y, aside_x)
    length = np.hypot(axis_x, axis_y)
    # A swing too small to have a direction: what turns the z-axis aside is its rotation vector.
    rate = np.where(length > _UNTURNED, angle / np.maximum(length, _UNTURNED), 1.0)
    twist = 2.0 * np.arctan2(np.where(w < 0.0, -z, z), np.abs(w))
    return np.stack((axis_x * rate, axis_y * rate, np.where(twist <= -np.pi, np.pi, twist)), axis=1)


def _whole_angle(quat: Array) -> Array:
    """Return the angle (n,) in 0 to π [rad] that unit quaternions (n, 4) turn by."""
    return np.asarray(2.0 * np.arctan2(np.sqrt((quat[:, 1:] ** 2).sum(axis=1)), np.abs(quat[:, 0])))
