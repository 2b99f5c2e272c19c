"""How deep each geom of the character is inside the scene, in every frame.

The depth of a geom, by what it is in:

- a plane: how far its lowest point is behind the plane;
- a box, a rod, a ball, a convex mesh: the shortest way out, from ``mj_geomDistance``;
- a heightfield, or a mesh that is not convex: how far its deepest point is straight under the
  surface. The points are the geom's corners and points over its skin no further apart than the
  grid points of the field (at most 3 cm), and, for the feet, the grid points themselves that poke
  into the geom from below.
"""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.validation.field import Field
from mjmotion.validation.ground import Ground
from mjmotion.validation.solids import (
    Skin,
    Solid,
    above_underside,
    reach,
    skin,
    solid_of,
    vertical_extent,
    within,
)

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_FINEST, _COARSEST = 0.01, 0.03  # [m] how far apart samples of a geom's skin are
_NOISE = 1e-9  # [m] shallower than rounding


@dataclasses.dataclass(frozen=True, eq=False)
class CharacterGeoms:
    """The geoms of the character that collide.

    Attributes:
      model: the model.
      ids: (ngeom,) which of the model's geoms they are.
      solids: their shapes.
      owner: (ngeom,) the body each belongs to; what hangs from a foot, as toes do, is the foot's.
      foot: (ngeom,) whether each belongs to a foot.
    """

    model: mujoco.MjModel
    ids: Index
    solids: tuple[Solid, ...]
    owner: Index
    foot: NDArray[np.bool_]
    _skins: dict[tuple[int, float], Skin] = dataclasses.field(default_factory=dict)

    @classmethod
    def of(cls, model: mujoco.MjModel, feet: tuple[int, ...]) -> CharacterGeoms:
        """Return the geoms under the free root; if none of them collides, all of them.

        Args:
          model: the model.
          feet: ids of the bodies that are feet.
        """
        endless = (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD)
        mine = model.body_rootid[model.geom_bodyid] == int(model.jnt_bodyid[0])
        mine &= ~np.isin(model.geom_type, endless)
        solid = mine & ((model.geom_contype != 0) | (model.geom_conaffinity != 0))
        ids = np.flatnonzero(solid if solid.any() else mine)
        solids = tuple(solid_of(model, int(geom)) for geom in ids)
        owner = np.array([_owner(model, int(body)) for body in model.geom_bodyid[ids]], np.int64)
        return cls(model, ids, solids, owner, np.isin(owner, feet))

    def skin(self, i: int, spacing: float) -> Skin:
        """Return the skin of geom number ``i``, without what is inside another of its body.

        What is inside another geom of the same body always has a part of that one under it.
        """
        if (i, spacing) in self._skins:
            return self._skins[i, spacing]
        model, geom = self.model, int(self.ids[i])
        # A rough field is deepest in a sole where its ridges cross the sole's outline.
        whole = skin(self.solids[i], spacing, spacing / 3 if self.foot[i] else None)
        hidden = np.zeros(len(whole.point), dtype=bool)
        turn, back = np.empty(9), np.empty(9)
        mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
        placed = whole.point @ turn.reshape(3, 3).T + model.geom_pos[geom]
        for k, other in enumerate(self.ids):
            if k != i and model.geom_bodyid[other] == model.geom_bodyid[geom]:
                mujoco.mju_quat2Mat(back, model.geom_quat[other])
                local = (placed - model.geom_pos[other]) @ back.reshape(3, 3)
                hidden |= within(self.solids[k], local)
        self._skins[i, spacing] = whole.keep(~hidden)
        return self._skins[i, spacing]


def _owner(model: mujoco.MjModel, body: int) -> int:
    """Return the body with a heel or toe site that a body hangs from, or the body itself."""
    feet = {
        int(model.site_bodyid[i])
        for i in range(model.nsite)
        if model.site(i).name.endswith(("heel", "toe"))
    }
    above = body
    while above > 0:
        if above in feet:
            return above
        above = int(model.body_parentid[above])
    return body


