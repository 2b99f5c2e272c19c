"""The line between a walk's footprints, and places told by how far along it and beside it they are.

way = Way.between(spots)
along, beside = way.coordinates(points, near=3.0)
points = way.points(along, beside)
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SHORTEST = 0.1  # corners nearer to each other than this are one [m]
NEAR = 1.5  # how far along the line from where a place is expected it may be [m]


@dataclasses.dataclass(frozen=True, eq=False)
class Way:
    """A line of straight pieces over the plane, whose first and last go on for ever.

    Attributes:
      corners: (n, 2) at least two [m].
      start: (n,) how far along each is [m].
      heading: (n - 1,) direction of each piece, unwrapped [rad].
    """

    corners: Array
    start: Array
    heading: Array

    @classmethod
    def between(cls, spots: Array, foot: Index, facing: float) -> Way:
        """Return the line through the middles between footprints and those of the other foot.

        Args:
          spots: (n, 2) footprints in order of time [m].
          foot: (n,) which foot's each is.
          facing: direction of a walk that goes nowhere [rad].
        """
        order = np.arange(len(spots))
        others = (foot != foot[:, None]) & (order < order[:, None])
        last = np.where(others, order, -1).max(axis=1)
        beside = last >= 0
        middle = 0.5 * (spots + spots[last])[beside] if beside.any() else spots
        kept = [middle[0]]
        for point in middle[1:]:
            if np.hypot(*(point - kept[-1])) > SHORTEST:
                kept.append(point)
        if len(kept) == 1:
            kept.append(kept[0] + (np.cos(facing), np.sin(facing)))
        corners = np.array(kept)
        step = np.diff(corners, axis=0)
        start = np.concatenate(([0.0], np.cumsum(np.hypot(step[:, 0], step[:, 1]))))
        return cls(corners, start, np.unwrap(np.arctan2(step[:, 1], step[:, 0])))

    def direction(self, along: Array) -> Array:
        """Return the direction (n,) of the line, turning evenly from piece to piece [rad]."""
        middle = 0.5 * (self.start[1:] + self.start[:-1])
        return np.interp(along, middle, self.heading)

    def coordinates(self, points: Array, near: Array | float) -> tuple[Array, Array]:
        """Return how far along the line points (n, 2) are, and how far to its left (n,) [m].

        Args:
          points: where [m].
          near: about how far along [m].
        """
        step = np.column_stack((np.cos(self.heading), np.sin(self.heading)))
        away = points[:, None] - self.corners[:-1]
        along = (away * step).sum(axis=2)
        length = np.diff(self.start)
        low = np.where(np.arange(len(length)) == 0, -np.inf, 0.0)
        high = np.where(np.arange(len(length)) == len(length) - 1, np.inf, length)
        on = np.clip(along, low, high)
        place = on + self.start[:-1]
        off = ((away - on[..., None] * step) ** 2).sum(axis=2)
        off = np.where(np.abs(place - np.reshape(near, (-1, 1))) > NEAR, np.inf, off)
        piece = off.argmin(axis=1)
        row = np.arange(len(points))
        side = step[piece, 0] * away[row, piece, 1] - step[piece, 1] * away[row, piece, 0]
        return place[row, piece], side

    def points(self, along: Array, beside: Array) -> Array:
        """Return the places (n, 2) [m] so far along the line and to its left (n,) [m]."""
        piece = np.clip(np.searchsorted(self.start, along, side="right") - 1, 0, None)
        piece = np.minimum(piece, len(self.heading) - 1)
        step = np.column_stack((np.cos(self.heading), np.sin(self.heading)))[piece]
        side = np.column_stack((-step[:, 1], step[:, 0]))
        ahead = (along - self.start[piece])[:, None] * step
        return np.asarray(self.corners[piece] + ahead + np.reshape(beside, (-1, 1)) * side)
