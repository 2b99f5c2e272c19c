"""Solids seen from above: what of them is in a band of heights, as convex outlines or points.

for shape in solid_shapes(model): shape.outline(0.45, 0.8)
"""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.geom_points import geom_points
from mjmotion.route.width import is_solid
from mjmotion.scene.hulls import fills_hull

Array = NDArray[np.float64]

SPACING = 0.04  # of points on meshes that are not convex [m]
_GROUND = (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD, mujoco.mjtGeom.mjGEOM_SDF)
_MOST_POINTS = 400_000  # on one mesh


@dataclasses.dataclass(frozen=True, eq=False)
class Shape:
    """A solid, as points of its surface.

    Attributes:
      geom: the geom that it is, or is a part of.
      points: (k, 3): corners of its convex hull; or points all over a mesh that is not convex [m].
      convex: which of them.
    """

    geom: int
    points: Array
    convex: bool

    def outline(self, low: float, high: float) -> Array:
        """Return corners (m, 2) of what is between two heights, counter-clockwise; or points.

        Of a convex solid those of its hull there, seen from above; of any other its points.
        """
        z = self.points[:, 2]
        inside = self.points[(z >= low) & (z <= high), :2]
        if not self.convex:
            return inside
        cuts = [inside]
        for level in (low, high):
            above, below = self.points[z > level], self.points[z < level]
            if len(above) and len(below):
                share = (level - below[None, :, 2]) / (above[:, None, 2] - below[None, :, 2])
                cut = below[None, :, :2] + share[..., None] * (above[:, None] - below)[..., :2]
                cuts.append(cut.reshape(-1, 2))
        return hull(np.concatenate(cuts))


def hull(points: Array) -> Array:
    """Return the corners (m, 2) of the convex hull of points (k, 2), counter-clockwise."""
    from scipy.spatial import ConvexHull, QhullError

    if len(points) < 3:
        return points
    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:  # all on one line
        way = np.argmax(np.ptp(points, axis=0))
        ends = [int(np.argmin(points[:, way])), int(np.argmax(points[:, way]))]
        return points[ends]


def outline_distance(corners: Array, points: Array) -> Array:
    """Return how far points (n, 2) are from a convex outline (m, 2) [m]; negative inside it."""
    start, end = corners, np.roll(corners, -1, axis=0)
    along = end - start
    size = np.maximum((along**2).sum(axis=1), 1e-18)
    away = points[:, None] - start
    share = np.clip((away * along).sum(axis=2) / size, 0.0, 1.0)
    off = away - share[..., None] * along
    distance = np.sqrt((off**2).sum(axis=2)).min(axis=1)
    if len(corners) < 3:
        return np.asarray(distance)
    across = along[:, 0] * away[..., 1] - along[:, 1] * away[..., 0]
    return np.where((across >= 0.0).all(axis=1), -distance, distance)


def solid_shapes(model: mujoco.MjModel, low: Array, high: Array) -> list[Shape]:
    """Return the solids of a scene, but planes and heightfields, within a box.

    Args:
      model: the scene.
      low: (3,) a corner of the box [m].
      high: (3,) the other [m].
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    chosen = is_solid(model) & ~np.isin(model.geom_type, [int(kind) for kind in _GROUND])
    turn = data.geom_xmat.reshape(-1, 3, 3)
    middle = data.geom_xpos + np.einsum("gij,gj->gi", turn, model.geom_aabb[:, :3])
    half = np.einsum("gij,gj->gi", np.abs(turn), model.geom_aabb[:, 3:])
    chosen &= ((middle + half >= low) & (middle - half <= high)).all(axis=1)
    shapes = []
    for geom in np.flatnonzero(chosen):
        place, matrix = data.geom_xpos[geom], turn[geom]
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
            shapes.append(_mesh_shape(model, int(geom), place, matrix, (low, high)))
        else:
            points = geom_points(model, int(geom)) @ matrix.T + place
            shapes.append(Shape(int(geom), points, convex=True))
    return [shape for shape in shapes if len(shape.points)]


def _mesh_shape(
    model: mujoco.MjModel, geom: int, place: Array, matrix: Array, box: tuple[Array, Array]
) -> Shape:
    """Return a mesh: its corners where it fills its hull, else points all over its triangles."""
    mesh = model.geom_dataid[geom]
    start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    vertices = np.asarray(model.mesh_vert[start : start + count], dtype=np.float64)
    vertices = vertices @ matrix.T + place
    start, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    corners = vertices[np.asarray(model.mesh_face[start : start + count], dtype=np.int64)]
    if fills_hull(corners):
        return Shape(geom, vertices, convex=True)
    near = (corners.max(axis=1) >= box[0]).all(axis=1) & (corners.min(axis=1) <= box[1]).all(axis=1)
    return Shape(geom, surface_points(corners[near]), convex=False)


def surface_points(corners: Array, spacing: float = SPACING) -> Array:
    """Return points (k, 3) all over triangles (m, 3, 3), about ``spacing`` apart [m]."""
    if len(corners) == 0:
        return np.empty((0, 3))
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    parts = np.maximum(np.ceil(longest / spacing), 1.0).astype(np.int64)
    while float(((parts + 1.0) * (parts + 2.0) / 2.0).sum()) > _MOST_POINTS and parts.max() > 1:
        parts = np.maximum(parts // 2, 1)
    found = []
    for count in np.unique(parts):
        u, v = np.meshgrid(np.arange(count + 1), np.arange(count + 1))
        share = np.stack((u, v), axis=-1)[u + v <= count] / count
        some = corners[parts == count]
        spread = some[:, None, 0] + share[:, :1] * (some[:, 1] - some[:, 0])[:, None]
        found.append((spread + share[:, 1:] * (some[:, 2] - some[:, 0])[:, None]).reshape(-1, 3))
    return np.concatenate(found)
