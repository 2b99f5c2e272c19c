"""Uniform cubic B-splines and Eq. 2, with SciPy's BSpline and a literal Eq. 2 to compare with."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from mjmotion.exceptions import FitError
from mjmotion.numerics.bspline import (
    basis,
    basis_matrix,
    fit_between,
    fit_level,
    fit_matrix,
    fit_multilevel,
    knot_intervals,
)

CLOSE = 1e-12
SOME = settings(deadline=None, max_examples=40, derandomize=True)
knot_spans = st.sampled_from((1.0, 2.0, 3.0, 4.0, 7.5, 16.0, 200.0))


def literal_equation_2(
    frames: np.ndarray, data: np.ndarray, nframe: int, frames_per_knot: float, squares: bool
) -> np.ndarray:
    """Eq. 2 word by word: the proximity set of each control point, ω, β, and the weighted mean."""

    def b(k: int, s: float) -> float:
        return (
            (1 - s) ** 3 / 6,
            (3 * s**3 - 6 * s**2 + 4) / 6,
            (-3 * s**3 + 3 * s**2 + 3 * s + 1) / 6,
            s**3 / 6,
        )[k]

    count = knot_intervals(nframe, frames_per_knot) + 3
    control = np.zeros((count, data.shape[1]))
    for index in range(count):
        j = index - 1  # the paper counts from -1
        upper, lower = np.zeros(data.shape[1]), 0.0
        for frame, x in zip(frames, data, strict=True):
            t = frame / frames_per_knot
            if not j - 2 <= t < j + 2:
                continue
            s = t - np.floor(t)
            k = int(j + 1 - np.floor(t))
            if not 0 <= k <= 3:
                continue
            omega = b(k, s)
            share = sum(b(i, s) ** 2 if squares else b(i, s) for i in range(4))
            upper += omega**2 * (omega * x / share)
            lower += omega**2
        control[index] = upper / lower if lower > 0 else 0.0
    return control


def scipy_spline(control: np.ndarray, frames_per_knot: float) -> BSpline:
    knots = frames_per_knot * np.arange(-3, len(control) + 1)
    return BSpline(knots, control, 3)


@SOME
@given(s=st.lists(st.floats(0.0, 1.0), min_size=1, max_size=20))
def test_basis_is_a_partition_of_unity(s: list[float]) -> None:
    weights = basis(s)
    assert weights.shape == (len(s), 4) and (weights >= 0.0).all()
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=CLOSE)
    # The mean of the control points' own places is the place itself (linear precision).
    np.testing.assert_allclose(weights @ (-1.0, 0.0, 1.0, 2.0), s, atol=CLOSE)


def test_basis_is_scipys() -> None:
    s = np.linspace(0.0, 1.0, 50, endpoint=False)
    for k in range(4):
        element = BSpline.basis_element(np.arange(5.0), extrapolate=False)
        np.testing.assert_allclose(basis(s)[:, k], element(s + 3 - k), atol=CLOSE)


@SOME
@given(nframe=st.integers(1, 90), frames_per_knot=knot_spans, seed=st.integers(0, 999))
def test_evaluation_is_scipys(nframe: int, frames_per_knot: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    control = rng.normal(size=(knot_intervals(nframe, frames_per_knot) + 3, 2))
    frames = np.sort(rng.uniform(0.0, nframe - 1, 30))
    frames[[0, -1]] = 0, nframe - 1
    matrix = basis_matrix(frames, nframe, frames_per_knot)
    assert matrix.nnz == 4 * len(frames)
    np.testing.assert_allclose(
        matrix @ control, scipy_spline(control, frames_per_knot)(frames), atol=1e-10
    )
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0, atol=CLOSE)


@pytest.mark.parametrize(
    ("nframe", "frames_per_knot", "wanted"),
    [(1, 16, 1), (2, 16, 1), (17, 16, 1), (18, 16, 2), (33, 16, 2), (464, 2, 232), (10, 2.25, 4)],
)
def test_knots_cover_the_frames(nframe: int, frames_per_knot: float, wanted: int) -> None:
    assert knot_intervals(nframe, frames_per_knot) == wanted


@pytest.mark.parametrize("squares", [True, False])
@pytest.mark.parametrize("frames_per_knot", [2, 4, 7.5, 16])
def test_control_points_are_those_of_equation_2(frames_per_knot: float, squares: bool) -> None:
    rng = np.random.default_rng(1)
    frames = np.sort(rng.choice(90, 25, replace=False))
    data = rng.normal(size=(25, 3))
    mine = fit_matrix(frames, 91, frames_per_knot, as_printed=not squares) @ data
    literal = literal_equation_2(frames, data, 91, frames_per_knot, squares)
    np.testing.assert_allclose(mine, literal, atol=CLOSE)
    level = fit_level(frames, data, 91, frames_per_knot, as_printed=not squares)
    np.testing.assert_allclose(
        level[:90], scipy_spline(literal, frames_per_knot)(np.arange(90)), atol=1e-10
    )


@SOME
@given(frame=st.integers(0, 60), frames_per_knot=knot_spans, value=st.floats(-5.0, 5.0))
def test_a_lone_data_point_is_met_exactly(frame: int, frames_per_knot: float, value: float) -> None:
    fitted = fit_level([frame], np.array([[value]]), 61, frames_per_knot)
    assert fitted[frame, 0] == pytest.approx(value, abs=1e-12)


def test_as_printed_a_lone_point_is_not_met() -> None:
    """What the paper prints, β over ΣB_k = 1, pulls only part of the way: hence the squares."""
    fitted = fit_level([32], np.ones((1, 1)), 65, 16, as_printed=True)
    assert fitted[32, 0] == pytest.approx((1 / 6) ** 2 * 2 + (4 / 6) ** 2)


@SOME
@given(frame=st.integers(0, 200), frames_per_knot=st.sampled_from((2.0, 4.0, 7.5, 16.0)))
def test_nothing_moves_outside_the_support(frame: int, frames_per_knot: float) -> None:
    """A data point moves its four control points, and those at most seven knots in all (§6)."""
    fitted = fit_level([frame], np.ones((1, 1)), 201, frames_per_knot)[:, 0]
    away = np.abs(np.arange(201) - frame)
    assert (fitted[away >= 4 * frames_per_knot] == 0.0).all()
    moved = np.flatnonzero(fitted)
    assert np.ptp(moved) < 7 * frames_per_knot
    assert frame in moved


def test_a_constant_is_kept() -> None:
    """Equal data at every frame give a level curve; local least squares makes it 14 % too high,
    which the next levels take back. As printed it would be 45 % too low."""
    data = np.full((100, 1), 3.0)
    for frames_per_knot in (2, 4, 16):
        inner = slice(2 * frames_per_knot, -2 * frames_per_knot)
        fitted = fit_level(np.arange(100), data, 100, frames_per_knot)[inner]
        assert np.ptp(fitted) < 0.01 and abs(fitted.mean() - 3.0) < 0.5
        printed = fit_level(np.arange(100), data, 100, frames_per_knot, as_printed=True)[inner]
        assert np.ptp(printed) < 0.01 and abs(printed.mean() - 1.64) < 0.01
    assert np.abs(fit_multilevel(np.arange(100), data, 100, (16, 8, 4, 2)) - 3.0).max() < 0.03


def test_levels_shrink_the_error() -> None:
    t = np.arange(200) / 30.0
    data = np.column_stack((np.sin(3.0 * t), np.exp(-((t - 3.0) ** 2)), t * 0.0))
    errors = []
    for count in range(1, 5):
        fitted = fit_multilevel(np.arange(200), data, 200, (16, 8, 4, 2)[:count])
        errors.append(np.abs(fitted - data).max())
    assert all(b < 0.6 * a for a, b in itertools.pairwise(errors)), errors
    assert errors[-1] < 0.03 and np.abs(fitted - data)[4:-4].max() < 0.01
    assert (fitted[:, 2] == 0.0).all()


def test_multilevel_is_the_sum_of_levels_of_what_was_left() -> None:
    rng = np.random.default_rng(2)
    frames, data = np.array((3, 10, 11, 40)), rng.normal(size=(4, 2))
    total, left = np.zeros((50, 2)), data.copy()
    for frames_per_knot in (8, 4):
        level = fit_level(frames, left, 50, frames_per_knot)
        total, left = total + level, left - level[frames]
    np.testing.assert_allclose(fit_multilevel(frames, data, 50, (8, 4)), total, atol=CLOSE)


def test_columns_do_not_mix_and_data_is_linear() -> None:
    rng = np.random.default_rng(3)
    frames, a, b = np.arange(0, 60, 3), rng.normal(size=(20, 2)), rng.normal(size=(20, 2))
    together = fit_level(frames, np.hstack((a, b)), 60, 4)
    np.testing.assert_allclose(together[:, :2], fit_level(frames, a, 60, 4), atol=CLOSE)
    both = fit_level(frames, 2.0 * a - b, 60, 4)
    np.testing.assert_allclose(both, 2.0 * together[:, :2] - together[:, 2:], atol=CLOSE)


def test_size_is_linear_in_frames() -> None:
    """The matrices have a fixed number of entries a frame."""
    for nframe in (464, 4640):
        assert fit_matrix(np.arange(nframe), nframe, 2).nnz <= 4 * nframe
        assert basis_matrix(np.arange(nframe), nframe, 2).nnz == 4 * nframe


def test_no_data_is_no_movement() -> None:
    assert (fit_level(np.empty(0, int), np.empty((0, 3)), 20, 4) == np.zeros((20, 3))).all()


@pytest.mark.parametrize("frames_per_knot", [0, -1, float("nan")])
def test_bad_knots(frames_per_knot: float) -> None:
    with pytest.raises(FitError, match="frames a knot"):
        fit_level([0], np.zeros((1, 1)), 10, frames_per_knot)


def test_between_two_frames_a_level_is_at_rest_outside() -> None:
    rng = np.random.default_rng(4)
    frames, data = np.arange(10, 59), rng.normal(size=(49, 2))
    for frames_per_knot in (12, 6, 3, 1.5):
        values = fit_between(frames, data, 10, 58, frames_per_knot, passes=2)
        assert values.shape == (49, 2)
        assert (values[[0, -1]] == 0.0).all() and np.abs(values).max() > 0.05
        # Value, slope and curvature vanish: near the ends it is the cube of the way.
        near = np.abs(values[[1, -2]]).max()
        assert near < 10.0 * np.abs(data).max() / frames_per_knot**3


def test_one_data_point_on_a_knot_reaches_three_knots_each_way() -> None:
    data = np.array([[2.0]])
    values = fit_between(np.array([40]), data, 4, 76, 12)
    assert values[36, 0] == pytest.approx(2.0, abs=CLOSE)
    assert np.flatnonzero(values[:, 0]).tolist() == list(range(1, 72))
    # Nothing had to be left out: it is the level of a spline over the whole clip.
    whole = fit_level(np.array([36]), data, 100, 12)
    np.testing.assert_allclose(values[:, 0], whole[:73, 0], atol=CLOSE)


def test_passes_between_two_frames_close_in() -> None:
    frames = np.arange(20, 60)
    data = np.sin(np.pi * (frames - 20) / 40.0)[:, None] ** 3
    left = [
        np.abs(fit_between(frames, data, 20, 60, 4, passes=n)[:-1] - data).max() for n in (1, 2, 4)
    ]
    assert left[2] < left[1] < left[0]


@pytest.mark.parametrize("span", [(0, 10, 4), (5, 5, 2), (0, 12, 0), (12, 0, 4)])
def test_a_range_of_no_whole_knots(span: tuple[int, int, float]) -> None:
    with pytest.raises(FitError, match="whole number"):
        fit_between(np.array([3]), np.zeros((1, 1)), *span)
