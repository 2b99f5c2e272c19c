"""One frame is dragged into another pose, and the frames around follow (§4.4, Figure 2).

The first level spreads the pose of the edited frame alone. The feet around it stand where they are
to stand until the body moves, so their displacements would all be zero, and Eq. 2 would draw the
change back to a spike. The later levels put the feet back; what they leave, the exact pass takes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.apps.edit.hold import HOLDS, Held, Hold, keep
from mjmotion.apps.edit.pose import drag_pose
from mjmotion.apps.edit.span import Span
from mjmotion.body.kinematics import Kinematics, site_id, site_positions
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.constraints import SiteConstraint, lay_out
from mjmotion.constraints.unmet import find_unmet, residuals
from mjmotion.exceptions import ConstraintError, FitError, unknown_name
from mjmotion.fitting import TOLERANCE, Trace, run_level
from mjmotion.fitting.levels import BETTER, check_levels, check_tolerance
from mjmotion.fitting.trace import Stopwatch
from mjmotion.footsteps.contacts import Contact, check_contacts, detect_contacts
from mjmotion.footsteps.paths import with_toes
from mjmotion.ik import HybridIK, IKProblem, Solution
from mjmotion.ik.solver import default_rigidity
from mjmotion.numerics.smoothing import envelope
from mjmotion.numerics.tangent import ominus, oplus
from mjmotion.output.result import Result
from mjmotion.scene import with_ground

Array = NDArray[np.float64]

LEVELS = (12.0, 6.0, 3.0, 1.5)  # frames a knot of each level
ROOT_STIFFNESS = 200.0  # how much stiffer the root is after the first level, which moved it
REACH_TIME = 0.15  # scale on which the root sinks for a limb to reach [s]
_REACH_ROUNDS = 2
_EXTRA_LEVELS = 4  # at most, at the finest knots


def edit_frame(  # more than eight parameters: all but the first three have a default
    motion: Motion | str | Path,
    frame: int,
    site: str | Sequence[str],
    *,
    by: ArrayLike | None = None,
    to: ArrayLike | None = None,
    levels: Sequence[float] = LEVELS,
    tolerance: float = TOLERANCE,
    contacts: Sequence[Contact] | None = None,
    hold: Hold = "feet",
) -> Result:
    """Drag sites at one frame; the frames covered by seven knots of the first level follow.

    The whole pose is found by IK, so a pelvis that sinks bends the knees over feet that stay.
    Frames at the outermost of the seven knots and beyond stay to the bit.

    Args:
      motion: the motion; it is not touched; or a file or built-in name. It gets a floor if it has
        no ground.
      frame: which frame to change.
      site: what to drag, one or more sites.
      by: (3,) or one row a site, how far, along the world's axes [m].
      to: (3,) or one row a site, where to, in place of ``by`` [m].
      levels: frames a knot of each level, coarse to fine, one or more each; the first a whole
        number: the change covers the frames less than three knots of it away.
      tolerance: further levels follow while anything is off by more [m].
      contacts: who stands when; found in the motion without.
      hold: what stays where it was within the range: ``"feet"``, both feet on their paths, on the
        ground and in the air, and whatever else has contacts; ``"contacts"``, what stands, while it
        stands; ``"frame"``, what stands at the edited frame, and feet may slide at others.

    Returns:
      The unedited motion as ``source`` and the edited one on the same model, who stands when, the
      levels, and what could not be met: a drag is followed as far as nothing that is held gives.

    Raises:
      FitError: a frame that there is not, levels that make no sense.
      ConstraintError: neither or both of ``by`` and ``to``, or not one row a site.
      ModelError: an unknown site.
      ContactError: contacts that do not fit the motion.
    """
    motion = motion if isinstance(motion, Motion) else load_clip(motion)
    levels = _check(motion, frame, levels, hold)
    source = motion.on(with_ground(motion.character))
    stands = (
        detect_contacts(source)
        if contacts is None
        else check_contacts(contacts, source.model, source.nframe)
    )
    span = Span(frame, int(levels[0]), source.nframe)
    drags = _drags(source, frame, [site] if isinstance(site, str) else list(site), by, to)
    held = keep(source, stands, span, drags, hold)
    moved, held, trace = _Edit(source, span, held, drags).run(levels, check_tolerance(tolerance))
    asked = [*held.constraints(), *drags]
    targets = lay_out(asked, source.model, source.nframe)
    moved = with_toes(moved, held.paths)
    return Result(source, moved, held.contacts, trace, find_unmet(moved, targets, asked))


def deformation(edited: Result) -> Array:
    """Return how far the furthest moved body of every frame is from where it was (nframe,) [m]."""
    kinematics = Kinematics(edited.motion.model, edited.motion.nframe)
    before = np.array(kinematics.forward(edited.source.qpos).xpos)
    after = kinematics.forward(edited.motion.qpos).xpos
    return np.asarray(np.linalg.norm(after - before, axis=-1).max(axis=1))


def _check(motion: Motion, frame: int, levels: Sequence[float], hold: str) -> tuple[float, ...]:
    """Return the levels, if they and the rest make sense."""
    if not 0 <= frame < motion.nframe:
        raise FitError(
            f"frame {frame} is not within the motion's 0 to {motion.nframe - 1}: give one of those"
        )
    checked = check_levels(levels)
    if checked[0] != int(checked[0]) or checked[-1] < 1.0:
        raise FitError(
            f"levels {list(checked)} of an edit must begin with a whole number of frames a knot,"
            " and none may be below 1"
        )
    if hold not in HOLDS:
        raise FitError(unknown_name("hold", hold, HOLDS))
    return checked


def _drags(
    motion: Motion,
    frame: int,
    sites: list[str],
    by: ArrayLike | None,
    to: ArrayLike | None,
) -> list[SiteConstraint]:
    """Where the dragged sites are to be at the frame."""
    if (by is None) == (to is None):
        raise ConstraintError("a drag takes either by, how far, or to, where to")
    if not sites or len(set(sites)) < len(sites):
        raise ConstraintError(f"drag one or more different sites: got {', '.join(sites) or 'none'}")
    given = np.asarray(by if to is None else to, dtype=np.float64)
    if given.ndim == 1 and len(sites) == 1:
        given = given[None]
    if given.shape != (len(sites), 3):
        raise ConstraintError(
            f"by or to has shape {given.shape}: give 3 numbers for each of {len(sites)} sites"
        )
    ids = np.array([site_id(motion.model, name) for name in sites])
    if by is not None:
        given = given + site_positions(motion.model, motion.qpos[frame : frame + 1], ids)[0]
    at = np.array([frame])
    return [SiteConstraint(name, at, position) for name, position in zip(sites, given, strict=True)]


@dataclasses.dataclass(frozen=True, eq=False)
class _Edit:
    """Algorithm 1 on the frames of a span.

    Attributes:
      source: the motion before.
      span: the frames that may change.
      held: what stays.
      drags: what the user asks for.
    """

    source: Motion
    span: Span
    held: Held
    drags: list[SiteConstraint]

    def run(self, levels: Sequence[float], tolerance: float) -> tuple[Motion, Held, Trace]:
        """Return the edited motion, what it holds in the end, and what the levels did."""
        character, span = self.source.character, self.span
        model, qpos = character.model, np.array(self.source.qpos)
        watch = Stopwatch(character.height)
        pose, reached = self._pose()
        first = lay_out([*self.held.constraints(), *self.drags], model, self.source.nframe)
        before = float(residuals(self.source, first).max(initial=0.0))
        qpos = self._level(qpos, np.array([span.frame]), partial(_onto, model, pose), levels[0])
        watch.level(levels[0], before)
        held = self.held.relaxed(self.source, self.source.replace(qpos), span.fade)
        # The drags go on to hold what was reached: what is out of reach must not pull again.
        targets = lay_out([*held.constraints(), *reached], model, self.source.nframe)
        rigidity = default_rigidity(model)
        rigidity[:6] *= ROOT_STIFFNESS
        problem, frames = HybridIK(character, rigidity).prepare(targets), targets.frames
        qpos = self._reach(qpos, problem, frames, far=reached is not self.drags)
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
        closing = problem.enforce(qpos[frames]).displacement
        qpos[frames] = oplus(model, qpos[frames], closing)
        moved = self.source.replace(self._within_limits(qpos))
        left = float(residuals(moved, targets).max(initial=0.0))
        nscalar = sum(one.nscalar for one in [*held.constraints(), *self.drags])
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
        drags = [dataclasses.replace(drag, frames=np.zeros(1, np.int64)) for drag in self.drags]
        pose, share = drag_pose(alone, self.held.at(frame), drags)
        if share == 1.0:
            return pose, self.drags
        sites = np.array([site_id(model, drag.site) for drag in self.drags])
        reached = site_positions(model, pose, sites)[0]
        return pose, [
            dataclasses.replace(drag, position=position)
            for drag, position in zip(self.drags, reached, strict=True)
        ]

    def _reach(
        self, qpos: Array, problem: IKProblem, frames: NDArray[np.int64], far: bool
    ) -> Array:
        """Return poses (nframe, nq) whose root sinks or rises where a limb does not reach.

        Not outside the span, nor at the edited frame where the body was dragged. A limb that was
        dragged too far has drawn the body after it as far as the others reach: nothing gives.
        """
        ends = set(self.source.character.limb_by_end)
        fixed = np.ones(len(qpos), dtype=bool)
        fixed[self.span.frames] = False
        dragged = {self._body(drag) for drag in self.drags}
        if far and dragged <= ends:
            return qpos
        fixed[self.span.frame] = not dragged <= ends
        own, qpos = problem.enforce(self.source.qpos[frames]).rise, qpos.copy()
        for _ in range(_REACH_ROUNDS):
            rise = problem.enforce(qpos[frames]).rise
            if own is None or rise is None or not rise.any():
                return qpos
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
    if done < len(levels):
        return levels[done]
    better = len(errors) < 2 or errors[-1] < BETTER * errors[-2]
    most = len(levels) + (_EXTRA_LEVELS if len(levels) > 1 else 0)
    if errors[-1] <= tolerance or done >= most or not better:
        return None
    return levels[-1]


__all__ = ["LEVELS", "deformation", "edit_frame"]
