"""Where along the rope hands and feet take hold, and how far a climb's holds are from it.

A hold takes the rope where it is: hanging below the hold above, and drawn straight between two.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.clips.climb_plan import Hold
from mjmotion.exceptions import ConstraintError

Array = NDArray[np.float64]

_SAME = 1e-6  # two holds this near are at the same place of the rope [m]


def places_along(holds: Sequence[Hold], anchor: Array, length: float) -> Array:
    """Return how far along the rope (nhold,) every hold takes it [m].

    Args:
      holds: who holds what when, in any order.
      anchor: (3,) where the rope hangs from [m].
      length: of the rope [m].

    Raises:
      ConstraintError: a hold is above the beam or below the rope's end: the rope is out of reach.
    """
    along = np.full(len(holds), np.nan)
    for index in sorted(range(len(holds)), key=lambda i: (holds[i].start, -holds[i].point[2])):
        hold = holds[index]
        above, below = (0.0, np.asarray(anchor)), None
        for other, place in zip(holds, along, strict=True):
            if np.isnan(place) or not other.start <= hold.start < other.end:
                continue
            if other.point[2] >= hold.point[2] - _SAME:
                above = max(above, (float(place), other.point), key=lambda one: one[0])
            elif below is None or place < below[0]:
                below = (float(place), other.point)
        down = float(np.linalg.norm(hold.point - above[1]))
        if below is None:
            along[index] = above[0] + down
        else:
            share = down / (down + float(np.linalg.norm(hold.point - below[1])))
            along[index] = above[0] + share * (below[0] - above[0])
        if hold.point[2] > anchor[2] or along[index] > length:
            where = "above its beam" if hold.point[2] > anchor[2] else "below its end"
            raise ConstraintError(
                f"the rope is out of reach: {hold.site} holds it at {hold.point[2]:.2f} m from"
                f" frame {hold.start}, {where}: hang it from {anchor[2]:.2f} m elsewhere",
                [hold.start],
            )
    return along
