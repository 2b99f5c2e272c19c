"""Heightfields, and how high anything in a rectangle may rise without a look at every point."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_CHUNK = 16384  # points whose height is taken at once
_FINEST = 0.04  # [m] side of the squares that are not told apart when tops are looked up
_MOST_CELLS = 512  # of them along a side, for solids that lie far apart


class Tops:
    """The highest value in any rectangle of a grid of cells, in four look-ups.

    For a rectangle of cells, windows of a power of two cells that overlap cover it. The tables of
    window maxima are made when they are first asked for.
    """

    def __init__(self, values: Array) -> None:
        self._tables = {(0, 0): values}

    def over(self, first: NDArray[np.int64], last: NDArray[np.int64]) -> Array:
        """Return the highest value (n,) in cells ``first`` to ``last``, both (n, 2): row, column.

        Minus infinity where none of them is in the grid.
        """
        shape = np.array(self._tables[0, 0].shape)
        beside = ((last < 0) | (first >= shape)).any(axis=1)
        first, last = np.clip(first, 0, shape - 1), np.clip(last, 0, shape - 1)
        power = np.frexp(last - first + 1)[1] - 1
        highest = np.empty(len(first))
        kind = power[:, 0] * 64 + power[:, 1]
        for code in np.unique(kind):
            rows = np.flatnonzero(kind == code)
            table = self._table(int(code) // 64, int(code) % 64)
            r, c = first[rows].T
            end_r, end_c = (last[rows] + 1 - (1 << power[rows])).T
            highest[rows] = np.maximum(
                np.maximum(table[r, c], table[r, end_c]),
                np.maximum(table[end_r, c], table[end_r, end_c]),
            )
        return np.where(beside, -np.inf, highest)

    def _table(self, row_power: int, column_power: int) -> Array:
        key = row_power, column_power
        if key not in self._tables:
            if column_power:
                half, smaller = 1 << (column_power - 1), self._table(row_power, column_power - 1)
                self._tables[key] = np.maximum(smaller[:, :-half], smaller[:, half:])
            else:
                half, smaller = 1 << (row_power - 1), self._table(row_power - 1, 0)
                self._tables[key] = np.maximum(smaller[:-half], smaller[half:])
        return self._tables[key]


class BoxTops:
    """The highest of many boxes that a rectangle touches, or a little more.

    Args:
      low: (nbox, 3) lower corners [m].
      high: (nbox, 3) upper corners [m].
    """

    def __init__(self, low: Array, high: Array) -> None:
        self._origin = low[:, :2].min(axis=0)
        span = high[:, :2].max(axis=0) - self._origin
        self._cell = max(_FINEST, float(span.max()) / _MOST_CELLS)
        first, last = self._cells(low), self._cells(high)
        values = np.full(last.max(axis=0) + 1, -np.inf)
        for (r, c), (end_r, end_c), top in zip(first, last, high[:, 2], strict=True):
            part = values[r : end_r + 1, c : end_c + 1]
            np.maximum(part, top, out=part)
        self._tops = Tops(values)

    def highest(self, centre: Array, extent: Array) -> Array:
        """Return the highest top (n,) around points (n, 3) in rectangles of half sizes (n, 3)."""
        return self._tops.over(self._cells(centre - extent), self._cells(centre + extent))

    def _cells(self, point: Array) -> NDArray[np.int64]:
        place = (point[:, :2] - self._origin) / self._cell
        return np.floor(place).astype(np.int64)[:, ::-1]


class Field:
    """One upright heightfield where it stands.

    Attributes:
      geom: its id.
      position: (3,) [m].
      turn: (2, 2) from its frame to the world's, about the vertical.
      half: (2,) half sizes along its x and y [m].
      values: (nrow, ncol) heights over its frame [m].
      spacing: (2,) of grid points along x and y [m].
      top: its highest point [m].
    """

    def __init__(self, model: mujoco.MjModel, geom: int, position: Array, matrix: Array) -> None:
        self.geom, self.position, self.turn = geom, position, matrix[:2, :2]
        self.values, self.spacing = field_grid(model, geom)
        self.half = model.hfield_size[model.geom_dataid[geom], :2]
        self.top = float(self.values.max() + position[2])
        self._block = max(1, int(_FINEST / self.spacing.max()))
        self._tops = Tops(_block_maximum(self.values, self._block))

    def on_grid(self, xy: Array) -> Array:
        """Return where points (n, 2) are on the grid (n, 2): column and line, with fractions."""
        return np.asarray(((xy - self.position[:2]) @ self.turn + self.half) / self.spacing)

    def height(self, xy: Array) -> Array:
        """Return the height (n,) under points (n, 2) [m], NaN beside the field.

        Between grid points the surface is MuJoCo's own two triangles a cell.
        """
        if len(xy) > _CHUNK:  # what fits a core's cache is several times as fast
            parts = np.array_split(xy, -(-len(xy) // _CHUNK))
            return np.concatenate([self.height(part) for part in parts])
        column, line = np.ascontiguousarray(self.on_grid(xy).T)
        nrow, ncol = self.values.shape
        c = np.clip(column.astype(np.int32), 0, ncol - 2)
        r = np.clip(line.astype(np.int32), 0, nrow - 2)
        column -= c
        line -= r
        flat = self.values.ravel()
        base = r * np.int32(ncol) + c
        corner = flat[base]
        far = flat[base + np.int32(ncol + 1)]
        # The corner between them, of the one of the cell's two triangles that the line meets.
        lower = column > line
        third = flat[base + np.where(lower, np.int32(1), np.int32(ncol))]
        long, short = np.maximum(column, line), np.minimum(column, line)
        height = corner + long * (third - corner) + short * (far - third)
        height += self.position[2]
        edge = 1e-9
        height[(short < -edge) | (long > 1 + edge)] = np.nan
        return np.asarray(height)

    def highest(self, centre: Array, extent: Array) -> Array:
        """Return a height (n,) that the field nowhere exceeds around points (n, 3) [m].

        ``extent`` (n, 3) are half sizes of boxes along the world's axes. Minus infinity where
        there is no field.
        """
        middle = self.on_grid(centre[:, :2]) / self._block
        radius = extent[:, :2] @ np.abs(self.turn) / (self.spacing * self._block)
        first = np.floor(middle - radius - 1e-6).astype(np.int64)
        last = np.floor(middle + radius + 1e-6).astype(np.int64)
        return self._tops.over(first[:, ::-1], last[:, ::-1]) + self.position[2]


def field_grid(model: mujoco.MjModel, geom: int) -> tuple[Array, Array]:
    """Return a heightfield over its frame (nrow, ncol), and its spacing (x, y) [m]."""
    field = int(model.geom_dataid[geom])
    nrow, ncol = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
    start = int(model.hfield_adr[field])
    size = model.hfield_size[field]
    values = np.asarray(model.hfield_data[start : start + nrow * ncol], dtype=np.float64)
    spacing = 2 * size[:2] / np.array([ncol - 1, nrow - 1])
    return values.reshape(nrow, ncol) * size[2], spacing


def _block_maximum(values: Array, side: int) -> Array:
    """Return the highest corner of each cell of a grid, and of squares of ``side`` cells."""
    cell = np.maximum(values[:-1], values[1:])
    cell = np.maximum(cell[:, :-1], cell[:, 1:])
    nrow, ncol = (-(-count // side) for count in cell.shape)
    filled = np.full((nrow * side, ncol * side), -np.inf)
    filled[: cell.shape[0], : cell.shape[1]] = cell
    return np.asarray(filled.reshape(nrow, side, ncol, side).max(axis=(1, 3)))
