"""Where rays straight down hit shapes: formulas for all rays at once, in MuJoCo's own order.

Each function takes one geom for every ray, or one for all, and returns how far it goes: to the
surface from outside, out of it again from inside; inf where it misses. Normals point out of the
geom.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from enum import IntEnum

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MINVAL = 1e-15  # MuJoCo's own, under which a direction has no part along an axis
_SURE = 1e-6  # nearer than this to a heightfield's surface or border its rays are MuJoCo's [m]


class Shape(IntEnum):
    """What is known of a geom's surface."""

    OTHER = 0  # nothing: rays on to it are MuJoCo's
    LEVEL_BOX = 1  # along the axes of the world
    BOX = 2
    SPHERE = 3
    CAPSULE = 4
    CYLINDER = 5
    ELLIPSOID = 6
    HFIELD = 7  # upright, turned about the vertical at most


_KINDS = {
    mujoco.mjtGeom.mjGEOM_BOX: Shape.BOX,
    mujoco.mjtGeom.mjGEOM_SPHERE: Shape.SPHERE,
    mujoco.mjtGeom.mjGEOM_CAPSULE: Shape.CAPSULE,
    mujoco.mjtGeom.mjGEOM_CYLINDER: Shape.CYLINDER,
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: Shape.ELLIPSOID,
    mujoco.mjtGeom.mjGEOM_HFIELD: Shape.HFIELD,
}


@dataclasses.dataclass(frozen=True, eq=False)
class Solids:
    """The geoms of a model that stands still, one a column.

    Attributes:
      model: theirs.
      shape: (ngeom,) a :class:`Shape` each.
      place: (3, ngeom) [m].
      matrix: (9, ngeom) how they are turned, by rows.
      size: (3, ngeom) as MuJoCo has it [m].
    """

    model: mujoco.MjModel
    shape: Index
    place: Array
    matrix: Array
    size: Array

    @classmethod
    def of(cls, model: mujoco.MjModel) -> Solids:
        """Return them for a model in its ``qpos0``."""
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        kinds = [_KINDS.get(mujoco.mjtGeom(kind), Shape.OTHER) for kind in model.geom_type]
        shape = np.array(kinds, dtype=np.int64)
        matrix = np.array(data.geom_xmat.T, order="C")
        level = (data.geom_xmat == np.eye(3).ravel()).all(axis=1)
        shape[level & (shape == Shape.BOX)] = Shape.LEVEL_BOX
        upright = (np.abs(data.geom_xmat[:, [2, 5, 6, 7]]) <= MINVAL).all(axis=1)
        upright &= data.geom_xmat[:, 8] > 0.0
        shape[~upright & (shape == Shape.HFIELD)] = Shape.OTHER
        return cls(
            model,
            shape,
            np.array(data.geom_xpos.T, order="C"),
            matrix,
            np.array(model.geom_size.T, order="C"),
        )

    def local(self, geoms: Index, points: Array) -> tuple[Array, Array]:
        """Return points (3, n) and the way down (3, n), in the frames of geoms (n or 1,)."""
        matrix = self.matrix[:, geoms]
        x, y, z = points - self.place[:, geoms]
        mapped = matrix[:3] * x + matrix[3:6] * y + matrix[6:] * z
        return mapped, np.broadcast_to(-matrix[6:], mapped.shape)

    def world(self, geoms: Index, normal: Array) -> Array:
        """Return normals (n, 3) of unit length from those (3, n) in frames of geoms (n or 1,)."""
        matrix = self.matrix[:, geoms].reshape(3, 3, -1)
        turned = (matrix * normal).sum(axis=1)
        return np.asarray((turned / np.maximum(np.linalg.norm(turned, axis=0), MINVAL)).T)


