"""Quaternions, matrices and rotation vectors, with SciPy's Rotation to compare with."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from mjmotion.numerics import rotations as rot

CLOSE = 1e-12  # [rad] and for matrix entries
SOME = settings(deadline=None, max_examples=50, derandomize=True)
numbers = st.floats(-1.0, 1.0, allow_subnormal=False)
vectors = arrays(np.float64, (5, 3), elements=numbers)
quats = arrays(np.float64, (5, 4), elements=numbers).filter(
    lambda q: bool((np.linalg.norm(q, axis=1) > 1e-3).all())
)


def scipy_of(quat: np.ndarray) -> Rotation:
    return Rotation.from_quat(quat.reshape(-1, 4), scalar_first=True)


def apart(quat: np.ndarray, other: Rotation) -> float:
    """Largest angle between rotations [rad]."""
    return float((scipy_of(quat).inv() * other).magnitude().max())


@SOME
@given(a=quats, b=quats, v=vectors)
def test_products_and_turned_vectors(a: np.ndarray, b: np.ndarray, v: np.ndarray) -> None:
    a, b = rot.normalized(a), rot.normalized(b)
    assert apart(rot.multiply(a, b), scipy_of(a) * scipy_of(b)) < CLOSE
    assert apart(rot.conjugate(a), scipy_of(a).inv()) < CLOSE
    np.testing.assert_allclose(rot.rotate(a, v), scipy_of(a).apply(v), atol=CLOSE)
    np.testing.assert_allclose(rot.cross(v, v[::-1]), np.cross(v, v[::-1]), atol=CLOSE)
    np.testing.assert_allclose(rot.dot(v, v[::-1]), np.sum(v * v[::-1], axis=1), atol=CLOSE)


@SOME
@given(v=vectors, size=st.sampled_from((1e-15, 1e-9, 1e-7, 1e-3, 1.0, 3.0, 20.0)))
def test_exp(v: np.ndarray, size: float) -> None:
    quat = rot.exp(size * v)
    assert apart(quat, Rotation.from_rotvec(size * v)) < 1e-11
    np.testing.assert_allclose(np.linalg.norm(quat, axis=1), 1.0, atol=CLOSE)


@SOME
@given(q=quats)
def test_log(q: np.ndarray) -> None:
    q = rot.normalized(q)
    vector = rot.log(q)
    assert np.linalg.norm(vector, axis=1).max() <= np.pi + CLOSE
    assert apart(rot.exp(vector), scipy_of(q)) < CLOSE
    below = np.abs(q[:, 0]) > 1e-9  # at π either way round will do
    np.testing.assert_allclose(rot.log(-q)[below], vector[below], atol=1e-9)


@SOME
@given(v=vectors, size=st.sampled_from((1e-15, 1e-9, 1e-3, 1.0, 1.8)))
def test_log_inverts_exp_below_pi(v: np.ndarray, size: float) -> None:
    np.testing.assert_allclose(rot.log(rot.exp(size * v)), size * v, rtol=1e-12, atol=1e-15)


@SOME
@given(q=quats)
def test_matrices(q: np.ndarray) -> None:
    q = rot.normalized(q)
    matrix = rot.to_matrix(q)
    np.testing.assert_allclose(matrix, scipy_of(q).as_matrix(), atol=CLOSE)
    again = rot.from_matrix(matrix)
    assert apart(again, scipy_of(q)) < 1e-9 and (again[:, 0] >= 0.0).all()


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.6, 0, 0.8), (0.6, -0.8, 0)])
@pytest.mark.parametrize("angle", [np.pi, np.pi - 1e-9, -np.pi + 1e-5])
def test_half_turns(axis: tuple[float, ...], angle: float) -> None:
    """Where the trace is -1 the other ways of writing a quaternion have to step in."""
    turn = Rotation.from_rotvec(angle * np.array(axis))
    assert apart(rot.from_matrix(turn.as_matrix()), turn) < 1e-8
    quat = rot.from_matrix(turn.as_matrix())
    assert np.linalg.norm(rot.log(quat)) == pytest.approx(abs(angle), abs=1e-8)


@SOME
@given(a=vectors, b=vectors)
def test_between_turns_the_least(a: np.ndarray, b: np.ndarray) -> None:
    a, b = a + (0, 0, 1.5), b + (0, 1.5, 0)
    a, b = rot.normalized(a), rot.normalized(b)
    quat = rot.between(a, b)
    np.testing.assert_allclose(rot.rotate(quat, a), b, atol=1e-9)
    angle = np.arccos(np.clip(rot.dot(a, b), -1.0, 1.0))
    np.testing.assert_allclose(scipy_of(quat).magnitude(), angle, atol=1e-7)


@pytest.mark.parametrize("a", [(1, 0, 0), (0, 1, 0), (0, 0, -1), (0.6, 0, 0.8)])
def test_between_opposites(a: tuple[float, ...]) -> None:
    a_, b = np.array([a], dtype=float), -np.array([a], dtype=float)
    np.testing.assert_allclose(rot.rotate(rot.between(a_, b), a_), b, atol=1e-9)
    np.testing.assert_allclose(rot.between(a_, a_), [[1, 0, 0, 0]], atol=CLOSE)


def test_normalized_keeps_zero() -> None:
    np.testing.assert_allclose(rot.normalized(np.array((0.0, 3.0, 4.0))), (0.0, 0.6, 0.8))
    np.testing.assert_array_equal(rot.normalized(np.zeros((2, 3))), np.zeros((2, 3)))


def test_yaw_and_leading_shapes() -> None:
    yaw = np.linspace(-3.0, 3.0, 6).reshape(2, 3)
    quat = rot.yaw_quat(yaw)
    assert quat.shape == (2, 3, 4)
    assert apart(quat, Rotation.from_rotvec(yaw.reshape(-1, 1) * (0, 0, 1))) < CLOSE
    assert rot.log(quat).shape == (2, 3, 3) and rot.to_matrix(quat).shape == (2, 3, 3, 3)
    np.testing.assert_allclose(rot.log(quat)[..., 2], yaw, atol=CLOSE)


def test_continuous_never_flips() -> None:
    rng = np.random.default_rng(3)
    vector = np.cumsum(rng.normal(scale=0.2, size=(60, 2, 3)), axis=0)
    quat = rot.exp(vector) * np.where(rng.random((60, 2, 1)) < 0.5, -1.0, 1.0)
    kept = quat.copy()
    smooth = rot.continuous(quat)
    assert (rot.dot(smooth[1:], smooth[:-1]) > 0.0).all()
    assert apart(smooth, scipy_of(quat)) < CLOSE
    np.testing.assert_array_equal(smooth[0], quat[0])
    np.testing.assert_array_equal(quat, kept)
