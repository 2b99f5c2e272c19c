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
from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.validation.ground import Ground
from mjmotion.validation.solids import Skin, Solid, reach, skin, solid_of, vertical_extent, within

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_SPACING = (0.01, 0.03)  # [m] finest and coarsest samples of a geom's skin
_BLOCK = 8  # grid points a side of the blocks whose highest point prunes the rest
_NOISE = 1e-9  # [m] shallower than rounding


@dataclasses.dataclass(frozen=True, eq=False)
class Character:
    """The geoms of the character that collide.

    Attributes:
      model: the model.
      geoms: (ngeom,) ids.
      solids: their shapes.
      foot: (ngeom,) whether each belongs to a foot.
    """

    model: mujoco.MjModel
    geoms: Index
    solids: tuple[Solid, ...]
    foot: NDArray[np.bool_]
    _skins: dict[tuple[int, float], Skin] = dataclasses.field(default_factory=dict)

    def skin(self, i: int, spacing: float) -> Skin:
        """Return the skin of geom number ``i``, without what is inside another of its body.

        What is inside another geom of the same body always has a part of that one under it.
        """
        if (i, spacing) in self._skins:
            return self._skins[i, spacing]
        model, geom = self.model, int(self.geoms[i])
        # A rough field is deepest in a sole where its ridges cross the sole's outline.
        whole = skin(self.solids[i], spacing, spacing / 3 if self.foot[i] else None)
        hidden = np.zeros(len(whole.point), dtype=bool)
        turn, back = np.empty(9), np.empty(9)
        mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
        placed = whole.point @ turn.reshape(3, 3).T + model.geom_pos[geom]
        for k, other in enumerate(self.geoms):
            if k != i and model.geom_bodyid[other] == model.geom_bodyid[geom]:
                mujoco.mju_quat2Mat(back, model.geom_quat[other])
                local = (placed - model.geom_pos[other]) @ back.reshape(3, 3)
                hidden |= within(self.solids[k], local)
        self._skins[i, spacing] = whole.keep(~hidden)
        return self._skins[i, spacing]


@lru_cache(maxsize=8)
def character_of(model: mujoco.MjModel, feet: tuple[int, ...]) -> Character:
    """Return the geoms under the free root; if none of them collides, all of them."""
    mine = model.body_rootid[model.geom_bodyid] == int(model.jnt_bodyid[0])
    mine &= ~np.isin(model.geom_type, (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD))
    solid = mine & ((model.geom_contype != 0) | (model.geom_conaffinity != 0))
    geoms = np.flatnonzero(solid if solid.any() else mine)
    return Character(
        model,
        geoms,
        tuple(solid_of(model, int(geom)) for geom in geoms),
        np.isin(model.geom_bodyid[geoms], feet),
    )


def penetration(
    ground: Ground, character: Character, position: Array, matrix: Array
) -> tuple[Array, Index]:
    """Return how deep every geom is in the scene.

    Args:
      ground: the scene.
      character: the geoms.
      position: (nframe, ngeom, 3) of the character's geoms [m].
      matrix: (nframe, ngeom, 3, 3).

    Returns:
      depth: (nframe, ngeom) [m], 0 where a geom is clear.
      other: (nframe, ngeom) id of the scene's geom that it is deepest in, -1 where it is clear.
    """
    depth = np.zeros(position.shape[:2])
    other = np.full(position.shape[:2], -1)
    for plane in ground.planes:
        _deepen(depth, other, _plane_depth(ground, plane, character, position, matrix), plane)
    if ground.convex:
        _add_convex(ground, character, position, matrix, depth, other)
    if ground.fields or ground.surfaces:
        _add_surfaces(ground, character, position, matrix, depth, other)
    return depth, other


def lowest_points(character: Character, position: Array, matrix: Array) -> Array:
    """Return the height (nframe, ngeom) of each geom's lowest point [m]."""
    down = -matrix[:, :, 2, :]  # world down in each geom's frame
    far = [reach(solid, down[:, i]) for i, solid in enumerate(character.solids)]
    return np.asarray(position[:, :, 2] - np.stack(far, axis=1))


def sole_points(
    character: Character,
    i: int,
    position: Array,
    matrix: Array,
    spacing: float,
    top: Array | None = None,
) -> tuple[Array, Index]:
    """Return world points (m, 3) on the underside of geom number ``i``, and the frame of each.

    Args:
      character: the geoms.
      i: which one of them.
      position: (nframe, 3) where it is [m].
      matrix: (nframe, 3, 3) how it is turned.
      spacing: how far apart the points are about [m].
      top: (nframe,) only points below these heights are wanted [m].
    """
    whole = character.skin(i, spacing)
    height = matrix[:, 2] @ whole.point.T + position[:, 2, None]
    chosen = whole.facing_down(matrix)
    if top is not None:
        chosen &= height < top[:, None]
    frame, which = np.nonzero(chosen)
    world = np.empty((len(frame), 3))
    for axis in (0, 1):  # every point in every frame, then the chosen: quicker than the reverse
        whole_axis = matrix[:, axis] @ whole.point.T + position[:, axis, None]
        world[:, axis] = whole_axis[frame, which]
    world[:, 2] = height[frame, which]
    return world, frame