def plane(solids: Solids, geom: int, points: Array) -> tuple[Array, Array]:
    """Return distances (n,) [m] and normals (n, 3) of rays down on to a plane without end."""
    x, y, z = points - solids.place[:, geom, None]
    normal = solids.matrix[2::3, geom]
    if -normal[2] > -MINVAL:
        distance = np.full(points.shape[1], np.inf)
    else:
        distance = (normal[0] * x + normal[1] * y + normal[2] * z) / normal[2]
        distance[distance < 0.0] = np.inf
    return distance, np.broadcast_to(normal, (points.shape[1], 3))


def _level_box(solids: Solids, geoms: Index, points: Array) -> tuple[Array, Array]:
    size = solids.size[:, geoms]
    x, y, z = points - solids.place[:, geoms]
    top, bottom = z - size[2], z + size[2]
    inside = top < 0.0
    distance = np.where(inside, bottom, top)
    beside = (np.abs(x) > size[0]) | (np.abs(y) > size[1]) | (distance < 0.0)
    distance[beside] = np.inf
    normal = np.zeros((points.shape[1], 3))
    normal[:, 2] = 1.0 - 2.0 * inside
    return distance, normal


def _box(solids: Solids, geoms: Index, points: Array) -> tuple[Array, Array]:
    size = solids.size[:, geoms]
    point, way = solids.local(geoms, points)
    nearest = np.full(points.shape[1], np.inf)
    normal = np.zeros(points.shape)
    for axis, others in enumerate(((1, 2), (0, 2), (0, 1))):
        goes = np.abs(way[axis]) > MINVAL
        along = np.where(goes, way[axis], 1.0)
        for side in (-1.0, 1.0):
            distance = (side * size[axis] - point[axis]) / along
            met = goes & (distance >= 0.0) & (distance < nearest)
            for other in others:
                met &= np.abs(point[other] + distance * way[other]) <= size[other]
            nearest[met] = distance[met]
            normal[:, met] = 0.0
            normal[axis, met] = side
    return nearest, solids.world(geoms, normal)


def _sphere(solids: Solids, geoms: Index, points: Array) -> tuple[Array, Array]:
    point = points - solids.place[:, geoms]
    way = np.zeros_like(point)
    way[2] = -1.0
    distance = _first(_roots(point, way, solids.size[0, geoms]))
    hit = point + np.where(np.isfinite(distance), distance, 0.0) * way
    return distance, np.asarray((hit / np.maximum(np.linalg.norm(hit, axis=0), MINVAL)).T)


def _ellipsoid(solids: Solids, geoms: Index, points: Array) -> tuple[Array, Array]:
    size = solids.size[:, geoms]
    point, way = solids.local(geoms, points)
    distance = _first(_roots(point / size, way / size, np.ones(points.shape[1])))
    hit = point + np.where(np.isfinite(distance), distance, 0.0) * way
    return distance, solids.world(geoms, hit / size**2)


def _capsule(solids: Solids, geoms: Index, points: Array) -> tuple[Array, Array]:
    radius, half = solids.size[:2, geoms]
    point, way = solids.local(geoms, points)
    side = (one for one in _roots(point[:2], way[:2], radius))
    ways = [_where(one, np.abs(point[2] + one * way[2]) <= half) for one in side]
    for end in (1.0, -1.0):
        from_cap = point - np.stack((0.0 * half, 0.0 * half, end * half))
        for one in _roots(from_cap, way, radius):
            ways.append(_where(one, end * (point[2] + one * way[2]) >= half))
    distance = _first(ways)
    hit = point + np.where(np.isfinite(distance), distance, 0.0) * way
    hit[2] -= np.clip(hit[2], -half, half)
    return distance, solids.world(geoms, hit)


