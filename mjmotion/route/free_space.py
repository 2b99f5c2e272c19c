"""Free space for a walk: how far every place is from what a body cannot pass, band by band.

    space = find_free_space(scene, path, height)
    space.lack(points, needed)        # how much a body of given half widths lacks at places

What is no higher than a step is ground; what hangs so high that one can bow under it is passable,
at a cost. All else bars, in the bands of heights over the ground that it is in (``BANDS`` of
:mod:`mjmotion.route.width`), and so do ledges and gaps, where there is no ground to walk to.
"""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.route.shapes import Shape, outline_distance, solid_shapes
from mjmotion.route.walkable import CELL as GROUND_CELL
from mjmotion.route.walkable import Walkable, find_walkable
from mjmotion.route.width import BANDS, LOWEST, STEP_HEIGHT
from mjmotion.scene import Scene

Array = NDArray[np.float64]
Index = NDArray[np.int64]

CELL = 0.05  # of the grid [m]
FAR = 0.65  # further away than this nothing is told [m]
CLIMB = 0.95  # what is no higher is climbed on or over, where that is asked for [m]
UNDER = 0.03  # room that a head wants [m]
_LEVEL = 0.3  # grounds that differ by less are one level to a shape [m]
_MOST = 0.5  # share of a solid that is walked on, and it is ground
NO_GROUND = -1
"""Stands for the geom where there is no ground."""


@dataclasses.dataclass(frozen=True, eq=False)
class FreeSpace:
    """Distances over a grid to what bars the way.

    Attributes:
      corner: (2,) where its first point is [m].
      distance: (nband + 1, ny, nx) to what is in each band, negative inside [m]; the last to where
        there is no ground. :data:`FAR` where nothing is near.
      nearest: (nband + 1, ny, nx) the geom that it is to, or :data:`NO_GROUND`.
      overhead: (ny, nx) to what one has to bow under [m].
      rise: (ny, nx) the highest single step of the ground within a foot's length [m].
      ground: what can be walked to.
      model: of the scene.
    """

    corner: Array
    distance: Array
    nearest: Index
    overhead: Array
    rise: Array
    ground: Walkable
    model: mujoco.MjModel

    def distances(self, points: Array) -> Array:
        """Return distances (..., nband + 3) at points (..., 2), the last of rises [m]."""
        layers = np.concatenate((self.distance, self.overhead[None], self.rise[None]))
        return self._between(points, layers)

    def _between(self, points: Array, layers: Array) -> Array:
        """Return layers (k, ny, nx) at points (..., 2), bilinear: (..., k)."""
        shape = np.array(layers.shape[1:])[::-1]
        at = np.clip((points - self.corner) / CELL, 0.0, shape - 1.001)
        first = at.astype(np.int64)
        u, v = np.moveaxis(at - first, -1, 0)
        column, row = first[..., 0], first[..., 1]
        near = (1.0 - v) * ((1.0 - u) * layers[:, row, column] + u * layers[:, row, column + 1])
        far = (1.0 - u) * layers[:, row + 1, column] + u * layers[:, row + 1, column + 1]
        return np.moveaxis(near + v * far, 0, -1)

    def holds(self, points: Array) -> bool:
        """Return whether points (n, 2) [m] are all well within the grid."""
        size = CELL * np.array(self.overhead.shape)[::-1]
        inside = (points > self.corner + FAR) & (points < self.corner + size - FAR)
        return bool(inside.all())

    def lack(self, points: Array, needed: Array) -> Array:
        """Return how much nearer than needed (..., nband + 1) what bars is at points (..., 2) [m].

        The most of all bands, 0 where all is free.
        """
        distance = self._between(points, self.distance)
        return np.maximum((needed - distance).max(axis=-1), 0.0)

    def worst(self, point: Array, needed: Array) -> tuple[int, float]:
        """Return the geom that lacks the most at a point (2,), and how much [m]."""
        lack = needed - self._between(point, self.distance)
        band = int(np.argmax(lack))
        column, row = np.rint((point - self.corner) / CELL).astype(np.int64)
        row = int(np.clip(row, 0, self.distance.shape[1] - 1))
        column = int(np.clip(column, 0, self.distance.shape[2] - 1))
        return int(self.nearest[band, row, column]), float(lack[band])


