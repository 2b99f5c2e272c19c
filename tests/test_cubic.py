"""Cubic splines: SciPy's to the bit, exact on cubics, and honest about what they cannot take."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import interpolate

from mjmotion.numerics.cubic import CubicSpline


@pytest.mark.parametrize(("count", "shape"), [(4, ()), (5, (2,)), (300, (4,))])
def test_scipys_to_the_bit(count: int, shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(count)
    x, values = np.sort(rng.uniform(0.0, 10.0, count)), rng.normal(size=(count, *shape))
    at = np.concatenate((rng.uniform(-1.0, 11.0, 200), x))
    mine, theirs = CubicSpline(x, values), interpolate.CubicSpline(x, values)
    np.testing.assert_array_equal(mine(at), theirs(at))
    np.testing.assert_array_equal(mine.integral(), theirs.antiderivative()(x))


def test_a_cubic_is_itself() -> None:
    x, at = np.array((0.0, 0.5, 2.0, 2.5, 4.0)), np.linspace(0.0, 4.0, 17)
    spline = CubicSpline(x, x**3 - 2.0 * x)
    np.testing.assert_allclose(spline(at), at**3 - 2.0 * at, atol=1e-12)
    np.testing.assert_allclose(spline.integral(), x**4 / 4.0 - x**2, atol=1e-12)


def test_three_points_are_too_few() -> None:
    with pytest.raises(ValueError, match="four points"):
        CubicSpline((0.0, 1.0, 2.0), (0.0, 1.0, 0.0))
