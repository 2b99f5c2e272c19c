"""One edit of the frames of a span: Algorithm 1 on those alone, with what is held (§4.4).

    edit = LocalEdit(source, span, held, drags, solver)
    edited = edit.run(levels, tolerance)

The first level spreads the pose of the edited frame alone. The feet around it stand where they are
to stand until the body moves, so their displacements would all be zero, and Eq. 2 would draw the
change back to a spike. The later levels put the feet back; what they leave, the exact pass takes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.edit.hold import Held
from mjmotion.apps.edit.pose import PoseSolver
from mjmotion.apps.edit.span import Span
from mjmotion.body.kinematics import site_id, site_positions
from mjmotion.body.motion import Motion
from mjmotion.constraints import SiteConstraint, lay_out
from mjmotion.constraints.unmet import residuals
from mjmotion.fitting import Trace, run_level
from mjmotion.fitting.levels import BETTER
from mjmotion.fitting.trace import Stopwatch
from mjmotion.footsteps.paths import with_toes
from mjmotion.ik import IKProblem, Solution, make_solver
from mjmotion.numerics.smoothing import envelope
from mjmotion.numerics.tangent import ominus, oplus

Array = NDArray[np.float64]

ROOT_STIFFNESS = 200.0  # how much stiffer the root is after the first level, which moved it
REACH_TIME = 0.15  # scale on which the root sinks for a limb to reach [s]
SAME = 1e-7  # with nothing off by more, there is nothing left for a level to do [m]
_REACH_ROUNDS = 2
_EXTRA_LEVELS = 4  # at most, at the finest knots


@dataclasses.dataclass(frozen=True, eq=False)
class LocalEdit:
    """Algorithm 1 on the frames of a span.

    Attributes:
      source: the motion before.
      span: the frames that may change.
      held: what stays, or goes where it was put.
      asked: what the user asks for.
      rigidity: (nv,) α of Eq. 4.
      guess: (nframe, 3) how far the root is moved first (§4.5), zero outside the span [m].
      ik: which solver the levels take.
    """

    source: Motion
    span: Span
    held: Held
    asked: list[SiteConstraint]
    rigidity: Array
    guess: Array | None = None
    ik: str = "hybrid"

    def run(
        self, levels: Sequence[float], tolerance: float, exact: bool = True
    ) -> tuple[Motion, Held, Trace]:
        """Return the edited motion, what it holds in the end, and what the levels did."""
        character, span = self.source.character, self.span
        model, qpos = character.model, np.array(self.source.qpos)
        if self.guess is not None:
            qpos[:, :3] += self.guess
        watch, reached = Stopwatch(character.height), self.asked
        single = bool(self.asked) and span.length == 1
        if single:
            pose, reached = self._pose()
            first = lay_out([*self.held.constraints(), *self.asked], model, self.source.nframe)
            before = float(residuals(self.source, first).max(initial=0.0))
            onto = partial(_onto, model, pose)
            qpos = self._level(qpos, np.array([span.frame]), onto, levels[0])
            watch.level(levels[0], before)
        held = self.held.relaxed(self.source, self.source.replace(qpos), span.fade)
        # The drags go on to hold what was reached: what is out of reach must not pull again.
        targets = lay_out([*held.constraints(), *reached], model, self.source.nframe)
        rigidity = np.array(self.rigidity)
        rigidity[:6] *= ROOT_STIFFNESS
        problem = make_solver(character, self.ik, rigidity).prepare(targets)
        frames = targets.frames
        qpos = self._reach(qpos, problem, frames, far=reached is not self.asked)
        watch.start()
        last, errors = None, []
        while True:
            last = problem.solve(qpos[frames], last)
            errors.append(float(last.error.max(initial=0.0)))
            frames_per_knot = _next_level(levels, len(watch), errors, tolerance)
            if frames_per_knot is None:
                break
            qpos = self._level(qpos, frames, partial(_answered, last), frames_per_knot)
            watch.level(frames_per_knot, errors[-1])
        if exact:
            closing = problem.enforce(qpos[frames]).displacement
            qpos[frames] = oplus(model, qpos[frames], closing)
        moved = with_toes(self.source.replace(self._within_limits(qpos)), held.paths)
        left = float(residuals(moved, targets).max(initial=0.0))
        nscalar = sum(one.nscalar for one in [*held.constraints(), *self.asked])
        return moved, held, watch.trace(errors[-1], left, nscalar)

    def _level(
        self,
        qpos: Array,
        frames: NDArray[np.int64],
        solve: Callable[[Array], Solution],
        frames_per_knot: float,
    ) -> Array:
        """Return poses (nframe, nq) after one level, whose spline is at rest at the span's ends."""

        def spline(solution: Solution) -> Array:
            submap = np.zeros((len(qpos), self.source.model.nv))
            spread = self.span.spread(frames, solution.displacement, frames_per_knot)
            submap[self.span.frames] = spread
            return submap

        return run_level(self.source.character, qpos, frames, solve, spline).qpos

    def _pose(self) -> tuple[Array, list[SiteConstraint]]:
        """Return the edited frame's pose (1, nq), and drags to where it came."""
        model, frame = self.source.model, self.span.frame
        alone = self.source.replace(self.source.qpos[frame : frame + 1])
        drags = [dataclasses.replace(drag, frames=np.zeros(1, np.int64)) for drag in self.asked]
        names = [drag.site for drag in self.asked]
        solver = PoseSolver.of(self.source.character, names, self.rigidity)
        pose, share = solver.drag(alone, self.held.at(frame), drags)
        if share == 1.0:
            return pose, self.asked
        sites = np.array([site_id(model, drag.site) for drag in self.asked])
        reached = site_positions(model, pose, sites)[0]
        return pose, [
            dataclasses.replace(drag, position=position)
            for drag, position in zip(self.asked, reached, strict=True)
        ]

    def _reach(
        self, qpos: Array, problem: IKProblem, frames: NDArray[np.int64], far: bool
    ) -> Array:
        """Return poses (nframe, nq) whose root sinks or rises where a limb does not reach.

        Not outside the span, nor at an edited frame where the body was dragged. A limb that was
        dragged too far has drawn the body after it as far as the others reach: nothing gives.
        """
        ends = set(self.source.character.limb_by_end)
        fixed = np.ones(len(qpos), dtype=bool)
        fixed[self.span.frames] = False
        dragged = {self._body(drag) for drag in self.asked}
        if far and dragged <= ends:
            return qpos
        fixed[self.span.frame : self.span.last + 1] |= bool(dragged) and not dragged <= ends
        own, qpos = None, qpos.copy()
        for _ in range(_REACH_ROUNDS):
            rise = problem.enforce(qpos[frames]).rise
            if rise is None or not rise.any():
                return qpos
            own = problem.enforce(self.source.qpos[frames]).rise if own is None else own
            assert own is not None
            for sign in (1.0, -1.0):
                need = np.zeros(len(qpos))
                # Legs that were straight already are the source's own.
                need[frames] = np.maximum(sign * rise, 0.0) - np.maximum(sign * own, 0.0)
                need[fixed] = 0.0
                if need.any():
                    give = sign * envelope(need, fixed, REACH_TIME * self.source.fps)
                    qpos[self.span.frames, 2] += give[self.span.frames]
        return qpos

    def _body(self, drag: SiteConstraint) -> int:
        model = self.source.model
        return int(model.site_bodyid[site_id(model, drag.site)])

    def _within_limits(self, qpos: Array) -> Array:
        """Return poses within joint limits, where the source was not further out itself."""
        character, within = self.source.character, self.span.frames
        qpos = qpos.copy()
        if character.coupling:
            qpos[within] = character.coupling.couple(qpos[within])
        limits = character.limits
        excess = limits.excess(qpos[within]).max(axis=1, initial=0.0)
        worse = excess > limits.excess(self.source.qpos[within]).max(axis=1, initial=0.0)
        qpos[within[worse]] = character.within_limits(qpos[within[worse]])
        return qpos


def _onto(model: mujoco.MjModel, pose: Array, qpos: Array) -> Solution:
    """Return what brings one pose (1, nq) on to another that is known: IK has found it already."""
    return Solution(ominus(model, pose, qpos), np.zeros(1))


def _answered(solution: Solution, qpos: Array) -> Solution:
    """Return what was answered to poses (n, nq) before it was decided that a level follows."""
    return solution


def _next_level(
    levels: Sequence[float], done: int, errors: Sequence[float], tolerance: float
) -> float | None:
    """Return frames a knot of the next level, or None; the finest again while that pays."""
    if errors[-1] <= min(tolerance, SAME):
        return None
    if done < len(levels):
        return levels[done]
    better = len(errors) < 2 or errors[-1] < BETTER * errors[-2]
    most = len(levels) + (_EXTRA_LEVELS if len(levels) > 1 else 0)
    if errors[-1] <= tolerance or done >= most or not better:
        return None
    return levels[-1]
