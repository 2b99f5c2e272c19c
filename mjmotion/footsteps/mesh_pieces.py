"""Convex pieces of meshes that are not convex: arches, caves, banisters.

A part of a mesh that hangs together and fills its own hull is a piece. Of any other, the walls and
overhangs near a walk are: triangles that lie in one cell and face one way, as a slab as thick as
the mesh is there. What faces up is ground (:mod:`mjmotion.footsteps.surfaces`).
"""

from __future__ import annotations

import copy

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.kinematics import RayCaster
from mjmotion.scene.ground import STEEPEST, solid_model
from mjmotion.scene.hulls import fills_hull

Array = NDArray[np.float64]
Index = NDArray[np.int64]

CELL = 0.25  # triangles further apart are never of one slab [m]
THICKEST = 0.6  # of a slab [m]
THINNEST = 0.03  # of a slab, and of one with no other side [m]
_SHARE = 0.9  # of the mesh's thickness that a slab has: its rim is to stay inside
_DOWN, _UP = 1.02, 1.4  # from the root to about the ground, and to what hands reach [m]
_CEILING = 0.5  # what faces down and is lower than that under the root is under the ground [m]
_FACINGS = 1.6  # how finely normals are told apart
_FEWEST = 4  # triangles of a solid


def mesh_pieces(
    scene: mujoco.MjModel, geom: int, placed: tuple[Array, Array], root_path: Array, near: float
) -> list[Array]:
    """Return convex pieces of a mesh geom, each as points (k, 3) in the world [m].

    Args:
      scene: the scene.
      geom: a mesh that is not convex.
      placed: its position (3,) and matrix (3, 3) in the world.
      root_path: (nframe, 3) where the root will pass [m].
      near: how far from that path anything matters [m].
    """
    mesh = scene.geom_dataid[geom]
    start, count = scene.mesh_vertadr[mesh], scene.mesh_vertnum[mesh]
    vertices = np.asarray(scene.mesh_vert[start : start + count], dtype=np.float64)
    vertices = vertices @ placed[1].T + placed[0]
    start, count = scene.mesh_faceadr[mesh], scene.mesh_facenum[mesh]
    faces = np.asarray(scene.mesh_face[start : start + count], dtype=np.int64)
    _, place = np.unique(np.round(vertices, 6), axis=0, return_inverse=True)
    pieces: list[Array] = []
    # As the file has it first: boxes that touch at their corners are parts of their own. Files
    # that give every triangle corners of its own have parts only where corners in one place are
    # one.
    for alike in (np.arange(len(vertices)), place.ravel()):
        part = connected_parts(alike[faces])
        loose = np.ones(len(faces), dtype=bool)
        for number in np.flatnonzero(np.bincount(part) >= _FEWEST):
            mine = part == number
            corners = vertices[faces[mine]]
            if fills_hull(corners):
                pieces.append(np.unique(corners.reshape(-1, 3), axis=0))
                loose &= ~mine
        faces = faces[loose]
        if len(faces) == 0:
            return pieces
    return pieces + _slabs(scene, geom, vertices[faces], root_path, near)


def connected_parts(faces: Index) -> Index:
    """Return which part (m,) of a mesh each triangle (m, 3) is of: parts share no corner."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    rows, columns = faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel()
    size = int(faces.max(initial=-1)) + 1
    graph = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(size, size))
    _, label = connected_components(graph, directed=False)
    _, part = np.unique(label[faces[:, 0]], return_inverse=True)
    return np.asarray(part.ravel(), dtype=np.int64)


def _slabs(
    scene: mujoco.MjModel, geom: int, corners: Array, root_path: Array, near: float
) -> list[Array]:
    """Return the walls and overhangs among triangles (m, 3, 3) near a path, as slabs."""
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1)
    corners, normal = corners[area > 1e-10], across[area > 1e-10] / area[area > 1e-10, None]
    chosen = _in_the_way(corners, normal, root_path, near)
    corners, normal = corners[chosen], normal[chosen]
    if len(corners) == 0:
        return []
    middle = corners.mean(axis=1)
    thick = _thickness(scene, geom, middle, normal)
    small = np.ptp(corners, axis=1).max(axis=1) < CELL
    cell = np.floor(middle / CELL).astype(np.int64)
    facing = np.rint(_FACINGS * normal).astype(np.int64)
    # Large triangles are pieces of their own.
    own = np.where(small, -1, np.arange(len(corners)))
    key = np.column_stack((cell, facing, own))
    _, group = np.unique(key, axis=0, return_inverse=True)
    slabs = []
    for members in np.split(
        np.argsort(group.ravel(), kind="stable"), np.cumsum(np.bincount(group.ravel()))[:-1]
    ):
        face = np.unique(corners[members].reshape(-1, 3), axis=0)
        inwards = -normal[members].mean(axis=0)
        inwards /= max(float(np.linalg.norm(inwards)), 1e-9)
        slabs.append(np.concatenate((face, face + thick[members].min() * inwards)))
    return slabs


def _in_the_way(corners: Array, normal: Array, root_path: Array, near: float) -> NDArray[np.bool_]:
    """Which triangles are near a path, neither what is stood on nor what is under that."""
    from scipy.spatial import KDTree

    low, high = corners.min(axis=1), corners.max(axis=1)
    middle, size = 0.5 * (low + high), np.linalg.norm(high - low, axis=1)[:, None] / 2.0
    apart, nearest = KDTree(root_path[:, :2]).query(middle[:, :2])
    root = root_path[nearest, 2]
    chosen = (apart < near + size[:, 0]) & (normal[:, 2] < STEEPEST)
    chosen &= (high[:, 2] > root - _DOWN) & (low[:, 2] < root + _UP)
    return np.asarray(chosen & ((normal[:, 2] > -STEEPEST) | (high[:, 2] > root - _CEILING)))


def _thickness(scene: mujoco.MjModel, geom: int, middle: Array, normal: Array) -> Array:
    """Return how thick (m,) a mesh is behind points of its surface [m], as far as that matters."""
    seen = copy.copy(solid_model(scene))
    seen.geom_rgba[np.arange(seen.ngeom) != geom, 3] = 0.0
    distance, _, _ = RayCaster(seen).cast(middle - 1e-3 * normal, -normal)
    thick = np.where(distance < 0.0, THINNEST, _SHARE * distance)
    return np.asarray(np.clip(thick, THINNEST, THICKEST))
