"""Footholds where the ground is uneven everywhere: the best place near for a sole to settle on."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mjmotion.footsteps.settling import COARSE_STEP, HeightMap, Plates, Tread, settle, settled
from mjmotion.numerics.rotations import rotate
from mjmotion.scene.ground import Ground

Array = NDArray[np.float64]

RISEN = 0.0042  # ground that rises further into a sole that stands makes it settle [m]
FIELD_GAP, SOLID_GAP = 0.008, 0.0015  # how far off the ground heel and ball may be [m]
_FIELD_COST, _SOLID_COST = 20.0, 100.0  # way that a gap beyond that is worth [m/m]
HANGS, _HANG_COST = 0.07, 0.25  # ground that is lower under a sole; way that it is worth [m]
_TILT_COST = 0.1  # way that a tilt is worth [m/rad]
_TILT_MOST = 0.4  # steeper than this no foot stands on such ground [rad]
_REFUSED = 1.0  # way that what is refused is worth [m]
_TRIES = 12  # places that are looked at closely
_GOOD = 0.01  # a place this little worse than it looked from afar is taken [m]


def settled_near(
    tread: Tread,
    ground: Ground,
    spot: Array,
    yaw: Array,
    shift: Array,
    refused: Callable[[Plates], NDArray[np.bool_]],
) -> tuple[Plates | None, float]:
    """Return the best place near a spot for a sole to settle on (n = 1), and what it costs [m].

    Little way, little tilt, heel and ball on the ground, and nothing that rises into the sole. None
    where it can settle nowhere.

    Args:
      tread: the sole.
      ground: the scene's surfaces.
      spot: (3,) where its posed site would be, about as high as the ground [m].
      yaw: (4,) how it is turned about the vertical.
      shift: (n, 3) from there to the places that are tried [m].
      refused: which of plates cannot be stood on.
    """
    coarse = Tread.of(tread.foot, COARSE_STEP)
    turned, spots = rotate(yaw, coarse.points), spot + shift
    reach = np.abs(shift[:, :2]).max() + np.linalg.norm(turned[:, :2], axis=1).max()
    heights = HeightMap(ground, spot, float(reach)).at(spots[:, None] + turned)
    around = np.broadcast_to(turned, (len(spots), *turned.shape))
    field = ground.on_field(spot + turned)
    gap = (FIELD_GAP, _FIELD_COST) if field else (SOLID_GAP, _SOLID_COST)
    cost = _cost(settled(coarse, spots, yaw, heights, around), shift, gap, refused)
    best, least = None, np.inf
    for index in np.argsort(cost)[:_TRIES]:
        # From close by it is never better than from afar by more than a little.
        if cost[index] >= least or cost[index] >= _REFUSED:
            break
        close = settle(tread, ground, spots[index], yaw)
        worth = float(_cost(close, shift[index : index + 1], gap, refused)[0])
        if worth < least:
            best, least = close, worth
        if worth < cost[index] + _GOOD:
            break
    return (best if least < _REFUSED else None), least


def _cost(
    plates: Plates,
    shift: Array,
    gap: tuple[float, float],
    refused: Callable[[Plates], NDArray[np.bool_]],
) -> Array:
    """Return what plates cost (n,), as way that they are worth [m].

    ``gap`` is what may be [m], and what more is worth.
    """
    tilt = np.arccos(np.clip(plates.normal[:, 2], -1.0, 1.0))
    bad = (tilt > _TILT_MOST) | refused(plates)
    beyond = np.maximum(plates.gap - gap[0], 0.0)
    way = np.linalg.norm(shift, axis=1)
    way = way + _HANG_COST * (plates.hangs > HANGS)
    return np.asarray(way + _TILT_COST * tilt + gap[1] * beyond + _REFUSED * bad)
