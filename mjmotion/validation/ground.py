"""The static scene, seen along vertical lines: where its solids begin and end.

``Ground.heights`` answers what someone would stand on. The vertical line through a point crosses
the solids of the scene; solids that touch (less than 1 mm of air between) count as one.

- A point in free space stands over the highest top under it, whatever hangs above: a lintel over
  the point is not ground, nor is a floor that a block stands on.
- A point inside a solid stands under that solid's top.

Planes and heightfields are solid all the way down. A mesh that is not convex counts as what its
own triangles enclose (an open sheet as solid below it), not as the hull it collides as.
"""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.validation.field import BoxTops, Field, field_grid
from mjmotion.validation.meshes import is_convex, mesh_arrays
from mjmotion.validation.solids import Solid, solid_of, vertical_extent

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_Geom = mujoco.mjtGeom
_AIR = 1e-3  # [m] less air than this between two solids is not free space
_FLAT = 1e-9  # a plane or field closer to upright than this is upright
_UPRIGHT = 1e-15  # of the cosine: how far off the vertical a box may be to count as upright


def static_geoms(model: mujoco.MjModel) -> Index:
    """Return the scene: geoms that collide with anything, on bodies that cannot move."""
    fixed = model.body_weldid[model.geom_bodyid] == 0
    return np.flatnonzero(fixed & ((model.geom_contype != 0) | (model.geom_conaffinity != 0)))


