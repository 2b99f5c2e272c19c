"""A foot that turns while it stands: about its ball with the heel up, or about its heel.

It stands flat, turns, and stands flat again as it then points, all on one spot: one stance, whose
foothold turns in its plane about what stays.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.feet import Foot
from mjmotion.body.kinematics import Pose, site_id
from mjmotion.numerics.rotations import multiply, rotate, yaw_quat

Array = NDArray[np.float64]

TURNS = np.radians(8.0)  # flat feet that point elsewhere by more have turned in between [rad]


@dataclasses.dataclass(frozen=True, eq=False)
class Pivot:
    """How a foot turns within a stance, frame by frame from its start.

    Attributes:
      turn: (n,) how far it has turned from where it first stood flat [rad].
      on_toe: whether it turns about its ball, and not about its heel.
    """

    turn: Array
    on_toe: bool

    def posed(self, foot: Foot, position: Array, quat: Array) -> tuple[Array, Array]:
        """Return where the posed site is (n, 3) [m], and its turn (n, 4), in a foothold that turns.

        Args:
          foot: the foot.
          position: (3,) of the foothold where the foot first stands flat [m].
          quat: (4,) its turn.
        """
        point = foot.toe if self.on_toe else foot.heel
        turned = multiply(quat, yaw_quat(self.turn))
        return position + rotate(quat, point) - rotate(turned, point), turned


def find_pivot(yaw: Array, heel: NDArray[np.bool_], toe: NDArray[np.bool_]) -> Pivot | None:
    """Return how a foot turns in a stance; None where it stands flat one way only.

    Args:
      yaw: (n,) which way it points over the ground, continuous [rad].
      heel: (n,) when it stands.
      toe: (n,) the same.
    """
    flat = heel & toe
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flat.astype(np.int8), [0]))))
    stays = edges.reshape(-1, 2)
    if len(stays) < 2:
        return None
    ways = [float(np.median(yaw[start:end])) for start, end in stays]
    if np.ptp(ways) <= TURNS:
        return None
    turn = yaw - ways[0]
    for (start, end), way in zip(stays, ways, strict=True):
        turn[start:end] = way - ways[0]  # while it stands flat it does not turn
    # What it stands on alone from the first flat stay to the last is what it turns about.
    within = slice(int(stays[0, 0]), int(stays[-1, 1]))
    on_toe = bool((toe & ~heel)[within].sum() >= (heel & ~toe)[within].sum())
    # What stands alone and is not what it turns about would be dragged along.
    other = (heel & ~toe) if on_toe else (toe & ~heel)
    number = np.clip(np.searchsorted(stays[:, 0], np.arange(len(yaw)), side="right") - 1, 0, None)
    turn[other] = (np.array(ways) - ways[0])[number[other]]
    return Pivot(turn, on_toe)


def foot_yaw(pose: Pose, foot: Foot, start: int, end: int) -> Array:
    """Return which way a foot points over the ground (end - start,), continuous [rad]."""
    heel, toe = (
        pose.site_xpos[start:end, site_id(pose.model, f"{foot.side}_{part}")]
        for part in ("heel", "toe")
    )
    along = toe - heel
    return np.unwrap(np.arctan2(along[:, 1], along[:, 0]))
