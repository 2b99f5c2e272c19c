"""A walk that goes another way: one move in the plane for every frame.

    bend = smooth_bend(shift, turn, weight, time)
    elsewhere = bend.apply(motion)

A move turns about the vertical through the root and shifts it over the plane. Everything that the
body does it does there, so stride lengths and turning rates change by what the bend itself
stretches and turns, and no more.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.motion import Motion
from mjmotion.numerics.rotations import multiply, yaw_quat
from mjmotion.numerics.smoothing import follow

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Bend:
    """Where the root of every frame goes, and how far the body turns with it.

    Attributes:
      shift: (nframe, 2) of the root over the plane [m].
      turn: (nframe,) about the vertical [rad].
    """

    shift: Array
    turn: Array

    @classmethod
    def none(cls, nframe: int) -> Bend:
        """Return the bend that moves nothing."""
        return cls(np.zeros((nframe, 2)), np.zeros(nframe))

    def apply(self, motion: Motion) -> Motion:
        """Return the motion on its new way: ``p + shift``, ``yaw(turn) ⊗ q`` of its root."""
        qpos = np.array(motion.qpos)
        qpos[:, :2] += self.shift
        qpos[:, 3:7] = multiply(yaw_quat(self.turn), qpos[:, 3:7])
        return motion.replace(qpos)

    def then(self, other: Bend) -> Bend:
        """Return the bend that does what this one does, and after it the other."""
        return Bend(self.shift + other.shift, self.turn + other.turn)


def smooth_bend(shift: Array, turn: Array, weight: Array, time: float) -> Bend:
    """Return the smooth bend near moves that are asked for, as far as each of them counts.

    Args:
      shift: (nframe, 2) asked for over the plane [m].
      turn: (nframe,) asked for about the vertical, unwrapped [rad].
      weight: (nframe,) how much each counts, above 0.
      time: τ of :func:`.follow` [frames].
    """
    smooth = follow(np.column_stack((shift, turn)), weight, time)
    return Bend(smooth[:, :2], smooth[:, 2])
