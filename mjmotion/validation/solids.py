"""The exact shape of one geom: its extent along vertical lines, its lowest point, its skin.

Everything here works on many places at once and knows the geom types of MuJoCo in their own
frames; heightfields and planes, which have no end, belong to :mod:`mjmotion.validation.ground`.
"""

from __future__ import annotations

import dataclasses
import itertools
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.validation.meshes import ROUNDING, convex_hull, face_planes

Array = NDArray[np.float64]
_Geom = mujoco.mjtGeom
_ROUND = (_Geom.mjGEOM_SPHERE, _Geom.mjGEOM_ELLIPSOID)
_TINY = 1e-12
_INSIDE = 1e-6  # a point counts as inside from this depth on [m]
_SIEVE = 8  # faces that a quick look is at


@dataclasses.dataclass(frozen=True, eq=False)
class Solid:
    """A convex geom in its own frame.

    Attributes:
      kind: the geom's ``mjtGeom``.
      size: (3,) semi-axes of an ellipsoid or sphere, or radius and half length of a rod [m].
      vertex: (nvertex, 3) corners of a box or of a mesh's convex hull [m]; none for round geoms.
      face: (nface, 3, 3) triangles of a box or hull [m].
    """

    kind: int
    size: Array
    vertex: Array
    face: Array

    @cached_property
    def plane(self) -> Array:
        """(nplane, 4) outward normal and offset of each face of a box or hull."""
        return face_planes(self.face, self.vertex.mean(axis=0))


def solid_of(model: mujoco.MjModel, geom: int) -> Solid:
    """Return the shape of a geom; a mesh is taken as its convex hull."""
    kind = int(model.geom_type[geom])
    size = np.array(model.geom_size[geom], dtype=np.float64)
    if kind == _Geom.mjGEOM_SPHERE:
        size = np.full(3, size[0])
    if kind in (*_ROUND, _Geom.mjGEOM_CAPSULE, _Geom.mjGEOM_CYLINDER):
        return Solid(kind, size, np.empty((0, 3)), np.empty((0, 3, 3)))
    if kind == _Geom.mjGEOM_BOX:
        points = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * size
        # Two triangles a side, by the corners' binary numbers.
        quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
        face = np.array([[q[0], q[i], q[i + 1]] for q in quads for i in (1, 2)])
    else:
        points, face = convex_hull(model, int(model.geom_dataid[geom]))
    return Solid(kind, size, points, points[face])


def vertical_extent(solid: Solid, position: Array, matrix: Array, xy: Array) -> tuple[Array, Array]:
    """Return where vertical lines enter and leave a geom, from below.

    Args:
      solid: the geom.
      position: (n, 3) or (3,) where it is [m].
      matrix: (n, 3, 3) or (3, 3) how it is turned.
      xy: (n, 2) the lines [m].

    Returns:
      low, high: (n,) heights [m], NaN where the line misses the geom.
    """
    flat = np.concatenate((xy, np.zeros((len(xy), 1))), axis=1) - position
    origin = np.einsum("...ji,...j->...i", matrix, flat)
    direction = np.broadcast_to(matrix[..., 2, :], origin.shape)
    with np.errstate(invalid="ignore", divide="ignore"):
        if len(solid.vertex):
            return _clip(origin, direction, solid.plane)
        if solid.kind in _ROUND:
            return _quadratic(origin / solid.size, direction / solid.size, 1.0)
        radius, half = solid.size[0], solid.size[1]
        low, high = _quadratic(origin[:, :2], direction[:, :2], radius)
        ends = np.array([[0.0, 0.0, 1.0, half], [0.0, 0.0, -1.0, half]])
        first, last = _clip(origin, direction, ends)
        low, high = np.maximum(low, first), np.minimum(high, last)
        low, high = np.where(low <= high, low, np.nan), np.where(low <= high, high, np.nan)
        if solid.kind == _Geom.mjGEOM_CAPSULE:
            for end in (-half, half):
                cap = origin - np.array([0.0, 0.0, end])
                first, last = _quadratic(cap, direction, radius)
                low, high = np.fmin(low, first), np.fmax(high, last)
        return low, high


