"""How a foot that stands turns about the vertical: not at all while it rests, and else as recorded.

A foot that rests is noisy by a degree or two and is to be still. One that turns on its ball or its
heel, or is turned out as it rolls off, turns as the recorded one does.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mjmotion.clips.recorded_feet import RecordedFoot, RecordedStance
from mjmotion.numerics import rotations as rot
from mjmotion.numerics.smoothing import follow

Array = NDArray[np.float64]

RESTS = np.radians(8.0)  # a flat foot that turns by no more in its stay rests [rad]
TURNS = np.radians(16.0)  # one that turns by more turns as recorded; between, the less the less
_TOGETHER = 0.1  # [s] flat stays less apart are one
_STEEP = 0.3  # least share of a foot's forward axis over the ground that tells its yaw
_WANDERS = 0.04  # [m] a ball that goes so far in a stance does not stay on its spot
_SLOW = 4.0  # [Hz] a foot that turns flat on the ground does so slower than that


def foot_yaw(foot: RecordedFoot) -> Array:
    """Return which way a foot points over the ground (nframe,), continuous over the frames [rad].

    Where it points nearly straight down or up that is drawn between the frames around.
    """
    forward = rot.rotate(foot.quat, np.array((1.0, 0.0, 0.0)))
    told = np.flatnonzero(np.hypot(forward[:, 0], forward[:, 1]) > _STEEP)
    if len(told) == 0:
        return np.zeros(len(forward))
    yaw = np.unwrap(np.arctan2(forward[told, 1], forward[told, 0]))
    return np.interp(np.arange(len(forward)), told, yaw)


def flat_stays(stance: RecordedStance, fps: float) -> list[NDArray[np.int64]]:
    """Return the frames of each stretch in which a foot stands flat, in order; no gaps in them."""
    if len(stance.flat) == 0:
        return []
    cuts = np.flatnonzero(np.diff(stance.flat) > max(1.0, _TOGETHER * fps)) + 1
    return [np.arange(part[0], part[-1] + 1) for part in np.split(stance.flat, cuts)]


def turns_on_heel(foot: RecordedFoot, stance: RecordedStance) -> bool:
    """Return whether a flat foot turns about its heel in a stance: the ball goes, the ankle stays.

    Slow enough that the ball would be taken to stand too.
    """
    span = slice(stance.start, stance.end)
    ball, ankle = (
        float(np.linalg.norm(np.ptp(np.percentile(p[span, :2], (5, 95), axis=0), axis=0)))
        for p in (foot.ball, foot.ankle)
    )
    return len(stance.flat) > 0 and ball > _WANDERS and ankle < 0.5 * ball


def stance_yaw(yaw: Array, stance: RecordedStance, frames: NDArray[np.int64], fps: float) -> Array:
    """Return which way a foot is to point in frames (n,) of a stance or near it [rad].

    Args:
      yaw: (nframe,) of :func:`foot_yaw`.
      stance: the stance.
      frames: (n,) in order; they hold all its flat ones.
      fps: frames a second.
    """
    known, change = [], []
    for stay in flat_stays(stance, fps):
        own = yaw[stay]
        wanted = np.full(len(own), np.median(own))
        extent = float(np.ptp(np.percentile(own, (5.0, 95.0))))
        if extent > RESTS:
            time = 1.0 / (2.0 * np.sin(np.pi * min(_SLOW / fps, 0.5)))
            turning = follow(own[:, None], np.ones(len(own)), time)[:, 0]
            # No step at the threshold: a foot that turns by hardly more than noise hardly turns.
            share = min((extent - RESTS) / (TURNS - RESTS), 1.0)
            wanted = wanted + share * (turning - wanted)
        known.append(stay)
        change.append(wanted - own)
    if not known:
        return np.array(yaw[frames])
    # What was put right while it rests goes on until it rests again.
    return yaw[frames] + np.interp(frames, np.concatenate(known), np.concatenate(change))
