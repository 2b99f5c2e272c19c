"""Keeping hands, knees and shins out of the ground: planes, heightfields, and meshes as fields.

    keep = SurfaceClearance(character, find_surfaces(model, root_path), nframe, left_out)

Feet are left out: they have a plan of their own. A mesh that is not convex is sampled to a field
of what can be stood on near the walk; its walls and overhangs are obstacles, piece by piece
(:mod:`mjmotion.footsteps.mesh_pieces`).
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Collection, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.character import Character
from mjmotion.body.geom_points import geom_points
from mjmotion.body.kinematics import Pose, RayCaster, character_geoms
from mjmotion.footsteps.obstacles import convex_obstacles
from mjmotion.ik.solver import Inequalities
from mjmotion.scene.ground import STEEPEST, solid_model

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SKIN = 0.003  # distance kept from ground, on which feet and so shins are at home [m]
_SLACK = 5e-4  # lower than that by less is high enough [m]
_REACH = 1.2  # how far from the root's path a surface can be touched [m]
_CELL = 0.04  # of a mesh that is sampled [m]


@dataclasses.dataclass(frozen=True, eq=False)
class Surface:
    """Ground that is solid below: heights over a grid, or a plane, which is a grid of one.

    Attributes:
      position: (3,) of its frame [m].
      matrix: (3, 3) axes of its frame, the last one up.
      heights: (nrow, ncol) over the frame [m], rows along +y; minus infinity where there is none.
      corner: (2,) where the first one is in the frame [m].
      cell: (2,) distance of columns and rows [m].
      tops: (nrow, ncol) the highest within :data:`_REACH` geoms' radii [m].
    """

    position: Array
    matrix: Array
    heights: Array
    corner: Array
    cell: Array
    tops: Array

    @property
    def endless(self) -> bool:
        """Whether it is a plane."""
        return self.heights.size == 1

    def below(self, points: Array) -> Array:
        """Return a height (m,) in its frame that nothing near points (m, 3) is above [m]."""
        if self.endless:
            return np.zeros(len(points))
        shape = np.array(self.heights.shape)
        place = np.rint((points[:, :2] - self.corner) / self.cell).astype(np.int64)
        place = np.clip(place, 0, shape[::-1] - 1)
        return np.asarray(self.tops[place[:, 1], place[:, 0]])

    def above(self, points: Array) -> tuple[Array, Array]:
        """Return how far (m,) points (m, 3) of its frame are above it [m], and its normals there.

        The distance is along the normal (m, 3); infinite beside the field or on a wall of it.
        """
        normal = np.zeros_like(points)
        normal[:, 2] = 1.0
        if self.endless:
            return points[:, 2].copy(), normal
        shape = np.array(self.heights.shape)[::-1]
        at = (points[:, :2] - self.corner) / self.cell
        first = np.clip(np.floor(at).astype(np.int64), 0, shape - 2)
        u, v = (at - first).T
        column, row = first.T
        low, high = self.heights[row, column], self.heights[row + 1, column + 1]
        right, back = self.heights[row, column + 1], self.heights[row + 1, column]
        with np.errstate(invalid="ignore"):
            # Either way of cutting a cell into two triangles: the higher of the two.
            rising = np.where(
                u >= v,
                low + u * (right - low) + v * (high - right),
                low + v * (back - low) + u * (high - back),
            )
            falling = np.where(
                u + v <= 1.0,
                low + u * (right - low) + v * (back - low),
                high + (1.0 - u) * (back - high) + (1.0 - v) * (right - high),
            )
            height = np.maximum(rising, falling)
            slope_x = 0.5 * ((right - low) + (high - back)) / self.cell[0]
            slope_y = 0.5 * ((back - low) + (high - right)) / self.cell[1]
            upward = 1.0 / np.sqrt(1.0 + slope_x**2 + slope_y**2)
            known = np.isfinite(height) & ((at >= 0.0) & (at <= shape - 1)).all(axis=1)
            known &= upward > STEEPEST
            normal = np.column_stack((-slope_x, -slope_y, np.ones_like(upward))) * upward[:, None]
            distance = np.where(known, (points[:, 2] - height) * upward, np.inf)
        return distance, np.where(known[:, None], normal, 0.0)


def find_surfaces(scene: mujoco.MjModel, root_path: Array, radius: float = 0.35) -> list[Surface]:
    """Return the grounds of a scene within reach of a walk.

    Args:
      scene: the scene, with or without a character.
      root_path: (nframe, 3) where the root passes, about [m].
      radius: of the largest geom that will be looked at [m].
    """
    data = mujoco.MjData(scene)
    mujoco.mj_kinematics(scene, data)
    solid = (scene.geom_contype != 0) | (scene.geom_conaffinity != 0)
    static = np.flatnonzero((scene.body_weldid[scene.geom_bodyid] == 0) & solid)
    convex = set(convex_obstacles(scene).tolist())
    found, hollow = [], []
    low, high = root_path.min(axis=0) - _REACH, root_path.max(axis=0) + _REACH
    for geom in static.tolist():
        position, matrix = np.array(data.geom_xpos[geom]), data.geom_xmat[geom].reshape(3, 3).copy()
        kind = scene.geom_type[geom]
        if kind == mujoco.mjtGeom.mjGEOM_PLANE:
            flat = np.zeros((1, 1))
            found.append(Surface(position, matrix, flat, np.zeros(2), np.ones(2), flat))
        elif kind == mujoco.mjtGeom.mjGEOM_HFIELD:
            field = int(scene.geom_dataid[geom])
            shape = int(scene.hfield_nrow[field]), int(scene.hfield_ncol[field])
            start, size = int(scene.hfield_adr[field]), scene.hfield_size[field]
            heights = scene.hfield_data[start : start + shape[0] * shape[1]].reshape(shape)
            cell = 2.0 * size[:2] / (np.array(shape)[::-1] - 1)
            path = (root_path - position) @ matrix
            grid = np.asarray(heights * size[2], dtype=np.float64)
            found.append(_cropped(position, matrix, grid, -size[:2], cell, path, radius))
        elif kind == mujoco.mjtGeom.mjGEOM_MESH and geom not in convex:
            hollow.append(geom)
    if hollow:
        heights = _sampled(scene, hollow, root_path, low, high)
        cell = np.full(2, _CELL)
        found.append(_cropped(np.zeros(3), np.eye(3), heights, low[:2], cell, root_path, radius))
    return found


def _cropped(
    position: Array,
    matrix: Array,
    heights: Array,
    corner: Array,
    cell: Array,
    path: Array,
    radius: float,
) -> Surface:
    """Return the part of a field that is within reach of a path (nframe, 3) in its frame [m]."""
    from scipy.ndimage import maximum_filter

    shape = np.array(heights.shape)[::-1]
    first = np.floor((path[:, :2].min(axis=0) - _REACH - corner) / cell).astype(np.int64)
    last = np.ceil((path[:, :2].max(axis=0) + _REACH - corner) / cell).astype(np.int64) + 1
    first, last = np.clip(first, 0, shape - 2), np.clip(last, 2, shape)
    part = heights[first[1] : last[1], first[0] : last[0]]
    around = 2 * np.ceil(radius / cell).astype(np.int64) + 3
    tops = maximum_filter(part, size=(int(around[1]), int(around[0])), mode="nearest")
    return Surface(position, matrix, part, corner + first * cell, cell, tops)


def _sampled(
    scene: mujoco.MjModel, geoms: Sequence[int], root_path: Array, low: Array, high: Array
) -> Array:
    """Return heights (nrow, ncol) [m] of meshes below the root's path, on a grid of _CELL."""
    seen = solid_model(scene)
    hidden = np.ones(seen.ngeom, dtype=bool)
    hidden[list(geoms)] = False
    seen.geom_rgba[hidden, 3] = 0.0
    count = np.ceil((high - low)[:2] / _CELL).astype(np.int64) + 1
    x, y = (low[i] + _CELL * np.arange(count[i]) for i in range(2))
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    from scipy.spatial import KDTree

    apart, nearest = KDTree(root_path[:, :2]).query(points, distance_upper_bound=_REACH)
    heights = np.full(len(points), -np.inf)
    near = np.flatnonzero(np.isfinite(apart))
    origin = np.column_stack((points[near], root_path[nearest[near], 2]))
    distance, _, normal = RayCaster(seen).cast(origin, np.array((0.0, 0.0, -1.0)))
    stands = (distance >= 0.0) & (normal[:, 2] > STEEPEST)
    heights[near[stands]] = (origin[:, 2] - distance)[stands]
    return heights.reshape(count[1], count[0])