def above_underside(
    solid: Solid, position: Array, matrix: Array, points: Array
) -> NDArray[np.bool_]:
    """Whether world points (n, 3) may be above a geom's underside: a quick look at a few faces.

    A face that looks down and has the point outside says no; all points of geoms without faces
    may be.
    """
    if len(solid.vertex) == 0:
        return np.ones(len(points), dtype=bool)
    plane = solid.plane[:_SIEVE]  # the largest
    local = np.einsum("nji,nj->ni", matrix, points - position)
    outside = local @ plane[:, :3].T > plane[:, 3] + _TINY
    return np.asarray(~(outside & (matrix[:, 2] @ plane[:, :3].T < -_TINY)).any(axis=1))


def reach(solid: Solid, direction: Array) -> Array:
    """Return how far (n,) a geom goes from its own origin along directions (n, 3) [m].

    The directions are unit vectors in the geom's frame; this is its support function.
    """
    if len(solid.vertex):
        return np.asarray((direction @ solid.vertex.T).max(axis=1))
    if solid.kind in _ROUND:
        return np.asarray(np.linalg.norm(direction * solid.size, axis=1))
    along = solid.size[1] * np.abs(direction[:, 2])
    if solid.kind == _Geom.mjGEOM_CAPSULE:
        return np.asarray(along + solid.size[0])
    return np.asarray(along + solid.size[0] * np.hypot(direction[:, 0], direction[:, 1]))


@dataclasses.dataclass(frozen=True, eq=False)
class Skin:
    """Points on a geom's surface, in its frame, and which way each faces.

    Attributes:
      point: (n, 3) [m].
      normal: (k, 3) outward normals.
      side: (n, m) which normals belong to each point, some of them more than once.
    """

    point: Array
    normal: Array
    side: NDArray[np.int64]

    def facing_down(self, matrix: Array) -> NDArray[np.bool_]:
        """Return (nframe, n) which points are on the underside, for orientations (nframe, 3, 3)."""
        # As one large product it would wake BLAS's threads, which takes longer than all else here.
        down = np.einsum("fi,ni->fn", matrix[:, 2, :], self.normal) < 1e-6
        facing = down[:, self.side[:, 0]]
        for points, normals in self._more_sides:
            facing[:, points] |= down[:, normals]
        return np.asarray(facing)

    @cached_property
    def _more_sides(self) -> list[tuple[NDArray[np.int64], NDArray[np.int64]]]:
        """Points with a second normal, and which; those with a third; and so on."""
        first, sides = self.side[:, 0], self.side.T[1:]
        more = [np.flatnonzero(side != first) for side in sides]
        return [(points, side[points]) for points, side in zip(more, sides, strict=True)]

    def keep(self, chosen: NDArray[np.bool_]) -> Skin:
        """Return the skin with some of its points (n,) only."""
        return Skin(self.point[chosen], self.normal, self.side[chosen])


