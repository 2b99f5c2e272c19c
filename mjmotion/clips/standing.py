"""When a recorded point of a foot stands: it is slow, or, in a noisy recording, it stays in place.

Noise shakes a point that stands, and its speed tells nothing. What is left of its speed after as
much smoothing as the noise asks finds the middle of a stay, and where it is then tells how long.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mjmotion.numerics.smoothing import follow

Array = NDArray[np.float64]

ABOVE = 10.0  # [Hz] what a point does faster is taken for noise
QUIET = 0.0015  # [m] about an axis; points of a usual recording have less noise
SHAKES = 0.05  # [m/s] of a point's speed that may be noise
_SLOWEST = 2.5  # [Hz] that speeds are smoothed to at most
_PLACE = 5.0  # [Hz] that places are smoothed to
_STAYS = 0.02  # [m] a point within this of its place is there still
_SIGMAS = 3.0  # times what noise is left in a place, added to that
_GAP = 0.15  # [s] stays on one place that are less apart are one
_FEWEST = 12  # frames that tell noise


def point_noise(points: Array, fps: float) -> float:
    """Return the RMS noise about an axis [m] of points (nframe, 3), as if it were white."""
    if len(points) < _FEWEST or fps < 2.5 * ABOVE:
        return 0.0
    fast = points - follow(points, np.ones(len(points)), _time(ABOVE, fps))
    share = max(1.0 - 2.0 * ABOVE / fps, 0.1)
    # The middle of it: a foot that strikes the ground is quick for a moment, and that is no noise.
    return float(1.4826 * np.median(np.abs(fast)) / np.sqrt(share))


def steady_speed(points: Array, fps: float, noise: float) -> Array:
    """Return speeds (nframe,) [m/s], smoothed so that noise [m] leaves :data:`SHAKES` of them."""
    if len(points) < 2:
        return np.zeros(len(points))
    if noise > QUIET:
        # White noise n smoothed at f: its speed is 2πf n √(2f / fps) / √3.
        least = np.sqrt(3.0 * fps / 2.0) * SHAKES / (2.0 * np.pi * noise)
        cutoff = max(least ** (2.0 / 3.0), _SLOWEST)
        points = follow(points, np.ones(len(points)), _time(cutoff, fps))
    return np.asarray(np.linalg.norm(np.gradient(points, axis=0), axis=1) * fps)


def stays(
    points: Array, fps: float, noise: float, still: float, moving: float
) -> list[tuple[int, int]]:
    """Return frames ``(start, end)`` of every stay of a point, in order.

    Args:
      points: (nframe, 3) [m].
      fps: frames a second.
      noise: of the points, by :func:`point_noise` [m].
      still: a point that stands is slower than this at some time [m/s].
      moving: one that stood and is faster has gone [m/s].
    """
    speed = steady_speed(points, fps, noise)
    if noise <= QUIET:
        edges = np.flatnonzero(np.diff(np.r_[True, speed >= moving, True].astype(int)))
        return [(int(a), int(b)) for a, b in edges.reshape(-1, 2) if (speed[a:b] < still).any()]
    place = follow(points, np.ones(len(points)), _time(_PLACE, fps))
    left = noise * np.sqrt(min(2.0 * _PLACE / fps, 1.0))
    reach = _STAYS + _SIGMAS * left
    edges = np.flatnonzero(np.diff(np.r_[True, speed >= still, True].astype(int)))
    found: list[tuple[int, int]] = []
    for first, last in edges.reshape(-1, 2):  # each begins where the one before it ended
        if found and first < found[-1][1]:
            continue
        away = np.linalg.norm(place - np.median(place[first:last], axis=0), axis=1) > reach
        before, after = np.flatnonzero(away[:first]), np.flatnonzero(away[last:])
        start = int(before[-1]) + 1 if len(before) else 0
        end = int(last + after[0]) if len(after) else len(points)
        start = max(start, found[-1][1]) if found else start
        if found and start - found[-1][1] < _GAP * fps:
            both = [np.median(place[a:b], axis=0) for a, b in (found[-1], (start, end))]
            if np.linalg.norm(both[0] - both[1]) < reach:
                start = found.pop()[0]
        found.append((start, end))
    return found


def at_rest(points: Array, fps: float, noise: float, still: float) -> NDArray[np.bool_]:
    """Return when a point rests (nframe,): slower than ``still`` [m/s], or staying in its place.

    Arguments as of :func:`stays`.
    """
    if noise <= QUIET:
        return steady_speed(points, fps, noise) < still
    rests = np.zeros(len(points), dtype=bool)
    for start, end in stays(points, fps, noise, still, still):
        rests[start:end] = True
    return rests


def _time(cutoff: float, fps: float) -> float:
    """Return the τ [frames] with which :func:`follow` leaves half of a cutoff [Hz]."""
    return float(1.0 / (2.0 * np.sin(np.pi * min(cutoff / fps, 0.5))))
