"""Joints of limbs that stand at the edge of their range, carried from one level to the next.

A limb closed in form does not know how far its joints can turn. Where they would leave their range
they are held at its edge by a high rigidity in the next solve (the penalty of Eq. 6), so that the
body and what is shared between frames give instead; they are let go once they turn back inside.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.character import Character
from mjmotion.body.limbs import Limbs

Array = NDArray[np.float64]

RIGIDITY = 2000.0  # α of a joint that is held at its edge
MARGIN = 0.03  # so far inside its range a joint is held: what levels leave must fit in [rad]
_OVER = 1e-4  # out of its range by more than this, a joint is held [rad]


@dataclasses.dataclass(frozen=True, eq=False)
class Edges:
    """What is held where, over some frames.

    Attributes:
      frames: (n,) frames, rising.
      side: (n, nlimb, 7) 1 at the upper edge of its range, -1 at the lower, 0 free.
      level: (n, nlimb, 7) the deviation at which the edge is [rad]; 0 where free.
    """

    frames: NDArray[np.int64]
    side: Array
    level: Array

    def at(self, frames: NDArray[np.int64]) -> Edges | None:
        """Return what is held at some of the frames; None where nothing is."""
        rows = np.searchsorted(self.frames, frames)
        side = self.side[rows]
        return Edges(frames, side, self.level[rows]) if side.any() else None

    def stiffened(self, sqrt_rigidity: Array) -> Array:
        """Return square roots of rigidities (n, nlimb, 7): stiff where a joint is held."""
        return np.where(self.side != 0.0, RIGIDITY**0.5, sqrt_rigidity)


def find_edges(
    character: Character,
    limbs: Limbs,
    frames: NDArray[np.int64],
    qpos: Array,
    displacement: Array,
    deviation: Array,
    before: Edges | None,
    free: NDArray[np.bool_],
) -> Edges:
    """Return what is at an edge after a displacement (n, nlimb, 7) of poses (n, nq).

    Args:
      character: the body.
      limbs: the limbs.
      frames: (n,) the frames of the poses.
      qpos: (n, nq) poses.
      displacement: (n, nlimb, 7) what they are about to be moved by.
      deviation: (n, nlimb, 7) how far they are from the motion to keep to, after that.
      before: what was held while this displacement was found.
      free: (n,) frames in which nothing is held, as there is no motion to keep to.
    """
    low, high = _bounds(character, limbs)
    angle = limbs.joint_angles(qpos, displacement)
    over = np.maximum(angle - high, 0.0) - np.maximum(low - angle, 0.0)
    side = np.where(np.abs(over) > _OVER, np.sign(over), 0.0)
    level = np.where(side != 0.0, deviation - over, 0.0)
    if before is not None:
        # Held, and not pulled back inside: it stays held, at the edge it was held at.
        inside = (deviation - before.level) * before.side < 0.0
        stays = (before.side != 0.0) & (side == 0.0) & ~inside
        side, level = np.where(stays, before.side, side), np.where(stays, before.level, level)
    side[free], level[free] = 0.0, 0.0
    return Edges(frames, side, level)


def _bounds(character: Character, limbs: Limbs) -> tuple[Array, Array]:
    """Return the ranges (nlimb, 7) of limbs' joints: swing and twist of balls, angle of hinges."""
    low, high = np.full((len(limbs), 7), -np.inf), np.full((len(limbs), 7), np.inf)
    boxes, model = character.limits.boxes, character.model
    for index, limb in enumerate(limbs.limbs):
        for body, columns in ((limb.upper, slice(0, 3)), (limb.end, slice(4, 7))):
            box = boxes.get(int(model.body_jntadr[body]))
            if box is not None:
                low[index, columns], high[index, columns] = box[:, 0] + MARGIN, box[:, 1] - MARGIN
    return low, high


def same(one: Edges | None, other: Edges | None) -> bool:
    """Return whether the same joints are held at the same edges."""
    if one is None or other is None:
        return one is other
    return np.array_equal(one.side, other.side) and np.array_equal(one.level, other.level)
