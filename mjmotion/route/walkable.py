"""What of a scene's ground can be walked to: heights over a grid, step by step from the start.

A place is walked to where its surface is no more than a step higher or lower than that of a place
next to it, or a short step away. What is under a bridge and on it are told apart by where the walk
comes from.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from mjmotion.scene.ground import Ground

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CELL = 0.1  # of the grid [m]
STRIDE = 4  # cells over which ground is walked on to: over a gap as wide, less a sole
_AGAIN = 0.2  # what had no ground is looked at again from this much higher or lower [m]
_FEWEST = 2  # cells to either side that a gap may have to be stepped over
_ROUNDS = 2000


@dataclasses.dataclass(frozen=True, eq=False)
class Walkable:
    """Ground over a grid.

    Attributes:
      corner: (2,) where its first point is [m].
      height: (ny, nx) of the ground; of the nearest that is known, where it is not [m].
      known: (ny, nx) where there is ground that can be walked to.
      geom: (ny, nx) what it is of there, else -1.
      step: the highest step [m].
    """

    corner: Array
    height: Array
    known: Mask
    geom: NDArray[np.int32]
    step: float

    def at(self, points: Array) -> Array:
        """Return heights (...) under points (..., 2) [m], of the nearest place of the grid."""
        return np.asarray(self.height[self.cells(points)])

    def cells(self, points: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return rows and columns (...) of the places of the grid nearest to points (..., 2)."""
        place = np.rint((points - self.corner) / CELL).astype(np.int64)
        row = np.clip(place[..., 1], 0, self.height.shape[0] - 1)
        column = np.clip(place[..., 0], 0, self.height.shape[1] - 1)
        return row, column

    def steppable(self) -> Mask:
        """Return (ny, nx) where a walk can pass: on ground, or over gaps of less than a step.

        Not where ground that can be walked to ends at more of the same, higher than a step.
        """
        from scipy.ndimage import binary_closing, maximum_filter, minimum_filter

        wide = np.pad(self.known, _FEWEST, mode="edge")
        size = 2 * _FEWEST + 1
        closed = binary_closing(wide, np.ones((size, size), dtype=bool))
        inner = slice(_FEWEST, -_FEWEST)
        rise = maximum_filter(self.height, 3) - minimum_filter(self.height, 3)
        return np.asarray((self.known | closed[inner, inner]) & (rise <= self.step))


def find_walkable(ground: Ground, start: Array, box: tuple[Array, Array], step: float) -> Walkable:
    """Return the ground within a box that can be walked to.

    Args:
      ground: of the scene.
      start: (n, 3) places where the walk is for certain [m], such as its first.
      box: (2,) and (2,) corners [m].
      step: the highest step [m].
    """
    from scipy.ndimage import distance_transform_edt

    shape = np.ceil((box[1] - box[0]) / CELL).astype(np.int64)[::-1] + 1
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    places = box[0] + CELL * np.stack((columns, rows), axis=-1)
    height = np.full(shape, np.nan)
    asked = np.full(shape, np.inf)
    geom = np.full(shape, -1, dtype=np.int32)
    seeds = np.clip(np.rint((start[:, :2] - box[0]) / CELL).astype(np.int64), 0, shape[::-1] - 1)
    height[seeds[:, 1], seeds[:, 0]] = start[:, 2]
    for _ in range(_ROUNDS):
        known = np.isfinite(height)
        far, nearest = distance_transform_edt(~known, return_indices=True)
        come_from = height[nearest[0], nearest[1]]
        ask = ~known & (far <= STRIDE) & (np.abs(come_from - asked) > _AGAIN)
        if not ask.any():
            break
        found, _, of = ground.standing(np.column_stack((places[ask], come_from[ask])))
        asked[ask] = come_from[ask]
        good = np.abs(found - come_from[ask]) <= step
        height[ask] = np.where(good, found, np.nan)
        geom[ask] = np.where(good, of, np.int32(-1))
    return Walkable(box[0], height[nearest[0], nearest[1]], known, geom, step)
