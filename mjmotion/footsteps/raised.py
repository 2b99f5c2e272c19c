"""Tell a foot that is held still in the air from one that stands.

Ground need not be flat, so a foot that rests well over the other may stand on a stair. One that
stands there bears the body, sooner or later alone; one that is only raised never does.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RAISED = 0.035  # a foot that rests so far over the ground under the other may be in the air [m]
ALONE = 0.1  # share of its frames, at least, that a foot which stands there bears the body alone
BRIEF = 0.5  # how long it may not, where the clip begins or ends [s]


def bears(
    run: tuple[int, int],
    height: Array,
    ground: Array,
    others: Sequence[NDArray[np.bool_]],
    fps: float,
) -> bool:
    """Return whether a foot that rests over frames of a clip stands, and is not just raised.

    Args:
      run: first frame and the one after the last.
      height: (nframe,) of the lowest site of the foot, over what is level [m].
      ground: (nframe,) under the other feet that stand, as far as known; NaN elsewhere [m].
      others: (nframe,) each, when every other foot rests.
      fps: frames a second.
    """
    start, end = run
    under = ground[start:end]
    known = ~np.isnan(under)
    if not others or not known.any():
        return True
    if float(np.median((height[start:end] - under)[known])) < RAISED:
        return True
    if (start == 0 or end == len(height)) and end - start < BRIEF * fps:
        return True
    rest = np.logical_or.reduce(others)[start:end]
    return bool((~rest).mean() >= ALONE)
