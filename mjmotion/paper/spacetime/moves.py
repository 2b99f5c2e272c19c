"""Targets as shared moves leave them, and how they answer to each of a move's four unknowns.

The large optimisation needs exact derivatives at moves that are not small. They are made here from
the definition of ``SharedMove`` alone, so that the reference shares no code with what it is a
reference for.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.kinematics import site_id
from mjmotion.constraints import Targets
from mjmotion.constraints.shared_targets import SharedMove
from mjmotion.exceptions import ConstraintError
from mjmotion.numerics.rotations import cross, exp, multiply, rotate, to_matrix

Array = NDArray[np.float64]

WIDTH = 4  # unknowns of a move: three directions [m] and a turn [rad]


@dataclasses.dataclass(frozen=True, eq=False)
class Effect:
    """How the targets of one move's site answer to it.

    Attributes:
      row: (n,) places in the targets' frames.
      column: the site's place among the targets' sites.
      change: (n, 6, 4) a target's move [m] and turn [rad] in world axes, for each unknown.
    """

    row: NDArray[np.int64]
    column: int
    change: Array


class MovedTargets:
    """Targets that shared moves displace; where a target is in several, in the order given.

    Args:
      moves: the moves.
      targets: the targets as they are without any move.
      model: the model.

    Raises:
      ConstraintError: a move of targets that do not exist.
    """

    def __init__(
        self, moves: Sequence[SharedMove], targets: Targets, model: mujoco.MjModel
    ) -> None:
        self.moves = tuple(moves)
        self.targets = targets
        self.rigidity = np.array([float(move.rigidity) for move in moves])
        self.free = np.zeros((len(moves), WIDTH), dtype=bool)
        self._place: list[tuple[NDArray[np.int64], int, Array]] = []
        for number, move in enumerate(moves):
            column = np.flatnonzero(targets.sites == site_id(model, move.site))
            there = np.isin(move.frames, targets.frames)
            if len(column) == 0 or not there.any():
                raise ConstraintError(
                    f"shared move of '{move.site}' at frames {move.frames[0]} to"
                    f" {move.frames[-1]}: no constraint holds that site there"
                )
            row = np.searchsorted(targets.frames, move.frames[there])
            self._place.append((row, int(column[0]), move.share[there]))
            self.free[number, : len(move.directions)] = True
            self.free[number, 3] = move.axis is not None
        # Which entries of an earlier move a later one takes along: (earlier, its rows, own rows).
        self._along: list[list[tuple[int, NDArray[np.int64], NDArray[np.int64]]]] = []
        for number, (row, column_, _) in enumerate(self._place):
            met = []
            for other, (its, its_column, _) in enumerate(self._place[:number]):
                if its_column == column_:
                    _, one, two = np.intersect1d(its, row, return_indices=True)
                    if len(one):
                        met.append((other, one, two))
            self._along.append(met)

    def __call__(self, values: Array) -> tuple[Targets, list[Effect]]:
        """Return the targets after moves (nmove, 4), and what each of them does there."""
        position, quat = self.targets.position.copy(), self.targets.quat.copy()
        effects: list[Effect] = []
        for move, value, (row, column, share), along in zip(
            self.moves, values, self._place, self._along, strict=True
        ):
            change = np.zeros((len(row), 6, WIDTH))
            count = len(move.directions)
            change[:, :3, :count] = move.directions.T * share[:, None, None]
            at = position[row, column] - move.pivot
            if move.axis is not None:
                turn = exp(share[:, None] * value[3] * move.axis)
                at = rotate(turn, at)
                quat[row, column] = multiply(turn, quat[row, column])
                change[:, :3, 3] = share[:, None] * cross(np.broadcast_to(move.axis, at.shape), at)
                change[:, 3:, 3] = share[:, None] * move.axis
                matrix = to_matrix(turn)
                for other, its, mine in along:
                    before = effects[other].change
                    for half in (slice(0, 3), slice(3, 6)):
                        before[its, half] = matrix[mine] @ before[its, half]
            position[row, column] = (
                move.pivot + at + share[:, None] * (value[:count] @ move.directions)
            )
            effects.append(Effect(row, column, change))
        moved = dataclasses.replace(
            self.targets, position=position, quat=quat, matrix=to_matrix(quat)
        )
        return moved, effects
