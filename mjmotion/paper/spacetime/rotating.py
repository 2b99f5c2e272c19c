"""How rotations answer to small changes: derivatives of exp, of log, and of swing and twist.

``exp(v + dv) = exp(v) exp(J_r(v) dv)`` to first order defines the right Jacobian J_r. All functions
work on any leading shape.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SMALL = 1e-3  # angle below which series are exact to rounding [rad]


def right_jacobian(vector: Array) -> Array:
    """Return J_r (..., 3, 3) of rotation vectors (..., 3) [rad]."""
    square = np.sum(vector * vector, axis=-1)
    small = square < _SMALL**2
    s = np.where(small, 1.0, square)
    a = np.sqrt(s)
    first = np.where(small, 0.5 - square / 24.0, (1.0 - np.cos(a)) / s)
    second = np.where(small, 1.0 / 6.0 - square / 120.0, (a - np.sin(a)) / (s * a))
    skew = _skew(vector)
    return np.asarray(
        np.eye(3) - first[..., None, None] * skew + second[..., None, None] * (skew @ skew)
    )


def inverse_right_jacobian(vector: Array) -> Array:
    """Return J_r⁻¹ (..., 3, 3): ``log(exp(v) exp(δ)) = v + J_r⁻¹(v) δ``, for ``|v| < 2π``."""
    square = np.sum(vector * vector, axis=-1)
    small = square < _SMALL**2
    s = np.where(small, 1.0, square)
    half = 0.5 * np.sqrt(s)
    # 1/s - (1 + cos a) / (2 a sin a), written without the zero of the sine at a = π
    exact = (1.0 - half * np.cos(half) / np.sin(half)) / s
    second = np.where(small, 1.0 / 12.0 + square / 720.0, exact)
    skew = _skew(vector)
    return np.asarray(np.eye(3) + 0.5 * skew + second[..., None, None] * (skew @ skew))


def swing_twist_jacobian(quat: Array) -> Array:
    """Return how swing_x, swing_y and twist change when balls turn about their own axes.

    Args:
      quat: (..., 4) unit quaternions wxyz.

    Returns:
      (..., 3, 3): d(``swing_twist``) / dδ for ``quat exp(δ)`` at δ = 0; zero at a swing of π, where
      neither its direction nor the twist is defined.
    """
    w, x, y, z = np.moveaxis(quat, -1, 0)
    real, swung = np.hypot(w, z), np.hypot(x, y)
    lost = real < 1e-9
    real = np.where(lost, 1.0, real)
    # swing = factor (x w - y z, x z + y w), factor = angle / (swung real), as in
    # body.joint_limits.swing_twist
    near = swung < 1e-6
    sine = np.where(near, 1.0, swung)
    factor = np.where(near, 2.0 / real**2, 2.0 * np.arctan2(sine, real) / (sine * real))
    by_swung = np.where(near, 0.0, (2.0 - factor) / sine)
    by_real = np.where(near, -4.0 / real**3, -(2.0 + factor) / real)
    zero = np.zeros_like(w)
    d_swung = np.stack((zero, x, y, zero), axis=-1) / sine[..., None]
    d_real = np.stack((w, zero, zero, z), axis=-1) / real[..., None]
    d_factor = by_swung[..., None] * d_swung + by_real[..., None] * d_real
    along = np.stack((x * w - y * z, x * z + y * w), axis=-1)
    of_along = np.stack(
        (np.stack((x, w, -z, -y), axis=-1), np.stack((y, z, w, x), axis=-1)), axis=-2
    )
    by_swing = factor[..., None, None] * of_along + along[..., None] * d_factor[..., None, :]
    by_twist = 2.0 * np.stack((-z, zero, zero, w), axis=-1) / (real**2)[..., None]
    by_quat = np.concatenate((by_swing, by_twist[..., None, :]), axis=-2)
    by_turn = 0.5 * np.stack(
        (
            np.stack((-x, -y, -z), axis=-1),
            np.stack((w, -z, y), axis=-1),
            np.stack((z, w, -x), axis=-1),
            np.stack((-y, x, w), axis=-1),
        ),
        axis=-2,
    )
    return np.asarray(np.where(lost[..., None, None], 0.0, by_quat @ by_turn))


def _skew(vector: Array) -> Array:
    x, y, z = np.moveaxis(vector, -1, 0)
    zero = np.zeros_like(x)
    rows = ((zero, -z, y), (z, zero, -x), (-y, x, zero))
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
