"""What a recording adds to the turns of a foot that no foot can do: noise, and frames that flutter.

Markers on shoes are few and close together, so ankles and toes are the noisiest joints of a
recording. What is quicker than a foot can be is taken out, without any delay. It is taken out of
how a foot is turned in the world, not against its shank: in the world it stands still, and the
noise of knee and hip would else go on into it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mjmotion.numerics import rotations as rot
from mjmotion.numerics.smoothing import follow

Array = NDArray[np.float64]

CUTOFF = 15.0  # [Hz] a foot that slaps down on the ground has next to nothing that is quicker
LOWEST_RATE = 60.0  # [Hz] of frames: below, noise looks like what a foot does, and is left
NOISE = np.radians(1.0)  # [rad] what is off by as much is noise of a usual recording
OUTLIER = 4.0  # times the noise around it: a frame that is further off hardly counts
MEDIAN_TIME = 0.1  # [s] over which the first guess is the median: a flutter is shorter than half
AROUND_TIME = 0.5  # [s] over which the noise is told
_ROUNDS = 6


def steady_turns(turn: Array, fps: float) -> Array:
    """Return the turns of a foot without what is quicker than a foot can turn.

    Of the quaternions q, continuous over the frames, the curve c minimises
    ``τ⁶ |Δ³c|² + Σ w |c − q|²``: it has half of what q has at :data:`CUTOFF`, and next to nothing
    above. Frames far off the others around them lose their weight ``w = 1 / (1 + (a / s)⁴)``, where
    a is the angle between c and q, and s :data:`OUTLIER` times what is usual around, or times
    :data:`NOISE`, the greater.

    Args:
      turn: (nframe, 4) wxyz.
      fps: frames a second; below :data:`LOWEST_RATE` turns are returned as they are.

    Returns:
      (nframe, 4) wxyz.
    """
    from scipy.ndimage import median_filter

    if len(turn) < 5 or fps < LOWEST_RATE:
        return np.array(turn)
    turn = rot.continuous(turn)
    time = 1.0 / (2.0 * np.sin(np.pi * CUTOFF / fps))
    curve = median_filter(turn, (_odd(MEDIAN_TIME * fps), 1), mode="nearest")
    width = _odd(AROUND_TIME * fps)
    for _ in range(_ROUNDS):
        angle = 2.0 * np.linalg.norm(curve - turn, axis=1)  # of small ones
        usual = 1.5 * median_filter(angle, width, mode="nearest")
        weight = 1.0 / (1.0 + (angle / (OUTLIER * np.maximum(usual, NOISE))) ** 4)
        curve = follow(turn, weight, time)
    return rot.normalized(curve)


def _odd(frames: float) -> int:
    """Return the odd number next to a width, 1 at least."""
    return 2 * round(0.5 * (frames - 1.0)) + 1 if frames > 1.0 else 1
