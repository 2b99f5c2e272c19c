"""Footholds: where each stance foot is to stand on the ground of a scene.

A *stance* is a foot's stay on one spot, from heel strike to toe-off. In the source it stands on
level ground; its foothold stands on the scene's: under the same spot, turned the same way about the
vertical, tilted to the surface, and moved as little as needed where it would straddle an edge, hang
over one or stand in a wall.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.feet import Foot
from mjmotion.exceptions import SceneError, frame_list
from mjmotion.footsteps.rough import RISEN, settled_near
from mjmotion.footsteps.settling import Plates, Tread
from mjmotion.footsteps.soles import Placed, set_down, walled
from mjmotion.footsteps.stances import Stance
from mjmotion.footsteps.under_toes import toes_on_ground
from mjmotion.numerics.rotations import multiply, rotate
from mjmotion.scene.ground import Ground

Array = NDArray[np.float64]

ROUGH = 0.005  # how far ground may be from the sole plane before a better spot is sought [m]
FIELD_ROUGH = 0.010  # the same on heightfields, which are nowhere quite flat [m]
SEARCH_RADIUS = 0.34  # how far a foothold may move [m]
NEARER = 0.05  # how much nearer a sole must settle for that to be worth it [m]
FEET_APART = 0.02  # how far beside the other foot a foot is set down, where the source does [m]
CROSSING = 0.06  # how much further across it may be, behind or before the other [m]
CROWD_COST = 0.06  # way that half of that space is worth [m]
_RINGS, _RAYS = 17, 16
FINE_STEP = 0.005  # distance of the spots that are tried around a chosen one [m]
FINE_AHEAD, FINE_ASIDE = 10, 2  # so many of them ahead, and of four times that distance aside
FINE_MARGINS = (0.015, 0.007, 0.001)  # how far inside an edge a sole keeps, if it can [m]
FINE_CROWD = 0.02  # way that half of the space before a step is worth there [m]
SAME_LEVEL = 0.06  # ground this near in height to a chosen spot is the one that was meant [m]


@dataclasses.dataclass(frozen=True, eq=False)
class Foothold:
    """Where a stance is to stand.

    Attributes:
      position: (3,) of the posed site [m].
      quat: (4,) its orientation, wxyz.
      normal: (3,) of the plane that the sole is in.
      moved: how far it is from where the source stands, over the plane [m].
      toes: how far the toes are bent up to lie on the ground ahead of the ball [rad].
    """

    position: Array
    quat: Array
    normal: Array
    moved: float
    toes: float = 0.0


def find_footholds(
    stances: Sequence[Stance], feet: Sequence[Foot], ground: Ground, start_height: float
) -> tuple[Foothold, ...]:
    """Place every stance on the ground, as :func:`each_foothold` says.

    Raises:
      SceneError: there is nothing to stand on within reach of a stance.
    """
    return tuple(each_foothold(stances, feet, ground, start_height))


def each_foothold(
    stances: Sequence[Stance], feet: Sequence[Foot], ground: Ground, start_height: float
) -> Iterator[Foothold]:
    """Place stances on the ground, one after the other as they are asked for.

    Heights are followed from stance to stance: each looks for ground from where the one before it
    stands, so a walk up a stair and under a bridge finds the stair, not the bridge.

    Args:
      stances: in order of time.
      feet: the feet they are of.
      ground: the scene's surfaces.
      start_height: height of the ground where the walk begins [m].

    Raises:
      SceneError: there is nothing to stand on within reach of a stance.
    """
    return _in_turn(
        stances, feet, ground, lambda before: start_height if before is None else before
    )


def footholds_at(
    stances: Sequence[Stance], feet: Sequence[Foot], ground: Ground, heights: Sequence[float]
) -> tuple[Foothold, ...]:
    """Place every stance on the ground of its own height, as near to its spot as that is good.

    Args:
      stances: in order of time, at spots that were chosen to within a few centimetres.
      feet: the feet they are of.
      ground: the scene's surfaces.
      heights: of the ground at each, about [m].

    Raises:
      SceneError: there is nothing to stand on within reach of a stance.
    """
    own = iter(heights)
    return tuple(_in_turn(stances, feet, ground, lambda _: next(own), near=True))


def _in_turn(
    stances: Sequence[Stance],
    feet: Sequence[Foot],
    ground: Ground,
    height_after: Callable[[float | None], float],
    *,
    near: bool = False,
) -> Iterator[Foothold]:
    """Place stances one after the other, each on ground of the height that the last one tells.

    With ``near``, spots a few centimetres away are tried before any that are further.
    """
    before: float | None = None
    treads = [Tread.of(foot) for foot in feet]
    last: dict[int, tuple[Stance, Foothold]] = {}
    for stance in stances:
        foot = feet[stance.foot]
        others = [
            Beside.of(stance, foot, *one, feet) for i, one in last.items() if i != stance.foot
        ]
        spot = np.array((*stance.source_pos[:2], height_after(before)))
        place = set_down(foot, ground, spot[None], stance.source_quat)
        rough = ROUGH
        if place.fault[0] <= FIELD_ROUGH:
            sole = spot + rotate(stance.source_quat, foot.sole)
            rough = FIELD_ROUGH if ground.on_field(sole) else ROUGH
        poor = place.fault[0] > rough or place.crowded[0] > 0
        poor = poor or any(other.lack(place)[0] > 0.0 for other in others)
        if poor or walled(foot, ground, place, 0):
            fine = _fine(foot, ground, spot, stance, rough, others) if near else None
            place = (
                _search(foot, ground, spot, stance, place, rough, others) if fine is None else fine
            )
        tread = treads[stance.foot]
        bend = toes_on_ground(foot, ground, place.position[0], place.quat[0])
        rises = tread.rises(ground, place.position[0], place.quat[0], bend)
        uneven = place.fault[0] > rough or rises > RISEN
        far = float(np.hypot(*(place.position[0] - spot)[:2])) - NEARER
        if uneven or far > NEARER:
            worth = np.inf if uneven else far
            place = _settled(tread, ground, spot, stance.source_quat, place, others, worth)
            bend = toes_on_ground(foot, ground, place.position[0], place.quat[0])
        moved = float(np.hypot(*(place.position[0, :2] - stance.source_pos[:2])))
        foothold = Foothold(place.position[0], place.quat[0], place.normal[0], moved, bend)
        before = float(place.position[0, 2])
        last[stance.foot] = stance, foothold
        yield foothold


@dataclasses.dataclass(frozen=True, eq=False)
class Beside:
    """The other foot's last foothold, beside which a foot is to be set down.

    Attributes:
      foot: the foot that is set down.
      quat: (4,) its yaw.
      sole: (k, 3) the other's sole in the world [m].
      side: (3,) the way from the other to it, across the body.
      least: how far beside the other it may be set down: as in the source, and not more [m].
    """

    foot: Foot
    quat: Array
    sole: Array
    side: Array
    least: float

    @classmethod
    def of(
        cls, stance: Stance, foot: Foot, other: Stance, foothold: Foothold, feet: Sequence[Foot]
    ) -> Beside:
        """Return it for a stance, and the other's last."""
        theirs = feet[other.foot].sole
        side = rotate(stance.source_quat, np.array((0.0, 1.0, 0.0)))
        mine = stance.source_pos + rotate(stance.source_quat, foot.sole)
        was = other.source_pos + rotate(other.source_quat, theirs)
        if (mine.mean(axis=0) - was.mean(axis=0)) @ side < 0.0:
            side = -side
        apart = float((mine @ side).min() - (was @ side).max())
        now = foothold.position + rotate(foothold.quat, theirs)
        return cls(foot, stance.source_quat, now, side, min(apart, FEET_APART))

    def lack(self, placed: Placed) -> Array:
        """Return how much nearer than it may be a foot would be at each place (n,) [m]."""
        ahead = np.array((self.side[1], -self.side[0], 0.0))
        mine = placed.position[:, None] + rotate(placed.quat[:, None], self.foot.sole)
        along, theirs = mine @ ahead, self.sole @ ahead
        clear = (along.min(axis=1) > theirs.max()) | (along.max(axis=1) < theirs.min())
        apart = (mine @ self.side).min(axis=1) - (self.sole @ self.side).max()
        return self.least - np.where(clear, CROSSING, 0.0) - apart


