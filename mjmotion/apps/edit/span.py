"""The frames that an edit covers: three knots of the first level to either side of what it asks."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from mjmotion.numerics.bspline import fit_between

Array = NDArray[np.float64]

KNOTS = 3  # on either side of the edited frame: seven with its own
PASSES = 2  # times that Eq. 2 is applied at a level's knots


@dataclasses.dataclass(frozen=True)
class Span:
    """The frames that an edit covers.

    A cubic B-spline through one data point that stands on a knot has three control points, whose
    supports together reach from the third knot before it to the third after: seven knots. The
    edited frame is therefore a knot of every level. Of the later levels, which have data at other
    frames too, only control points take part whose support lies within.

    Attributes:
      frame: the edited frame, or the first of several.
      frames_per_knot: frames between the knots of the first level.
      nframe: frames of the clip.
      length: how many frames are edited.
    """

    frame: int
    frames_per_knot: int
    nframe: int
    length: int = 1

    @property
    def last(self) -> int:
        """The last edited frame."""
        return self.frame + self.length - 1

    @property
    def knots(self) -> NDArray[np.int64]:
        """The knots of the first level, as frames; some may lie outside the clip.

        Seven for one frame: it and three to either side.
        """
        between = -(-(self.length - 1) // self.frames_per_knot)
        return self.frame + self.frames_per_knot * np.arange(-KNOTS, between + KNOTS + 1)

    @property
    def frames(self) -> NDArray[np.int64]:
        """The frames that change: between the outermost knots, within the clip."""
        low, high = int(self.knots[0]), int(self.knots[-1])
        return np.arange(max(0, low + 1), min(self.nframe, high))

    @property
    def fade(self) -> Array:
        """A weight (nframe,): 1 in the middle, 0 from the outermost knots on, smooth between."""
        frames = np.arange(self.nframe)
        away = np.maximum(np.maximum(self.frame - frames, frames - self.last), 0)
        away = away / self.frames_per_knot
        rest = np.clip(KNOTS - away, 0.0, 1.0)
        return np.asarray(rest * rest * (3.0 - 2.0 * rest))

    def spread(self, frames: NDArray[np.int64], data: Array, frames_per_knot: float) -> Array:
        """Return one level (len(self.frames), k) through ``data`` (n, k) at ``frames`` (n,)."""
        first, last = int(self.knots[0]), int(self.knots[-1])
        values = fit_between(frames, data, first, last, frames_per_knot, passes=PASSES)
        return values[self.frames - first]