class Ground:
    """The static geoms of a model.

    Attributes:
      planes: ids of planes.
      fields: the heightfields that stand upright.
      convex: ids of boxes, balls, rods and convex meshes.
      surfaces: ids of other meshes, of signed distance fields, and of tilted heightfields, all
        taken triangle by triangle.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        self.position = np.array(data.geom_xpos)
        self.matrix = np.array(data.geom_xmat).reshape(-1, 3, 3)
        groups: dict[str, list[int]] = {"plane": [], "field": [], "convex": [], "surface": []}
        for geom in static_geoms(model):
            groups[self._group(int(geom))].append(int(geom))
        self.planes = groups["plane"]
        self.fields = [
            Field(model, geom, self.position[geom], self.matrix[geom]) for geom in groups["field"]
        ]
        self.convex, self.surfaces = groups["convex"], groups["surface"]
        self.solids: dict[int, Solid] = {geom: solid_of(model, geom) for geom in self.convex}
        self._solid_cells: _Cells | None = None
        self._box_tops: BoxTops | None = None
        if self.convex:
            self._index_solids()
        self._triangles, self._triangle_geom = self._collect_triangles()
        self._surface_bounds = self._bound_surfaces()
        self._triangle_cells = (
            _Cells(self._triangles[:, :, :2].min(axis=1), self._triangles[:, :, :2].max(axis=1))
            if len(self._triangles)
            else None
        )

    def heights(self, points: Array) -> tuple[Array, Index]:
        """Return the height of the ground for points (n, 3), and which geom it belongs to.

        Returns:
          height: (n,) [m], NaN where there is nothing under the point.
          geom: (n,) geom ids, -1 where there is nothing.
        """
        low, high, geom = self.extents(points[:, :2])
        count, width = low.shape
        if width == 0:
            return np.full(count, np.nan), np.full(count, -1)
        z = points[:, 2, None]
        free: NDArray[np.bool_] = ~np.isnan(high) & ~np.isposinf(high)
        for column in range(width if width > 1 else 0):
            top = high[:, column, None]
            covered = (low <= top + _AIR) & (high > top + _FLAT)
            free[:, column] &= ~covered.any(axis=1)
        inside: NDArray[np.bool_] = np.any((low < z) & (z < high), axis=1)
        rise = np.where(free & (high >= z) & inside[:, None], high, np.inf)
        fall = np.where(free & (high <= z) & ~inside[:, None], high, -np.inf)
        best = np.where(inside, rise.argmin(axis=1), fall.argmax(axis=1))
        rows = np.arange(count)
        height = np.where(inside, rise[rows, best], fall[rows, best])
        found = np.isfinite(height)
        return np.where(found, height, np.nan), np.where(found, geom[rows, best], -1)

    def depth_in_surfaces(self, points: Array) -> tuple[Array, Index]:
        """Return how deep (n,) points are, straight up, in heightfields and open meshes [m].

        Zero outside; with the geom, -1 outside. Planes and convex geoms do not count here.
        """
        depth, owner = np.zeros(len(points)), np.full(len(points), -1)
        for field in self.fields:
            deep = field.height(points[:, :2]) - points[:, 2]
            deeper = deep > depth  # never beside the field, where it is NaN
            depth[deeper], owner[deeper] = deep[deeper], field.geom
        if self._triangle_cells is not None:
            row, low, high, geom = self._surface_extents(points[:, :2])
            z = points[row, 2]
            order = np.argsort(high - z, kind="stable")  # the last one written stays
            order = order[((low < z) & (z < high) & (high - z > depth[row]))[order]]
            depth[row[order]], owner[row[order]] = (high - z)[order], geom[order]
        return depth, owner

    def extents(self, xy: Array) -> tuple[Array, Array, Index]:
        """Return what vertical lines (n, 2) cross.

        Args:
          xy: the lines [m].

        Returns:
          low, high: (n, k) where the line is in a solid [m], NaN in unused columns.
          geom: (n, k) ids, -1 in unused columns.
        """
        row, low, high, geom = [], [], [], []

        def add(rows: Index, bottoms: Array, tops: Array, ids: Index | int) -> None:
            hit = ~np.isnan(tops)
            row.append(rows[hit])
            low.append(bottoms[hit])
            high.append(tops[hit])
            geom.append(np.broadcast_to(ids, rows.shape)[hit])

        every = np.arange(len(xy))
        for field in self.fields:
            add(every, np.full(len(xy), -np.inf), field.height(xy), field.geom)
        if self._triangle_cells is not None:
            rows, bottoms, tops, ids = self._surface_extents(xy)
            add(rows, bottoms, tops, ids)
        for plane in self.planes:
            bottoms, tops = self._plane_extents(plane, xy)
            add(every, bottoms, tops, plane)
        if self._solid_cells is not None:
            for rows, bottoms, tops, ids in self._solid_extents(xy):
                add(rows, bottoms, tops, ids)
        return _side_by_side(len(xy), row, low, high, geom)

    def highest(self, centre: Array, extent: Array, *, solids: bool = True) -> Array:
        """Return a height that no ground rises above near points, or a little more than that.

        Args:
          centre: (n, 3) middles of boxes along the world's axes [m].
          extent: (n, 3) their half sizes [m].
          solids: also planes and convex geoms, not only heightfields and open meshes.

        Returns:
          (n,) [m], minus infinity where there is nothing over or under a box. A ceiling is none.
        """
        top = np.full(len(centre), -np.inf)
        for field in self.fields:
            top = np.maximum(top, field.highest(centre, extent))
        for low, high in self._surface_bounds:
            reach = extent[:, :2] + 1e-6
            beside = (centre[:, :2] + reach < low[:2]) | (centre[:, :2] - reach > high[:2])
            top = np.where(beside.any(axis=1), top, np.maximum(top, high[2]))
        if solids:
            for plane in self.planes:
                normal = self.matrix[plane][:, 2]
                if normal[2] > _FLAT:
                    _, height = self._plane_extents(plane, centre[:, :2])
                    climb = extent[:, :2] @ np.abs(normal[:2]) / normal[2]
                    top = np.maximum(top, height + climb)
            if self._box_tops is not None:
                top = np.maximum(top, self._box_tops.highest(centre, extent))
        return top

    @property
    def surface_top(self) -> float:
        """Height of the highest point of all heightfields and open meshes [m]."""
        tops = [field.top for field in self.fields]
        tops += [float(high[2]) for _, high in self._surface_bounds]
        return max(tops, default=-np.inf)

    def name(self, geom: int) -> str:
        """Return a geom's name, or its kind and number."""
        if geom < 0:
            return "nothing"
        kind = _Geom(int(self.model.geom_type[geom])).name.removeprefix("mjGEOM_").lower()
        return self.model.geom(geom).name or f"{kind} {geom}"

    def _group(self, geom: int) -> str:
        kind = self.model.geom_type[geom]
        if kind == _Geom.mjGEOM_PLANE:
            return "plane"
        if kind == _Geom.mjGEOM_HFIELD:
            return "field" if self.matrix[geom][2, 2] > 1 - _FLAT else "surface"
        if kind == _Geom.mjGEOM_SDF:  # its mesh is what MuJoCo sampled it to
            return "surface"
        if kind == _Geom.mjGEOM_MESH:
            convex = is_convex(self.model, int(self.model.geom_dataid[geom]))
            return "convex" if convex else "surface"
        return "convex"

    def _index_solids(self) -> None:
        ids = np.array(self.convex)
        box = self.model.geom_aabb[ids]
        centre = self.position[ids] + np.einsum("gij,gj->gi", self.matrix[ids], box[:, :3])
        half = np.einsum("gij,gj->gi", np.abs(self.matrix[ids]), box[:, 3:])
        self._solid_cells = _Cells((centre - half)[:, :2], (centre + half)[:, :2])
        self._box_tops = BoxTops(centre - half - 1e-6, centre + half + 1e-6)
        is_box = self.model.geom_type[ids] == _Geom.mjGEOM_BOX
        self._upright = is_box & (np.abs(self.matrix[ids, 2, 2]) > 1 - _UPRIGHT)

    def _solid_extents(self, xy: Array) -> Iterator[tuple[Index, Array, Array, Index]]:
        """Yield points, where their lines enter and leave a solid, and which: all boxes first."""
        assert self._solid_cells is not None
        point, which = self._solid_cells.pairs(xy)
        upright = self._upright[which]
        rows, ids = point[upright], np.array(self.convex)[which[upright]]
        if len(rows):
            turn, size = self.matrix[ids, :2, :2], self.model.geom_size[ids]
            aside = np.einsum("nji,nj->ni", turn, xy[rows] - self.position[ids, :2])
            over = (np.abs(aside) <= size[:, :2]).all(axis=1)
            rows, ids, size = rows[over], ids[over], size[over]
            height = self.position[ids, 2]
            yield rows, height - size[:, 2], height + size[:, 2], ids
        point, which = point[~upright], which[~upright]
        for slot in np.unique(which):
            rows, geom = point[which == slot], self.convex[slot]
            low, high = vertical_extent(
                self.solids[geom], self.position[geom], self.matrix[geom], xy[rows]
            )
            yield rows, low, high, np.full(len(rows), geom)

    def _bound_surfaces(self) -> list[tuple[Array, Array]]:
        """Return the bounding boxes of open meshes and tilted heightfields, each (3,) and (3,)."""
        boxes = []
        for geom in self.surfaces:
            corner = self._triangles[self._triangle_geom == geom].reshape(-1, 3)
            boxes.append((corner.min(axis=0), corner.max(axis=0)))
        return boxes

    def _collect_triangles(self) -> tuple[Array, Index]:
        triangles, owners = [np.empty((0, 3, 3))], [np.empty(0, np.int64)]
        for geom in self.surfaces:
            if self.model.geom_type[geom] == _Geom.mjGEOM_HFIELD:
                vertex, face = self._field_mesh(geom)
            else:
                vertex, face = mesh_arrays(self.model, int(self.model.geom_dataid[geom]))
            world = vertex @ self.matrix[geom].T + self.position[geom]
            triangles.append(world[face])
            owners.append(np.full(len(face), geom))
        return np.concatenate(triangles), np.concatenate(owners)

    def _field_mesh(self, geom: int) -> tuple[Array, Index]:
        values, spacing = field_grid(self.model, geom)
        nrow, ncol = values.shape
        r, c = np.mgrid[:nrow, :ncol]
        half = self.model.hfield_size[self.model.geom_dataid[geom], :2]
        vertex = np.stack((c * spacing[0] - half[0], r * spacing[1] - half[1], values), axis=2)
        base = (r * ncol + c)[:-1, :-1].ravel()
        lower = np.stack((base, base + 1, base + ncol + 1), axis=1)
        upper = np.stack((base, base + ncol + 1, base + ncol), axis=1)
        return vertex.reshape(-1, 3), np.concatenate((lower, upper))

    def _plane_extents(self, geom: int, xy: Array) -> tuple[Array, Array]:
        """MuJoCo's planes have no edge for collisions, whatever size they are drawn with."""
        normal = self.matrix[geom][:, 2]
        offset = float(normal @ self.position[geom])
        across = xy @ normal[:2]
        endless = np.full(len(xy), np.inf)
        if abs(normal[2]) < _FLAT:  # a wall: its back half is solid
            inside = np.where(across < offset, np.inf, np.nan)
            return -inside, inside
        height = (offset - across) / normal[2]
        return (-endless, height) if normal[2] > 0 else (height, endless)

    def _surface_extents(self, xy: Array) -> tuple[Index, Array, Array, Index]:
        """Pair the crossings of each line with each open mesh: in, out, in, out, from above."""
        assert self._triangle_cells is not None
        # A hair's breadth aside, so that no line runs through an edge and counts two triangles.
        line = xy + np.array([1.37e-8, 0.71e-8])
        point, which = self._triangle_cells.pairs(line)
        a, b, c = (self._triangles[which, i] for i in range(3))
        p = line[point]
        twice = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (
            c[:, 0] - a[:, 0]
        )
        with np.errstate(invalid="ignore", divide="ignore"):
            second = (
                (p[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1])
                - (p[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
            ) / twice
            third = (
                (b[:, 0] - a[:, 0]) * (p[:, 1] - a[:, 1])
                - (b[:, 1] - a[:, 1]) * (p[:, 0] - a[:, 0])
            ) / twice
        hit = (second >= 0) & (third >= 0) & (second + third <= 1)  # NaN: upright, no hit
        z = a[:, 2] + second * (b[:, 2] - a[:, 2]) + third * (c[:, 2] - a[:, 2])
        point, z, geom = point[hit], z[hit], self._triangle_geom[which[hit]]
        order = np.lexsort((-z, geom, point))
        point, z, geom = point[order], z[order], geom[order]
        new = np.ones(len(point), dtype=bool)
        new[1:] = (point[1:] != point[:-1]) | (geom[1:] != geom[:-1])
        start = np.flatnonzero(new)
        place = np.arange(len(point)) - np.repeat(start, np.diff(np.append(start, len(point))))
        enters = np.flatnonzero(place % 2 == 0)
        leaves = np.minimum(enters + 1, len(point) - 1)
        closed = (leaves > enters) & ~new[leaves]
        bottom = np.where(closed, z[leaves], -np.inf)
        return point[enters], bottom, z[enters], geom[enters]


class _Cells:
    """Which rectangles lie over a point: a square grid that lists the rectangles of each cell."""

    def __init__(self, low: Array, high: Array) -> None:
        self._origin = low.min(axis=0) - 1e-6
        span = high.max(axis=0) + 1e-6 - self._origin
        size = float(np.median(np.max(high - low, axis=1)))
        self._cell = max(size, float(span.max()) / 512, 1e-6)
        self._shape = np.maximum(1, np.ceil(span / self._cell)).astype(np.int64)
        first = self._cell_of(low)
        last = self._cell_of(high)
        extent = last - first + 1
        count = extent[:, 0] * extent[:, 1]
        which = np.repeat(np.arange(len(low)), count)
        place = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
        x = first[which, 0] + place % extent[which, 0]
        y = first[which, 1] + place // extent[which, 0]
        cell = x * self._shape[1] + y
        order = np.argsort(cell, kind="stable")
        self._members = which[order]
        self._start = np.searchsorted(cell[order], np.arange(self._shape.prod() + 1))
        self._low, self._high = low, high

    def pairs(self, xy: Array) -> tuple[Index, Index]:
        """Return the pairs (point, rectangle) where the rectangle holds the point."""
        place = np.floor((xy - self._origin) / self._cell).astype(np.int64)
        within = np.flatnonzero(((place >= 0) & (place < self._shape)).all(axis=1))
        cell = place[within, 0] * self._shape[1] + place[within, 1]
        start, count = self._start[cell], self._start[cell + 1] - self._start[cell]
        point = np.repeat(within, count)
        offset = np.arange(len(point)) - np.repeat(np.cumsum(count) - count, count)
        member = self._members[np.repeat(start, count) + offset]
        p = xy[point]
        holds = ((p >= self._low[member] - 1e-7) & (p <= self._high[member] + 1e-7)).all(axis=1)
        return point[holds], member[holds]

    def _cell_of(self, xy: Array) -> Index:
        place = np.floor((xy - self._origin) / self._cell).astype(np.int64)
        return np.asarray(np.clip(place, 0, self._shape - 1))


def _side_by_side(
    count: int, row: list[Index], low: list[Array], high: list[Array], geom: list[Index]
) -> tuple[Array, Array, Index]:
    """Put hits, listed by point, into arrays of one line a point."""
    if sum(len(rows) for rows in row) == 0:
        return np.empty((count, 0)), np.empty((count, 0)), np.empty((count, 0), np.int64)
    if len(row) == 1 and len(row[0]) == count:  # one field under everything: nothing to sort
        return low[0][:, None], high[0][:, None], geom[0][:, None]
    rows = np.concatenate(row)
    order = np.argsort(rows, kind="stable")
    rows = rows[order]
    start = np.searchsorted(rows, np.arange(count))
    column = np.arange(len(rows)) - start[rows]
    shape = (count, int(column.max()) + 1)
    bottom, top = np.full(shape, np.nan), np.full(shape, np.nan)
    ids = np.full(shape, -1)
    bottom[rows, column] = np.concatenate(low)[order]
    top[rows, column] = np.concatenate(high)[order]
    ids[rows, column] = np.concatenate(geom)[order]
    return bottom, top, ids