def penetration(
    ground: Ground, geoms: CharacterGeoms, position: Array, matrix: Array
) -> tuple[Array, Index]:
    """Return how deep every geom is in the scene.

    Args:
      ground: the scene.
      geoms: the character's geoms.
      position: (nframe, ngeom, 3) of the character's geoms [m].
      matrix: (nframe, ngeom, 3, 3).

    Returns:
      depth: (nframe, ngeom) [m], 0 where a geom is clear.
      other: (nframe, ngeom) id of the scene's geom that it is deepest in, -1 where it is clear.
    """
    depth = np.zeros(position.shape[:2])
    other = np.full(position.shape[:2], -1)
    for plane in ground.planes:
        _deepen(depth, other, _plane_depth(ground, plane, geoms, position, matrix), plane)
    if ground.convex:
        _add_convex(ground, geoms, position, matrix, depth, other)
    if ground.fields or ground.surfaces:
        _add_surfaces(ground, geoms, position, matrix, depth, other)
    return depth, other


def lowest_points(solid: Solid, position: Array, matrix: Array) -> Array:
    """Return the height (n,) of a geom's lowest point [m], from (n, 3) and (n, 3, 3)."""
    return position[:, 2] - reach(solid, -matrix[:, 2])  # world down in the geom's frame


def world_boxes(
    model: mujoco.MjModel, geom: int | Index, position: Array, matrix: Array
) -> tuple[Array, Array]:
    """Return middles (n, 3) and half sizes (n, 3) of geoms' boxes along the world's axes [m].

    Args:
      model: the model.
      geom: the geom's id, or an id (n,) for each pose.
      position: (n, 3) where it is [m].
      matrix: (n, 3, 3) how it is turned.
    """
    box = np.broadcast_to(model.geom_aabb[geom], (len(position), 6))
    middle = position + np.einsum("nij,nj->ni", matrix, box[:, :3])
    return middle, np.einsum("nij,nj->ni", np.abs(matrix), box[:, 3:])


def sole_points(
    geoms: CharacterGeoms,
    i: int,
    position: Array,
    matrix: Array,
    spacing: float,
    top: Array | None = None,
) -> tuple[Array, Index]:
    """Return world points (m, 3) on the underside of geom number ``i``, and the frame of each.

    Args:
      geoms: the character's geoms.
      i: which one of them.
      position: (nframe, 3) where it is [m].
      matrix: (nframe, 3, 3) how it is turned.
      spacing: how far apart the points are about [m].
      top: (nframe,) only points below these heights are wanted [m].
    """
    whole = geoms.skin(i, spacing)
    height = matrix[:, 2] @ whole.point.T + position[:, 2, None]
    chosen = whole.facing_down(matrix)
    if top is not None:
        chosen &= height < top[:, None]
    frame, which = np.divmod(np.flatnonzero(chosen), chosen.shape[1])
    world = np.empty((len(frame), 3))
    for axis in (0, 1):  # every point in every frame, then the chosen: quicker than the reverse
        whole_axis = matrix[:, axis] @ whole.point.T + position[:, axis, None]
        world[:, axis] = whole_axis[frame, which]
    world[:, 2] = height[frame, which]
    return world, frame


def sample_spacing(ground: Ground) -> float:
    """Return how far apart to take points of a geom's skin [m]: as the finest field's own."""
    finest = [float(field.spacing.min()) for field in ground.fields]
    return float(np.clip(min(finest, default=_COARSEST), _FINEST, _COARSEST))


def _deepen(depth: Array, other: Index, new: Array, geom: int | Index) -> None:
    deeper = new > np.maximum(depth, _NOISE)
    other[:] = np.where(deeper, geom, other)
    depth[:] = np.where(deeper, new, depth)


def _plane_depth(
    ground: Ground, plane: int, geoms: CharacterGeoms, position: Array, matrix: Array
) -> Array:
    normal = ground.matrix[plane][:, 2]
    distance = (position - ground.position[plane]) @ normal
    near = distance < ground.model.geom_rbound[geoms.ids]
    for i in np.flatnonzero(near.any(axis=0)):
        frames = np.flatnonzero(near[:, i])
        toward = np.einsum("fji,j->fi", matrix[frames, i], -normal)
        distance[frames, i] -= reach(geoms.solids[i], toward)
    return np.maximum(-distance, 0.0)


