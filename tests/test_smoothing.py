"""Fades and envelopes against dense least squares solved by other means."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mjmotion.numerics import smoothing
from mjmotion.numerics.smoothing import Bound, between, blend, envelope, fade

CLOSE = 1e-8
BELOW = 2e-4  # how far under a wanted height an envelope may stay [m]
SOME = settings(deadline=None, max_examples=25, derandomize=True)


def energy(nframe: int, *weights: float) -> np.ndarray:
    """Σ w_k D_kᵀ D_k as a dense matrix, differences by numpy.diff."""
    total = np.zeros((nframe, nframe))
    for order, weight in enumerate(weights):
        difference = np.diff(np.eye(nframe), n=order, axis=0)
        total += weight * difference.T @ difference
    return total


def dense_fade(fixed: np.ndarray, values: np.ndarray, time: float) -> np.ndarray:
    matrix = energy(len(fixed), 1.0, 2.0 * time**2, time**4)
    curve = np.where(fixed[:, None], values, 0.0)
    free = ~fixed
    right = -matrix[np.ix_(free, fixed)] @ curve[fixed]
    curve[free] = np.linalg.solve(matrix[np.ix_(free, free)], right)
    return curve


@SOME
@given(seed=st.integers(0, 10_000), time=st.sampled_from((0.5, 1.2, 4.0)))
def test_fade_is_the_dense_minimum(seed: int, time: float) -> None:
    rng = np.random.default_rng(seed)
    fixed = rng.random(40) < 0.4
    fixed[5] = True
    values = rng.normal(size=(40, 2))
    kept = values.copy()
    curve = fade(fixed, values, time)
    np.testing.assert_allclose(curve, dense_fade(fixed, values, time), atol=CLOSE)
    np.testing.assert_array_equal(curve[fixed], values[fixed])
    np.testing.assert_array_equal(values, kept)


def test_fade_dies_out_and_does_not_swing_over() -> None:
    fixed = np.zeros(200, dtype=bool)
    fixed[:20] = True
    curve = fade(fixed, np.ones((200, 1)), 4.0)[:, 0]
    assert (curve > -1e-6).all() and (np.diff(curve) < 1e-9).all()
    assert curve[20 + 60] < 1e-4  # 15 time constants on
    # It leaves with the slope of the stretch, which is level: exp(-t/4) alone would be at 0.78.
    assert curve[20] > 0.94


@pytest.mark.parametrize("nframe", [1, 4, 5, 30])
def test_fade_without_anything_to_do(nframe: int) -> None:
    values = np.arange(float(nframe))[:, None]
    np.testing.assert_array_equal(fade(np.ones(nframe, bool), values, 3.0), values)
    np.testing.assert_array_equal(fade(np.zeros(nframe, bool), values, 3.0), 0.0 * values)


@SOME
@given(seed=st.integers(0, 10_000), time=st.sampled_from((0.5, 1.2, 4.0)))
def test_blend_is_the_dense_minimum(seed: int, time: float) -> None:
    rng = np.random.default_rng(seed)
    weight, values = rng.choice((0.0, 0.5, 20.0), 40), rng.normal(size=(40, 2))
    matrix = energy(40, 1.0, 3.0 * time**2, 3.0 * time**4, time**6)
    wanted = np.linalg.solve(matrix + np.diag(weight), weight[:, None] * values)
    np.testing.assert_allclose(blend(weight, values, time), wanted, atol=CLOSE)
    assert (blend(np.zeros(40), values, time) == 0.0).all()


def best_envelope(need: np.ndarray, fixed: np.ndarray, time: float) -> float:
    """Least energy of a curve above ``need``: projected gradients on the dual, run to the end."""
    from scipy.optimize import lsq_linear

    matrix = energy(len(need), 1.0, 0.0, 0.0, time**6)[np.ix_(~fixed, ~fixed)]
    root = np.linalg.cholesky(matrix)
    # min |Lᵀ x|² with x >= need, as bounded least squares.
    low = np.maximum(need[~fixed], 0.0)
    found = lsq_linear(root.T, np.zeros(len(low)), bounds=(low, np.inf), method="bvls")
    return float(found.x @ matrix @ found.x)


@SOME
@given(seed=st.integers(0, 10_000), time=st.sampled_from((2.0, 3.6)))
def test_envelope_is_above_and_nearly_the_least(seed: int, time: float) -> None:
    rng = np.random.default_rng(seed)
    nframe = 50
    fixed = np.zeros(nframe, dtype=bool)
    fixed[:10], fixed[40:] = True, True
    need = np.full(nframe, -1.0)
    for place in rng.integers(13, 37, 2):
        need[place - 2 : place + 2] = rng.uniform(0.01, 0.1)
    curve = envelope(need, fixed, time)
    assert (curve[fixed] == 0.0).all() and (curve >= 0.0).all()
    assert (curve - np.where(fixed, 0.0, need)).min() > -BELOW
    matrix = energy(nframe, 1.0, 0.0, 0.0, time**6)
    # Within a third of the optimum: it must be smooth, and need not be the very best.
    assert curve @ matrix @ curve < 1.35 * best_envelope(need, fixed, time) + 1e-6


def test_envelope_where_nothing_is_needed() -> None:
    fixed = np.zeros(30, dtype=bool)
    assert (envelope(np.full(30, -np.inf), fixed, 3.0) == 0.0).all()
    need = np.zeros(30)
    need[4] = 0.2
    fixed[4] = True  # a need at a fixed frame does not count
    assert (envelope(need, fixed, 3.0) == 0.0).all()


def test_envelope_is_smooth_and_wide() -> None:
    """One needy frame lifts a stretch about it, not a spike."""
    need = np.full(120, -np.inf)
    need[60] = 0.1
    curve = envelope(need, np.zeros(120, bool), 5.0)
    assert curve[60] > 0.1 - BELOW and curve.max() < 0.101
    assert curve[57] > 0.05 and curve[63] > 0.05
    assert np.abs(np.diff(curve, n=3)).max() < 0.01
    assert curve[[0, 119]].max() < 1e-3


def dense_between(values: np.ndarray, time: float, bounds: list[Bound]) -> np.ndarray:
    """The same as bounded least squares: max(0, x)² is the least of (x + t)² over t >= 0."""
    from scipy.optimize import lsq_linear

    nframe = len(values)
    smooth = time**3 * np.diff(np.eye(nframe), n=3, axis=0)
    rows, right, prices = [smooth, np.eye(nframe)], [np.zeros(len(smooth)), values], []
    for bound in bounds:
        frames = np.flatnonzero(bound.frames & np.isfinite(bound.value))
        root = np.sqrt(bound.price)
        sided = root if bound.upper else -root
        rows.append(sided * np.eye(nframe)[frames])
        right.append(sided * bound.value[frames])
        prices += len(frames) * [root]
    pad = np.zeros((len(smooth) + nframe, len(prices)))
    matrix = np.hstack((np.concatenate(rows), np.concatenate((pad, np.diag(prices)))))
    low = np.concatenate((np.full(nframe, -np.inf), np.zeros(len(prices))))
    found = lsq_linear(matrix, np.concatenate(right), (low, np.inf), method="bvls", tol=1e-14)
    return np.asarray(found.x[:nframe])


def some_bounds(rng: np.random.Generator, nframe: int, price: float) -> list[Bound]:
    """One above and one below, each at some frames, and each at some of those infinite."""
    upper, lower = rng.normal(0.2, 0.4, nframe), rng.normal(-0.2, 0.4, nframe)
    upper[rng.random(nframe) < 0.3], lower[rng.random(nframe) < 0.3] = np.inf, -np.inf
    return [
        Bound(upper, rng.random(nframe) < 0.5, price, upper=True),
        Bound(lower, rng.random(nframe) < 0.5, 0.3 * price, upper=False),
    ]


@SOME
@given(
    seed=st.integers(0, 10_000),
    time=st.sampled_from((0.5, 1.2, 3.0)),
    price=st.sampled_from((3.0, 200.0)),
)
def test_between_is_the_minimum(seed: int, time: float, price: float) -> None:
    rng = np.random.default_rng(seed)
    values = rng.normal(size=30)
    kept, bounds = values.copy(), some_bounds(rng, 30, price)
    wanted = dense_between(values, time, bounds)
    np.testing.assert_allclose(between(values, time, bounds), wanted, atol=1e-5)
    np.testing.assert_array_equal(values, kept)


@pytest.mark.parametrize("time", [0.5, 4.0])
def test_between_without_bounds_is_the_linear_solve(time: float) -> None:
    values = np.random.default_rng(3).normal(size=40)
    wanted = np.linalg.solve(energy(40, 1.0, 0.0, 0.0, time**6), values)
    np.testing.assert_allclose(between(values, time), wanted, atol=CLOSE)
    # Bounds that do not count are none: at no frame, without a value, or already kept.
    far, none, every = np.full(40, 9.0), np.zeros(40, bool), np.ones(40, bool)
    idle = [
        Bound(-far, none, 1e4, upper=True),
        Bound(np.full(40, np.inf), every, 1e4, upper=True),
        Bound(np.full(40, -np.inf), every, 1e4, upper=True),  # what nothing can keep
        Bound(np.full(40, -np.inf), every, 1e4, upper=False),
        Bound(far, every, 1e4, upper=True),
    ]
    np.testing.assert_allclose(between(values, time, idle), wanted, atol=CLOSE)


def test_between_keeps_what_is_dear_and_gives_up_what_is_cheap() -> None:
    values, frames = np.zeros(80), np.zeros(80, dtype=bool)
    frames[30:50] = True
    low, high = np.full(80, -0.3), np.full(80, 0.2)
    both = [Bound(low, frames, 1e7, upper=True), Bound(high, frames, 10.0, upper=False)]
    curve = between(values, 4.0, both)
    assert (curve[frames] < -0.3 + 1e-4).all()
    assert np.abs(curve[[0, 79]]).max() < 0.02  # and all else is as it was
    assert np.abs(np.diff(curve, n=3)).max() < 0.02


@pytest.mark.parametrize("nframe", [1, 4, 5])
def test_between_of_few_frames(nframe: int) -> None:
    values = np.linspace(0.0, 1.0, nframe) ** 2
    bound = Bound(np.full(nframe, -1.0), np.ones(nframe, bool), 1e6, upper=True)
    curve = between(values, 2.0, [bound])
    assert curve.shape == values.shape and curve is not values
    if nframe < 5:
        np.testing.assert_array_equal(curve, values)
    else:
        np.testing.assert_allclose(curve, -1.0, atol=1e-3)


@pytest.mark.parametrize("seed", range(4))
def test_newton_steps_find_the_curve_that_paying_in_turn_finds(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(seed)
    values, price = rng.normal(size=80).cumsum(), 50.0
    upper = Bound(values - rng.random(80), rng.random(80) < 0.5, price, upper=True)
    lower = Bound(values - 2.0 * rng.random(80), rng.random(80) < 0.5, price, upper=False)
    need, fixed = np.maximum(rng.normal(size=80), 0.0), rng.random(80) < 0.1
    found = between(values, 3.0, (upper, lower)), envelope(need, fixed, 3.0)
    monkeypatch.setattr(smoothing, "_exchange", lambda priced, start: (start, False))
    newton = between(values, 3.0, (upper, lower)), envelope(need, fixed, 3.0)
    for one, other in zip(found, newton, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6)
    assert (found[0] > upper.value)[upper.frames].any()  # bounds that are dear, not walls


@pytest.mark.parametrize("seed", range(30))
def test_an_envelope_of_rough_needs_is_above_them_and_not_far(seed: int) -> None:
    """Needs of noise and of boxes, at random places; a search that goes astray is far above."""
    rng = np.random.default_rng(seed)
    nframe, time = int(rng.integers(60, 400)), float(rng.uniform(3.0, 25.0))
    need = np.full(nframe, -1.0)
    for _ in range(int(rng.integers(1, 5))):
        start = int(rng.integers(0, nframe - 5))
        span = slice(start, start + int(rng.integers(5, 80)))
        count = len(need[span])
        need[span] = rng.uniform(0.0, 1.0, count) if rng.random() < 0.5 else rng.uniform(0.1, 0.9)
    curve = envelope(need, np.zeros(nframe, dtype=bool), time)
    assert (curve >= need - 2e-4).all()
    assert curve.max() < 4.0 * need.max()
