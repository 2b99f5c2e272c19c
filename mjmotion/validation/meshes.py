"""Meshes: their triangles, their convex hulls, and whether the two are the same.

What counts as convex is the rule of ``docs/figures.md``, "What is solid".
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]
ROUNDING = 1e-5  # of a shape's size: how far off its face a corner may be
_HOLLOW = 1e-3  # [m] a triangle further inside the hull makes a mesh hollow
_COVERED = 0.99  # of the hull's area that a convex mesh has at least
_FLAT = 1e-9  # of its extent: a mesh this thin has no hull
_CHUNK = 1_000_000  # distances of corners from planes that are taken at once


def mesh_arrays(model: mujoco.MjModel, mesh: int) -> tuple[Array, Index]:
    """Return all vertices (n, 3) [m] and faces (m, 3) of a compiled mesh."""
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    vertex = np.array(model.mesh_vert[first : first + count], dtype=np.float64)
    first, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    return vertex, np.array(model.mesh_face[first : first + count], dtype=np.int64)


def is_convex(model: mujoco.MjModel, mesh: int) -> bool:
    """Whether a mesh is its own convex hull, to 1 mm, with no more than 1 % of it open.

    Every triangle must be within 1 mm of one face of the hull, and all of them together must have
    99 % of its area. The first finds pits and the sides of passages, the second what is missing.
    """
    vertex, face = mesh_arrays(model, mesh)
    centred = vertex - vertex.mean(axis=0)
    extent = float(np.ptp(vertex, axis=0).max())
    if float(np.linalg.svd(centred, compute_uv=False)[-1]) < _FLAT * extent:
        return False
    hull, hull_face = convex_hull(model, mesh)
    if _areas(vertex[face]).sum() < _COVERED * _areas(hull[hull_face]).sum():
        return False
    plane = face_planes(hull[hull_face], hull.mean(axis=0))
    triangle = vertex[face]
    for part in np.array_split(triangle, 1 + 3 * len(triangle) * len(plane) // _CHUNK):
        depth = (plane[:, 3] - part @ plane[:, :3].T).max(axis=1)  # (triangle, plane)
        if (depth.min(axis=1) > _HOLLOW).any():
            return False
    return True


def convex_hull(model: mujoco.MjModel, mesh: int) -> tuple[Array, Index]:
    """Return vertices (n, 3) [m] and faces (m, 3) of the convex hull of a mesh's vertices.

    It is MuJoCo's own, which collisions use, but where that is told to leave corners out
    (``maxhullvert``) or was never made, since nothing collides with the mesh.
    """
    vertex, _ = mesh_arrays(model, mesh)
    start = int(model.mesh_graphadr[mesh])
    if start >= 0:
        graph = model.mesh_graph[start:]
        nvert, nface = int(graph[0]), int(graph[1])
        used = np.asarray(graph[2 + nvert : 2 + 2 * nvert], dtype=np.int64)
        first = 2 + 3 * nvert + 3 * nface
        face = np.asarray(graph[first : first + 3 * nface], dtype=np.int64).reshape(-1, 3)
    if start < 0 or _leaves_out(vertex, vertex[face]):
        from scipy.spatial import ConvexHull  # rare, and slow to import

        hull = ConvexHull(vertex)
        used, face = np.sort(hull.vertices), hull.simplices.astype(np.int64)
    order = np.argsort(used)
    return vertex[used[order]], np.searchsorted(used[order], face)


def face_planes(triangle: Array, centre: Array) -> Array:
    """Return (n, 4) outward normals and offsets of the faces of a convex shape.

    Args:
      triangle: (m, 3, 3) its surface [m]; triangles of one flat face become one plane.
      centre: (3,) a point inside [m].
    """
    normal = np.cross(triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0])
    area = np.linalg.norm(normal, axis=1)
    largest_first = np.argsort(-area, kind="stable")
    largest_first = largest_first[area[largest_first] > 0]
    triangle = triangle[largest_first]
    normal = normal[largest_first] / area[largest_first, None]
    offset = np.einsum("ni,ni->n", normal, triangle[:, 0])
    outward = np.where(normal @ centre > offset, -1.0, 1.0)
    normal, offset = normal * outward[:, None], offset * outward
    # Vertices are single precision, so the triangles of a flat face are not quite in one plane.
    size = np.ptp(triangle.reshape(-1, 3), axis=0).max()
    same = normal @ normal.T > 0.99
    for corner in range(3):
        same &= np.abs(normal @ triangle[:, corner].T - offset[:, None]) < ROUNDING * size
    keep = same.argmax(axis=0) == np.arange(len(same))
    return np.concatenate((normal, offset[:, None]), axis=1)[keep]


def _areas(triangle: Array) -> Array:
    """Return the areas (n,) [m²] of triangles (n, 3, 3)."""
    side = triangle[:, 1:] - triangle[:, :1]
    return np.asarray(np.linalg.norm(np.cross(side[:, 0], side[:, 1]), axis=1) / 2.0)


def _leaves_out(vertex: Array, hull: Array) -> bool:
    """Whether any of the points (n, 3) is outside of a hull's triangles (m, 3, 3)."""
    normal = np.cross(hull[:, 1] - hull[:, 0], hull[:, 2] - hull[:, 0])
    length = np.linalg.norm(normal, axis=1)
    corner, normal = hull[length > 0, 0], normal[length > 0] / length[length > 0, None]
    height = vertex @ normal.T - np.einsum("ni,ni->n", normal, corner)
    inner = hull.reshape(-1, 3).mean(axis=0) @ normal.T - np.einsum("ni,ni->n", normal, corner)
    outside = np.where(inner > 0, -height.min(axis=0), height.max(axis=0))
    return bool(outside.max() > ROUNDING * np.ptp(vertex, axis=0).max())
