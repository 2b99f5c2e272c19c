"""The ground under toes: how far they bend to lie on what rises or falls ahead of the ball."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.feet import Foot
from mjmotion.numerics.rotations import normalized, rotate
from mjmotion.scene.ground import Ground

Array = NDArray[np.float64]

TOES_UP, TOES_DOWN = 0.3, 0.15  # how far toes follow ground ahead of the ball [rad]
TOE_SHARES = (0.4, 0.7, 1.0)  # of the way from the ball to the toes' outline that are looked at
TOE_LEVER = 0.03  # least lever that this is reckoned with [m]
EDGE = 0.06  # ground this far below toes is beyond an edge [m]
LEVEL = 1e-3  # a slope that is none [rad]


def toes_on_ground(foot: Foot, ground: Ground, position: Array, quat: Array) -> float:
    """Return how far toes bend up [rad] to lie on the ground ahead of a ball that stands.

    Args:
      foot: the foot.
      ground: the scene's surfaces.
      position: (3,) where its posed site stands [m].
      quat: (4,) how it is turned.
    """
    if foot.toes is None:
        return 0.0
    anchor, outline = foot.toes.anchor, foot.sole[foot.bends[: len(foot.sole)]]
    ahead = foot.front - foot.toe
    ahead = ahead / max(float(np.linalg.norm(ahead)), 1e-9)
    away = ((outline - anchor) @ ahead)[:, None] * ahead
    local = np.concatenate([outline - (1.0 - share) * away for share in TOE_SHARES])
    points = position + rotate(quat, local)
    height, _ = ground.under(points)
    up = np.where(np.isnan(height), -np.inf, height - points[:, 2])
    if (up < -EDGE).all():
        return 0.0  # over an edge toes lie on nothing
    lever = np.maximum((local - anchor) @ ahead, TOE_LEVER)
    slope = float(np.arctan2(up, lever).max())
    return float(np.clip(slope, -TOES_DOWN, TOES_UP)) if abs(slope) > LEVEL else 0.0


def under_toes(foot: Foot, points: Array, above: Array, count: int) -> Array:
    """Return how much higher than the plane of the sole points of it lie (n, k) [m].

    Toes lie on what rises or falls ahead of the ball, as far as they follow it.

    Args:
      foot: the foot.
      points: (k, 3) points under it, and before and behind it, in its frame [m].
      above: (n, k) how far the ground there is above that plane [m].
      count: how many of them, at the end, are of its sole, in its order.
    """
    bends = np.zeros(len(points), dtype=bool)
    bends[-count:] = foot.bends[len(foot.sole) - count : len(foot.sole)]
    if foot.toes is None or not bends.any():
        return np.zeros_like(above)
    ahead = normalized(foot.front - foot.toe)
    lever = np.maximum((points - foot.toes.anchor) @ ahead, 0.0)
    slope = np.arctan2(above[:, bends], np.maximum(lever[bends], TOE_LEVER))
    bend = np.clip(slope.max(axis=1, keepdims=True), -TOES_DOWN, TOES_UP)
    return np.asarray(lever * np.tan(bend))
