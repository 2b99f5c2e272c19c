"""The steps of a walk, chosen together: where each foot is put down so that all can be walked.

    chain = find_chain(stances, feet, ground, start_height)
    chain.spots, chain.turns

Each step is sought from where the one before it stands, by the source's own step. Of all the ways
to put the feet down one after the other, that of least cost is taken (dynamic programming over the
best few hundred places of every stance), so a step is never good by itself only. Where the
ground is level and good the source's own spots cost nothing, and are kept to the bit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.feet import Foot
from mjmotion.exceptions import SceneError, frame_list
from mjmotion.footsteps.footholds import Foothold, each_foothold
from mjmotion.footsteps.spots import CELL, Spots
from mjmotion.footsteps.stances import Stance
from mjmotion.footsteps.step_costs import Placed, Step, best_steps
from mjmotion.footsteps.way import Way
from mjmotion.scene.ground import Ground

Array = NDArray[np.float64]
Index = NDArray[np.int64]

BLOCK = 2  # of so many cells along either side the best one is a candidate
KEPT = 160  # places of a stance from which the next step is sought
CARRIED = 40  # of these, from which the source's own step is tried as it is
BACK, ON, ASIDE = 0.55, 0.30, 0.30  # how much shorter, longer or wider a step may be [m]
FIRST = 0.35  # how far from its own spot the first foot may stand [m]
FIRST_OFF = 0.20  # a first foot is worth one that is so far from its own spot [m]
LOOK = 0.10  # how far beyond its spots ground is looked at for a foot [m]
TOLERATED = 6.0  # a chain none of whose steps costs more is left as it is: nobody would mind


@dataclasses.dataclass(frozen=True, eq=False)
class Chain:
    """Where the feet are to be put down, one spot a stance.

    Attributes:
      spots: (n, 2) of the posed site [m].
      heights: (n,) of the ground there, about [m].
      turns: (n,) about the vertical, against the stance's own [rad].
      costs: (n,) of each step and of how well its foot fits.
    """

    spots: Array
    heights: Array
    turns: Array
    costs: Array


@dataclasses.dataclass(frozen=True, eq=False)
class _Row:
    """The kept places of one stance: what leads there in all, and from which of those before."""

    placed: Placed
    total: Array
    own: Array
    back: Index


class _Walk:
    """What is known of the source's steps."""

    def __init__(self, stances: Sequence[Stance], feet: Sequence[Foot]) -> None:
        self.stances, self.feet = stances, feet
        self.spots = np.array([stance.source_pos[:2] for stance in stances])
        quat = np.array([stance.source_quat for stance in stances])
        self.yaw = 2.0 * np.arctan2(quat[:, 3], quat[:, 0])
        foot = np.array([stance.foot for stance in stances])
        self.way = Way.between(self.spots, foot, float(self.yaw[0]))
        coordinates = [self.way.coordinates(self.spots[:1], 0.0)]
        for spot in self.spots[1:]:
            near = coordinates[-1][0] + 0.5
            coordinates.append(self.way.coordinates(spot[None], near))
        self.along, self.beside = np.array(coordinates)[..., 0].T

    def step(self, index: int) -> Step:
        """Return the step to stance number ``index``."""
        same = self.stances[index].foot == self.stances[index - 1].foot
        side = self.feet[self.stances[index].foot].side
        return Step(
            float(self.along[index] - self.along[index - 1]),
            float(self.beside[index] - self.beside[index - 1]),
            float(self.beside[index]),
            0 if same else 1 if side == "left" else -1,
            self.stances[index].start == self.stances[0].start,
        )

    def turned(self, index: int, along: Array) -> Array:
        """Return how far a foot turns (n,) that is put down so far along the way [rad]."""
        own = self.way.direction(self.along[index : index + 1])
        return np.asarray(self.way.direction(along) - own)

    def placed(self, points: Array, near: float, height: Array) -> Placed:
        """Return feet put down at points (n, 2) [m], about so far along."""
        return Placed(points, *self.way.coordinates(points, near), height)


def find_chain(
    stances: Sequence[Stance], feet: Sequence[Foot], ground: Ground, start_height: float
) -> Chain:
    """Choose the steps of a walk together.

    Args:
      stances: in order of time, at their own spots.
      feet: the feet they are of.
      ground: the scene's surfaces.
      start_height: height of the ground where the walk begins [m].

    Raises:
      SceneError: there is nothing to stand on within reach of a step.
    """
    walk, spots = _Walk(stances, feet), Spots(ground)
    rows = [_first(walk, spots, start_height)]
    for index in range(1, len(stances)):
        rows.append(_next(walk, spots, index, rows[-1]))
    chosen = [int(rows[-1].total.argmin())]
    for row in rows[:0:-1]:
        chosen.append(int(row.back[chosen[-1]]))
    pairs = list(zip(rows, chosen[::-1], strict=True))
    along = np.array([row.placed.along[i] for row, i in pairs])
    turns = [walk.turned(k, along[k : k + 1])[0] for k in range(len(pairs))]
    return Chain(
        np.array([row.placed.point[i] for row, i in pairs]),
        np.array([row.placed.height[i] for row, i in pairs]),
        np.array(turns),
        np.array([row.own[i] for row, i in pairs]),
    )


def walkable_footholds(
    stances: Sequence[Stance], feet: Sequence[Foot], ground: Ground, start_height: float
) -> tuple[Foothold, ...] | None:
    """Return footholds near the stances' own spots if all of their steps can be walked, else None.

    Raises:
      SceneError: there is nothing to stand on within reach of a stance.
    """
    if len(stances) == 0:
        return ()  # one who kneels, crawls or sits takes no steps
    walk, spots = _Walk(stances, feet), Spots(ground)
    footholds: list[Foothold] = []
    for index, foothold in enumerate(each_foothold(stances, feet, ground, start_height)):
        footholds.append(foothold)
        # One step that cannot be walked is enough: the rest need not be found.
        if index and _cost(walk, spots, index, footholds) > TOLERATED:
            return None
    return tuple(footholds)


