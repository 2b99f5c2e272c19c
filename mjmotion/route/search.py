"""The way through free space that changes a walk's line the least: dynamic programming.

Layer by layer along the arc length, the line goes on by one step from each of the places where it
may be, in its own curve and in ones more or less sharp. Of those that come to much the same place
and heading the cheapest is kept, and of all of these the cheapest few thousand. Arc lengths are
those of the old line, so no stride is stretched, and the cost is linear in them.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from mjmotion.route.free_space import FreeSpace

Array = NDArray[np.float64]
Index = NDArray[np.int64]

STEP = 0.2  # of arc length between layers [m]
SHARPEST = 1.5  # curvature more than the source's: 60° in a step of 0.7 m [1/m]
CURVES = np.array((-1.0, -0.6, -0.3, -0.1, 0.0, 0.1, 0.3, 0.6, 1.0))  # shares of the sharpest
KEPT = 3000  # places of a layer
PLACE, HEADING = 0.08, np.radians(10.0)  # nearer than that two are one [m], [rad]

ASIDE = 1.0  # price of a metre's way one metre off the old line
FARTHEST = 1.2  # further off it costs no more [m]
ASTRAY = 0.15  # price of a metre's way that heads elsewhere than the old line does, by a radian
WORST = np.radians(75.0)  # more than that costs no more
CURVED = 0.3  # price of a metre's way curved by 1/m more than the old line
BENT = 0.05  # price of a change of that curvature
TIGHT = 15.0  # price of a metre's way that lacks a metre of what the arms swing through
BARRED = 600.0  # price of a metre's way that lacks a metre of what trunk and legs take up
BOWED = 1.0  # price of a metre's way under what hangs low
CLIMBED = 8.0  # price of a metre's way with a single step a metre higher than LEVEL
LEVEL = 0.22  # step that costs nothing [m]
SET_OFF = 6.0  # price of setting off another way, by a squared radian
ABOUT = np.radians((-40.0, -30.0, -20.0, -10.0, 0.0, 10.0, 20.0, 30.0, 40.0))  # which ways
HEAD = 0.25  # nearer to it than that one bows [m]


@dataclasses.dataclass(frozen=True, eq=False)
class Asked:
    """What a walk asks of its way, at every step of arc length.

    Attributes:
      line: (n, 2) its own line [m].
      swung: (n, nband + 1) half widths with the arms [m].
      trunk: (n, nband + 1) without [m].
      sharpest: (n,) most curvature beyond its own [1/m].
      spacing: arc length of a step [m].
    """

    line: Array
    swung: Array
    trunk: Array
    sharpest: Array
    spacing: float = STEP


@dataclasses.dataclass(frozen=True, eq=False)
class _Places:
    """Where the line may be in one layer: (m, …), the cheapest first."""

    point: Array
    off: Array  # heading beyond the old line's
    curve: Array  # curvature beyond the old line's
    along: Array  # how far along the old line, in its steps
    cost: Array
    before: Index  # in the layer before

    def __getitem__(self, chosen: Index) -> _Places:
        return _Places(*(getattr(self, field.name)[chosen] for field in dataclasses.fields(self)))


def find_way(asked: Asked, space: FreeSpace) -> Array:
    """Return the points (n, 2) of the cheapest way, a step of arc length apart [m].

    It begins where the old line does. Where there is no free way it is the one that lacks least.
    """
    line, count = asked.line, len(asked.line)
    ways = np.diff(line, axis=0)
    heading = np.unwrap(np.arctan2(ways[:, 1], ways[:, 0]))
    none, first = np.zeros(len(ABOUT)), np.repeat(line[:1], len(ABOUT), axis=0)
    begin = np.zeros(len(ABOUT), dtype=np.int64)
    layers = [_Places(first, ABOUT, none, none, SET_OFF * ABOUT**2, begin)]
    for layer in range(count - 1):
        layers.append(_next(layers[-1], layer, asked, heading, space))
    found, chosen = [], 0
    for places in reversed(layers):
        found.append(places.point[chosen])
        chosen = int(places.before[chosen])
    return np.array(found[::-1])


def _next(places: _Places, layer: int, asked: Asked, heading: Array, space: FreeSpace) -> _Places:
    """Return where a step leads to from each of the places."""
    step, count = asked.spacing, len(CURVES)
    curve = np.tile(asked.sharpest[layer] * CURVES, len(places.cost))
    before = np.repeat(np.arange(len(places.cost)), count)
    cost = places.cost[before] + CURVED * step * curve**2
    cost += BENT * (curve - places.curve[before]) ** 2
    off = places.off[before] + step * curve
    middle = heading[layer] + off - 0.5 * step * curve
    point = places.point[before] + step * np.column_stack((np.cos(middle), np.sin(middle)))
    # What else there is to pay is much the same for all that are in much the same place.
    chosen = _cheapest(point, off, cost)
    before, curve, off, point = before[chosen], curve[chosen], off[chosen], point[chosen]
    cost, way = cost[chosen], heading[layer] + off
    along, aside, astray = _beside(asked.line, heading, places.along[before], point, way)
    cost += step * ASIDE * np.minimum(aside, FARTHEST) ** 2
    cost += step * ASTRAY * np.minimum(astray, WORST) ** 2
    # In the middle of the step as well: a post is thinner than a step is long.
    for at in (0.5 * (places.point[before] + point), point):
        distance = space.distances(at)
        for price, needed in ((TIGHT, asked.swung), (BARRED, asked.trunk)):
            lack = (needed[layer + 1] - distance[:, :-2]).max(axis=1)
            cost += 0.5 * step * price * np.maximum(lack, 0.0)
        cost += 0.5 * step * BOWED * (distance[:, -2] < HEAD)
        cost += 0.5 * step * CLIMBED * np.maximum(distance[:, -1] - LEVEL, 0.0)
    new = _Places(point, off, curve, along, cost, before)
    return new[np.argsort(cost, kind="stable")[:KEPT]]


def _beside(
    line: Array, heading: Array, along: Array, point: Array, way: Array
) -> tuple[Array, Array, Array]:
    """Return how far along a line points are, in its steps, how far aside, and how far astray."""
    last = len(line) - 1
    for _ in range(2):
        first = np.clip(along.astype(np.int64), 0, last - 1)
        start, span = line[first], line[first + 1] - line[first]
        size = np.maximum((span**2).sum(axis=1), 1e-12)
        share = ((point - start) * span).sum(axis=1) / size
        along = np.maximum(along, np.clip(first + share, 0.0, along + 1.5))
    first = np.clip(along.astype(np.int64), 0, last - 1)
    nearest = line[first] + (along - first)[:, None] * (line[first + 1] - line[first])
    aside = np.linalg.norm(point - nearest, axis=1)
    astray = np.abs((way - heading[first] + np.pi) % (2.0 * np.pi) - np.pi)
    return along, aside, astray


def _cheapest(point: Array, off: Array, cost: Array) -> Index:
    """Return the cheapest of those that are in much the same place and heading."""
    cell = np.floor(point / PLACE).astype(np.int64)
    cell -= cell.min(axis=0)
    turn = np.floor(off / HEADING + 0.5).astype(np.int64)
    turn -= turn.min()
    key = (cell[:, 0] * (cell[:, 1].max() + 1) + cell[:, 1]) * (turn.max() + 1) + turn
    order = np.lexsort((cost, key))
    key = key[order]
    return np.asarray(order[np.flatnonzero(np.concatenate(([True], key[1:] != key[:-1])))])
