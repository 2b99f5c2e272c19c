"""The rope climb on another character, with a rope for each (Figure 5c).

    climb = climb_rope("climber")
    climb.original, climb.motion          # climber and rope in one motion each
    climb.figures.held_mm, climb.jerk_ratio

The humanoid's climb is put on the character, fitted so that hands and feet hold the rope where and
when the humanoid's did, and the rope is simulated against both.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.retarget import held_shift
from mjmotion.apps.retarget.grasps import check_span
from mjmotion.apps.rope.grasps import places_along
from mjmotion.apps.rope.measuring import measure
from mjmotion.apps.rope.points import rope_points
from mjmotion.apps.rope.result import ORIGINAL, RopeClimb
from mjmotion.apps.rope.simulation import simulate
from mjmotion.body.character import Character, CharacterLike, joint_names
from mjmotion.body.motion import Motion
from mjmotion.clips.climb import climb_constraints, climb_contacts, make_climb
from mjmotion.clips.climb_grip import find_grips
from mjmotion.clips.climb_plan import plan_holds
from mjmotion.constraints import SiteConstraint
from mjmotion.exceptions import ConstraintError, ModelError
from mjmotion.fitting import TOLERANCE, Fit, fit
from mjmotion.ik import IKSolver
from mjmotion.numerics.progress import Progress, no_progress
from mjmotion.scene import Scene, compose, rope, without_scene
from mjmotion.scene.rope_scene import BEAM, EDGE
from mjmotion.validation.figures import joint_jerk_ratio

Array = NDArray[np.float64]

_END = 0.3  # height of a rope's lower end, where its length is not given [m]


@dataclasses.dataclass(frozen=True, eq=False)
class ClimbPlan:
    """What is fitted, and to what.

    Attributes:
      original: the humanoid's climb.
      guess: its joint angles on the other character.
      constraints: hands and feet where and when they held the rope: 5,898 scalars.
      shift: (nframe, 3) of the root, the first guess (§4.5) [m].
    """

    original: Motion
    guess: Motion
    constraints: tuple[SiteConstraint, ...]
    shift: Array


def plan_climb(character: CharacterLike) -> ClimbPlan:
    """Return the climb on a character, ready for the fit.

    Args:
      character: the character, or what names one.

    Raises:
      ModelError: no such character, or it lacks hands and feet or the humanoid's joints.
      ConstraintError: its hands and feet do not reach so far apart: the rope is out of reach.
    """
    humanoid, other = (_alone(Character.of(name)) for name in (ORIGINAL, character))
    constraints = climb_constraints(other)
    try:
        check_span(other.model, constraints)
    except ConstraintError as error:
        raise ConstraintError(f"the rope is out of reach: {error}", error.frames) from None
    original = make_climb(humanoid)
    if joint_names(other.model) != original.joint_names:
        raise ModelError(
            f"character '{other.name}' cannot climb as the humanoid: the two models have different"
            " joints: retarget the motion instead"
        )
    guess = Motion(other, original.qpos, original.fps)
    return ClimbPlan(original, guess, constraints, held_shift(guess, constraints))


def climb_rope(
    character: CharacterLike = "climber",
    *,
    beam: float = BEAM,
    length: float | None = None,
    edge: float = EDGE,
    levels: Sequence[float] | None = None,
    tolerance: float = TOLERANCE,
    ik: str | IKSolver = "hybrid",
    progress: Progress = no_progress,
) -> RopeClimb:
    """Put the built-in climb on a character and simulate the rope against both.

    Args:
      character: the character, or what names one.
      beam: height that the rope hangs from [m].
      length: of the rope [m]; down to 0.3 m over the floor without.
      edge: distance of the points that the rope is made of [m], about.
      levels: frames a knot of each level, coarse to fine.
      tolerance: refinement stops once no constraint is off by more [m].
      ik: ``"hybrid"``, ``"numeric"`` or a solver of one's own.
      progress: called with stage, done, of.

    Raises:
      ModelError: no such character, or it lacks hands and feet or the humanoid's joints.
      SceneError: a rope that cannot be.
      ConstraintError, FitError: out of reach, or settings that make no sense.
    """
    other = Character.of(character)
    progress("hanging up the ropes", 0, 0)
    length = beam - _END if length is None else length
    scene = Scene.from_spec(rope(beam=beam, length=length, edge=edge), "rope")
    climbers = [compose(which, scene, moving=True) for which in (ORIGINAL, other)]
    line = rope_points(climbers[0].model)
    places_along(plan_holds(), line.rest[0], line.length)  # out of reach is known before any work
    progress("climbing", 0, 0)
    plan = plan_climb(other)
    fitted = fit(
        plan.guess,
        plan.constraints,
        levels=levels,
        tolerance=tolerance,
        ik=ik,
        first_guess=plan.shift,
        progress=progress,
    )
    return _simulated(plan, fitted, climbers, progress)


def _simulated(
    plan: ClimbPlan, fitted: Fit, climbers: Sequence[Character], progress: Progress
) -> RopeClimb:
    """Return both climbs with a simulated rope each, measured.

    Args:
      plan: what was fitted.
      fitted: the climb on the other character.
      climbers: humanoid and rope, and the other character and rope.
      progress: called with stage, done, of.
    """
    holds, motions = plan_holds(), []
    for climber, motion in zip(climbers, (plan.original, fitted.motion), strict=True):
        progress(f"simulating the rope of the {climber.name}", 0, 0)
        motions.append(Motion(climber, simulate(climber.spec, motion, holds), motion.fps))
    progress("measuring", 0, 0)
    alone = (plan.original.model, plan.guess.model)
    figures = [
        measure(motion, holds, find_grips(model))
        for motion, model in zip(motions, alone, strict=True)
    ]
    return RopeClimb(
        character=climbers[1].name,
        original=motions[0],
        source=_with_rope(plan.guess, motions),
        motion=motions[1],
        holds=holds,
        contacts=climb_contacts(),
        constraints=plan.constraints,
        trace=fitted.trace,
        unmet=fitted.unmet,
        original_figures=figures[0],
        figures=figures[1],
        jerk_ratio=joint_jerk_ratio(fitted.motion, (plan.original,)),
    )


def _with_rope(guess: Motion, motions: Sequence[Motion]) -> Motion:
    """Return the guess with a rope: its angles on the other character, the original's rope."""
    qpos = motions[0].qpos.copy()
    qpos[:, : guess.model.nq] = guess.qpos
    return Motion(motions[1].character, qpos, guess.fps)


def _alone(character: Character) -> Character:
    """Return a character without what else its file has in its world."""
    if len(character.geoms) == 0:
        name = character.name
        raise ModelError(f"character '{name}' has no geoms: it has nothing to hold a rope with")
    return without_scene(character)