def find_free_space(
    scene: Scene,
    points: Array,
    reach: float,
    height: float,
    *,
    climb: bool = False,
    avoid: tuple[str, ...] = (),
) -> FreeSpace:
    """Return the free space around a walk's line.

    Args:
      scene: the scene, at rest.
      points: (n, 2) of the line, from where the walk begins [m].
      reach: how far around it [m].
      height: of the body [m].
      climb: whether what has a top is climbed, where it is not too high.
      avoid: names of geoms that are not ground.
    """
    low, high = points.min(axis=0) - reach, points.max(axis=0) + reach
    start = np.append(points[0], scene.start_pos[2])[None]
    step = CLIMB if climb else STEP_HEIGHT
    ground = find_walkable(scene.ground, start, (low, high), step)
    shape = np.ceil((high - low) / CELL).astype(np.int64)[::-1] + 1
    grid = _Grid(low, tuple(shape.tolist()), ground, height, step)
    levels = ground.height
    floor, ceiling = float(levels.min()) + step, float(levels.max()) + height + UNDER
    box = np.append(low - FAR, floor), np.append(high + FAR, ceiling)
    for solid in solid_shapes(scene.model, *box):
        grid.add(solid)
    grid.add_ground()
    return FreeSpace(
        low, grid.distance, grid.nearest, grid.overhead, grid.rises(), ground, scene.model
    )


