"""Rays straight down on to many geoms: exact, and as quick with thousands of them as with one.

    columns = Columns(model)
    distance, geom, normal = columns.cast(origins)

A grid over the plane knows which geoms are over each of its cells, so a ray meets those few alone.
Shapes with a formula are met here, for all rays at once (:mod:`.shapes`); rays on to the others,
such as meshes, are MuJoCo's, as are those next to the border of a heightfield or from inside it.
"""

from __future__ import annotations

import copy
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.kinematics import RayCaster
from mjmotion.scene.shapes import SHAPES, Shape, Solids, plane

Array = NDArray[np.float64]
Index = NDArray[np.int64]

CELLS = 200  # of the grid along its longer side, for few geoms
CELLS_A_GEOM = 4.0  # along its longer side for each root of their number, for many
MOST_CELLS = 1000  # along that side at most
_TINY = 1e-9  # by which bounds are widened, so that rounding leaves nothing out [m]
_DOWN = np.array((0.0, 0.0, -1.0))


class Columns:
    """The visible geoms of a model that stands still, for rays straight down.

    Args:
      model: of the scene, in its ``qpos0``; planes have no end, transparent geoms are not met.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        self._solids = Solids.of(model)
        visible = model.geom_rgba[:, 3] != 0.0
        planes = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
        self._planes = np.flatnonzero(visible & planes)
        self._bounded = np.flatnonzero(visible & ~planes)
        field = model.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD
        self._walls = np.flatnonzero(visible & ~planes & ~field)
        self.low, self.high = bounds(model, self._solids)
        self._grid = _Grid(self._bounded, self.low, self.high)
        kinds = set(np.unique(self._solids.shape[self._bounded]).tolist())
        self._shapes = [shape for shape in Shape if shape.value in kinds]

    def cast(self, origins: Array) -> tuple[Array, NDArray[np.int32], Array]:
        """Return where rays straight down from ``origins`` (n, 3) [m] first hit, as MuJoCo's do.

        Returns:
          distance (n,) [m], -1 for a miss; geom (n,), -1 for a miss; normal (n, 3), out of the geom
          and so down for a ray from inside it, zero for a miss.
        """
        found = _Nearest(len(origins))
        points = np.array(origins.T, order="C")
        every = np.arange(len(origins))
        for geom in self._planes:
            found.add(every, int(geom), *plane(self._solids, int(geom), points))
        unsure = [np.empty(0, dtype=np.int64)]
        for rows, geoms in self._grid.candidates(points):
            kinds = self._solids.shape[geoms]
            for shape in self._shapes:
                some = slice(None) if len(self._shapes) == 1 else np.flatnonzero(kinds == shape)
                mine, of = rows[some], geoms[some]
                if len(mine) == 0:
                    continue
                if shape == Shape.OTHER:
                    unsure.append(mine)
                    continue
                alone = of[:1] if (of == of[0]).all() else of
                distance, normal = SHAPES[shape](self._solids, alone, points[:, mine])
                found.add(mine, of, distance, normal)
                unsure.append(mine[np.isnan(distance)])
        rows = np.unique(np.concatenate(unsure))
        if len(rows):
            distance, hit, normal = self._others.cast(origins[rows], _DOWN)
            distance = np.where(hit >= 0, distance, np.inf)
            found.add(rows, hit.astype(np.int64), distance, normal)
        missed = ~np.isfinite(found.distance)
        return np.where(missed, -1.0, found.distance), found.geom, found.normal

    def any_wall_near(self, low: Array, high: Array) -> bool:
        """Return whether a geom that is no heightfield may be between two corners (3,) [m]."""
        up = self._solids.matrix[2::3, self._planes]
        middle = 0.5 * (low + high)[:, None] - self._solids.place[:, self._planes]
        over = (up * middle - np.abs(up) * 0.5 * (high - low)[:, None]).sum(axis=0)
        walls = self._walls
        near = ((self.low[walls] <= high) & (self.high[walls] >= low)).all(axis=1)
        return bool((over <= 0.0).any() or near.any())

    @cached_property
    def _others(self) -> RayCaster:
        """MuJoCo's rays on to what has no formula here; the rest is out of their way."""
        rest = copy.copy(self.model)
        own = (Shape.OTHER.value, Shape.HFIELD.value)
        rest.geom_rgba[~np.isin(self._solids.shape, own), 3] = 0.0
        rest.geom_rgba[self._planes, 3] = 0.0
        return RayCaster(rest)


