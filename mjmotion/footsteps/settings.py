"""What may be planned anew where a scene asks for it, and what has to stay as recorded.

settings = PlanSettings(path="keep", strict=True)
plan = make_plan(clip, scene, settings=settings)
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from mjmotion.exceptions import FitError, unknown_name

PATHS = ("bend", "keep")
"""The walk goes round what is in its way, or keeps its own."""

PACES = ("steps", "keep")
"""Steps take the time that their height and length ask for, or that of the clip."""


@dataclasses.dataclass(frozen=True, eq=False)
class PlanSettings:
    """What of a walk may change, and what it may use.

    Attributes:
      path: ``"bend"``: round what is in the way, and back; ``"keep"``: the clip's own; or (n, 2)
        points of the way that it is to take [m]. Sites ``way_1, way_2, …`` of the scene give that
        for ``"bend"``.
      pace: ``"steps"``: a step takes longer that climbs, and less that is short; ``"keep"``: each
        as long as in the clip.
      avoid: names of geoms that are not stood on, however low.
      climb: whether it steps on or over what is higher than a step and has a top; else it goes
        round that.
      footholds: (n, 3) x and y [m] and yaw [rad] of every stance in order of time, in place of
        those that are found.
      strict: whether a way that is barred is an error; else the nearest way is taken and told.
    """

    path: str | NDArray[np.float64] = "bend"
    pace: str = "steps"
    avoid: tuple[str, ...] = ()
    climb: bool = False
    footholds: NDArray[np.float64] | None = None
    strict: bool = False

    def __post_init__(self) -> None:
        """Check them.

        Raises:
          FitError: an unknown path or pace.
        """
        if self.pace not in PACES:
            raise FitError(unknown_name("pace", self.pace, PACES))
        if isinstance(self.path, str) and self.path not in PATHS:
            raise FitError(unknown_name("path", self.path, PATHS))
