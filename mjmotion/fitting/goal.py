"""What a level solves for: its targets, moved first where they are free to move as a whole (§7).

    goal = Goal.begin(solver, character, targets, moves, clearance, qpos)
    goal = goal.advanced(qpos, last)        # free targets go where all frames deviate least
    solution = goal.solve(qpos[goal.targets.frames])

Moves add up over the levels, and so must the deviation that is to be kept least: it counts from the
first guess on.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.character import Character
from mjmotion.constraints import Targets
from mjmotion.constraints.shared_targets import SETTLED, SharedMove, SharedMoves
from mjmotion.exceptions import FitError
from mjmotion.ik.solver import (
    Clearance,
    Deviation,
    IKProblem,
    IKSolver,
    SensitiveProblem,
    Solution,
)
from mjmotion.numerics.tangent import ominus

Array = NDArray[np.float64]

_ASKED = 6  # frames of the shortest shared move that tell what moves would cost


@dataclasses.dataclass(frozen=True, eq=False)
class Goal:
    """The targets of one level, and the problem that they make.

    Attributes:
      targets: with the moves so far made.
      problem: the solver's, of those targets.
      last: what the level before answered.
      moves: (nmove, 4) what each shared move came to so far.
      settled: whether the moves hardly change any more.
    """

    targets: Targets
    problem: IKProblem
    last: Solution | None = None
    moves: Array = dataclasses.field(default_factory=lambda: np.zeros((0, 4)))
    settled: bool = True

    @classmethod
    def begin(
        cls,
        solver: IKSolver,
        character: Character,
        targets: Targets,
        moves: Sequence[SharedMove],
        clearance: Clearance | None,
        guess: Array,
    ) -> Goal:
        """Return the goal of the first level.

        Args:
          solver: the IK solver.
          character: whose poses they are.
          targets: what is to hold, without any move.
          moves: what is free to move as a whole.
          clearance: what to keep clear of.
          guess: (nframe, nq) the first guess.

        Raises:
          FitError: the solver makes no problems, or targets are free and it cannot say what they
            cost.
          ConstraintError: a move of targets that do not exist.
        """
        problem = solver.prepare(targets, clearance)
        for name in ("solve", "enforce"):
            if not callable(getattr(problem, name, None)):
                raise FitError(
                    f"{type(solver).__name__}.prepare() returned a {type(problem).__name__} without"
                    f" {name}(): see mjmotion.ik.solver.IKProblem"
                )
        if not moves:
            return cls(targets, problem)
        if not isinstance(problem, SensitiveProblem):
            raise FitError(
                f"{type(solver).__name__} has no sensitivity(), which targets that are free to move"
                " need: use ik='hybrid' or 'numeric', or hold them"
            )
        shared = SharedMoves(moves, targets, character.model)
        return FreeGoal(
            targets,
            problem,
            solver=solver,
            character=character,
            clearance=clearance,
            shared=shared,
            reference=guess[targets.frames],
            moves=np.zeros((len(moves), 4)),
            settled=False,
            deviation=Deviation(
                np.zeros((len(targets.frames), character.model.nv)), shared.touched
            ),
        )

    def advanced(self, qpos: Array, last: Solution | None) -> Goal:
        """Return the goal of the next level, for poses (nframe, nq); see :class:`FreeGoal`."""
        return dataclasses.replace(self, last=last)

    def solve(self, qpos: Array) -> Solution:
        """Return what the problem answers to poses (n, nq) at the targets' frames."""
        return self.problem.solve(qpos, self.last)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class FreeGoal(Goal):
    """A goal whose targets take part in the fit.

    Attributes:
      solver, character, clearance: what problems are made of.
      shared: the moves, laid out over the targets' frames.
      reference: (n, nq) the first guess at the targets' frames.
      deviation: of the poses from the reference, in the frames that any move has a share in.
    """

    solver: IKSolver
    character: Character
    clearance: Clearance | None
    shared: SharedMoves
    reference: Array
    deviation: Deviation

    def advanced(self, qpos: Array, last: Solution | None) -> Goal:
        """Return the goal of the next level: targets moved to where all frames deviate least.

        Frames that something was pushed out of are left alone from then on: they must not be drawn
        back in.
        """
        poses = qpos[self.targets.frames]
        counts = self.deviation.counts
        if last is not None and last.pushed is not None:
            counts = counts & ~last.pushed
        values = ominus(self.character.model, poses, self.reference) * counts[:, None]
        goal = dataclasses.replace(self, last=last, deviation=Deviation(values, counts))
        return goal if self.settled else goal._moved(poses)

    def _moved(self, poses: Array) -> FreeGoal:
        """Return the goal with a better move of its targets.

        What frames answer varies slowly: a few of the shortest move speak for all.
        """
        rows = self.shared.some_rows(_ASKED)
        some = self.solver.prepare(self.targets.at(rows), self.clearance)
        assert isinstance(some, SensitiveProblem)  # as begin() made sure
        sensitivity = some.sensitivity(poses[rows], self.deviation.at(rows), self.last)
        moves = self.shared.step(self.moves, self.targets, rows, sensitivity)
        targets = self.shared.moved(moves)
        return dataclasses.replace(
            self,
            targets=targets,
            problem=self.solver.prepare(targets, self.clearance),
            moves=moves,
            settled=bool(np.abs(moves - self.moves).max() < SETTLED),
        )

    def solve(self, qpos: Array) -> Solution:
        """Return what the problem answers, least together with the deviation there is."""
        return self.problem.solve(qpos, self.last, self.deviation)
