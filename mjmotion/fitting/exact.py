"""The exact pass of §4.4: constrained frames meet their targets, within limits, without jerks."""

from __future__ import annotations

import dataclasses
import math
from functools import cached_property, partial

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.bones import Bones
from mjmotion.body.motion import Motion
from mjmotion.constraints import Targets
from mjmotion.fitting.level import run_level
from mjmotion.fitting.submap import fit_submap
from mjmotion.ik.numeric import NumericIK
from mjmotion.ik.solver import IKProblem, Solution, default_rigidity
from mjmotion.numerics.bspline import fit_level
from mjmotion.numerics.smoothing import cover
from mjmotion.numerics.tangent import oplus

Array = NDArray[np.float64]

RISE_TIME = 0.25  # over how long the root rises or sinks for a limb to reach at last [s]
LIMIT_SLACK = 1e-5  # how far a closed limb may be out of its range before the root gives [rad]
HOPELESS = 0.35  # what is further out would take the body off its feet: the root leaves it [rad]
EASE_TURN = 10.0  # rigidity of the root against turning where it gives, against moving [1/rad²]
_EASES = 4
_PASSES = 2  # times that Eq. 2 is applied at a level's knots
_FOLLOWS = 3  # levels in which limbs follow a root that has moved
_BETTER = 0.8  # the root gives again only while that leaves less than this share of what was over