def skin(solid: Solid, spacing: float, edge_spacing: float | None = None) -> Skin:
    """Return points on a geom's surface.

    Args:
      solid: the geom.
      spacing: how far apart the points are at most, about [m].
      edge_spacing: the same along sharp edges, ``spacing`` if not given. Corners are among
        the points, where they are no closer than half of it to one another.
    """
    if len(solid.vertex):
        along = edge_spacing or spacing
        point = np.concatenate(
            (solid.vertex, _on_edges(solid, spacing, along), _on_faces(solid, spacing))
        )
        # A finely cut mesh has more corners than are of use; of a crowd, a corner comes first.
        cell = np.round(point / (along / 2)).astype(np.int64)
        _, first = np.unique(cell @ np.array([1, 1 << 20, 1 << 40]), return_index=True)
        point = point[np.sort(first)]
        size = np.ptp(solid.vertex, axis=0).max()
        member = solid.plane[:, 3] - point @ solid.plane[:, :3].T < ROUNDING * size
        # The normals of each point come first; where it has fewer than others, its first again.
        side = np.argsort(~member, axis=1, kind="stable")[:, : int(member.sum(axis=1).max())]
        side = np.where(np.take_along_axis(member, side, axis=1), side, side[:, :1])
        return Skin(point, solid.plane[:, :3], side)
    if solid.kind in _ROUND:
        ball = _ball(max(6, int(np.ceil(np.pi * solid.size.max() / spacing))))
        normal = ball / solid.size
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        return Skin(ball * solid.size, normal, np.arange(len(ball))[:, None])
    radius, half = solid.size[0], solid.size[1]
    count = max(6, int(np.ceil(2 * np.pi * radius / spacing)))
    angle = np.linspace(0.0, 2 * np.pi, count, endpoint=False)
    ring = np.stack((np.cos(angle), np.sin(angle), np.zeros(count)), axis=1)
    height = np.linspace(-half, half, max(2, 1 + int(np.ceil(2 * half / spacing))))
    wall = (radius * ring[None] + height[:, None, None] * np.array([0.0, 0.0, 1.0])).reshape(-1, 3)
    points, normals = [wall], [np.tile(ring, (len(height), 1))]
    ball = _ball(max(6, int(np.ceil(np.pi * radius / spacing))))
    for sign in (-1.0, 1.0):
        if solid.kind == _Geom.mjGEOM_CAPSULE:
            cap = ball[ball[:, 2] * sign >= 0.0]
            points.append(radius * cap + np.array([0.0, 0.0, sign * half]))
            normals.append(cap)
        else:
            for part in np.linspace(0.0, 1.0, max(2, int(np.ceil(radius / spacing)) + 1)):
                points.append(part * radius * ring + np.array([0.0, 0.0, sign * half]))
                normals.append(np.tile([0.0, 0.0, sign], (count, 1)))
    point = np.concatenate(points)
    return Skin(point, np.concatenate(normals), np.arange(len(point))[:, None])


def within(solid: Solid, points: Array) -> NDArray[np.bool_]:
    """Return which points (n, 3) in the geom's frame are inside it."""
    if len(solid.vertex):
        room = solid.plane[:, 3] - points @ solid.plane[:, :3].T
        return np.asarray((room > _INSIDE).all(axis=1))
    if solid.kind in _ROUND:
        inner = np.linalg.norm(points / solid.size, axis=1)
        return np.asarray((1 - inner) * solid.size.min() > _INSIDE)
    radius, half = solid.size[0], solid.size[1]
    across = np.hypot(points[:, 0], points[:, 1])
    along = np.abs(points[:, 2]) - half
    if solid.kind == _Geom.mjGEOM_CAPSULE:
        return np.asarray(np.hypot(across, np.maximum(along, 0.0)) < radius - _INSIDE)
    return np.asarray((across < radius - _INSIDE) & (along < -_INSIDE))


def _clip(origin: Array, direction: Array, plane: Array) -> tuple[Array, Array]:
    """Return the part of lines ``origin + t direction`` (n, 3) behind all planes (m, 4)."""
    slope = direction @ plane[:, :3].T
    room = plane[:, 3] - origin @ plane[:, :3].T
    flat = np.abs(slope) < _TINY
    cut = room / np.where(flat, 1.0, slope)
    low = np.where(~flat & (slope < 0), cut, -np.inf).max(axis=1)
    high = np.where(~flat & (slope > 0), cut, np.inf).min(axis=1)
    miss = (low > high) | (flat & (room < 0)).any(axis=1)
    return np.where(miss, np.nan, low), np.where(miss, np.nan, high)


def _quadratic(origin: Array, direction: Array, radius: float) -> tuple[Array, Array]:
    """Return where lines are within ``radius`` of the origin, in any number of dimensions."""
    square = np.einsum("ni,ni->n", direction, direction)
    half = np.einsum("ni,ni->n", origin, direction)
    rest = np.einsum("ni,ni->n", origin, origin) - radius**2
    root = np.sqrt(half**2 - square * rest)  # NaN where the line misses
    low, high = (-half - root) / square, (-half + root) / square
    parallel = square < _TINY**2
    inside = np.where(rest <= 0, np.inf, np.nan)
    return np.where(parallel, -inside, low), np.where(parallel, inside, high)


