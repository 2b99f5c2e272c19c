"""How far a hip must sink for its leg to reach."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def drop_to_reach(hip: Array, ankle: Array, reach: ArrayLike, least: ArrayLike = 0.0) -> Array:
    """Return how far hips must come down for ankles to be within reach; negative is room to rise.

    Straight down, the distance ``|hip − ankle|`` is ``reach`` where the vertical part is
    ``√(reach² − flat²)``, with ``flat`` the horizontal part.

    Args:
      hip: (..., 3) [m].
      ankle: (..., 3) where ankles are to be [m].
      reach: (...) the most that hip and ankle may be apart [m].
      least: (...) height that a hip keeps over its ankle where the reach is all horizontal [m].

    Returns:
      (...) [m].
    """
    apart = hip - ankle
    flat = np.einsum("...i,...i->...", apart[..., :2], apart[..., :2])
    square = np.square(reach) - flat
    return np.asarray(apart[..., 2] - np.sqrt(np.maximum(square, np.square(least))))