def _fine(
    foot: Foot,
    ground: Ground,
    spot: Array,
    stance: Stance,
    rough: float,
    others: Sequence[Beside],
) -> Placed | None:
    """Return the best spot within a few centimetres, on the same level; None where none is good.

    Where a tread is hardly longer than a foot, that keeps less far inside its edges.
    """
    along, across = (
        np.arange(-count, count + 1) * step
        for count, step in ((FINE_AHEAD, FINE_STEP), (FINE_ASIDE, 4.0 * FINE_STEP))
    )
    shift = np.stack(np.meshgrid(along, across, [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
    away = np.linalg.norm(shift, axis=1)
    spots = spot + rotate(stance.source_quat, shift)
    for margin in FINE_MARGINS:
        placed = set_down(foot, ground, spots, stance.source_quat, margin, overhang=True)
        good = (placed.fault <= rough) & (np.abs(placed.position[:, 2] - spot[2]) < SAME_LEVEL)
        for other in others:
            good &= other.lack(placed) <= 0.0
        worth = away + FINE_CROWD * placed.crowded
        for index in np.flatnonzero(good)[np.argsort(worth[good], kind="stable")]:
            if not walled(foot, ground, placed, int(index)):
                return placed[int(index)]
    return None


def _search(
    foot: Foot,
    ground: Ground,
    spot: Array,
    stance: Stance,
    first: Placed,
    rough: float,
    others: Sequence[Beside],
) -> Placed:
    """Return the nearest spot with good ground; the best there is when none is good."""
    shift = _around()
    radius = np.linalg.norm(shift, axis=1)
    placed = set_down(foot, ground, spot + rotate(stance.source_quat, shift), stance.source_quat)
    if first.fault[0] <= rough and not walled(foot, ground, first, 0):
        radius, placed = np.concatenate(([0.0], radius)), first + placed
    for other in others:  # ground on which the other foot stands is no better than none
        placed = dataclasses.replace(placed, fault=placed.fault + 1.0 * (other.lack(placed) > 0.0))
    good = np.flatnonzero(placed.fault <= rough)
    # Some crowding is worth a little way, not any: on narrow treads there is no better spot.
    worth = radius[good] + CROWD_COST * placed.crowded[good]
    for index in good[np.argsort(worth, kind="stable")]:
        if not walled(foot, ground, placed, int(index)):
            return placed[int(index)]
    # Ground that is uneven everywhere: trade how far to move against how badly it fits.
    cost = placed.fault + 0.05 * radius
    for index in np.argsort(cost):
        if placed.fault[index] < 1.0 and not walled(foot, ground, placed, int(index)):
            near = first.fault[0] <= cost[index] and not walled(foot, ground, first, 0)
            return first if near else placed[int(index)]
    x, y = spot[:2]
    frames = range(stance.start, stance.end)
    raise SceneError(
        f"no ground under the walk: nothing to stand on within {SEARCH_RADIUS} m of"
        f" x={x:.2f}, y={y:.2f} at frames {frame_list(frames)}:"
        " move the scene's site 'start' or choose a larger scene",
        frames,
    )


def _around() -> Array:
    """Return the ways (n, 3) from a spot to where else a foot may go, over the plane [m]."""
    radius = np.repeat(np.arange(1, _RINGS + 1) * SEARCH_RADIUS / _RINGS, _RAYS)
    angle = np.tile(np.arange(_RAYS) * 2.0 * np.pi / _RAYS, _RINGS)
    return np.column_stack((radius * np.cos(angle), radius * np.sin(angle), np.zeros(len(radius))))


def _settled(
    tread: Tread,
    ground: Ground,
    spot: Array,
    yaw: Array,
    first: Placed,
    others: Sequence[Beside],
    worth: float,
) -> Placed:
    """Return where a foot settles near a spot for less than ``worth`` [m]; else ``first``."""

    def placed(plates: Plates) -> Placed:
        crowded = np.zeros(len(plates.gap))
        return Placed(plates.position, plates.quat, plates.normal, plates.gap, crowded)

    def refused(plates: Plates) -> NDArray[np.bool_]:
        lacks = [other.lack(placed(plates)) > 0.0 for other in others]
        bad = np.any([np.zeros(len(plates.gap), dtype=bool), *lacks], axis=0)
        # Walls are felt for one by one: at a place that is looked at closely.
        if len(bad) == 1 and walled(tread.foot, ground, placed(plates), 0):
            bad[:] = True
        return np.asarray(bad)

    shift = np.concatenate((np.zeros((1, 3)), rotate(yaw, _around())))
    near, cost = settled_near(tread, ground, spot, yaw, shift, refused)
    return first if near is None or cost >= worth else placed(near)


def carried(stance: Stance, foothold: Foothold) -> Array:
    """Return the turn (4,) that carries the stance's level frame into its foothold's."""
    return multiply(foothold.quat, stance.source_quat * np.array((1.0, -1.0, -1.0, -1.0)))
