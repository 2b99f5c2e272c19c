"""Where a walk goes: along its own line where that is free, else the least changed one that is.

route = find_route(source, scene)
elsewhere = route.bend.apply(source)
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.motion import Motion
from mjmotion.route.bend import Bend
from mjmotion.route.centreline import Centreline, at_lengths
from mjmotion.route.fit import FINE, fit_line
from mjmotion.route.free_space import FAR, NO_GROUND, FreeSpace, find_free_space
from mjmotion.route.given import rounded
from mjmotion.route.search import SHARPEST, STEP, Asked, find_way
from mjmotion.route.width import BodyWidth
from mjmotion.scene import Scene

Array = NDArray[np.float64]

MARGIN = 0.03  # room beside trunk and legs [m]
SWING = 0.05  # room beside arms [m]
FREE = 0.02  # a line that lacks no more of what trunk and legs take up is free [m]
TRACK = 0.12  # half width of what a walk needs as ground [m]
REACH = (2.5, 8.0)  # how far around its line a walk may go, at least and at most [m]
BESIDE = 1.0  # how far around its own line it is first looked whether that is free [m]
AHEAD = 0.4  # how much further a foot is put than the line goes [m]
LAST = 0.2  # as much of that counts for its own line [m]
NEXT = 0.4  # a walk that ends nearer to an edge had no room for a step more [m]
TURNING = np.radians(80.0)  # most that a walk turns in a second beyond what it does
ASIDE = 1.6  # most that it is pulled aside [m/s²]


@dataclasses.dataclass(frozen=True, eq=False)
class Route:
    """Where a walk goes.

    Attributes:
      own: (n, 2) its own line [m].
      line: (m, 2) the line that it takes; the same where that is free [m].
      bend: what takes it there.
      space: what is free.
      lack: by how much the body is too wide for the line at its narrowest place [m].
      place: (2,) where that is [m].
      bars: the geom that it lacks it of; -1 where there is no ground.
    """

    own: Array
    line: Array
    bend: Bend
    space: FreeSpace
    lack: float
    place: Array
    bars: int

    @property
    def bent(self) -> bool:
        """Whether it is another line than its own."""
        return self.line is not self.own

    def changed(self) -> str:
        """Return what is changed of the walk's own way, in a line; empty where nothing is."""
        if not self.bent:
            return ""
        shift = np.linalg.norm(self.bend.shift, axis=1)
        turn = np.degrees(np.abs(self.bend.turn).max())
        return (
            f"the way is bent: up to {shift.max():.2f} m off the walk's own, turned by up to"
            f" {turn:.0f}°, and ends {shift[-1]:.2f} m off"
        )


def find_route(
    source: Motion,
    scene: Scene,
    *,
    given: Array | None = None,
    keep: bool = False,
    climb: bool = False,
    avoid: tuple[str, ...] = (),
    stepped: Callable[[], bool] = lambda: False,
) -> Route:
    """Return where a walk goes in a scene.

    Args:
      source: the walk at the scene's start, on level ground.
      scene: the scene, at rest.
      given: (n, 2) the way that it is to take, whatever is in it [m]; found without.
      keep: whether it keeps its own, whatever is in it.
      climb: whether what is higher than a step and has a top is climbed.
      avoid: names of geoms that are not ground.
      stepped: says whether its own way has places for its steps, whatever the ground is between.
    """
    line = Centreline.of(source)
    width = BodyWidth.of(source, line, float(scene.start_pos[2]))
    own = line.spaced(FINE)
    # A body is as long as it is wide, about, and its last step goes on a little.
    ahead = line.spaced(FINE, LAST)
    _, trunk = needed_widths(width, FINE * np.arange(len(ahead), dtype=np.float64))
    if given is not None:
        new = line_of_length(rounded(given), line.whole)
        around = np.concatenate((source.qpos[:1, :2], new))
        space = find_free_space(scene, around, REACH[0], width.height, climb=climb, avoid=avoid)
        return _route(own, new, line.bend(new), space, trunk)
    # Whether the own line is free shows next to it: the rest is only looked at where it is not.
    for far in (REACH[0],) if keep else (BESIDE, REACH[0]):
        space = find_free_space(scene, own, far, width.height, climb=climb, avoid=avoid)
        if keep or len(own) < 3 or space.lack(ahead, trunk).max() <= FREE:
            return _route(own, own, Bend.none(source.nframe), space, trunk)
    body = np.array(trunk)
    body[:, -1] = -np.inf  # of its tracks: what is solid alone
    if space.lack(ahead, body).max() <= FREE and stepped():
        return _route(own, own, Bend.none(source.nframe), space, body)
    points = line.spaced(STEP, AHEAD)
    lengths = STEP * np.arange(len(points), dtype=np.float64)
    asked = Asked(points, *needed_widths(width, lengths), _sharpest(line, lengths))
    new = fit_line(find_way(asked, space), asked, space)
    if not space.holds(new):  # it leaves what was looked at: round a corner, mostly
        reach = float(np.clip(line.whole, *REACH))
        space = find_free_space(scene, own, reach, width.height, climb=climb, avoid=avoid)
        new = fit_line(find_way(asked, space), asked, space)
    count = min(len(new), len(trunk))
    return _route(own, new, line.bend(new), space, trunk[:count])


