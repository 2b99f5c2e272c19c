"""One edit of the frames of a span: Algorithm 1 on those alone, with what is held (§4.4).

    edit = LocalEdit(source, span, held, rigidity)
    edited, held, trace = edit.run(drags, levels, tolerance)

The first level spreads the pose of the edited frame alone. The feet around it stand where they are
to stand until the body moves, so their displacements would all be zero, and Eq. 2 would draw the
change back to a spike. The later levels put the feet back; what they leave, the exact pass takes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import cached_property, partial

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.edit.hold import Held, Paths
from mjmotion.apps.edit.one_pose import Places
from mjmotion.apps.edit.pose import PoseSolver
from mjmotion.apps.edit.span import Span
from mjmotion.body.kinematics import body_dofs, site_id
from mjmotion.body.limbs import Limb
from mjmotion.body.motion import Motion
from mjmotion.constraints import SiteConstraint, Targets, lay_out
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
SLIGHT = 1e-4  # a limb that lacks no more of what counts as its reach is closed as it is [m]
_REACH_ROUNDS = 2
_EXTRA_LEVELS = 4  # at most, at the finest knots


@dataclasses.dataclass(frozen=True, eq=False)
class LocalEdit:
    """Algorithm 1 on the frames of a span, for one drag after another.

    Attributes:
      source: the motion before.
      span: the frames that may change.
      held: what stays, or goes where it was put.
      rigidity: (nv,) α of Eq. 4.
      guess: (nframe, 3) how far the root is moved first (§4.5), zero outside the span [m].
      ik: which solver the levels take.
    """

    source: Motion
    span: Span
    held: Held
    rigidity: Array
    guess: Array | None = None
    ik: str = "hybrid"

    def run(
        self,
        asked: Sequence[SiteConstraint],
        levels: Sequence[float],
        tolerance: float,
        exact: bool = True,
    ) -> tuple[Motion, Held, Trace]:
        """Return the edited motion, what it holds in the end, and what the levels did.

        Args:
          asked: what the user asks for: sites at one frame, or at several.
          levels: frames a knot of each, coarse to fine.
          tolerance: no further level follows once nothing is off by more [m].
          exact: whether what is held is closed at the end (§4.4).
        """
        character, span = self.source.character, self.span
        model, qpos = character.model, np.array(self.source.qpos)
        asked = [self._by_posed_site(one) for one in asked]
        if self.guess is not None:
            qpos[:, :3] += self.guess
        watch, reached = Stopwatch(character.height), list(asked)
        if asked and span.length == 1:
            pose, reached, before = self._pose(asked)
            onto = partial(_onto, model, pose)
            qpos = self._level(qpos, np.array([span.frame]), onto, levels[0])
            watch.level(levels[0], before)
        held = self.held
        if not np.array_equal(qpos[:, :7], self.source.qpos[:, :7]) or self._moves_feet(asked):
            held = held.relaxed(self.source.put(qpos), span.fade, self._own_paths)
        # The drags go on to hold what was reached: what is out of reach must not pull again.
        staying = held.constraints()
        asks = [*staying, *reached]
        nscalar = sum(one.nscalar for one in [*staying, *asked])
        # Of those, limbs' ends: the first level has put what is dragged elsewhere in its place.
        ends = self.source.character.limb_by_end
        on_limbs = [*staying, *(one for one in reached if self._body(one) in ends)]
        targets = lay_out(on_limbs, model, self.source.nframe)
        far = any(new is not old for new, old in zip(reached, asked, strict=True))
        problem = self._problem(targets)
        qpos, closing = self._reach(qpos, problem, targets.frames, asked, far)
        if self._lets_go(targets, closing):
            if all(self._on_limb(one) for one in self.held.others):
                closed = self._closed_levels(qpos, closing, targets, (levels, tolerance), watch)
            else:
                targets = lay_out(asks, model, self.source.nframe)
                closed = self._levels(qpos, targets, levels, tolerance, watch)
            qpos, closing, errors = closed
        else:
            # Closing follows the body as smoothly as the body moves: splines have nothing to do.
            errors = [float(closing.error.max(initial=0.0))]
        if exact:
            qpos[targets.frames] = oplus(model, qpos[targets.frames], closing.displacement)
        bent = with_toes(self.source.put(self._within_limits(qpos)), held.paths)
        moved = self.source.replace(bent.qpos)
        left = self._off(moved.qpos[targets.frames], targets)
        return moved, held, watch.trace(errors[-1], left, nscalar)

    def _closed_levels(
        self,
        qpos: Array,
        closing: Solution,
        targets: Targets,
        until: tuple[Sequence[float], float],
        watch: Stopwatch,
    ) -> tuple[Array, Solution, list[float]]:
        """Return poses after the levels, what closes them, and the errors before each [m].

        The body is where the first level put it, and stays: the limbs' poses that every level goes
        towards are known before the first of them.
        """
        model, frames = self.source.model, targets.frames
        goals = oplus(model, qpos[frames], closing.displacement)
        errors = [float(closing.error.max(initial=0.0))]
        watch.start()
        levels, tolerance = until
        while (apart := _next_level(levels, len(watch), errors, tolerance)) is not None:
            qpos = self._level(qpos, frames, partial(_onto, model, goals), apart)
            watch.level(apart, errors[-1])
            errors.append(self._off(qpos[frames], targets))
        return qpos, _onto(model, goals, qpos[frames]), errors

    def _levels(
        self,
        qpos: Array,
        targets: Targets,
        levels: Sequence[float],
        tolerance: float,
        watch: Stopwatch,
    ) -> tuple[Array, Solution, list[float]]:
        """Return the same where more than limbs is held, and the body moves on with each level."""
        problem, frames = self._problem(targets), targets.frames
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
        return qpos, problem.enforce(qpos[frames]), errors

    def _off(self, qpos: Array, targets: Targets) -> float:
        """Return how far the worst site of poses (n, nq) at the targets' frames is off [m]."""
        gap = targets.position - self.positions(qpos, targets.sites)
        far = np.einsum("nsi,nsi->ns", gap, gap) * (targets.position_weight > 0.0)
        return float(np.sqrt(far.max(initial=0.0)))

    def positions(self, qpos: Array, sites: NDArray[np.int64]) -> Array:
        """Return where sites (s,) are in poses (n, nq) of the body: (n, s, 3) [m]."""
        return self._places(qpos, sites)

    @cached_property
    def _places(self) -> Places:
        return Places(self.source.model)

    def _problem(self, targets: Targets) -> IKProblem:
        """Return the problem of some targets; the root, which has moved already, is stiff."""
        rigidity = np.array(self.rigidity)
        rigidity[:6] *= ROOT_STIFFNESS
        return make_solver(self.source.character, self.ik, rigidity).prepare(targets)

    def _lets_go(self, targets: Targets, closing: Solution) -> bool:
        """Return whether a site that must be closed is let go somewhere within the span."""
        within = self.span.frames
        present = np.isin(within, targets.frames)
        held = np.maximum(targets.position_weight, targets.turn_weight) > 0.0
        always = held[np.isin(targets.frames, within)].all(axis=0) & present.all()
        moves = np.abs(closing.displacement).max(axis=0, initial=0.0) > SAME
        model = self.source.model
        parted = [
            (moves & body_dofs(model, int(model.site_bodyid[site]))).any()
            for site in targets.sites[~always]
        ]
        return any(parted) or bool(targets.relational.any())

    def _on_limb(self, one: SiteConstraint) -> bool:
        limbs = self.source.character.limbs
        return self._body(one) in {
            part for limb in limbs for part in (limb.upper, limb.lower, limb.end)
        }

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

    def _pose(self, asked: Sequence[SiteConstraint]) -> tuple[Array, list[SiteConstraint], float]:
        """Return the edited frame's pose (1, nq), drags to where it came, and how far that was."""
        model, (alone, held, own) = self.source.model, self._alone
        drags = [dataclasses.replace(drag, frames=np.zeros(1, np.int64)) for drag in asked]
        names = tuple(one.site for one in asked)
        if names not in self._solvers:
            self._solvers[names] = PoseSolver.of(self.source.character, names, self.rigidity)
        solver = self._solvers[names]
        sites = np.array([site_id(model, name) for name in names])
        was = solver.positions(alone.qpos, sites)
        pose, there = solver.drag(alone, held, drags, own)
        wanted = np.concatenate([np.asarray(one.position) for one in drags])
        way = float(np.linalg.norm(wanted - was, axis=1).max())
        if there:
            return pose, list(asked), way
        came = solver.positions(pose, sites)
        reached = [
            dataclasses.replace(drag, position=position)
            for drag, position in zip(asked, came, strict=True)
        ]
        return pose, reached, way

    @cached_property
    def _solvers(self) -> dict[tuple[str, ...], PoseSolver]:
        """Solvers of the edited frame by what is dragged: drags go on with the same sites."""
        return {}

    def _reach(
        self,
        qpos: Array,
        problem: IKProblem,
        frames: NDArray[np.int64],
        asked: Sequence[SiteConstraint],
        far: bool,
    ) -> tuple[Array, Solution]:
        """Return poses (nframe, nq) whose root sinks or rises where a limb does not reach.

        Not outside the span, nor at an edited frame where the body was dragged. A limb that was
        dragged too far has drawn the body after it as far as the others reach: nothing gives.

        Returns:
          poses, and what closes the limbs there.
        """
        ends = set(self.source.character.limb_by_end)
        fixed = np.ones(len(qpos), dtype=bool)
        fixed[self.span.frames] = False
        dragged = {self._body(drag) for drag in asked}
        closing = problem.enforce(qpos[frames])
        if far and dragged <= ends:
            return qpos, closing
        fixed[self.span.frame : self.span.last + 1] |= bool(dragged) and not dragged <= ends
        own, qpos = None, qpos.copy()
        for _ in range(_REACH_ROUNDS):
            rise = closing.rise
            if rise is None or not rise.any():
                break
            if own is None:
                own = self._own_rise(problem, frames, on_limbs=bool(dragged & ends))
            gives = False
            for sign in (1.0, -1.0):
                need = np.zeros(len(qpos))
                # Legs that were straight already are the source's own.
                need[frames] = np.maximum(sign * rise, 0.0) - np.maximum(sign * own, 0.0)
                need[fixed] = 0.0
                if (need > SLIGHT).any():
                    give = sign * envelope(need, fixed, REACH_TIME * self.source.fps)
                    qpos[self.span.frames, 2] += give[self.span.frames]
                    gives = True
            if not gives:
                break
            closing = problem.enforce(qpos[frames])
        return qpos, closing

    def _own_rise(self, problem: IKProblem, frames: NDArray[np.int64], on_limbs: bool) -> Array:
        """Return how far the source's own root lacks of its limbs' reach (n,) [m]."""
        if not on_limbs and len(self._held_rise) == len(frames):
            return self._held_rise
        rise = problem.enforce(self.source.qpos[frames]).rise
        return np.zeros(len(frames)) if rise is None else rise

    @cached_property
    def _held_rise(self) -> Array:
        """The same with what is held alone, wherever a drag goes."""
        targets = lay_out(self.held.constraints(), self.source.model, self.source.nframe)
        rise = self._problem(targets).enforce(self.source.qpos[targets.frames]).rise
        return np.zeros(len(targets.frames)) if rise is None else rise

    def _by_posed_site(self, drag: SiteConstraint) -> SiteConstraint:
        """Return the drag of a heel or toe as that of its foot's posed site: it goes along."""
        feet = [foot for foot in self.held.feet if foot.body == self._body(drag)]
        if not feet or drag.position is None or self.span.length != 1 or drag.quat is not None:
            return drag
        frame = self.source.qpos[self.span.frame : self.span.frame + 1]
        sites = np.array([site_id(self.source.model, name) for name in (drag.site, feet[0].site)])
        here, posed = self.positions(frame, sites)[0]
        return dataclasses.replace(drag, site=feet[0].site, position=drag.position + (posed - here))

    def _moves_feet(self, asked: Sequence[SiteConstraint]) -> bool:
        """Return whether what is dragged is of a leg."""
        legs = [limb for foot in self.held.feet if (limb := self._limb(foot.body)) is not None]
        parts = {part for limb in legs for part in (limb.upper, limb.lower, limb.end)}
        return any(self._body(one) in parts for one in asked)

    def _limb(self, body: int) -> Limb | None:
        return self.source.character.limb_by_end.get(body)

    def _body(self, drag: SiteConstraint) -> int:
        model = self.source.model
        return int(model.site_bodyid[site_id(model, drag.site)])

    @cached_property
    def _own_paths(self) -> Paths:
        """The feet's paths as the source's ankles can follow them."""
        return self.held.own(self.source)

    @cached_property
    def _alone(self) -> tuple[Motion, Held, Paths]:
        """The edited frame as a motion, what is held there, and how ankles can follow that."""
        frame = self.span.frame
        alone, held = self.source.replace(self.source.qpos[frame : frame + 1]), self.held.at(frame)
        return alone, held, held.own(alone)

    @cached_property
    def _own_excess(self) -> Array:
        """How far joints of the source are out of their limits in the span's frames."""
        excess = self.source.character.limits.excess(self.source.qpos[self.span.frames])
        return np.asarray(excess.max(axis=1, initial=0.0))

    def _within_limits(self, qpos: Array) -> Array:
        """Return poses within joint limits, where the source was not further out itself."""
        character, within = self.source.character, self.span.frames
        qpos = qpos.copy()
        if character.coupling:
            qpos[within] = character.coupling.couple(qpos[within])
        excess = character.limits.excess(qpos[within]).max(axis=1, initial=0.0)
        worse = excess > self._own_excess
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