def _cost(walk: _Walk, spots: Spots, index: int, footholds: Sequence[Foothold]) -> float:
    """Return what the step to foothold number ``index`` costs."""
    two = np.array([foothold.position for foothold in footholds[index - 1 : index + 1]])
    window = spots.window(
        two[:, :2].min(axis=0) - LOOK, two[:, :2].max(axis=0) + LOOK, float(two[0, 2])
    )
    before, after = (walk.placed(point[None, :2], walk.along[index], point[2:]) for point in two)
    none = np.zeros(1)
    cost, _ = best_steps(walk.step(index), before, none, after, none, window, 1)
    avoided = float(spots.ground.firm(two[1:])[2][0])
    return float(cost[0]) + avoided * 2.0 * TOLERATED


def _first(walk: _Walk, spots: Spots, height: float) -> _Row:
    """Return the places of the first stance."""
    own = walk.spots[:1]
    points, carried = _lattice(own[0] - FIRST, own[0] + FIRST), own
    cost = np.linalg.norm(points - own, axis=1) / FIRST_OFF
    points, cost = np.concatenate((carried, points)), np.concatenate(([0.0], cost**2))
    reach = FIRST + LOOK + _size(walk.feet)
    window = spots.window(own[0] - reach, own[0] + reach, height)
    fit = window.fits(walk.feet[walk.stances[0].foot], float(walk.yaw[0]), points)
    cost = cost + fit.cost
    kept = _best(points, cost, 1)
    if len(kept) == 0:
        raise _nothing(walk, 0, own[0])
    placed = walk.placed(points[kept], float(walk.along[0]), fit.height[kept])
    return _Row(placed, cost[kept], cost[kept], np.zeros(len(kept), dtype=np.int64))


def _next(walk: _Walk, spots: Spots, index: int, last: _Row) -> _Row:
    """Return the places of a stance, each with the best way to it from the stance before."""
    step, foot = walk.step(index), walk.feet[walk.stances[index].foot]
    best = np.argsort(last.total, kind="stable")[:CARRIED]
    origin = last.placed[best]
    # The source's own step from where the foot before stands: exactly its own where that does.
    along, beside = origin.along + step.along, origin.beside + step.beside
    own = walk.way.points(walk.along[index : index + 1], walk.beside[index : index + 1])
    carried = walk.spots[index] + (walk.way.points(along, beside) - own)
    ahead = np.array((-BACK, ON)) * (1.0 if step.along >= 0.0 else -1.0)
    corners = np.concatenate([walk.way.points(along + one, beside) for one in ahead])
    points = np.concatenate(
        (carried, _lattice(corners.min(axis=0) - ASIDE, corners.max(axis=0) + ASIDE))
    )
    middle = float(np.median(along))
    near = np.concatenate((points, last.placed.point))
    reach = LOOK + _size(walk.feet)
    height = float(np.median(origin.height))
    window = spots.window(near.min(axis=0) - reach, near.max(axis=0) + reach, height)
    yaw = float(walk.yaw[index] + walk.turned(index, np.array([middle]))[0])
    fit = window.fits(foot, yaw, points)
    few = _best(points, fit.cost, len(carried))
    if len(few) == 0:
        raise _nothing(walk, index, carried[0])
    placed = walk.placed(points[few], middle, fit.height[few])
    ways, back = best_steps(step, last.placed, last.total, placed, fit.cost[few], window, KEPT)
    own_cost = ways + fit.cost[few]
    whole = own_cost + last.total[back]
    kept = np.argsort(whole, kind="stable")[:KEPT]
    kept = kept[np.isfinite(whole[kept])]
    if len(kept) == 0:
        raise _nothing(walk, index, carried[0])
    return _Row(placed[kept], whole[kept], own_cost[kept], back[kept])


def _lattice(low: Array, high: Array) -> Array:
    """Return the samples (n, 2) within a rectangle [m], in whole blocks."""
    first, last = (np.floor(corner / (CELL * BLOCK)).astype(np.int64) for corner in (low, high))
    x, y = (np.arange(first[i], last[i] + 1) for i in range(2))
    block = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 1, 2)
    cell = np.stack(np.meshgrid(*(np.arange(BLOCK),) * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    return np.asarray((block * BLOCK + cell).reshape(-1, 2) * CELL)


def _best(points: Array, cost: Array, count: int) -> Index:
    """Return which points to keep: the first ``count``, and of every block its best; none bad."""
    blocks = cost[count:].reshape(-1, BLOCK * BLOCK)
    best = count + np.arange(len(blocks)) * BLOCK * BLOCK + blocks.argmin(axis=1)
    some = np.concatenate((np.arange(count), best))
    return np.asarray(some[np.isfinite(cost[some])])


def _size(feet: Sequence[Foot]) -> float:
    """How far the soles reach from their posed sites [m]."""
    return max(float(np.linalg.norm(foot.sole[:, :2], axis=1).max()) for foot in feet)


def _nothing(walk: _Walk, index: int, spot: Array) -> SceneError:
    stance = walk.stances[index]
    frames = range(stance.start, stance.end)
    return SceneError(
        f"no ground under the walk: nothing to stand on within a step of x={spot[0]:.2f},"
        f" y={spot[1]:.2f} at frames {frame_list(frames)}:"
        " move the scene's site 'start' or choose a larger scene",
        frames,
    )