@dataclasses.dataclass(frozen=True, eq=False)
class ExactPass:
    """Makes poses meet their targets exactly, with the body where the levels left it.

    Attributes:
      motion: the motion that is fitted; its model and rate.
      problem: closes the limbs; of the same targets.
      targets: what is to hold.
      frames_per_knot: of the coarsest level.
      bones: a body for each frame, where it changes.
    """

    motion: Motion
    problem: IKProblem
    targets: Targets
    frames_per_knot: float
    bones: Bones | None

    def __call__(self, qpos: Array) -> tuple[Array, float]:
        """Return poses (nframe, nq) that meet the targets, and the error before [m].

        Where a limb would not reach, or would leave its range, the root gives first, over more
        frames than those, so that nothing jerks.
        """
        fitted = qpos
        solution = self.problem.enforce(qpos[self.targets.frames])
        error = float(solution.error.max(initial=0.0))
        qpos, known = self._within_reach(qpos, solution)
        closed, beyond = self._closed(qpos, known)
        before, turn, frames = math.inf, 0, self.targets.frames
        # What no smooth move of the root mends stays within limits, and is reported.
        while beyond.max() > LIMIT_SLACK and turn < _EASES and beyond.max() <= _BETTER * before:
            before, turn = float(beyond.max()), turn + 1
            qpos = self._ease(qpos, np.flatnonzero(beyond > LIMIT_SLACK))
            # A root that gave for a joint may have left a leg behind.
            qpos, known = self._within_reach(qpos, self.problem.enforce(qpos[frames]))
            closed, beyond = self._closed(qpos, known)
        qpos, closed = self._standing_last(qpos, closed)
        if qpos is not fitted and (followed := self._follow(qpos)) is not qpos:
            closed, _ = self._closed(followed)
        return closed, error

    def _within_reach(self, qpos: Array, solution: Solution) -> tuple[Array, Solution | None]:
        """Let the root rise or sink for limbs that do not reach; None where it did."""
        if solution.rise is None or not solution.rise.any():
            return qpos, solution
        moved = qpos.copy()
        moved[:, 2] += self._spread(solution.rise)
        return moved, None

    def _standing_last(self, qpos: Array, closed: Array) -> tuple[Array, Array]:
        """Let what stands have the last word on the root: a hand out of reach takes no foot along.

        Returns:
          poses with the root where legs reach, and the same closed.
        """
        if not self.targets.contact.any() or self.targets.contact.all():
            return qpos, closed
        rise = self.problem.enforce(qpos[self.targets.frames]).standing_rise
        if rise is None or not rise.any():
            return qpos, closed
        moved = qpos.copy()
        moved[:, 2] += self._spread(rise)
        return moved, self._closed(moved)[0]

    def _closed(self, qpos: Array, solution: Solution | None = None) -> tuple[Array, Array]:
        """Return poses that meet the targets, within limits, and how far they were out (n,).

        Of what the root gives for; frames that are hopelessly far out count as none.
        """
        frames, model = self.targets.frames, self.motion.model
        closed = qpos.copy()
        if solution is None:
            solution = self.problem.enforce(qpos[frames])
        closed[frames] = oplus(model, qpos[frames], solution.displacement)
        clamped = self.motion.character.within_limits(closed)
        off = np.abs(clamped[frames] - closed[frames])
        beyond = np.where(self._standing, off, 0.0).max(axis=1)
        return clamped, np.where(beyond < HOPELESS, beyond, 0.0)

    @cached_property
    def _standing(self) -> NDArray[np.bool_]:
        """Which numbers of a pose (n, nq) the root gives for: of limbs that stand or hold on.

        Where nothing does, of all. A hand that is asked for more than an arm does must not take a
        foot off its place.
        """
        character, targets = self.motion.character, self.targets
        model, stands = character.model, targets.contact.any(axis=1)
        counts = np.zeros((len(targets.frames), model.nq), dtype=bool)
        counts[~stands] = True
        for column, site in enumerate(targets.sites):
            limb = character.limb_by_end.get(int(model.site_bodyid[site]))
            if limb is None:
                counts[targets.contact[:, column]] = True
                continue
            for body in (limb.upper, limb.lower, limb.end):
                first = int(model.jnt_qposadr[model.body_jntadr[body]])
                ball = model.jnt_type[model.body_jntadr[body]] == mujoco.mjtJoint.mjJNT_BALL
                counts[targets.contact[:, column], first : first + (4 if ball else 1)] = True
        return counts

    def _spread(self, rise: Array) -> Array:
        """Spread smoothly over frames (nframe,) what the root must rise or sink at some."""
        spread = np.zeros(self.motion.nframe)
        for sign in (1.0, -1.0):
            need = np.zeros(self.motion.nframe)
            need[self.targets.frames] = sign * rise
            spread += sign * cover(need, RISE_TIME * self.motion.fps)
        return spread

    def _follow(self, qpos: Array) -> Array:
        """Take limbs along after a root that has moved, smoothly past where they are let go.

        A hand that is held at some frames stays there; in the frames beside them it would still be
        where the old root had it.
        """
        targets, nframe = self.targets, self.motion.nframe
        held = np.maximum(targets.position_weight, targets.turn_weight) > 0.0
        if len(held) == nframe and held.all() and not (targets.relative or targets.look_at):
            return qpos
        character = self.motion.character
        for halving in range(1, _FOLLOWS + 1):
            frames_per_knot = self.frames_per_knot / 2.0**halving
            spline = partial(
                fit_submap, character, targets, nframe, frames_per_knot, _PASSES, fit_level
            )
            qpos = run_level(character, qpos, targets.frames, self.problem.enforce, spline).qpos
        return qpos

    def _ease(self, qpos: Array, rows: NDArray[np.int64]) -> Array:
        """Move the root, smoothly, where closed limbs would leave their range.

        The numeric solver knows limits and finds where the root would have to be at those frames; a
        level of its own spreads that to the frames around them.
        """
        character, frames = self.motion.character, self.targets.frames[rows]
        rigidity = default_rigidity(character.model)
        rigidity[:3], rigidity[3:6] = 1.0, EASE_TURN
        solver = NumericIK(character, rigidity, iterations=4, bones=self.bones)
        problem = solver.prepare(self.targets.at(rows))
        frames_per_knot = min(self.frames_per_knot, RISE_TIME * self.motion.fps)

        def root_alone(solution: Solution) -> Array:
            submap = np.zeros((self.motion.nframe, character.model.nv))
            root = solution.displacement[:, :6]
            submap[:, :6] = fit_level(frames, root, self.motion.nframe, frames_per_knot)
            return submap

        return run_level(character, qpos, frames, problem.solve, root_alone).qpos
