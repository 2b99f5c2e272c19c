"""Curves over frames that must pass through some values, or stay above them, and are else smooth.

Both are least-squares problems with a banded matrix, so their cost is linear in frames.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

_DIFFERENCES = (
    np.array((1.0,)),
    np.array((-1.0, 1.0)),
    np.array((1.0, -2.0, 1.0)),
    np.array((-1.0, 3.0, -3.0, 1.0)),
)
_ROUNDS = 60
_HALVINGS = 12
_SETTLED = 1e-7  # a Newton step this small ends the search [m]
_RAISES = 8
_STIFF = 30.0  # penalty for a curve below what is needed, against its own stiffness
_ABOVE = 1e-4  # how far below a wanted height a curve may stay [m]


def _energy(nframe: int, weights: tuple[float, float, float, float]) -> Array:
    """Lower band (4, nframe) of Σ_k weights[k] D_kᵀ D_k, with D_k the k-th difference."""
    band = np.zeros((4, nframe))
    for order, weight in enumerate(weights):
        window = _DIFFERENCES[order]
        for i in range(order + 1):
            for j in range(i + 1):
                band[i - j, j : nframe - order + j] += weight * window[i] * window[j]
    return band


def _solve(band: Array, right: Array, fixed: NDArray[np.bool_], values: Array) -> Array:
    """Solve the banded system with some unknowns given."""
    # LAPACK itself: the checks of solveh_banded take longer than it does.
    from scipy.linalg.lapack import dpbsv

    band, right = band.copy(), right.copy()
    free = ~fixed
    known = np.where(fixed[:, None], values, 0.0)
    for offset in range(1, len(band)):
        column = band[offset, : len(fixed) - offset, None]
        right[offset:] -= column * known[:-offset]
        right[:-offset] -= column * known[offset:]
        band[offset, : len(fixed) - offset] *= free[offset:] * free[:-offset]
    band[0, fixed] = 1.0
    right[fixed] = values[fixed]
    _, solved, info = dpbsv(band, right, lower=1, overwrite_ab=1, overwrite_b=1)
    if info != 0:
        raise np.linalg.LinAlgError("the banded matrix is not positive definite")
    return np.asarray(solved)


def fade(fixed: NDArray[np.bool_], values: Array, time: float) -> Array:
    """Return the curves that are ``values`` at the fixed frames and else fade to zero smoothly.

    They minimise ``τ⁴ |Δ²e|² + 2 τ² |Δe|² + |e|²``, whose solutions leave a fixed stretch with its
    own slope and die out as ``exp(-t/τ)``. Following its curvature too would swing far over where a
    contact stops a foot short.

    Args:
      fixed: (nframe,) where values are given.
      values: (nframe, k); only those at fixed frames count.
      time: τ [frames].

    Returns:
      (nframe, k).
    """
    nframe = len(fixed)
    if nframe < 5 or fixed.all() or not fixed.any():
        return np.where(fixed[:, None], values, 0.0)
    band = _energy(nframe, (1.0, 2.0 * time**2, time**4, 0.0))
    return _solve(band, np.zeros_like(values), fixed, values)


def blend(weight: Array, values: Array, time: float) -> Array:
    """Return smooth curves near ``values`` where ``weight`` says so, and near zero elsewhere.

    They minimise ``τ⁶ |Δ³e|² + 3 τ⁴ |Δ²e|² + 3 τ² |Δe|² + |e|² + weight |e − values|²``.

    Args:
      weight: (nframe,) how much the values count against zero and against smoothness.
      values: (nframe, k).
      time: τ [frames].

    Returns:
      (nframe, k).
    """
    nframe = len(weight)
    if nframe < 5:
        return values * (weight / (1.0 + weight))[:, None]
    band = _energy(nframe, (1.0, 3.0 * time**2, 3.0 * time**4, time**6))
    band[0] += weight
    free = np.zeros(nframe, dtype=bool)
    return _solve(band, weight[:, None] * values, free, values)


def follow(values: Array, weight: Array, time: float) -> Array:
    """Return smooth curves that follow values as far as each of them counts.

    They minimise ``τ⁶ |Δ³c|² + Σ weight |c − values|²``: of a wave of f cycles a frame, weights all
    1, ``1 / (1 + (2 τ sin πf)⁶)`` is left, undelayed.

    Args:
      values: (nframe, k).
      weight: (nframe,) above 0.
      time: τ [frames].

    Returns:
      (nframe, k).
    """
    nframe = len(values)
    if nframe < 5:
        return np.array(values)
    band = _energy(nframe, (0.0, 0.0, 0.0, time**6))
    band[0] += weight
    return _solve(band, weight[:, None] * values, np.zeros(nframe, dtype=bool), values)


def envelope(need: Array, fixed: NDArray[np.bool_], time: float) -> Array:
    """Return a smooth curve that is zero at the fixed frames and nowhere below ``need``.

    It minimises ``τ⁶ |Δ³l|² + 3 τ⁴ |Δ²l|² + 3 τ² |Δl|² + |l|²`` over the curves that stay above, to
    within 0.1 mm.

    Args:
      need: (nframe,) least values; -inf or anything negative where nothing is needed.
      fixed: (nframe,) where the curve must be zero; ``need`` does not count there.
      time: τ, the scale of its rise and fall [frames].

    Returns:
      (nframe,) the curve; zero everywhere when nothing is needed.
    """
    nframe = len(need)
    need = np.where(fixed, 0.0, np.maximum(need, 0.0))
    if nframe < 5 or not (need > 0.0).any():
        return np.array(need)
    base = _energy(nframe, (1.0, 3.0 * time**2, 3.0 * time**4, time**6))
    stiffness = _STIFF * base[0].max()
    goal = need.copy()
    curve = np.zeros(nframe)
    for _ in range(_RAISES):
        curve = _penalised(base, goal, fixed, stiffness, curve)
        missing = np.where(fixed, 0.0, need - curve)
        if missing.max() < _ABOVE:
            break
        # Augmented Lagrangian: aim higher by what the penalty let through.
        goal = np.where(goal > curve, goal + np.maximum(missing, 0.0), goal)
        goal = np.maximum(goal, np.where(missing > 0.0, need + missing, goal))
    return np.maximum(curve, 0.0)


def cover(need: Array, time: float) -> Array:
    """Return a smooth curve nowhere below ``need`` nor zero: a sliding maximum, then smoothed.

    Cheaper than :func:`envelope` and broader; for curves that need not be zero anywhere.

    Args:
      need: (nframe,) least values; negative where nothing is needed.
      time: how far on either side a peak is felt [frames].
    """
    from scipy.ndimage import maximum_filter1d, uniform_filter1d

    curve = np.maximum(need, 0.0)
    if not curve.any():
        return curve
    width = max(1, round(time / 3.0))
    curve = maximum_filter1d(curve, 6 * width + 1, mode="nearest")
    # Three boxes, together no wider than the maximum slid: nowhere less than what is needed.
    for _ in range(3):
        curve = uniform_filter1d(curve, 2 * width + 1, mode="nearest")
    return np.maximum(curve, need)


@dataclasses.dataclass(frozen=True, eq=False)
class Bound:
    """What a curve should not be above, or below, at some frames, and what being beyond it costs.

    Attributes:
      value: (nframe,) the bound.
      frames: (nframe,) where it counts.
      price: of a squared unit beyond it, against a squared unit off the values that are followed.
      upper: whether the curve should be below it, and not above.
    """

    value: Array
    frames: NDArray[np.bool_]
    price: float
    upper: bool


def between(values: Array, time: float, bounds: Sequence[Bound] = ()) -> Array:
    """Return the smooth curve that follows values and keeps, as far as it pays, within bounds.

    It minimises ``τ⁶ |Δ³c|² + |c − values|² + Σ price |beyond|²``, a convex quadratic programme
    with a banded matrix, by Newton steps on the bounds that are broken.

    Args:
      values: (nframe,).
      time: τ [frames].
      bounds: what to keep within.

    Returns:
      (nframe,).
    """
    nframe = len(values)
    if nframe < 5:
        return np.array(values)
    base = _energy(nframe, (1.0, 0.0, 0.0, time**6))
    sign = np.array([1.0 if bound.upper else -1.0 for bound in bounds])[:, None]
    value = np.array([bound.value for bound in bounds]).reshape(-1, nframe)
    counts = np.array([bound.frames for bound in bounds], dtype=bool).reshape(-1, nframe)
    counts &= np.isfinite(value)
    level = np.where(counts, value, 0.0)
    price = np.array([bound.price for bound in bounds])[:, None]
    free = np.zeros(nframe, dtype=bool)
    curve = _solve(base, values[:, None], free, values[:, None])[:, 0]
    for _ in range(_ROUNDS):
        active = counts & (sign * (curve - level) > 0.0)
        weight = np.where(active, price, 0.0)
        band, right = base.copy(), values + (weight * level).sum(axis=0)
        band[0] += weight.sum(axis=0)
        direction = _solve(band, right[:, None], free, values[:, None])[:, 0] - curve
        if np.abs(direction).max() < _SETTLED:
            break
        # Along the direction the slope only grows: halve towards where it crosses zero.
        flat = direction @ (_times(base, curve) - values)
        steep = direction @ _times(base, direction)
        low, high = 0.0, 1.0
        for halving in range(_HALVINGS + 1):
            length = 1.0 if halving == 0 else 0.5 * (low + high)
            beyond = np.maximum(sign * (curve + length * direction - level), 0.0)
            pull = (np.where(counts, price * sign * beyond, 0.0) @ direction).sum()
            falling = flat + length * steep + pull < 0.0
            if falling and halving == 0:
                break
            low, high = (length, high) if falling else (low, length)
        curve = curve + length * direction
    return curve


def _penalised(
    base: Array, goal: Array, fixed: NDArray[np.bool_], stiffness: float, start: Array
) -> Array:
    """Minimise ``lᵀ base l + stiffness |max(0, goal − l)|²`` by Newton steps."""
    zero = np.zeros((len(goal), 1))
    curve = start
    for _ in range(_ROUNDS):
        active = ~fixed & (curve < goal)
        band = base.copy()
        band[0, active] += stiffness
        newton = _solve(band, np.where(active, stiffness * goal, 0.0)[:, None], fixed, zero)
        direction = newton[:, 0] - curve
        if np.abs(direction).max() < _SETTLED:
            break
        # Along the direction the slope only grows: halve towards where it crosses zero.
        flat, steep = direction @ _times(base, curve), direction @ _times(base, direction)
        low, high = 0.0, 1.0
        for halving in range(_HALVINGS + 1):
            length = 1.0 if halving == 0 else 0.5 * (low + high)
            below = np.where(fixed, 0.0, np.maximum(goal - curve - length * direction, 0.0))
            falling = flat + length * steep < stiffness * (below @ direction)
            if falling and halving == 0:
                break
            low, high = (length, high) if falling else (low, length)
        curve = curve + length * direction
    return curve


def _times(band: Array, vector: Array) -> Array:
    """Return the product of a symmetric banded matrix (lower form) and a vector."""
    product = band[0] * vector
    for offset in range(1, len(band)):
        side = band[offset, :-offset]
        product[offset:] += side * vector[:-offset]
        product[:-offset] += side * vector[offset:]
    return product


def ease(share: ArrayLike) -> Array:
    """Return the smooth step from 0 at 0 and below to 1 at 1 and above, twice differentiable."""
    s = np.clip(np.asarray(share, dtype=np.float64), 0.0, 1.0)
    return np.asarray(s**3 * (10.0 - 15.0 * s + 6.0 * s * s))