class _Grid:
    """Distances while they are collected."""

    def __init__(
        self, corner: Array, shape: tuple[int, ...], ground: Walkable, height: float, step: float
    ) -> None:
        self.corner, self.ground, self.step = corner, ground, step
        self.ceiling = height + UNDER
        self.distance = np.full((len(BANDS) + 1, *shape), FAR)
        self.nearest = np.full(self.distance.shape, NO_GROUND, dtype=np.int64)
        self.overhead = np.full(shape, FAR)

    def add(self, solid: Shape) -> None:
        """Take a solid into account, over each level of ground that is near it."""
        if solid.convex and self._stood_on(solid):
            return
        low, high = solid.points[:, :2].min(axis=0) - FAR, solid.points[:, :2].max(axis=0) + FAR
        cells, points = self._cells(low, high)
        if len(points) == 0:
            return
        if not solid.convex:
            self._over_mesh(solid, cells, points)
            return
        ground = self.ground.at(points)
        level = np.rint(ground / _LEVEL).astype(np.int64)
        if np.ptp(ground) < 0.5 * _LEVEL:
            level[:] = 0
        for number in np.unique(level):
            mine = level == number
            over = float(np.median(ground[mine]))
            self._over(solid, over, (cells[0][mine], cells[1][mine]), points[mine])

    def _cells(self, low: Array, high: Array) -> tuple[tuple[Index, Index], Array]:
        """Return rows and columns of the places within a box, and the places (n, 2)."""
        shape = np.array(self.overhead.shape)[::-1]
        first = np.clip(np.floor((low - self.corner) / CELL), 0, shape).astype(np.int64)
        last = np.clip(np.ceil((high - self.corner) / CELL) + 1, 0, shape).astype(np.int64)
        rows, columns = np.mgrid[first[1] : last[1], first[0] : last[0]]
        cells = rows.ravel(), columns.ravel()
        return cells, self.corner + CELL * np.column_stack(cells[::-1])

    def _stood_on(self, solid: Shape) -> bool:
        """Whether a solid is ground: most of it, seen from above, is walked on."""
        ends = solid.points[:, :2].min(axis=0), solid.points[:, :2].max(axis=0)
        _, points = self._cells(*ends)
        points = points[outline_distance(solid.outline(-np.inf, np.inf), points) < 0.0]
        return bool(
            len(points)
            and (self.ground.geom[self.ground.cells(points)] == solid.geom).mean() > _MOST
        )

    def _over(self, solid: Shape, ground: float, cells: tuple[Index, Index], points: Array) -> None:
        """Take a convex solid into account over ground of one level."""
        low, high = solid.points[:, 2].min() - ground, solid.points[:, 2].max() - ground
        if high <= self.step or low >= self.ceiling:
            return
        if low >= LOWEST:
            outline = solid.outline(ground + LOWEST, ground + self.ceiling)
            near = np.minimum(self.overhead[cells], outline_distance(outline, points))
            self.overhead[cells] = near
            return
        last: tuple[Array, Array] | None = None
        for band, (floor, above) in enumerate(zip(BANDS, (*BANDS[1:], self.ceiling), strict=True)):
            outline = solid.outline(ground + floor, ground + above)
            if len(outline) == 0:
                continue
            same = last is not None and np.array_equal(last[0], outline)
            distance = last[1] if last and same else outline_distance(outline, points)
            last = outline, distance
            self._nearer(band, solid.geom, cells, distance)

    def _over_mesh(self, solid: Shape, cells: tuple[Index, Index], points: Array) -> None:
        """Take a mesh into account that is not convex: what of it is ground is not in the way."""
        up = solid.points[:, 2] - self.ground.at(solid.points[:, :2])
        high = (up > self.step) & (up < self.ceiling)
        places, up = solid.points[high, :2], up[high]
        if len(up) == 0:
            return
        # What hangs is what has nothing below it, over the ground, in its own column.
        _, column = np.unique(np.rint(places / GROUND_CELL), axis=0, return_inverse=True)
        lowest = np.full(column.max() + 1, np.inf)
        np.minimum.at(lowest, column.ravel(), up)
        hangs = lowest[column.ravel()] >= LOWEST
        if hangs.any():
            near = np.minimum(self.overhead[cells], _point_distance(places[hangs], points))
            self.overhead[cells] = near
        for band, (floor, above) in enumerate(zip(BANDS, (*BANDS[1:], self.ceiling), strict=True)):
            # Low parts are ground: legs meet what knees meet.
            floor, above = (self.step, BANDS[2]) if band == 0 else (floor, above)
            inside = ~hangs & (up >= floor) & (up <= above)
            if inside.any():
                self._nearer(band, solid.geom, cells, _point_distance(places[inside], points))

    def _nearer(self, band: int, geom: int, cells: tuple[Index, Index], distance: Array) -> None:
        nearer = distance < self.distance[band][cells]
        rows, columns = cells[0][nearer], cells[1][nearer]
        self.distance[band, rows, columns] = distance[nearer]
        self.nearest[band, rows, columns] = geom

    def rises(self) -> Array:
        """Return (ny, nx) the highest single step of the ground within a foot's length [m]."""
        from scipy.ndimage import maximum_filter, minimum_filter

        height = self.ground.height
        rise = maximum_filter(maximum_filter(height, 3) - minimum_filter(height, 3), 3)
        rows, columns = np.indices(self.overhead.shape)
        points = self.corner + CELL * np.stack((columns, rows), axis=-1)
        return np.asarray(rise[self.ground.cells(points)])

    def add_ground(self) -> None:
        """Take into account where there is no ground."""
        from scipy.ndimage import distance_transform_edt

        passable = self.ground.steppable()
        if passable.all():
            return
        apart = distance_transform_edt(passable) - distance_transform_edt(~passable)
        rows, columns = np.indices(self.overhead.shape)
        points = self.corner + CELL * np.stack((columns, rows), axis=-1)
        self.distance[-1] = np.minimum(FAR, GROUND_CELL * apart[self.ground.cells(points)])


def _point_distance(places: Array, points: Array) -> Array:
    """Return distances (n,) of points (n, 2) to the nearest of places (m, 2) [m]."""
    from scipy.spatial import KDTree

    near, _ = KDTree(places).query(points, distance_upper_bound=FAR)
    return np.minimum(near, FAR)


def geom_name(model: mujoco.MjModel, geom: int) -> str:
    """Return what a geom is called."""
    return model.geom(geom).name or f"geom {geom}"