def _add_convex(
    ground: Ground,
    geoms: CharacterGeoms,
    position: Array,
    matrix: Array,
    depth: Array,
    other: Index,
) -> None:
    """Boxes and their like: prune by bounding boxes, all frames at once, then measure each pair."""
    model = ground.model
    frame, geom, solid = _close_pairs(ground, geoms, position, matrix)
    if len(frame) == 0:
        return
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)  # places the static geoms; the others are set below
    xpos, xmat = data.geom_xpos, data.geom_xmat
    flat = matrix.reshape(len(matrix), -1, 9)
    mine, theirs = geoms.ids.tolist(), np.array(ground.convex)[solid].tolist()
    gap = np.empty(len(frame))
    last = -1
    for k, (f, i, static) in enumerate(zip(frame.tolist(), geom.tolist(), theirs, strict=True)):
        if f != last:
            xpos[geoms.ids], xmat[geoms.ids] = position[f], flat[f]
            last = f
        gap[k] = mujoco.mj_geomDistance(model, data, mine[i], static, 0.0, None)
    order = np.argsort(-gap, kind="stable")
    order = order[gap[order] < -_NOISE]
    found, against = np.zeros_like(depth), np.full_like(other, -1)
    # The deepest comes last, and the last one written stays.
    found[frame[order], geom[order]] = -gap[order]
    against[frame[order], geom[order]] = np.array(ground.convex)[solid[order]]
    _deepen(depth, other, found, against)


def _close_pairs(
    ground: Ground, geoms: CharacterGeoms, position: Array, matrix: Array
) -> tuple[Index, Index, Index]:
    """Return frame, geom and static solid of all pairs whose bounding boxes may touch.

    Three sieves, each on what the one before let through: a box around the whole character, each
    geom's bounding ball, and the six face axes of the two oriented boxes.
    """
    model, ids, statics = ground.model, geoms.ids, np.array(ground.convex)
    size = model.geom_rbound[ids]
    low = (position - size[:, None]).min(axis=1)
    high = (position + size[:, None]).max(axis=1)
    turn = ground.matrix[statics]
    half = model.geom_aabb[statics, 3:]
    centre = ground.position[statics] + np.einsum("sij,sj->si", turn, model.geom_aabb[statics, :3])
    extent = np.einsum("sij,sj->si", np.abs(turn), half)
    near = np.ones((len(position), len(statics)), dtype=bool)
    for axis in range(3):
        near &= low[:, axis, None] < centre[:, axis] + extent[:, axis]
        near &= high[:, axis, None] > centre[:, axis] - extent[:, axis]
    frame, solid = np.nonzero(near)
    offset = position[frame] - centre[solid, None]
    beside = np.abs(offset) - extent[solid, None]
    pair, geom = np.nonzero((beside < size[:, None]).all(axis=2))
    frame, solid = frame[pair], solid[pair]

    mine = matrix[frame, geom]
    box = model.geom_aabb[ids[geom]]
    arm = position[frame, geom] + np.einsum("pij,pj->pi", mine, box[:, :3]) - centre[solid]
    mutual = np.swapaxes(turn[solid], 1, 2) @ mine  # my axes in the static box's frame
    absolute = np.abs(mutual)
    theirs = np.einsum("pji,pj->pi", turn[solid], arm)
    touch = (np.abs(theirs) <= half[solid] + (absolute @ box[:, 3:, None])[:, :, 0] + 1e-9).all(
        axis=1
    )
    own = np.einsum("pji,pj->pi", mine, arm)
    reachable = box[:, 3:] + np.einsum("pji,pj->pi", absolute, half[solid]) + 1e-9
    touch &= (np.abs(own) <= reachable).all(axis=1)
    return frame[touch], geom[touch], solid[touch]


