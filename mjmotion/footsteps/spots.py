"""Where a foot could stand, found on a grid of heights: how well it fits at many spots at once.

    spots = Spots(ground)
    window = spots.window(low, high, height)
    fit = window.fits(foot, yaw, points)

The ground is sampled once wherever a walk may come, a tile at a time, from a little above the
height at which it comes there. What is found here is to within a cell; :mod:`.footholds` finds
the rest.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.feet import Foot
from mjmotion.scene.ground import Ground

Array = NDArray[np.float64]
Index = NDArray[np.int64]

CELL = 0.02  # distance of samples [m]
TILE = 32  # samples along each side of what is sampled at once
STOREY = 0.5  # heights from which the ground is looked for are multiples of this [m]
EDGE = 0.015  # ground that ends this near to a sole is poor [m]
FLAT = 0.012  # how far ground may be from the plane of a sole that fits well on a grid [m]
UNEVEN = 0.015  # further than that is worth one for each of these [m]
ROUGHEST = 0.06  # where ground is further from it nobody stands [m]
BESIDE = 0.09  # how far round a foot there should be room for its leg [m]
HIGH = 0.22  # what rises more than this so near is in a leg's way [m]
RISER = 0.02  # a rise that counts as one [m]
AHEAD = 0.05  # how far before the toe and behind the heel no riser should be [m]
TOES_UP = 0.03  # toes do not reach up on to what rises more [m]
EDGE_COST, OVERHANG_COST, RISER_COST, LEG_COST = 0.4, 0.15, 0.15, 2.0


@dataclasses.dataclass(frozen=True, eq=False)
class Fit:
    """How well a foot fits at spots.

    Attributes:
      height: (n,) of the plane that the sole would be in, at the posed site [m].
      cost: (n,) 0 where it fits as on a level floor, infinite where it cannot stand.
    """

    height: Array
    cost: Array


@dataclasses.dataclass(frozen=True, eq=False)
class Window:
    """Heights of the ground over a rectangle.

    Attributes:
      corner: (2,) cell of the first sample.
      heights: (nx, ny) [m]; NaN where there is nothing to stand on.
      avoided: (nx, ny) where it is not meant to be stood on.
    """

    corner: Index
    heights: Array
    avoided: NDArray[np.bool_]

    def cells(self, points: Array) -> tuple[Index, Index]:
        """Return the samples nearest to points (..., 2) [m], clipped to the window."""
        place = np.rint(points / CELL).astype(np.int64) - self.corner
        place = np.clip(place, 0, np.array(self.heights.shape) - 1)
        return place[..., 0], place[..., 1]

    def at(self, points: Array) -> Array:
        """Return heights (...) [m] at points (..., 2) [m]."""
        return np.asarray(self.heights[self.cells(points)])

    def fits(self, foot: Foot, yaw: float, points: Array) -> Fit:
        """Return how well a foot would stand with its posed site over points (n, 2) [m].

        Args:
          foot: the foot.
          yaw: how it is turned about the vertical [rad].
          points: where, no nearer to the window's border than a foot reaches.
        """
        turn = np.array(((np.cos(yaw), -np.sin(yaw)), (np.sin(yaw), np.cos(yaw))))
        sole, toes, rim, ends, leg = (
            np.unique(np.rint(part @ turn.T / CELL).astype(np.int64), axis=0)
            for part in _outlines(foot)
        )
        width = self.heights.shape[1]
        column, row = self.cells(points)
        first = column * width + row
        # All samples that are asked for lie within: no index can run over.
        flat = self.heights.ravel()

        def places(part: Index) -> Index:
            return np.asarray(first[:, None] + part[:, 0] * width + part[:, 1])

        under = flat[places(sole)]
        stands = np.asarray(~np.isnan(under).any(axis=1))
        if self.avoided.any():
            stands &= ~self.avoided.ravel()[places(sole)].any(axis=1)
        under = np.where(stands[:, None], under, 0.0)
        matrix = np.column_stack((CELL * sole, np.ones(len(sole))))
        plane = under @ np.linalg.pinv(matrix).T
        off = np.abs(under - plane @ matrix.T).max(axis=1)
        cost = np.maximum(off - FLAT, 0.0) / UNEVEN
        cost = np.where(stands & (off < ROUGHEST), cost**2, np.inf)
        good = np.flatnonzero(np.isfinite(cost))  # the others need no further look

        def over(part: Index) -> Array:
            level = plane[good, :2] @ (CELL * part.T) + plane[good, 2:]
            height = flat[places(part)[good]]
            return np.asarray(np.where(np.isnan(height), np.inf, height - level))

        ahead = over(toes)
        cost[good] += np.where((ahead > TOES_UP).any(axis=1), np.inf, 0.0)
        cost[good] += OVERHANG_COST * (ahead < -RISER - FLAT).mean(axis=1)
        cost[good] += EDGE_COST * (np.abs(over(rim)) > FLAT + RISER).any(axis=1)
        cost[good] += RISER_COST * (over(ends) > RISER + FLAT).sum(axis=1)
        high = over(leg)
        cost[good] += LEG_COST * ((high > HIGH) & np.isfinite(high)).any(axis=1)
        return Fit(plane[:, 2], cost)


class Spots:
    """The ground of a scene as samples, taken where they are asked for.

    Args:
      ground: the scene's surfaces.
    """

    def __init__(self, ground: Ground) -> None:
        self.ground = ground
        self._tiles: dict[tuple[int, int, int], tuple[Array, NDArray[np.bool_]]] = {}

    def window(self, low: Array, high: Array, height: float) -> Window:
        """Return the samples over a rectangle.

        Args:
          low: (2,) its corner nearest to the origin of x and y [m].
          high: (2,) the opposite one [m].
          height: about where the ground is there [m].
        """
        storey = round(height / STOREY)
        first = np.floor(low / (CELL * TILE)).astype(np.int64)
        last = np.floor(high / (CELL * TILE)).astype(np.int64)
        columns = range(int(first[0]), int(last[0]) + 1)
        rows = range(int(first[1]), int(last[1]) + 1)
        self._sample([(i, j, storey) for i in columns for j in rows])
        parts = [[self._tiles[i, j, storey] for j in rows] for i in columns]
        return Window(
            first * TILE,
            np.block([[tile[0] for tile in row] for row in parts]),
            np.block([[tile[1] for tile in row] for row in parts]),
        )

    def _sample(self, tiles: list[tuple[int, int, int]]) -> None:
        """Sample the tiles that have not been yet, all at once."""
        new = [tile for tile in tiles if tile not in self._tiles]
        if not new:
            return
        i, j = np.meshgrid(np.arange(TILE), np.arange(TILE), indexing="ij")
        own = np.stack((i, j), axis=-1)
        corners = np.array([tile[:2] for tile in new]) * TILE
        points = np.empty((len(new), TILE, TILE, 3))
        points[..., :2] = CELL * (corners[:, None, None] + own)
        points[..., 2] = STOREY * np.array([tile[2] for tile in new])[:, None, None]
        height, _, avoided = self.ground.firm(points)
        self._tiles.update(zip(new, zip(height, avoided, strict=True), strict=True))


def _outlines(foot: Foot) -> tuple[Array, Array, Array, Array, Array]:
    """Return points (k, 2) in a foot's frame that are looked at.

    Of its sole as far as the ball, of its toes, of the rim of the former, behind the heel and
    before the toes, and all around.
    """
    sole = foot.sole[:, :2]
    bends = foot.bends[: len(sole)]
    ahead = foot.front[:2] - foot.heel[:2]
    ahead = ahead / np.linalg.norm(ahead)
    # Along the middle too, so that no sample is left out under it.
    firm = np.concatenate((sole[~bends], np.linspace(foot.heel[:2], foot.toe[:2], 8)))
    toes = np.concatenate((sole[bends], np.linspace(foot.toe[:2], foot.front[:2], 4)[1:]))
    middle = 0.5 * (foot.toe + foot.heel)[:2]
    away = firm - middle
    far = np.linalg.norm(away, axis=1, keepdims=True)
    rim = middle + away * (1.0 + EDGE / np.maximum(far, EDGE))
    # A sample stands for half a cell to either side: what ends within that is the exact look's.
    firm = middle + away * np.maximum(1.0 - 0.5 * CELL / np.maximum(far, CELL), 0.0)
    toes = toes - 0.5 * CELL * ahead
    shares = np.array((0.5, 1.0))[:, None]
    ends = (foot.heel[:2] - shares * AHEAD * ahead, foot.front[:2] + shares * AHEAD * ahead)
    whole = sole - 0.5 * (foot.front + foot.heel)[:2]
    out = sole + BESIDE * whole / np.maximum(np.linalg.norm(whole, axis=1, keepdims=True), 0.03)
    return firm, toes, rim, np.concatenate(ends), out
