"""Tell a foot that is held still in the air from one that stands.

Ground need not be flat, so a foot that rests well over the other may stand on a stair. One that
stands there bears the body, sooner or later alone; one that is only raised never does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RAISED = 0.035  # a foot that rests so far over the ground under the other may be in the air [m]
ALONE = 0.1  # share of its frames, at least, that a foot which stands there bears the body alone
BRIEF = 0.5  # how long it may not, where the clip begins or ends [s]


def not_raised(
    spans: Sequence[tuple[int, int, int]], lowest: Mapping[int, Array], fps: float
) -> list[bool]:
    """Return of each rest of a foot whether it stands there, and is not just held in the air.

    Args:
      spans: foot, first frame, and the one after the last.
      lowest: foot to height (nframe,) of its lowest site, over what is level [m].
      fps: frames a second.
    """
    rests = {foot: np.zeros(len(height), dtype=bool) for foot, height in lowest.items()}
    for foot, start, end in spans:
        rests[foot][start:end] = True
    stood = []
    for foot, start, end in spans:
        others = [other for other in rests if other != foot and rests[other][start:end].any()]
        brief = (start == 0 or end == len(lowest[foot])) and end - start < BRIEF * fps
        if not others or brief:
            stood.append(True)
            continue
        resting = np.stack([rests[other][start:end] for other in others])
        height = np.stack([lowest[other][start:end] for other in others])
        any_rests = resting.any(axis=0)
        over = lowest[foot][start:end] - np.where(resting, height, np.inf).min(axis=0)
        raised = float(np.median(over[any_rests])) >= RAISED
        stood.append(not raised or float((~any_rests).mean()) >= ALONE)
    return stood
