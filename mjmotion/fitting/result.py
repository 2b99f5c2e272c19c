"""What a fit gives back."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.motion import Motion
from mjmotion.constraints import Targets
from mjmotion.constraints.unmet import Unmet
from mjmotion.fitting.trace import Trace

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Fit:
    """A fitted motion, what the fit did, and what it could not meet.

    Attributes:
      motion: the fitted motion.
      trace: what every level did.
      unmet: constraints that are off by more than 1 mm or 0.5 degrees.
      moves: (nshared, 4) what each shared move came to: along its directions [m], and its turn
        [rad]; in the order in which they were given, those of ``free`` constraints last.
      targets: what the fit held in the end, with shared moves made.
    """

    motion: Motion
    trace: Trace
    unmet: tuple[Unmet, ...]
    moves: Array
    targets: Targets

    def __repr__(self) -> str:
        met = "all met" if not self.unmet else f"{len(self.unmet)} constraints not met"
        return f"<Fit: {self.motion.nframe} frames in {self.trace.fit_seconds:.3f} s, {met}>"
