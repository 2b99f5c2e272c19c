"""Arms go with the legs: where a thigh is lifted higher than in the source, the other side's arm
swings further forwards.

How far says the source itself: by as much as its arm follows the other side's thigh, and by no more
than a third of what the thigh is lifted. So arms that carry something, or hang, stay as they are.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.kinematics import Kinematics, Pose, level_side
from mjmotion.body.motion import Motion
from mjmotion.body.parts import LimbParts, Parts
from mjmotion.exceptions import ModelError
from mjmotion.footsteps.bow import add_turn
from mjmotion.numerics.rotations import cross
from mjmotion.numerics.smoothing import ease
from mjmotion.numerics.tangent import oplus

Array = NDArray[np.float64]

SHARE = 1.0 / 3.0  # the most of what a thigh is lifted by that an arm swings
ELBOW = 0.5  # of what a shoulder swings, by how much its elbow bends
MOST = 0.35  # the most that an arm swings further than in the source [rad]
LITTLE, MUCH = (
    0.08,
    0.2,
)  # thighs lifted by less ask nothing of arms, by more all that they do [rad]
SWING_TIME = 0.08  # standard deviation of what smooths the arms' swing [s]
_FAR = 4.0  # times that it reaches


def arms_swung(
    motion: Motion,
    source: Motion,
    held: Collection[int] = (),
    busy: NDArray[np.bool_] | None = None,
) -> Motion:
    """Return the motion with arms that swing with thighs lifted higher than in the source.

    With e how much higher one thigh is lifted, less by how much the other is, an arm of the other
    side turns forwards by ``min(SHARE, b) e`` and no further than :data:`MOST`, smoothed over time;
    b is the slope of the source's arm over its thigh, least squares. A motion whose thighs are
    lifted as in the source is returned as it is.

    Args:
      motion: the motion, on the character alone.
      source: what it was made of; as many frames, on the same character.
      held: bodies; arms that any of them is part of stay as they are.
      busy: (nframe,) where all arms stay as they are; nowhere without.
    """
    try:
        parts = motion.character.parts
    except ModelError:  # no legs and arms that can be told
        return motion
    pairs = [pair for pair in _across(parts) if not set(pair[1].bodies) & set(held)]
    kinematics = Kinematics(motion.model, motion.nframe)
    own, was = (kinematics.forward(one.qpos) for one in (motion, source))
    side = level_side(own)
    unit, any_swings = np.zeros((motion.nframe, motion.model.nv)), np.zeros(motion.nframe, bool)
    extra = [_lift(own, leg) - _lift(was, leg) for leg in parts.legs]
    for leg, arm in pairs:
        number = parts.legs.index(leg)
        more = np.maximum(extra[number], 0.0) - np.maximum(extra[1 - number], 0.0)
        share = min(SHARE, _follows(was, leg, arm))
        asked = share * more * ease((more - LITTLE) / (MUCH - LITTLE))
        swing = _smooth(asked, busy, motion.fps)
        if share <= 0.0 or not swing.any():
            continue
        for bodies, part in ((arm.upper, 1.0), (arm.lower, ELBOW)):
            if bodies:
                step = np.zeros_like(unit)
                add_turn(step, own, bodies[0], side, -part)
                unit += swing[:, None] * step
        any_swings |= swing > 0.0
    if not any_swings.any():
        return motion
    swung = motion.character.within_limits(oplus(motion.model, motion.qpos, unit))
    return motion.replace(np.where(any_swings[:, None], swung, motion.qpos))


def _across(parts: Parts) -> list[tuple[LimbParts, LimbParts]]:
    """Return each leg with the arm of the other side."""
    if len(parts.legs) != 2 or len(parts.arms) != 2:
        return []
    way = parts.legs[0].points[0] - parts.legs[1].points[0]
    near, far = parts.arms
    if (near.points[0] - far.points[0]) @ way < 0.0:
        near, far = far, near
    return [(parts.legs[0], far), (parts.legs[1], near)]


def _lift(pose: Pose, limb: LimbParts) -> Array:
    """Return how far forwards a thigh or an upper arm is lifted (n,) [rad]; hanging, 0."""
    if not (limb.upper and limb.lower):
        return np.zeros(len(pose.xpos))
    bone = pose.xpos[:, limb.lower[0]] - pose.xpos[:, limb.upper[0]]
    ahead = cross(level_side(pose), np.array((0.0, 0.0, 1.0)))
    return np.arctan2((bone * ahead).sum(axis=1), -bone[:, 2])


def _follows(pose: Pose, leg: LimbParts, arm: LimbParts) -> float:
    """Return by how much an arm is lifted for each radian that a thigh is, least squares."""
    thigh, upper = (one - one.mean() for one in (_lift(pose, leg), _lift(pose, arm)))
    return float((thigh @ upper) / max(thigh @ thigh, 1e-9))


def _smooth(swing: Array, busy: NDArray[np.bool_] | None, fps: float) -> Array:
    """Return the swing (nframe,) [rad] bounded and smoothed; nothing where arms are busy."""
    from scipy.ndimage import gaussian_filter1d, maximum_filter1d

    spread, far = SWING_TIME * fps, round(_FAR * SWING_TIME * fps)
    bounded = np.minimum(swing, MOST)
    if busy is not None:
        wide = maximum_filter1d(busy.astype(np.int8), 2 * far + 1, mode="constant")
        bounded = np.where(wide > 0, 0.0, bounded)
    return np.asarray(gaussian_filter1d(bounded, spread, mode="nearest", radius=far))