def sample_spacing(ground: Ground) -> float:
    """Return how far apart to take points of a geom's skin [m]: as the finest field's own."""
    finest = [float(ground.field_grid(field)[1].min()) for field in ground.fields]
    return float(np.clip(min(finest, default=_SPACING[1]), *_SPACING))


def _deepen(depth: Array, other: Index, new: Array, geom: int | Index) -> None:
    deeper = new > np.maximum(depth, _NOISE)
    other[:] = np.where(deeper, geom, other)
    depth[:] = np.where(deeper, new, depth)


def _plane_depth(
    ground: Ground, plane: int, character: Character, position: Array, matrix: Array
) -> Array:
    normal = ground.matrix[plane][:, 2]
    distance = (position - ground.position[plane]) @ normal
    near = distance < ground.model.geom_rbound[character.geoms]
    for i in np.flatnonzero(near.any(axis=0)):
        frames = np.flatnonzero(near[:, i])
        toward = np.einsum("fji,j->fi", matrix[frames, i], -normal)
        distance[frames, i] -= reach(character.solids[i], toward)
    return np.maximum(-distance, 0.0)


def _add_convex(
    ground: Ground,
    character: Character,
    position: Array,
    matrix: Array,
    depth: Array,
    other: Index,
) -> None:
    """Boxes and their like: prune by bounding boxes, all frames at once, then measure each pair."""
    model = ground.model
    frame, geom, solid = _close_pairs(ground, character, position, matrix)
    if len(frame) == 0:
        return
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)  # places the static geoms; the others are set below
    xpos, xmat = data.geom_xpos, data.geom_xmat
    flat = matrix.reshape(*matrix.shape[:2], 9)
    mine, theirs = character.geoms.tolist(), np.array(ground.convex)[solid].tolist()
    gap = np.empty(len(frame))
    last = -1
    for k, (f, i, static) in enumerate(zip(frame.tolist(), geom.tolist(), theirs, strict=True)):
        if f != last:
            xpos[character.geoms], xmat[character.geoms] = position[f], flat[f]
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
    ground: Ground, character: Character, position: Array, matrix: Array
) -> tuple[Index, Index, Index]:
    """Return frame, geom and static solid of all pairs whose bounding boxes may touch.

    Three sieves, each on what the one before let through: a box around the whole character, each
    geom's bounding ball, and the six face axes of the two oriented boxes.
    """
    model, ids, statics = ground.model, character.geoms, np.array(ground.convex)
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
    character: Character,
    position: Array,
    matrix: Array,
    depth: Array,
    other: Index,
) -> None:
    spacing = sample_spacing(ground)
    top = _surface_tops(ground, character, position)
    near = lowest_points(character, position, matrix) < top
    points, owners = [], []
    for i in range(len(character.solids)):
        frames = np.flatnonzero(near[:, i])
        if len(frames) == 0:
            continue
        xyz, frame = sole_points(
            character, i, position[frames, i], matrix[frames, i], spacing, top[frames, i]
        )
        points.append(xyz)
        owners.append(np.stack((frames[frame], np.full(len(frame), i)), axis=1))
    if not points:
        return
    xyz, owner = np.concatenate(points), np.concatenate(owners)
    deep, geom = ground.depth_in_surfaces(xyz)
    _deepest(depth, other, owner, deep, geom)
    for field in ground.fields:
        for i in np.flatnonzero(character.foot).tolist():
            _add_grid_points(
                ground, field, character, i, near[:, i], position, matrix, depth, other
            )


def _surface_tops(ground: Ground, character: Character, position: Array) -> Array:
    """Return (nframe, ngeom): a height that nothing within reach of a geom rises above [m].

    Minus infinity where there is no heightfield and no open mesh within reach.
    """
    top = np.full(position.shape[:2], -np.inf)
    size = ground.model.geom_rbound[character.geoms]
    for low, high in ground.surface_bounds():
        around = (position > low - size[:, None]) & (position < high + size[:, None])
        top = np.where(around.all(axis=2), np.maximum(top, high[2]), top)
    for field in ground.fields:
        values, spacing = ground.field_grid(field)
        block = spacing * _BLOCK
        half = ground.model.hfield_size[ground.model.geom_dataid[field], :2]
        turn = ground.matrix[field][:2, :2]
        local = (position[..., :2] - ground.position[field, :2]) @ turn + half
        for reach_class in np.unique(np.ceil(size / block.min())):
            group = np.flatnonzero(np.ceil(size / block.min()) == reach_class)
            around = np.ceil(size[group].max() / block).astype(np.int64)
            highest = _block_maximum(values, around)
            place = np.floor(local[:, group] / block).astype(np.int64) + around
            limit = np.array(highest.shape)[::-1]
            inside = ((place >= 0) & (place < limit)).all(axis=2)
            place = np.clip(place, 0, limit - 1)
            here = highest[place[..., 1], place[..., 0]] + ground.position[field, 2]
            top[:, group] = np.maximum(top[:, group], np.where(inside, here, -np.inf))
    return top


