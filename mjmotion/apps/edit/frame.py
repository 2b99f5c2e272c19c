"""One frame is dragged into another pose, and the frames around follow (§4.4, Figure 2).

The first level spreads the pose of the edited frame alone. The feet around it stand where they are
to stand until the body moves, so their displacements would all be zero, and Eq. 2 would draw the
change back to a spike. The later levels put the feet back; what they leave, the exact pass takes.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.apps.edit.hold import HOLDS, Held, Hold, keep
from mjmotion.apps.edit.pose import drag_pose
from mjmotion.apps.edit.span import Span
from mjmotion.body.joint_coupling import couple, coupling
from mjmotion.body.joint_limits import limit_excess
from mjmotion.body.kinematics import Kinematics, character_height, site_id, site_positions
from mjmotion.body.limbs import find_limbs
from mjmotion.body.motion import Motion
from mjmotion.constraints import SiteConstraint, Targets, lay_out
from mjmotion.exceptions import ConstraintError, FitError, unknown_name
from mjmotion.fitting import LevelTrace, Trace, find_unmet, residuals
from mjmotion.fitting.exact import within_limits
from mjmotion.footsteps.contacts import Contact, check_contacts, detect_contacts
from mjmotion.ik.hybrid import HybridIK
from mjmotion.ik.solver import default_weights
from mjmotion.numerics.smoothing import envelope
from mjmotion.numerics.tangent import ominus, oplus
from mjmotion.output.result import Result
from mjmotion.scene import with_ground

Array = NDArray[np.float64]

ROOT_STIFFNESS = 200.0  # how much stiffer the root is after the first level, which moved it
FINEST = 1.0  # frames a knot below which no level goes
MET = 1e-4  # further levels follow while anything is off by more [m]
REACH_TIME = 0.15  # scale on which the root sinks for a limb to reach [s]
_REACH_ROUNDS = 2
_EXTRA_LEVELS = 4  # at most, at the finest spacing
_BETTER = 0.8  # a further level only while each leaves less than this share of the one before


def edit_frame(
    motion: Motion,
    frame: int,
    site: str | Sequence[str],
    *,
    by: ArrayLike | None = None,
    to: ArrayLike | None = None,
    spacing: int = 12,
    levels: int = 4,
    contacts: Sequence[Contact] | None = None,
    hold: Hold = "feet",
    character: str | Path = "humanoid",
) -> Result:
    """Drag sites at one frame; the frames covered by seven knots follow.

    The whole pose is found by IK, so a pelvis that sinks bends the knees over feet that stay.
    Frames at the outermost of the seven knots and beyond stay to the bit.

    Args:
      motion: the motion; it is not touched.
      frame: which frame to change.
      site: what to drag, one or more sites.
      by: (3,) or one row a site, how far, along the world's axes [m].
      to: (3,) or one row a site, where to, in place of ``by`` [m].
      spacing: frames between the knots of the first level: the change covers the frames less than
        three spacings away.
      levels: how many levels, each with knots half as far apart, down to one frame a knot.
      contacts: who stands when; found in the motion without.
      hold: what stays where it was within the range: ``"feet"``, both feet on their paths, on the
        ground and in the air, and whatever else has contacts; ``"contacts"``, what stands, while it
        stands; ``"frame"``, what stands at the edited frame, and feet may slide at others.
      character: the MJCF of the motion's model; it gets a floor if it has no ground.

    Returns:
      The unedited motion as ``source`` and the edited one on the same model, who stands when, the
      levels, and what could not be met: a drag is followed as far as nothing that is held gives.

    Raises:
      FitError: a frame that there is not, a spacing or number of levels below 1.
      ConstraintError: neither or both of ``by`` and ``to``, or not one row a site.
      ModelError: an unknown site, or a character with other joints than the motion's.
      ContactError: contacts that do not fit the motion.
    """
    _check(motion, frame, spacing, levels, hold)
    began = time.perf_counter()
    spec = with_ground(character)
    source = motion.on(spec.compile())
    stands = (
        detect_contacts(source)
        if contacts is None
        else check_contacts(contacts, source.model, source.nframe)
    )
    span = Span(frame, spacing, source.nframe)
    drags = _drags(source, frame, [site] if isinstance(site, str) else list(site), by, to)
    held = keep(source, stands, span, drags, hold)
    moved, held, trace = _Edit(source, span, held, drags).run(levels, began)
    asked = lay_out([*held.constraints(), *drags], source.model, source.nframe)
    unmet = find_unmet(moved, asked, residuals(moved, asked))
    return Result(source, moved, held.contacts, trace, unmet, spec)


def deformation(edited: Result) -> Array:
    """Return how far the furthest moved body of every frame is from where it was (nframe,) [m]."""
    kinematics = Kinematics(edited.motion.model, edited.motion.nframe)
    before = np.array(kinematics.forward(edited.source.qpos).xpos)
    after = kinematics.forward(edited.motion.qpos).xpos
    return np.asarray(np.linalg.norm(after - before, axis=-1).max(axis=1))


def _check(motion: Motion, frame: int, spacing: int, levels: int, hold: str) -> None:
    if not 0 <= frame < motion.nframe:
        raise FitError(
            f"frame {frame} is not within the motion's 0 to {motion.nframe - 1}: give one of those"
        )
    if spacing != int(spacing) or spacing < 1:
        raise FitError(f"spacing {spacing} must be a whole number of frames, 1 or more")
    if levels != int(levels) or levels < 1:
        raise FitError(f"levels {levels} must be a whole number, 1 or more")
    if hold not in HOLDS:
        raise FitError(unknown_name("hold", hold, HOLDS))


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

    def run(self, levels: int, began: float) -> tuple[Motion, Held, Trace]:
        """Return the edited motion, what it holds in the end, and what the levels did."""
        model, span = self.source.model, self.span
        percent = 100.0 / character_height(model)
        start = time.perf_counter()
        pose, reached = self._pose()
        qpos = np.array(self.source.qpos)
        displacement = ominus(model, pose, qpos[span.frame : span.frame + 1])
        self._move(qpos, np.array([span.frame]), displacement, float(span.spacing))
        took = [(float(span.spacing), time.perf_counter() - start)]
        held = self.held.given(self.source, self.source.replace(qpos), span.fade)
        # The drags go on to hold what was reached: what is out of reach must not pull again.
        targets = lay_out([*held.constraints(), *reached], model, self.source.nframe)
        first = lay_out([*held.constraints(), *self.drags], model, self.source.nframe)
        before = float(residuals(self.source, first).max(initial=0.0))
        weights = default_weights(model)
        weights[:6] *= ROOT_STIFFNESS
        solver = HybridIK(model, weights)
        self._reach(qpos, solver, targets, far=reached is not self.drags)
        errors: list[float] = []
        spacings = [span.spacing / 2**level for level in range(1, levels)]
        queue = [spacing for spacing in spacings if spacing >= FINEST]
        most = 1 + len(queue) + (_EXTRA_LEVELS if levels > 1 else 0)
        while True:
            start = time.perf_counter()
            solution = solver.solve(qpos[targets.frames], targets)
            errors.append(float(solution.error.max(initial=0.0)))
            if not queue:
                better = len(errors) < 2 or errors[-1] < _BETTER * errors[-2]
                if errors[-1] <= MET or len(took) >= most or not better:
                    break
                queue.append(took[-1][0])
            spacing = queue.pop(0)
            self._move(qpos, targets.frames, solution.displacement, spacing)
            took.append((spacing, time.perf_counter() - start))
        closing = solver.enforce(qpos[targets.frames], targets).displacement
        qpos[targets.frames] = oplus(model, qpos[targets.frames], closing)
        moved = self.source.replace(self._within_limits(qpos))
        last = float(residuals(moved, targets).max(initial=0.0))
        traced = tuple(
            LevelTrace(number, spacing, seconds, percent * error)
            for number, ((spacing, seconds), error) in enumerate(
                zip(took, errors, strict=True), start=1
            )
        )
        nscalar = sum(one.nscalar for one in [*held.constraints(), *self.drags])
        whole = time.perf_counter() - began
        return moved, held, Trace(traced, whole, percent * before, percent * last, nscalar)

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

    def _move(
        self, qpos: Array, frames: NDArray[np.int64], displacement: Array, spacing: float
    ) -> None:
        """Move poses (nframe, nq), in place, by one level's spline; it is at rest at the ends."""
        within = self.span.frames
        submap = self.span.spread(frames, displacement, spacing)
        qpos[within] = oplus(self.source.model, qpos[within], submap)

    def _reach(self, qpos: Array, solver: HybridIK, targets: Targets, far: bool) -> None:
        """Let the root of poses (nframe, nq) sink or rise, in place, where a limb does not reach.

        Not outside the span, nor at the edited frame where the body was dragged. A limb that was
        dragged too far has drawn the body after it as far as the others reach: nothing gives.
        """
        ends = {limb.end for limb in find_limbs(self.source.model)}
        fixed = np.ones(len(qpos), dtype=bool)
        fixed[self.span.frames] = False
        dragged = {self._body(drag) for drag in self.drags}
        if far and dragged <= ends:
            return
        fixed[self.span.frame] = not dragged <= ends
        frames = targets.frames
        own = solver.enforce(self.source.qpos[frames], targets).rise
        for _ in range(_REACH_ROUNDS):
            rise = solver.enforce(qpos[frames], targets).rise
            if own is None or rise is None or not rise.any():
                return
            for sign in (1.0, -1.0):
                need = np.zeros(len(qpos))
                # Legs that were straight already are the source's own.
                need[frames] = np.maximum(sign * rise, 0.0) - np.maximum(sign * own, 0.0)
                need[fixed] = 0.0
                if need.any():
                    give = sign * envelope(need, fixed, REACH_TIME * self.source.fps)
                    qpos[self.span.frames, 2] += give[self.span.frames]

    def _body(self, drag: SiteConstraint) -> int:
        model = self.source.model
        return int(model.site_bodyid[site_id(model, drag.site)])

    def _within_limits(self, qpos: Array) -> Array:
        """Return poses within joint limits, where the source was not further out itself."""
        model, within = self.source.model, self.span.frames
        qpos = qpos.copy()
        if coupling(model):
            qpos[within] = couple(model, qpos[within])
        excess = limit_excess(model, qpos[within]).max(axis=1, initial=0.0)
        worse = excess > limit_excess(model, self.source.qpos[within]).max(axis=1, initial=0.0)
        qpos[within[worse]] = within_limits(self.source, qpos[within[worse]])
        return qpos


__all__ = ["deformation", "edit_frame"]