def stopped_short(route: Route, last: Array) -> Route:
    """Return a route that is barred where its ground ends and the walk stops for that reason.

    Steps that are chosen together get shorter before an edge: all of them are good, and yet the
    walk does not get where it was to go.

    Args:
      route: where the walk was to go.
      last: (n, 2) its last footholds [m].
    """
    line, ground = route.line, route.space.ground
    known = np.flatnonzero(ground.known[ground.cells(line)])
    if len(known) == 0 or known[-1] == len(line) - 1:
        return route
    end, short = int(known[-1]), FINE * float(len(line) - 1 - known[-1])
    apart = np.linalg.norm(line - last[:, None], axis=-1)
    reached = int(apart.argmin(axis=1).max())
    if FINE * (end - reached) > NEXT or short <= max(route.lack, NEXT):
        return route
    return dataclasses.replace(route, lack=short, place=line[end], bars=NO_GROUND)


def line_of_length(line: Array, whole: float) -> Array:
    """Return as much of a line (n, 2), :data:`FINE` apart, as a walk of some length goes [m]."""
    length = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))))
    return at_lengths(line, length, np.arange(0.0, whole + FINE, FINE))


def way_length(way: Array) -> float:
    """Return how long a given way is with its corners rounded [m]."""
    return float(np.linalg.norm(np.diff(rounded(way), axis=0), axis=1).sum())


def needed_widths(width: BodyWidth, lengths: Array) -> tuple[Array, Array]:
    """Return what a walk needs (n, nband + 1) to either side: with its arms, and without [m]."""
    swung, trunk = width.at(lengths)
    track = np.full((len(lengths), 1), TRACK)
    trunk = np.column_stack((trunk + MARGIN, track))
    swung = np.column_stack((swung + SWING, track))
    # Nothing is told of what is further off than FAR: nothing wider can be asked for.
    widest = FAR - MARGIN
    return np.minimum(np.maximum(swung, trunk), widest), np.minimum(trunk, widest)


def _sharpest(line: Centreline, lengths: Array) -> Array:
    """Return the most curvature (n,) beyond its own that a walk is to have [1/m]."""
    pace = np.gradient(line.length) * line.fps if len(line.length) > 1 else np.zeros(1)
    at = np.interp(lengths, line.length, pace)
    pace = np.maximum(at, 0.1)
    return np.minimum(SHARPEST, np.minimum(TURNING / pace, ASIDE / pace**2))


def _route(own: Array, line: Array, bend: Bend, space: FreeSpace, needed: Array) -> Route:
    count = min(len(line), len(needed))
    lack = space.lack(line[:count], needed[:count])
    worst = int(np.argmax(lack))
    geom, _ = space.worst(line[worst], needed[worst])
    return Route(own, line, bend, space, float(lack[worst]), line[worst], geom)