@dataclasses.dataclass(frozen=True, eq=False)
class _Sunk:
    """The deepest point of one geom in a surface: its frame (m,), point and normal (m, 3)."""

    geom: int
    frame: Index
    point: Array
    normal: Array
    distance: Array


class SurfaceClearance:
    """What a character lacks to be above the ground (:class:`.clearances.BodyClearance`).

    Args:
      character: the character, alone. Its feet are left out.
      surfaces: what to keep above.
      left_out: more bodies that may touch the ground, such as hands that rest on it.
      margin: distance to keep [m].
    """

    def __init__(
        self,
        character: Character,
        surfaces: Sequence[Surface],
        left_out: Collection[int] = (),
        margin: float = SKIN,
    ) -> None:
        self.margin = margin
        self.model = model = character.model
        self.surfaces = tuple(surfaces)
        out = {body for foot in character.feet for body in foot.bodies} | set(left_out)
        self._geoms = np.array(
            [g for g in character_geoms(model, colliding=True) if model.geom_bodyid[g] not in out],
            dtype=np.int64,
        )
        self._points = [geom_points(model, int(geom)) for geom in self._geoms]

    def at_margin(self, margin: float) -> SurfaceClearance:
        """Return the same with another distance to keep [m]."""
        other = copy.copy(self)
        other.margin = margin
        return other

    def lacking(self, pose: Pose, qpos: Array, frames: Index) -> Inequalities:
        """Return what poses lack of being above; the rest says nothing more here."""
        found = [one for surface in self.surfaces for one in self._below(pose, surface)]
        if not found:
            empty = np.empty(0)
            return Inequalities(
                empty.astype(np.int64), np.empty((0, self.model.nv)), empty, empty.copy()
            )
        frame = np.concatenate([one.frame for one in found])
        point = np.concatenate([one.point for one in found])
        normal = np.concatenate([one.normal for one in found])
        distance = np.concatenate([one.distance for one in found])
        geom = np.repeat([one.geom for one in found], [len(one.frame) for one in found])
        rows = pose.rows(frame, point, self.model.geom_bodyid[geom], normal)
        return Inequalities(frame, rows, self.margin - distance, distance)

    def _below(self, pose: Pose, surface: Surface) -> list[_Sunk]:
        """Return the deepest points of geoms in the frames in which they are too deep."""
        assert pose.geom_xpos is not None and pose.geom_xmat is not None
        model, geoms = self.model, self._geoms
        centre = (pose.geom_xpos[:, geoms] - surface.position) @ surface.matrix
        top = surface.below(centre.reshape(-1, 3)).reshape(centre.shape[:2]) + self.margin
        geom, frame = np.nonzero((centre[..., 2] - model.geom_rbound[geoms] < top).T)
        # Of what is low enough for that: how far its box reaches down from its own origin.
        box = model.geom_aabb[geoms[geom]]
        down = surface.matrix[:, 2] @ pose.geom_xmat[frame, geoms[geom]]
        lowest = centre[frame, geom, 2] + np.einsum("mj,mj->m", down, box[:, :3])
        low = lowest - np.einsum("mj,mj->m", np.abs(down), box[:, 3:]) < top[frame, geom]
        geom, frame = geom[low], frame[low]
        return [
            self._deepest(pose, surface, int(which), frame[geom == which])
            for which in np.unique(geom)
        ]

    def _deepest(self, pose: Pose, surface: Surface, which: int, frames: Index) -> _Sunk:
        """Return the deepest point of one geom in the frames in which it is too deep."""
        assert pose.geom_xpos is not None and pose.geom_xmat is not None
        geom = int(self._geoms[which])
        points, turn = self._points[which], pose.geom_xmat[frames, geom]
        turn = surface.matrix.T @ turn
        centre = (pose.geom_xpos[frames, geom] - surface.position) @ surface.matrix
        height = turn[:, 2] @ points.T + centre[:, 2, None]
        low = height < surface.below(centre)[:, None] + self.margin
        row, point = np.nonzero(low)
        local = (turn[row] @ points[point][..., None])[..., 0] + centre[row]
        distance, normal = surface.above(local)
        # The deepest of each frame: the first in this order.
        order = np.lexsort((distance, row))
        _, first = np.unique(row[order], return_index=True)
        deepest = order[first]
        deepest = deepest[distance[deepest] < self.margin - _SLACK]
        world = local[deepest] @ surface.matrix.T + surface.position
        normal = normal[deepest] @ surface.matrix.T
        return _Sunk(geom, frames[row[deepest]], world, normal, distance[deepest])
