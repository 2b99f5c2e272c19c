"""Uniform cubic B-splines over frames, fitted locally (§3.2, Eq. 2).

    values = fit_level(frames, data, nframe, frames_per_knot=16)   # one level, at every frame
    values = fit_multilevel(frames, data, nframe, levels=(16, 8, 4, 2))
    values = fit_between(frames, data, start=24, end=96, frames_per_knot=12)  # at rest outside

Knots stand every ``frames_per_knot`` frames from frame 0 on. A control point is found from the data
points in its own support alone, so a level is two sparse products and its cost is linear in frames;
frames further than two knots from every data point get exactly zero.

Eq. 2 as the paper prints it divides β by ΣB_k, which is 1. The multilevel B-spline paper it takes
the method from (Lee, Wolberg and Shin 1997) divides by ΣB_k², with which a lone data point is
interpolated exactly. The squares are the default; ``as_printed=True`` gives the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Protocol

import numpy as np
import scipy.sparse as sparse
from numpy.typing import ArrayLike, NDArray

from mjmotion.exceptions import FitError


class Curve(Protocol):
    """Fits one level to data at some frames, and returns it at every frame; see fit_level."""

    def __call__(
        self,
        frames: ArrayLike,
        data: NDArray[np.float64],
        nframe: int,
        frames_per_knot: float,
        *,
        passes: int = 1,
    ) -> NDArray[np.float64]:
        """Return (nframe, k) values."""
        ...


def basis(fraction: ArrayLike) -> NDArray[np.float64]:
    """Return the uniform cubic B-spline basis ``B_0 … B_3`` at ``fraction`` in [0, 1].

    Args:
      fraction: (n,) position between two knots.

    Returns:
      (n, 4) weights, each row summing to 1.
    """
    s = np.asarray(fraction, dtype=np.float64)
    r = 1.0 - s
    return np.stack(
        (
            r * r * r / 6.0,
            (3.0 * s * s * s - 6.0 * s * s + 4.0) / 6.0,
            (3.0 * r * r * r - 6.0 * r * r + 4.0) / 6.0,
            s * s * s / 6.0,
        ),
        axis=-1,
    )


def knot_intervals(nframe: int, frames_per_knot: float) -> int:
    """Return how many knot intervals cover ``nframe`` frames; there are 3 more control points."""
    return max(1, int(np.ceil((nframe - 1) / frames_per_knot - 1e-9)))


def basis_matrix(frames: ArrayLike, nframe: int, frames_per_knot: float) -> sparse.csr_array:
    """Return the matrix that evaluates a spline at ``frames``: values = matrix @ control points.

    Args:
      frames: (n,) frames, whole or between.
      nframe: frames the knot sequence covers.
      frames_per_knot: frames a knot.

    Returns:
      (n, knot_intervals + 3) sparse matrix, four entries a row.
    """
    at = np.asarray(frames, dtype=np.float64) / frames_per_knot
    count = knot_intervals(nframe, frames_per_knot)
    first = np.minimum(np.floor(at).astype(np.int64), count - 1)
    weights = basis(at - first)
    rows = 4 * np.arange(len(at) + 1)
    columns = (first[:, None] + np.arange(4)).ravel()
    return sparse.csr_array((weights.ravel(), columns, rows), shape=(len(at), count + 3))


def fit_matrix(
    frames: ArrayLike, nframe: int, frames_per_knot: float, *, as_printed: bool = False
) -> sparse.csr_array:
    """Return the matrix of Eq. 2: control points = matrix @ data.

    Control point j is the mean of ``ω_ij x_i / Σ_k B_k²`` over its own data points, weighted by
    ``ω_ij²``; control points with no data in their support are zero.

    Returns:
      (knot_intervals + 3, n) sparse matrix.
    """
    omega = basis_matrix(frames, nframe, frames_per_knot)
    squares = omega.power(2)
    share = np.ones(omega.shape[0]) if as_printed else np.asarray(squares.sum(axis=1)).ravel()
    cubes = omega.power(3).multiply((1.0 / share)[:, None]).tocsr()
    total = np.asarray(squares.sum(axis=0)).ravel()
    scale = np.divide(1.0, total, out=np.zeros_like(total), where=total > 0.0)
    return (cubes.T.tocsr().multiply(scale[:, None])).tocsr()


def fit_level(
    frames: ArrayLike,
    data: NDArray[np.float64],
    nframe: int,
    frames_per_knot: float,
    *,
    passes: int = 1,
    as_printed: bool = False,
) -> NDArray[np.float64]:
    """Fit one level to ``data`` (n, k) at ``frames`` (n,) and return it at every frame.

    Args:
      frames: (n,) frames that have data.
      data: (n, k) values.
      nframe: frames of the result.
      frames_per_knot: frames a knot.
      passes: times that Eq. 2 is applied at these knots, each time to what is left.
      as_printed: divide by ΣB_k, as the paper prints it, in place of ΣB_k².

    Returns:
      (nframe, k) values of the spline (Eq. 2).

    Raises:
      FitError: the number of frames is not positive.
    """
    if not frames_per_knot > 0:
        raise FitError(f"{frames_per_knot} frames a knot must be a positive number")
    fitting, there, everywhere = _level_matrices(
        np.asarray(frames, dtype=np.float64).tobytes(), nframe, float(frames_per_knot), as_printed
    )
    control = fitting @ data
    for _ in range(passes - 1):
        control += fitting @ (data - there @ control)
    return np.asarray(everywhere @ control)


def fit_between(
    frames: ArrayLike,
    data: NDArray[np.float64],
    start: int,
    end: int,
    frames_per_knot: float,
    *,
    passes: int = 1,
) -> NDArray[np.float64]:
    """Fit one level that is zero outside a range of frames, and begins and ends there smoothly.

    Its knots stand every ``frames_per_knot`` frames from ``start`` to ``end``; only control points
    whose support lies within take part, so value, velocity and acceleration are zero at both.

    Args:
      frames: (n,) frames that have data, from ``start`` to ``end``.
      data: (n, k) values.
      start: the outermost knot before.
      end: the outermost knot after, a whole number of levels later.
      frames_per_knot: frames a knot.
      passes: times that Eq. 2 is applied, each time to what is left.

    Returns:
      (end - start + 1, k) values of the spline (Eq. 2) at the whole frames from start to end.

    Raises:
      FitError: the range is no whole number of levels.
    """
    count = round((end - start) / frames_per_knot) if frames_per_knot > 0 else 0
    if count < 1 or abs(count * frames_per_knot - (end - start)) > 1e-6:
        raise FitError(
            f"frames {start} to {end} are no whole number of knots {frames_per_knot:g} apart"
        )
    at = np.asarray(frames, dtype=np.float64) - start
    nframe = end - start + 1
    fitting, there, everywhere = _level_matrices(
        at.tobytes(), nframe, float(frames_per_knot), False
    )
    control = np.zeros((count + 3, data.shape[1]))
    for _ in range(passes):
        control[3:-3] += (fitting @ (data - there @ control))[3:-3]
    return np.asarray(everywhere @ control)


@lru_cache(maxsize=64)
def _level_matrices(
    frames: bytes, nframe: int, frames_per_knot: float, as_printed: bool
) -> tuple[sparse.csr_array, sparse.csr_array, sparse.csr_array]:
    """Fitting, and evaluation at the data and at every frame; the levels of a fit share them."""
    at = np.frombuffer(frames)
    fitting = fit_matrix(at, nframe, frames_per_knot, as_printed=as_printed)
    everywhere = basis_matrix(np.arange(nframe), nframe, frames_per_knot)
    return fitting, basis_matrix(at, nframe, frames_per_knot), everywhere


def fit_multilevel(
    frames: ArrayLike, data: NDArray[np.float64], nframe: int, levels: Sequence[float]
) -> NDArray[np.float64]:
    """Fit ``data`` (n, k) at whole ``frames`` (n,) coarse to fine, each level what the last left.

    For values that add up, such as a path in the plane; displacements of a pose do not (§4.1).

    Returns:
      (nframe, k) sum of the levels.
    """
    index = np.asarray(frames, dtype=np.int64)
    total = np.zeros((nframe, data.shape[1]))
    for frames_per_knot in levels:
        total += fit_level(index, data - total[index], nframe, frames_per_knot)
    return total