class _Nearest:
    """The first hits of rays so far: the nearest, and of two as near the geom that comes first."""

    def __init__(self, count: int) -> None:
        self.distance = np.full(count, np.inf)
        self.geom = np.full(count, -1, dtype=np.int32)
        self.normal = np.zeros((count, 3))

    def add(self, rows: Index, geom: Index | int, distance: Array, normal: Array) -> None:
        """Take over hits on ``geom`` that are nearer; inf is a miss, and NaN one too."""
        best = self.distance[rows]
        nearer = distance < best
        level = np.isfinite(best) & (distance == best)
        if level.any():
            nearer |= level & (geom < self.geom[rows])
        rows = rows[nearer]
        self.distance[rows] = distance[nearer]
        self.geom[rows] = geom if isinstance(geom, int) else geom[nearer]
        self.normal[rows] = normal[nearer]


class _Grid:
    """Which geoms are over each cell of a grid over the plane."""

    def __init__(self, geoms: Index, low: Array, high: Array) -> None:
        self._corner, self._step = np.zeros(2), 1.0
        self._shape = np.zeros(2, dtype=np.int64)
        first = last = np.zeros((len(geoms), 2), dtype=np.int64)
        if len(geoms):
            self._corner = low[geoms, :2].min(axis=0)
            extent = high[geoms, :2].max(axis=0) - self._corner
            along = float(np.clip(CELLS_A_GEOM * np.sqrt(len(geoms)), CELLS, MOST_CELLS))
            self._step = max(float(extent.max()) / along, _TINY)
            self._shape = np.floor(extent / self._step).astype(np.int64) + 1
            first = np.floor((low[geoms, :2] - self._corner) / self._step).astype(np.int64)
            last = np.floor((high[geoms, :2] - self._corner) / self._step).astype(np.int64)
        # What is beside the grid is over one more cell, the last, in which there is nothing.
        ncell = int(self._shape.prod())
        wide = last - first + 1
        each = wide.prod(axis=1)
        own = np.repeat(np.arange(len(geoms)), each)
        place = np.arange(len(own)) - np.repeat(np.cumsum(each) - each, each)
        row, column = np.divmod(place, wide[own, 0])
        cell = (first[own, 1] + row) * self._shape[0] + first[own, 0] + column
        order = np.argsort(cell, kind="stable")
        self._geoms = geoms[own[order]]
        self._count = np.bincount(cell, minlength=ncell + 1)
        self._start = np.cumsum(self._count) - self._count
        self._most = int(self._count.max())

    def candidates(self, points: Array) -> list[tuple[Index, Index]]:
        """Return rows of points (3, n) and a geom each: all pairs that share a cell, in parts."""
        place = np.floor((points[:2] - self._corner[:, None]) / self._step)
        inside = ((place >= 0) & (place < self._shape[:, None])).all(axis=0)
        if not inside.any():
            return []
        rows = np.flatnonzero(inside)
        column, row = place[:, rows].astype(np.int64)
        cell = row * self._shape[0] + column
        count, start = self._count[cell], self._start[cell]
        pairs = []
        for number in range(self._most):
            more = count > number
            if not more.all():
                rows, count, start = rows[more], count[more], start[more]
            if len(rows) == 0:
                break
            pairs.append((rows, self._geoms[start + number]))
        return pairs


def bounds(model: mujoco.MjModel, solids: Solids) -> tuple[Array, Array]:
    """Return the corners (ngeom, 3) of boxes along the axes around all geoms [m]; of planes too.

    The latter say nothing, since a plane has no end.
    """
    middle, half = model.geom_aabb[:, :3], model.geom_aabb[:, 3:]
    matrix = solids.matrix.T.reshape(-1, 3, 3)
    centre = solids.place.T + (matrix @ middle[..., None])[..., 0]
    reach = (np.abs(matrix) @ half[..., None])[..., 0]
    reach = reach * (1.0 + _TINY) + _TINY
    return centre - reach, centre + reach
