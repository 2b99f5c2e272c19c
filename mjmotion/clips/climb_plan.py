"""The plan of a climb: who holds the rope where and when, and how hands and feet go there.

The rope hangs at x = y = 0 and the climber is behind it, at x < 0, facing +x. A climb begins with a
hang by both hands; then the feet come up and clamp the rope, the legs push, and one hand after the
other reaches up. Frames are those of 30 fps.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mjmotion.clips.climb_grip import HANDS, LIMBS, Grip
from mjmotion.constraints import SiteConstraint
from mjmotion.footsteps.contacts import Contact
from mjmotion.numerics.rotations import exp, multiply
from mjmotion.numerics.smoothing import ease

Array = NDArray[np.float64]

FRAMES = 275
FPS = 30.0
RISE = 0.40  # of a hand from hold to hold, and of the feet [m]

# When each limb takes and leaves the rope: a reach takes 10 frames from the last of one hold to the
# first of the next, a step of both feet 12.
HELD: dict[str, tuple[tuple[int, int], ...]] = {
    "left_hand": ((0, 42), (51, 148), (157, 254), (263, 275)),
    "right_hand": ((0, 80), (89, 186), (195, 275)),
    "left_foot": ((14, 108), (119, 214), (225, 275)),
    "right_foot": ((14, 108), (119, 214), (225, 275)),
}

_FIRST = {"left_hand": 2.09, "right_hand": 2.20, "left_foot": 0.765, "right_foot": 0.765}  # [m]
# Hands draw the rope a little to their own side, feet press it a little forward [m].
_TO_SIDE = {"left_hand": 0.005, "right_hand": -0.005, "left_foot": 0.0, "right_foot": 0.0}
_FORWARD = {"left_hand": 0.0, "right_hand": 0.0, "left_foot": 0.06, "right_foot": 0.06}
# Feet in the hang: forward, to their side and down from where they clamp the rope [m], and how far
# they turn from there: outward, toes down, toes out [rad].
_DANGLING = (-0.16, 0.085, 0.40)
_DANGLING_TURN = (0.05, 0.30, 0.05)
# How far a limb's way bows out, forward and to its own side [m], and turns at its middle [rad].
_BOW = {True: (-0.05, 0.085), False: (-0.09, 0.10)}
_TURN = {True: (0.0, -0.12, 0.10), False: (0.06, 0.12, 0.10)}


@dataclasses.dataclass(frozen=True, eq=False)
class Hold:
    """One hold of one limb.

    Attributes:
      site: the hand or foot.
      start, end: its frames, ``end`` not included.
      point: (3,) what it holds of the rope's centre line [m].
    """

    site: str
    start: int
    end: int
    point: Array


def plan_holds() -> tuple[Hold, ...]:
    """Return every hold of the climb, limb by limb, in order."""
    holds = []
    for site in LIMBS:
        for number, (start, end) in enumerate(HELD[site]):
            point = (_FORWARD[site], _TO_SIDE[site], _FIRST[site] + RISE * number)
            holds.append(Hold(site, start, end, np.array(point)))
    return tuple(holds)


def hold_contacts(holds: Sequence[Hold]) -> tuple[Contact, ...]:
    """Return the holds as contacts, in order of their start."""
    contacts = [Contact(hold.site, hold.start, hold.end) for hold in holds]
    return tuple(sorted(contacts, key=lambda contact: (contact.start, contact.site)))


def hold_constraints(
    holds: Sequence[Hold], grips: Mapping[str, Grip]
) -> tuple[SiteConstraint, ...]:
    """Return position and orientation of every hold: six scalars a frame.

    Args:
      holds: who holds the rope where and when.
      grips: how the limbs of this character lie against a rope.
    """
    constraints = []
    for hold in holds:
        grip = grips[hold.site]
        constraints.append(
            SiteConstraint(
                hold.site,
                np.arange(hold.start, hold.end),
                grip.position(hold.point, grip.quat),
                grip.quat,
                contact=True,
            )
        )
    return tuple(constraints)


def limb_path(site: str, holds: Sequence[Hold], grip: Grip, nframe: int) -> tuple[Array, Array]:
    """Return the way of one limb: its site's (nframe, 3) positions [m] and (nframe, 4) turns.

    Between two holds it leaves the rope, bows away from it and comes back, with two smooth
    derivatives. Before its first hold a foot dangles.
    """
    mine = [hold for hold in holds if hold.site == site]
    side = 1.0 if site.startswith("left") else -1.0
    mirror = np.array((side, 1.0, side))  # of a rotation vector
    points = np.empty((nframe, 3))
    turns = np.zeros((nframe, 3))  # from how the limb holds the rope, in its own frame
    for hold in mine:
        points[hold.start : hold.end] = hold.point
    if mine[0].start > 0:
        x, y, z = _DANGLING
        free = mine[0].point + np.array((x, side * y, -z))
        dangling = dataclasses.replace(mine[0], start=-1, end=1, point=free)
        points[0], turns[0] = free, mirror * _DANGLING_TURN
        mine.insert(0, dangling)
    bow = np.array((_BOW[site in HANDS][0], side * _BOW[site in HANDS][1], 0.0))
    turn = mirror * _TURN[site in HANDS]
    for before, after in pairwise(mine):
        frames = np.arange(before.end, after.start)
        part = np.asarray((frames - before.end + 1) / (after.start - before.end + 1), float)
        done = ease(part)[:, None]
        middle = (64.0 * (part * (1.0 - part)) ** 3)[:, None]
        points[frames] = before.point + done * (after.point - before.point) + middle * bow
        turns[frames] = (1.0 - done) * turns[before.end - 1] + middle * turn
    quat = multiply(np.broadcast_to(grip.quat, (nframe, 4)), exp(turns))
    return grip.position(points, quat), quat
