"""A sole put down on ground: how it tilts, how well it fits, and what crowds it."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.feet import Foot
from mjmotion.footsteps.under_toes import under_toes
from mjmotion.numerics.rotations import cross, from_matrix, normalized, rotate
from mjmotion.scene.ground import Ground

Array = NDArray[np.float64]

APPROACH = 0.06  # how far before the toe and behind the heel no step may rise [m]
STEP = 0.02  # a rise there that counts as a step [m]
SINK = 0.0032  # how far the ground may rise into the sole [m]
EDGE_MARGIN = 0.015  # how far inside an edge a sole keeps [m]
_ANKLE = 0.10  # height over the sole at which walls are felt for [m]


@dataclasses.dataclass(frozen=True, eq=False)
class Placed:
    """Candidate footholds (n, …), how badly the ground fits under each [m], how crowded each is.

    ``crowded`` is 1 when a step rises near the toe or behind the heel, 2 when it is very near.
    """

    position: Array
    quat: Array
    normal: Array
    fault: Array
    crowded: Array

    def __add__(self, other: Placed) -> Placed:
        return Placed(
            *(
                np.concatenate((getattr(self, field.name), getattr(other, field.name)))
                for field in dataclasses.fields(self)
            )
        )

    def __getitem__(self, index: int) -> Placed:
        one = slice(index, index + 1)
        return Placed(*(getattr(self, field.name)[one] for field in dataclasses.fields(self)))


def set_down(
    foot: Foot,
    ground: Ground,
    spots: Array,
    yaw: Array,
    margin: float = EDGE_MARGIN,
    *,
    overhang: bool = False,
) -> Placed:
    """Set a foot down at spots (n, 3): tilt it through the ground under heel, toe and sides.

    Args:
      foot: the foot.
      ground: the scene's surfaces.
      spots: of its posed site [m].
      yaw: (4,) how it is turned about the vertical.
      margin: how far inside an edge its sole keeps [m].
      overhang: whether its toes may be over an edge.
    """
    more = 1.0 + margin / np.maximum(np.linalg.norm(foot.sole[2:, :2], axis=1), 0.03)
    probe = foot.sole[2:] * np.column_stack((more, more, np.ones(len(more))))
    ahead = APPROACH * normalized((foot.toe - foot.heel) * (1.0, 1.0, 0.0))
    near = [
        place
        for part in (0.5, 1.0)
        for place in (foot.heel - part * ahead, foot.front + part * ahead)
    ]
    ends = (foot.heel, foot.toe, *near)
    points = spots[:, None] + rotate(yaw, np.concatenate((ends, probe))) * (1.0, 1.0, 0.0)
    heights, normals, avoided = ground.firm(points)
    missing = np.isnan(heights) | avoided
    normals = np.where(avoided[..., None], 0.0, normals)
    heights = np.where(missing, spots[:, None, 2], heights)
    heel = np.concatenate((points[:, 0, :2], heights[:, :1]), axis=1)
    toe = np.concatenate((points[:, 1, :2], heights[:, 1:2]), axis=1)
    along = normalized(toe - heel)
    # Roll: the mean surface normal under the sole, made square to the heel-toe line.
    normal = normalized(normals.sum(axis=1) + (0.0, 0.0, 1e-9))
    normal = normalized(normal - (normal * along).sum(axis=1, keepdims=True) * along)
    across = cross(normal, along)
    local = normalized(foot.toe - foot.heel)
    side = cross(np.array((0.0, 0.0, 1.0)), local)
    own = np.stack((local, side, cross(local, side)))
    quat = from_matrix(np.stack((along, across, normal), axis=-1) @ own)
    position = heel - rotate(quat, foot.heel)
    # How far the true ground is from the plane of the sole, above it and below it.
    above = (
        (points + (0, 0, 1) * (heights - points[..., 2])[..., None] - position[:, None])
        * normal[:, None]
    ).sum(axis=-1) - foot.sole[0, 2]
    above -= under_toes(foot, np.concatenate((ends, probe)), above, len(probe))
    if overhang:
        above = _without_hanging(foot, above, len(probe))
    step = above[:, 2:6] > STEP + np.abs(along[:, 2:]) * APPROACH
    crowded = step[:, :2].any(axis=1) + step.any(axis=1).astype(float)
    above = np.delete(above, (2, 3, 4, 5), axis=1)
    rise = above[:, 2:].max(axis=1)
    position = position + normal * np.maximum(0.0, rise - SINK)[:, None]
    fault = np.abs(above).max(axis=1) + missing[:, [0, 1, *range(6, missing.shape[1])]].sum(axis=1)
    return Placed(position, quat, normal, fault, crowded)


def _without_hanging(foot: Foot, above: Array, count: int) -> Array:
    """Return how far ground is above a sole (n, k), as if there were some under toes that hang.

    Args:
      foot: the foot.
      above: (n, k); its last ``count`` are of the sole but for its first two points [m].
      count: of those.
    """
    hangs = np.zeros(above.shape[1], dtype=bool)
    hangs[-count:] = foot.bends[2 : len(foot.sole)]
    return np.where(hangs & (above < -STEP), 0.0, above)


def walled(foot: Foot, ground: Ground, placed: Placed, index: int) -> bool:
    """Whether anything stands in the foot: rays at ankle height from its middle to its outline."""
    normal, quat = placed.normal[index], placed.quat[index]
    centre = placed.position[index] + rotate(quat, 0.5 * (foot.heel + foot.front)) + _ANKLE * normal
    sole = placed.position[index] + rotate(quat, foot.sole) + _ANKLE * normal
    way = sole - centre
    way = way[np.linalg.norm(way, axis=1) > 1e-6]  # a point in the very middle has none
    return ground.blocked(np.broadcast_to(centre, way.shape), way, EDGE_MARGIN)