def _block_maximum(values: Array, around: NDArray[np.int64]) -> Array:
    """Return the highest value of each block of the grid and ``around`` (x, y) blocks beside it.

    The result has ``around`` more blocks on each side than the grid.
    """
    nrow, ncol = values.shape
    rows, cols = -(-nrow // _BLOCK), -(-ncol // _BLOCK)
    # A block's cells end on the first grid points of the next block, so those count too.
    filled = np.full((rows * _BLOCK + 1, cols * _BLOCK + 1), -np.inf)
    filled[:nrow, :ncol] = values
    block = filled[:-1, :-1].reshape(rows, _BLOCK, cols, _BLOCK).max(axis=(1, 3))
    right = filled[:-1, _BLOCK::_BLOCK].reshape(rows, _BLOCK, cols).max(axis=1)
    above = filled[_BLOCK::_BLOCK, :-1].reshape(rows, cols, _BLOCK).max(axis=2)
    corner = filled[_BLOCK::_BLOCK, _BLOCK::_BLOCK]
    block = np.maximum.reduce((block, right, above, corner))
    for axis, pad in ((0, int(around[1])), (1, int(around[0]))):
        widths = [(0, 0), (0, 0)]
        widths[axis] = (2 * pad, 2 * pad)
        padded = np.pad(block, widths, constant_values=-np.inf)
        window = np.lib.stride_tricks.sliding_window_view(padded, 2 * pad + 1, axis=axis)
        block = window.max(axis=-1)
    return np.asarray(block)


def _add_grid_points(
    ground: Ground,
    field: int,
    character: Character,
    i: int,
    near: NDArray[np.bool_],
    position: Array,
    matrix: Array,
    depth: Array,
    other: Index,
) -> None:
    """Grid points of a field that poke into a foot between the samples of its sole."""
    values, spacing = ground.field_grid(field)
    frames = np.flatnonzero(near)
    if len(frames) == 0:
        return
    model, geom = ground.model, int(character.geoms[i])
    pos, mat = position[frames, i], matrix[frames, i]
    box = model.geom_aabb[geom]
    centre = pos + mat @ box[:3]
    extent = np.abs(mat) @ box[3:]
    turn = ground.matrix[field][:2, :2]
    half = model.hfield_size[model.geom_dataid[field], :2]
    middle = ((centre[:, :2] - ground.position[field, :2]) @ turn + half) / spacing
    # The rectangle of grid points over the foot's own bounding rectangle, turned with the field.
    radius = extent[:, :2] @ np.abs(turn) / spacing
    first = np.ceil(middle - radius).astype(np.int64)
    count = np.maximum(np.floor(middle + radius).astype(np.int64) - first + 1, 0)
    total = count[:, 0] * count[:, 1]
    frame = np.repeat(np.arange(len(frames)), total)
    place = np.arange(len(frame)) - np.repeat(np.cumsum(total) - total, total)
    column = first[frame, 0] + place % np.maximum(count[frame, 0], 1)
    line = first[frame, 1] + place // np.maximum(count[frame, 0], 1)
    within = (column >= 0) & (line >= 0)
    within &= (column < values.shape[1]) & (line < values.shape[0])
    frame, column, line = frame[within], column[within], line[within]
    height = values[line, column] + ground.position[field, 2]
    poking = height > centre[frame, 2] - extent[frame, 2]
    frame, column, line, height = frame[poking], column[poking], line[poking], height[poking]
    if len(frame) == 0:
        return
    local = np.stack((column, line), axis=1) * spacing - half
    xy = local @ turn.T + ground.position[field, :2]
    low, _ = vertical_extent(character.solids[i], pos[frame], mat[frame], xy)
    deep = np.where(height > low, height - low, 0.0)
    owner = np.stack((frames[frame], np.full(len(frame), i)), axis=1)
    _deepest(depth, other, owner, deep, np.full(len(frame), field))


def _deepest(depth: Array, other: Index, owner: Index, deep: Array, geom: Index) -> None:
    """Write the deepest of many points of each (frame, geom) into ``depth`` and ``other``."""
    inside = deep > _NOISE
    order = np.flatnonzero(inside)[np.argsort(deep[inside], kind="stable")]
    found, against = np.zeros_like(depth), np.full_like(other, -1)
    found[owner[order, 0], owner[order, 1]] = deep[order]
    against[owner[order, 0], owner[order, 1]] = geom[order]
    _deepen(depth, other, found, against)
