"""The paper's rough terrain: a bicubic B-spline surface through random heights, seeded."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.boundary.limits import MOST_SAMPLES, at_most
from mjmotion.exceptions import SceneError
from mjmotion.scene.heights import add_heightfield
from mjmotion.scene.stage import add_start, check_positive, check_range, new_scene

BODY_HEIGHT = 1.75
"""Height of the humanoid [m], which the paper's terrain is measured in."""


def terrain(
    seed: int = 1,
    *,
    spacing: float = 0.8 * BODY_HEIGHT,
    height: float = 1.2 * BODY_HEIGHT,
    x_range: tuple[float, float] = (-4.0, 20.0),
    y_range: tuple[float, float] = (-8.0, 8.0),
    cell: float = 0.05,
) -> mujoco.MjSpec:
    """Return the rough terrain of the paper (§7): control heights random on a square grid.

    Args:
      seed: seed of the heights; the same seed gives the same terrain anywhere.
      spacing: width of the control grid's squares [m]; the paper's is 80 % of the body height.
      height: control heights are uniform in [0, height) [m]; the paper's is 120 % of it.
      x_range: extent along x [m]; the clip starts at the origin and walks along +x.
      y_range: extent along y [m].
      cell: greatest distance between samples of the heightfield [m].

    Raises:
      SceneError: a size that is not positive, a range out of order, or a start beside the terrain.
    """
    check_positive("terrain", spacing=spacing, height=height, cell=cell)
    check_range("terrain", x_range=x_range, y_range=y_range)
    for name, step in (("cell", cell), ("spacing", spacing)):
        count = (np.ptp(x_range) / step + 3) * (np.ptp(y_range) / step + 3)
        at_most(count, MOST_SAMPLES, f"terrain: {name} is {step} m, samples", SceneError)
    x = _samples(x_range, cell)
    y = _samples(y_range, cell)
    control = control_heights(seed, spacing, height, x_range, y_range)
    heights = spline_surface(control, (x - x_range[0]) / spacing, (y - y_range[0]) / spacing)
    center = (sum(x_range) / 2, sum(y_range) / 2)
    spec = new_scene("terrain", center, radius=max(np.ptp(x_range), np.ptp(y_range)) * 0.6)
    add_heightfield(spec, "terrain", heights, x_range, y_range)
    add_start(spec)
    return spec


def control_heights(
    seed: int,
    spacing: float,
    height: float,
    x_range: tuple[float, float],
    y_range: tuple[float, float],
) -> NDArray[np.float64]:
    """Return the control heights (rows along y, columns along x) [m] that cover the ranges.

    Three more rows and columns than squares, as a cubic B-spline needs.
    """
    if seed < 0:
        raise SceneError(f"terrain: seed is {seed}, it must not be negative")
    shape = tuple(int(np.ceil(np.ptp(span) / spacing - 1e-9)) + 3 for span in (y_range, x_range))
    return np.random.default_rng(seed).uniform(0.0, height, shape)


def spline_surface(control: ArrayLike, column: ArrayLike, row: ArrayLike) -> NDArray[np.float64]:
    """Return the uniform bicubic B-spline surface on a grid of points.

    Args:
      control: (nrow, ncol) control heights [m].
      column: (n,) coordinates along x in squares, from 0 to ncol - 3.
      row: (m,) coordinates along y in squares, from 0 to nrow - 3.

    Returns:
      (m, n) heights [m].
    """
    control = np.asarray(control, dtype=np.float64)
    rows = _basis(np.asarray(row, dtype=np.float64), control.shape[0])
    columns = _basis(np.asarray(column, dtype=np.float64), control.shape[1])
    return rows @ control @ columns.T


def _basis(coordinate: NDArray[np.float64], ncontrol: int) -> NDArray[np.float64]:
    """Return the uniform cubic B-spline basis (npoint, ncontrol) at ``coordinate`` (npoint,)."""
    square = np.clip(np.floor(coordinate).astype(int), 0, ncontrol - 4)
    t = coordinate - square
    weights = np.stack(
        [(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3], axis=1
    )
    basis = np.zeros((len(coordinate), ncontrol))
    np.put_along_axis(basis, square[:, None] + np.arange(4), weights / 6, axis=1)
    return basis


def _samples(span: tuple[float, float], cell: float) -> NDArray[np.float64]:
    """Return evenly spaced coordinates over ``span``, both ends included."""
    return np.linspace(span[0], span[1], int(np.ceil(np.ptp(span) / cell - 1e-9)) + 1)