def _cylinder(solids: Solids, geoms: Index, points: Array) -> tuple[Array, Array]:
    radius, half = solids.size[:2, geoms]
    point, way = solids.local(geoms, points)
    goes = np.abs(way[2]) > MINVAL
    along = np.where(goes, way[2], 1.0)
    nearest = np.full(points.shape[1], np.inf)
    normal = np.zeros(points.shape)
    for end in (-1.0, 1.0):
        distance = (end * half - point[2]) / along
        x, y = point[:2] + distance * way[:2]
        met = goes & (distance >= 0.0) & (x * x + y * y <= radius * radius) & (distance < nearest)
        nearest[met] = distance[met]
        normal[2, met] = end
    for one in _roots(point[:2], way[:2], radius):
        met = (one >= 0.0) & (np.abs(point[2] + one * way[2]) <= half) & (one < nearest)
        nearest[met] = one[met]
        normal[:2, met] = point[:2, met] + one[met] * way[:2, met]
        normal[2, met] = 0.0
    return nearest, solids.world(geoms, normal)


def _hfield(solids: Solids, geoms: Index, points: Array) -> tuple[Array, Array]:
    """Heightfields seen from over their surface, away from their border; NaN for other rays."""
    model = solids.model
    field = model.geom_dataid[geoms]
    rows, columns = model.hfield_nrow[field], model.hfield_ncol[field]
    half_x, half_y, top, _ = model.hfield_size[field].T
    (x, y, z), _ = solids.local(geoms, points)
    sure = (np.abs(x) < half_x - _SURE) & (np.abs(y) < half_y - _SURE)
    step_x, step_y = 2.0 * half_x / (columns - 1), 2.0 * half_y / (rows - 1)
    u, v = np.where(sure, (x + half_x) / step_x, 0.0), np.where(sure, (y + half_y) / step_y, 0.0)
    column = np.clip(np.floor(u).astype(np.int64), 0, columns - 2)
    row = np.clip(np.floor(v).astype(np.int64), 0, rows - 2)
    u, v = u - column, v - row
    at = model.hfield_adr[field] + row * columns + column
    height = model.hfield_data
    corner, far = height[at] * top, height[at + columns + 1] * top
    # A cell is two triangles that meet along its diagonal.
    right = u >= v
    third = height[np.where(right, at + 1, at + columns)] * top
    rise_x = np.where(right, third - corner, far - third)
    rise_y = np.where(right, far - third, third - corner)
    distance = z - (corner + u * rise_x + v * rise_y)
    sure &= distance > _SURE
    normal = np.stack((-rise_x / step_x, -rise_y / step_y, np.ones(points.shape[1])))
    return np.where(sure, distance, np.nan), solids.world(geoms, normal)


SHAPES: dict[Shape, Callable[[Solids, Index, Array], tuple[Array, Array]]] = {
    Shape.LEVEL_BOX: _level_box,
    Shape.BOX: _box,
    Shape.SPHERE: _sphere,
    Shape.CAPSULE: _capsule,
    Shape.CYLINDER: _cylinder,
    Shape.ELLIPSOID: _ellipsoid,
    Shape.HFIELD: _hfield,
}
"""Distances (n,) [m] and normals (n, 3) of rays down from points (3, n) on to geoms (n or 1,)."""


def _roots(point: Array, way: Array, radius: Array) -> tuple[Array, Array]:
    """Return where rays meet ‖point + x way‖ = radius, near and far; NaN where they do not."""
    a = (way * way).sum(axis=0)
    b = (way * point).sum(axis=0)
    c = (point * point).sum(axis=0) - radius * radius
    inside = b * b - a * c
    met = (inside >= 0.0) & (a > MINVAL)
    a = np.where(met, a, 1.0)
    root = np.sqrt(np.where(met, inside, 0.0))
    return np.where(met, (-b - root) / a, np.nan), np.where(met, (-b + root) / a, np.nan)


def _where(distance: Array, met: NDArray[np.bool_]) -> Array:
    return np.where(met, distance, np.nan)


def _first(distances: Iterable[Array]) -> Array:
    """Return the least of distances (n,) that is not behind; inf where there is none."""
    nearest = None
    for distance in distances:
        ahead = np.where(distance >= 0.0, distance, np.inf)
        nearest = ahead if nearest is None else np.minimum(nearest, ahead)
    assert nearest is not None
    return nearest
