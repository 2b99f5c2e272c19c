"""A motion between its frames."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.body.character import quaternion_addresses
from mjmotion.body.motion import Motion
from mjmotion.numerics.rotations import continuous, normalized

Array = NDArray[np.float64]


def sample(motion: Motion, at: ArrayLike) -> Array:
    """Return poses (n, nq) of a motion at places (n,) between its frames, by cubic splines.

    Quaternions are interpolated as four numbers, made continuous first and normalised after: at
    the rates of motions the turn from frame to frame is small, and so the error of that.

    Args:
      motion: the motion.
      at: (n,) frames, whole or not; before the first and after the last, the motion stands still.
    """
    from scipy.interpolate import CubicSpline

    at = np.clip(np.asarray(at, dtype=np.float64), 0.0, motion.nframe - 1.0)
    if motion.nframe == 1:
        return np.repeat(motion.qpos, len(at), axis=0)
    columns = np.array(quaternion_addresses(motion.model))[:, None] + np.arange(4)
    qpos = np.array(motion.qpos)
    qpos[:, columns] = continuous(qpos[:, columns])
    values = np.asarray(CubicSpline(np.arange(motion.nframe), qpos)(at))
    values[:, columns] = normalized(values[:, columns])
    return values
