"""What a step costs against the source's own: longer, wider, higher, over a tread, across a leg.

A cost of one is what a walker would hardly notice, ten what nobody does who has another way.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from mjmotion.footsteps.spots import CELL, Window

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SHORTER, LONGER = 0.30, 0.10  # a step is worth one that is this much shorter, or longer [m]
STRIDE_MORE = 0.25  # a step longer than the source's by this share of it is a stretch
STRIDES = 0.3  # a step of the source that is longer goes somewhere [m]
STRIDE_LESS = 0.75  # and is not shortened by more than this share of it
STRETCH = 0.015  # worth one for each of these more [m]
WIDER = 0.10  # the same beside [m]
OFF_WAY = 0.35  # a foot is worth one that is so far beside its own line [m]
TAKEN = 3.0  # times that a step should rather be its own that is no step: both feet stand
EASY_RISE = 0.22  # what a step may rise or fall at no cost [m]
HIGHER = 0.04  # a step is worth one that rises or falls this much more [m]
FEET_APART = 0.11  # how far beside the other's a foot keeps, or as far as the source's [m]
CROSSING = 0.035  # nearer than that by this is worth one [m]
LEVELS = 0.05  # what lies this much between two heights is a level of its own [m]
LEVEL = 0.012  # ground is level that rises no more from sample to sample [m]
SAMPLES = 12  # of the ground along a step
TREAD = 0.08  # a level this long that is stepped over is a tread left out [m]
SKIPPED = 5.0
EASY_HURDLE, HURDLE = 0.06, 0.08  # what may be stepped over, and what more is worth one [m]
LOOKED_AT = 6  # best steps to a place between which what lies on their way decides
WALL = 25.0  # cost of a step through where there is no ground to be seen


@dataclasses.dataclass(frozen=True, eq=False)
class Placed:
    """Feet put down somewhere.

    Attributes:
      point: (n, 2) of the posed site [m].
      along, beside: (n,) the same along the way and to its left [m].
      height: (n,) of the ground there [m].
    """

    point: Array
    along: Array
    beside: Array
    height: Array

    def __getitem__(self, index: Index | NDArray[np.bool_]) -> Placed:
        return Placed(self.point[index], self.along[index], self.beside[index], self.height[index])


@dataclasses.dataclass(frozen=True)
class Step:
    """The source's own step.

    Attributes:
      along, beside: of the foot that steps from the other, along the way and to its left [m].
      off: how far to the way's left it ends [m].
      side: 1 where the foot that steps is the left, -1 the right, 0 if the same foot steps again.
      taken: whether both feet stand already when the clip begins.
    """

    along: float
    beside: float
    off: float
    side: int
    taken: bool


def best_steps(
    step: Step, before: Placed, total: Array, after: Placed, own: Array, window: Window, count: int
) -> tuple[Array, Index]:
    """Return what the best step to each of some places costs (n,), and which it is from (n,).

    Args:
      step: the source's own.
      before: m places to step from.
      total: (m,) what it costs to stand there.
      after: n places to step to.
      own: (n,) what those cost by themselves.
      window: the ground between them.
      count: how many of the best places are asked for; steps to what is certainly none of these
        cost infinity.
    """
    whole = _bare_costs(step, before, after)
    bare = whole.copy()
    whole += total
    # What lies on the way is looked at for the likeliest only: it makes no step cheaper.
    least = whole.min(axis=1) + own
    cost, source = np.full(len(own), np.inf), np.zeros(len(own), dtype=np.int64)

    def look(rows: Index) -> None:
        some = min(LOOKED_AT, len(total))
        few = np.argpartition(whole[rows], some - 1, axis=1)[:, :some]
        ways = bare[rows[:, None], few] + _on_the_way(before[few], after[rows], window)
        best = (ways + total[few]).argmin(axis=1)
        each = np.arange(len(rows))
        cost[rows], source[rows] = ways[each, best], few[each, best]

    likely = np.argpartition(least, count - 1)[:count] if count < len(own) else np.arange(len(own))
    look(likely)
    most = (cost[likely] + total[source[likely]] + own[likely]).max()
    # With a little room, as sums in another order round differently.
    left = np.flatnonzero(np.isinf(cost) & (least <= most * (1.0 + 1e-9) + 1e-9))
    if len(left):
        look(left)
    return cost, source


def _bare_costs(step: Step, before: Placed, after: Placed) -> Array:
    """Return what steps from some places (m) to others (n) cost by themselves (n, m)."""
    along = after.along[:, None] - before.along
    beside = after.beside[:, None] - before.beside
    more = (along - step.along) * (1.0 if step.along >= 0.0 else -1.0)
    firm = TAKEN if step.taken else 1.0
    cost = (firm * more / np.where(more > 0.0, LONGER, SHORTER)) ** 2
    if abs(step.along) > STRIDES:
        cost = np.where(more < -STRIDE_LESS * abs(step.along), np.inf, cost)
    most = STRIDE_MORE * abs(step.along) + CELL
    cost += (np.maximum(more - most, 0.0) / STRETCH) ** 2
    cost += (firm * (beside - step.beside) / WIDER) ** 2
    cost += ((after.beside[:, None] - step.off) / OFF_WAY) ** 2
    rise = after.height[:, None] - before.height
    cost += (np.maximum(np.abs(rise) - EASY_RISE, 0.0) / HIGHER) ** 2
    if step.side:
        least = min(step.side * step.beside, FEET_APART)
        cost += (np.maximum(least - step.side * beside, 0.0) / CROSSING) ** 2
    return np.asarray(cost)


def _on_the_way(before: Placed, after: Placed, window: Window) -> Array:
    """Return what lies between costs (n, m): treads left out, and what has to be stepped over.

    Args:
      before: (n, m) places to step from.
      after: (n,) to step to.
      window: the ground between them.
    """
    share = np.arange(1, SAMPLES) / SAMPLES
    way = after.point[:, None] - before.point
    ground = window.at(before.point[..., None, :] + share[:, None] * way[..., None, :])
    low = np.minimum(after.height[:, None], before.height)[..., None]
    high = np.maximum(after.height[:, None], before.height)[..., None]
    between = (ground > low + LEVELS) & (ground < high - LEVELS)
    level = np.abs(np.diff(ground, axis=2)) < LEVEL
    treads = (between[..., 1:] & between[..., :-1] & level).sum(axis=2)
    length = treads * np.linalg.norm(way, axis=2) / SAMPLES
    cost = SKIPPED * np.minimum(length / TREAD, 2.0) * (length > 0.5 * TREAD)
    missing = np.isnan(ground).any(axis=2)
    over = np.where(np.isnan(ground), -np.inf, ground).max(axis=2) - high[..., 0]
    cost = cost + (np.maximum(over - EASY_HURDLE, 0.0) / HURDLE) ** 2
    return np.asarray(cost + WALL * missing)
