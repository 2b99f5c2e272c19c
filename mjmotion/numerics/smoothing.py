"""Curves over frames that must pass through some values, or stay above them, and are else smooth.

Both are least-squares problems with a banded matrix, so their cost is linear in frames.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_DIFFERENCES = (
    np.array((1.0,)),
    np.array((-1.0, 1.0)),
    np.array((1.0, -2.0, 1.0)),
    np.array((-1.0, 3.0, -3.0, 1.0)),
)
_CIRCLES = 6  # times that paying for what is broken may break no fewer bounds
_ROUNDS = 60
_HALVINGS = 12  # towards the least along a direction
_SETTLED = 1e-7  # a Newton step this small ends the search [m]
_RAISES = 8
_STIFF = 30.0  # penalty for a curve below what is needed, against its own stiffness
_ABOVE = 1e-4  # how far below a wanted height a curve may stay [m]


def _energy(nframe: int, weights: tuple[float, float, float, float]) -> Array:
    """Lower band (4, nframe) of Σ_k weights[k] D_kᵀ D_k, with D_k the k-th difference."""
    band = np.zeros((4, nframe), order="F")  # as LAPACK takes it
    for order, weight in enumerate(weights):
        window = _DIFFERENCES[order]
        for i in range(order + 1):
            for j in range(i + 1):
                band[i - j, j : nframe - order + j] += weight * window[i] * window[j]
    return band


def _holding(band: Array, fixed: NDArray[np.bool_]) -> Array:
    """Return the band (4, nframe) with some unknowns' rows those of the identity."""
    free, held = ~fixed, band.copy(order="F")
    for offset in range(1, len(band)):
        held[offset, :-offset] *= free[offset:] * free[:-offset]
    held[0, fixed] = 1.0
    return held


def _solve(band: Array, right: Array) -> Array:
    """Solve the banded system for right-hand sides (nframe, k) or (nframe,); both are overwritten.

    Raises:
      LinAlgError: the matrix is not positive definite.
    """
    # LAPACK itself: the checks of solveh_banded take longer than it does.
    from scipy.linalg.lapack import dpbsv

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
    known = np.where(fixed[:, None], values, 0.0)
    right = np.zeros_like(known)
    for offset in range(1, len(band)):
        column = band[offset, :-offset, None]
        right[offset:] -= column * known[:-offset]
        right[:-offset] -= column * known[offset:]
    right[fixed] = values[fixed]
    return _solve(_holding(band, fixed), right)


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
    return _solve(band, weight[:, None] * values)


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
    return _solve(band, weight[:, None] * values)


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
    start = _solve(base.copy(order="F"), np.array(values))
    if not bounds:
        return start
    sign = np.array([1.0 if bound.upper else -1.0 for bound in bounds])[:, None]
    value = np.array([bound.value for bound in bounds])
    counts = np.array([bound.frames for bound in bounds], dtype=bool) & np.isfinite(value)
    level = np.where(counts, value, 0.0)
    price = np.where(counts, np.array([bound.price for bound in bounds])[:, None], 0.0)

    def broken(curve: Array) -> Mask:
        return counts & (sign * (curve - level) > 0.0)

    def solve(active: Mask) -> Array:
        weight = np.where(active, price, 0.0)
        band = base.copy(order="F")
        band[0] += weight.sum(axis=0)
        return _solve(band, values + (weight * level).sum(axis=0))

    def slope(curve: Array, direction: Array) -> Callable[[float], float]:
        flat = direction @ (_times(base, curve) - values)
        steep = direction @ _times(base, direction)
        over, along = sign * (curve - level), sign * direction

        def at(length: float) -> float:
            beyond = np.maximum(over + length * along, 0.0)
            return float(flat + length * steep + (price * beyond * along).sum())

        return at

    priced = _Priced(broken, solve, slope)
    curve, settled = _exchange(priced, start)
    return curve if settled else _newton(priced, curve)


@dataclasses.dataclass(frozen=True, eq=False)
class _Priced:
    """A convex quadratic programme whose bounds have a price each.

    Attributes:
      broken: which bounds a curve breaks.
      solve: the least curve that pays for some of them, and neither less nor more.
      slope: of what a curve costs along a direction, at a length of it; it only grows.
    """

    broken: Callable[[Array], Mask]
    solve: Callable[[Mask], Array]
    slope: Callable[[Array, Array], Callable[[float], float]]


def _exchange(priced: _Priced, start: Array) -> tuple[Array, bool]:
    """Pay for what is broken, then for what is broken then, until nothing changes.

    Far fewer solves than Newton steps, none of which is measured; but it may go round in circles.

    Args:
      priced: the programme.
      start: a curve that may be near the least.

    Returns:
      The last curve, and whether it is the one of least cost.
    """
    active = priced.broken(start)
    fewest, circles = active.size + 1, 0
    while True:
        curve = priced.solve(active)
        now = priced.broken(curve)
        wrong = int(np.count_nonzero(now != active))
        circles = 0 if wrong < fewest else circles + 1
        if wrong == 0 or circles == _CIRCLES:
            return curve, wrong == 0
        fewest, active = min(wrong, fewest), now


def _newton(priced: _Priced, start: Array) -> Array:
    """Return the curve of least cost, by Newton steps on the bounds that are broken."""
    curve = start
    for _ in range(_ROUNDS):
        direction = priced.solve(priced.broken(curve)) - curve
        if np.abs(direction).max() < _SETTLED:
            break
        length = _where_flat(priced.slope(curve, direction))
        curve = curve + length * direction
    return curve


def _where_flat(slope: Callable[[float], float]) -> float:
    """Return where in (0, 1] a slope that only grows from below 0 is 0, or 1 where it is not."""
    if slope(1.0) <= 0.0:
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if slope(middle) < 0.0 else (low, middle)
    return 0.5 * (low + high)


def _penalised(
    base: Array, goal: Array, fixed: NDArray[np.bool_], stiffness: float, start: Array
) -> Array:
    """Minimise ``lᵀ base l + stiffness |max(0, goal − l)|²``; zero where it is fixed."""
    held, free = _holding(base, fixed), ~fixed
    pull = stiffness * goal

    def broken(curve: Array) -> Mask:
        return free & (curve < goal)

    def solve(active: Mask) -> Array:
        band = held.copy(order="F")
        band[0, active] += stiffness
        return _solve(band, np.where(active, pull, 0.0))

    def slope(curve: Array, direction: Array) -> Callable[[float], float]:
        flat, steep = direction @ _times(base, curve), direction @ _times(base, direction)
        gap, along = goal - curve, np.where(free, direction, 0.0)

        def at(length: float) -> float:
            below = np.maximum(gap - length * direction, 0.0)
            return float(flat + length * steep - stiffness * (below @ along))

        return at

    priced = _Priced(broken, solve, slope)
    curve, settled = _exchange(priced, start)
    # What goes round in circles are long stretches at zero: no better place to begin than start.
    return curve if settled else _newton(priced, start)


def _times(band: Array, vector: Array) -> Array:
    """Return the product of a symmetric banded matrix (lower form) and a vector."""
    from scipy.linalg.blas import dsbmv

    return np.asarray(dsbmv(len(band) - 1, 1.0, band, vector, lower=1))


def ease(share: ArrayLike) -> Array:
    """Return the smooth step from 0 at 0 and below to 1 at 1 and above, twice differentiable."""
    s = np.clip(np.asarray(share, dtype=np.float64), 0.0, 1.0)
    return np.asarray(s**3 * (10.0 - 15.0 * s + 6.0 * s * s))