def _on_edges(solid: Solid, spacing: float, sharp_spacing: float) -> Array:
    """Return points along the edges of a box or hull, without its corners.

    Edges where two faces meet at more than 30 degrees have their own spacing.
    """
    start = solid.face.reshape(-1, 3)
    end = np.roll(solid.face, -1, axis=1).reshape(-1, 3)
    ahead = end - start  # every edge comes twice, once each way: keep one
    sign = ahead @ np.array([1.0, 1e-4, 1e-8])
    start, ahead = start[sign > 0], ahead[sign > 0]
    size = np.ptp(solid.vertex, axis=0).max()
    normal, offset = solid.plane[:, :3], solid.plane[:, 3]
    on = np.abs(offset - start @ normal.T) < ROUNDING * size
    on &= np.abs(offset - (start + ahead) @ normal.T) < ROUNDING * size
    faces = on.sum(axis=1)
    real = faces >= 2  # the others cut a flat face in two
    start, ahead, on, faces = start[real], ahead[real], on[real], faces[real]
    # The mean of two unit normals is as long as the cosine of half their angle.
    sharp = np.linalg.norm(on @ normal, axis=1) / faces < np.cos(np.radians(15.0))
    steps = np.linalg.norm(ahead, axis=1) / np.where(sharp, sharp_spacing, spacing)
    between = np.ceil(steps).astype(np.int64) - 1
    which = np.repeat(np.arange(len(between)), between)
    step = np.arange(len(which)) - np.repeat(np.cumsum(between) - between, between) + 1
    part = (step / (between[which] + 1))[:, None]
    return np.asarray(start[which] + part * ahead[which])


def _on_faces(solid: Solid, spacing: float) -> Array:
    """Return a grid of points on faces whose middle is further than ``spacing`` from any edge."""
    size = np.ptp(solid.vertex, axis=0).max()
    normal, offset = solid.plane[:, :3], solid.plane[:, 3]
    first = np.eye(3)[np.abs(normal).argmin(axis=1)]
    first = first - np.einsum("ki,ki->k", first, normal)[:, None] * normal
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    frame = np.stack((first, np.cross(normal, first)), axis=2)  # (nplane, 3, 2)
    flat = np.einsum("vi,kij->kvj", solid.vertex, frame)
    mine = np.abs(offset[:, None] - normal @ solid.vertex.T) < ROUNDING * size
    low = np.where(mine[..., None], flat, np.inf).min(axis=1)
    extent = np.where(mine[..., None], flat, -np.inf).max(axis=1) - low
    points = [np.empty((0, 3))]
    for k in np.flatnonzero(extent.min(axis=1) > 2 * spacing):
        steps = np.ceil(extent[k] / spacing).astype(np.int64)
        axes = [low[k, i] + extent[k, i] * np.arange(1, steps[i]) / steps[i] for i in (0, 1)]
        grid = np.stack(np.meshgrid(axes[0], axes[1]), axis=-1).reshape(-1, 2)
        place = grid @ frame[k].T + offset[k] * normal[k]
        room = offset - place @ normal.T
        points.append(place[(room > -ROUNDING * size).all(axis=1)])
    return np.concatenate(points)


def _ball(count: int) -> Array:
    """Return points on the unit sphere, ``count`` from pole to pole."""
    points = []
    for polar in np.linspace(0.0, np.pi, count + 1):
        around = max(1, round(2 * count * np.sin(polar)))
        angle = 2 * np.pi * np.arange(around) / around
        points.append(
            np.stack(
                (
                    np.sin(polar) * np.cos(angle),
                    np.sin(polar) * np.sin(angle),
                    np.full(around, np.cos(polar)),
                ),
                axis=1,
            )
        )
    return np.concatenate(points)