def _add_surfaces(
    ground: Ground,
    geoms: CharacterGeoms,
    position: Array,
    matrix: Array,
    depth: Array,
    other: Index,
) -> None:
    spacing, highest = sample_spacing(ground), ground.surface_top
    size = ground.model.geom_rbound[geoms.ids]
    geom, frame = np.nonzero((position[:, :, 2] - size < highest).T)
    centre, extent = world_boxes(
        ground.model, geoms.ids[geom], position[frame, geom], matrix[frame, geom]
    )
    top = ground.highest(centre, extent, solids=False)
    low = centre[:, 2] - extent[:, 2] < top
    geom, frame, top = geom[low], frame[low], top[low]
    points, owners = [], []
    near: dict[int, Index] = {}
    for i in np.unique(geom).tolist():
        mine = geom == i
        near[i] = frames = frame[mine]
        xyz, row = sole_points(geoms, i, position[frames, i], matrix[frames, i], spacing, top[mine])
        points.append(xyz)
        owners.append(np.stack((frames[row], np.full(len(row), i)), axis=1))
    if not points:
        return
    xyz, owner = np.concatenate(points), np.concatenate(owners)
    deep, against = ground.depth_in_surfaces(xyz)
    _deepest(depth, other, owner, deep, against)
    for field in ground.fields:
        for i in np.flatnonzero(geoms.foot).tolist():
            if i in near:
                _add_grid_points(field, geoms, i, near[i], position, matrix, depth, other)


def _add_grid_points(
    field: Field,
    geoms: CharacterGeoms,
    i: int,
    frames: Index,
    position: Array,
    matrix: Array,
    depth: Array,
    other: Index,
) -> None:
    """Grid points of a field that poke into a foot between the samples of its sole."""
    pos, mat = position[frames, i], matrix[frames, i]
    centre, extent = world_boxes(geoms.model, int(geoms.ids[i]), pos, mat)
    middle = field.on_grid(centre[:, :2])
    # The rectangle of grid points over the foot's own bounding rectangle, turned with the field.
    radius = extent[:, :2] @ np.abs(field.turn) / field.spacing
    first = np.ceil(middle - radius).astype(np.int64)
    count = np.maximum(np.floor(middle + radius).astype(np.int64) - first + 1, 0)
    total = count[:, 0] * count[:, 1]
    frame = np.repeat(np.arange(len(frames)), total)
    place = np.arange(len(frame)) - np.repeat(np.cumsum(total) - total, total)
    column = first[frame, 0] + place % np.maximum(count[frame, 0], 1)
    line = first[frame, 1] + place // np.maximum(count[frame, 0], 1)
    shape = field.values.shape
    on = (column >= 0) & (line >= 0) & (column < shape[1]) & (line < shape[0])
    frame, column, line = frame[on], column[on], line[on]
    height = field.values[line, column] + field.position[2]
    # Of use is only what is deeper in the foot than its samples are in the field.
    spare = height - depth[frames[frame], i]
    poking = np.flatnonzero(spare > centre[frame, 2] - extent[frame, 2])
    local = np.stack((column[poking], line[poking]), axis=1) * field.spacing - field.half
    xy = local @ field.turn.T + field.position[:2]
    frame, height, spare = frame[poking], height[poking], spare[poking]
    at = np.column_stack((xy, spare))
    inside = above_underside(geoms.solids[i], pos[frame], mat[frame], at)
    frame, height, xy = frame[inside], height[inside], xy[inside]
    if len(frame) == 0:
        return
    low, _ = vertical_extent(geoms.solids[i], pos[frame], mat[frame], xy)
    deep = np.where(height > low, height - low, 0.0)
    owner = np.stack((frames[frame], np.full(len(frame), i)), axis=1)
    _deepest(depth, other, owner, deep, np.full(len(frame), field.geom))


def _deepest(depth: Array, other: Index, owner: Index, deep: Array, geom: Index) -> None:
    """Write the deepest of many points of each (frame, geom) into ``depth`` and ``other``."""
    inside = deep > _NOISE
    order = np.flatnonzero(inside)[np.argsort(deep[inside], kind="stable")]
    found, against = np.zeros_like(depth), np.full_like(other, -1)
    found[owner[order, 0], owner[order, 1]] = deep[order]
    against[owner[order, 0], owner[order, 1]] = geom[order]
    _deepen(depth, other, found, against)
