"""Toes that bend: flat on the ground while the foot rolls over its ball, as in the source else.

IK poses the rigid part of a foot; its toes are set here. While the ball stands, they are bent up by
as much as the foot is pitched over its foothold, so that they lie in its plane; what that is other
than in the source fades out within the swing, and where the ground would come into them they give.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.feet import Foot
from mjmotion.footsteps.swings import DIP
from mjmotion.numerics.rotations import conjugate, exp, multiply, rotate
from mjmotion.numerics.smoothing import envelope, fade
from mjmotion.scene.ground import Ground

Array = NDArray[np.float64]

BACK_TIME = 0.05  # what they are bent other than the source's dies out as exp(-t / this) [s]
GIVE_TIME = 0.03  # how far on either side a giving of the toes is felt [s]
_GIVES = 2  # times that it is looked how far they must give
_SHORT = 0.02  # least lever that this is reckoned with [m]


def pitch_between(old: Array, new: Array) -> Array:
    """Return how far feet turned from ``old`` to ``new`` (n, 4) are pitched (n,), heel up [rad]."""
    w, x, y, z = np.moveaxis(multiply(conjugate(old), new), -1, 0)
    return np.asarray(np.arctan2(2.0 * (w * y - x * z), 1.0 - 2.0 * (x * x + y * y)))


def ball_over_tip(foot: Foot, lying: Array, flat: Array) -> Array:
    """Return how far the ball goes (n, 3) [m], in its foothold's axes, as a foot rolls on its tip.

    Args:
      foot: the foot.
      lying: (n,) how far toes would have to bend up to lie on the ground; what is more than they
        can is rolled over their tip [rad].
      flat: (n,) how far they do where the foot is flat [rad].
    """
    if foot.toes is None:
        return np.zeros((len(lying), 3))
    axis, turn = foot.toes.axis, lying - foot.toes.settled(np.maximum(lying, foot.toes.low))
    turn = np.maximum(turn, 0.0)
    long = rotate(exp(flat[:, None] * axis), (foot.front - foot.toe)[None])
    return np.asarray(long - rotate(exp(-turn[:, None] * axis), long))


def lying_flat(foot: Foot, lying: Array, ball: NDArray[np.bool_], bend: Array, fps: float) -> Array:
    """Return how far toes would bend up (nframe,) [rad], on the ground while the ball stands.

    Args:
      foot: the foot.
      lying: (nframe,) how far they would have to, to lie on it, where it stands [rad].
      ball: (nframe,) when its ball stands.
      bend: (nframe,) how far the source's toes are bent up [rad].
      fps: frames a second.
    """
    if foot.toes is None:
        return bend
    own = foot.toes.wanted(bend)
    return np.asarray(own + fade(ball, (lying - own)[:, None], BACK_TIME * fps)[:, 0])


def kept_up(
    foot: Foot,
    position: Array,
    quat: Array,
    bend: Array,
    ball: NDArray[np.bool_],
    ground: Ground,
    fps: float,
) -> Array:
    """Return how far toes would bend up (nframe,) [rad] so that they stay out of the ground.

    While the ball stands, they lie as they are; what is more than they can give is for the foot.
    """
    if foot.toes is None:
        return bend
    local = foot.sole[foot.bends[: len(foot.sole)]]
    free = np.flatnonzero(~ball)
    hinge = position + rotate(quat, foot.toes.anchor)
    for _ in range(_GIVES):
        settled = foot.toes.settled(bend)
        points = position[free, None] + rotate(
            quat[free, None], foot.toes.turned(local, settled[free])
        )
        height, _ = ground.under(points)
        deep = np.where(np.isnan(height), 0.0, height - points[..., 2])
        lever = np.linalg.norm((points - hinge[free, None])[..., :2], axis=-1)
        need = np.zeros(len(bend))
        need[free] = np.arctan2(deep - DIP, np.maximum(lever, _SHORT)).max(axis=1)
        need = np.minimum(need, foot.toes.high - settled)
        if need.max(initial=0.0) <= 0.0:
            break
        bend = bend + envelope(need, ball, GIVE_TIME * fps)
    return bend


def room_under_ball(
    foot: Foot, position: Array, quat: Array, stance: NDArray[np.bool_], ground: Ground
) -> Array:
    """Return how far the ends of a ball may go down (nframe,) [m], infinite where no ground is.

    Where it stands (``stance``), one may dig in a little.
    """
    if foot.toes is None:
        return np.full(len(position), np.inf)
    ends = position[:, None] + rotate(quat[:, None], foot.sole[None, -2:])
    height, _ = ground.under(ends)
    room = np.where(np.isnan(height), np.inf, ends[..., 2] - height).min(axis=1)
    return np.asarray(np.maximum(room + DIP * stance, 0.0))


def rolled_no_further(
    foot: Foot,
    turn: tuple[Array, Array],
    bend: Array,
    stance: NDArray[np.bool_],
    room: Array,
) -> tuple[Array, Array]:
    """Roll a turned foot back where an end of its ball would go into the ground.

    Args:
      foot: the foot; its toes bend.
      turn: (nframe, 4) how it was turned, and how it is to be, about its ball.
      bend: (nframe,) how far its toes would bend up to lie on the ground, where it stands [rad].
      stance: (nframe,) when it stands.
      room: (nframe,) how far the ends of its ball may go down [m].

    Returns:
      How it is turned (nframe, 4), and what room that leaves (nframe,) [m].
    """
    assert foot.toes is not None
    old, new = turn
    up = np.tile((0.0, 0.0, 1.0), (len(new), 1))
    up[stance] = rotate(multiply(old, exp(bend[:, None] * foot.toes.axis)), up)[stance]
    ends = foot.sole[-2:] - foot.toe
    height = (rotate(old[:, None], ends[None]) * up[:, None]).sum(axis=-1)
    least = height - room[:, None]
    ahead = np.cross(rotate(new, foot.toes.axis), up)  # in the ground's plane, across the hinge
    ahead /= np.maximum(np.linalg.norm(ahead, axis=-1, keepdims=True), 1e-9)
    for _ in range(_GIVES):
        low = (rotate(new[:, None], ends[None]) * up[:, None]).sum(axis=-1)
        for end, deep in enumerate((least - low).T):
            far = rotate(new, ends[end][None])
            lever = (np.cross(ahead, far) * up).sum(axis=-1)
            roll = np.maximum(deep, 0.0) / np.copysign(np.maximum(np.abs(lever), _SHORT), lever)
            new = multiply(exp(roll[:, None] * ahead), new)
    low = (rotate(new[:, None], ends[None]) * up[:, None]).sum(axis=-1)
    return new, np.maximum((low - least).min(axis=1), 0.0)
