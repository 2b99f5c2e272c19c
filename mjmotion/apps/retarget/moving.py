"""Retargeting: a motion moves to a character of other proportions, its contacts kept.

Joint angles are copied, or, where the other body has other joints, found such that its bones point
where the motion's do; the root is carried as high as the other legs hold it (§4.5), and sinks
where one would not reach; feet get paths through the spots they stood on, or through spots as far
apart as the other legs are long; hands keep what they hold. Then the same fit as everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.adaptation import fit_plan
from mjmotion.apps.clearing import FitSettings
from mjmotion.apps.retarget.copying import carry_root, copy_joints, leg_ratio, same_joints
from mjmotion.apps.retarget.grasps import check_span, held_shift, hold_constraints
from mjmotion.apps.retarget.reaching import Legs
from mjmotion.apps.retarget.roles import map_bones, with_soles
from mjmotion.apps.retarget.strides import Strides
from mjmotion.body.character import Character, CharacterLike
from mjmotion.body.kinematics import Kinematics
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.constraints import Constraint, SiteConstraint
from mjmotion.exceptions import ContactError, FitError, unknown_name
from mjmotion.fitting import TOLERANCE
from mjmotion.footsteps.above_ground import above_ground
from mjmotion.footsteps.ankles import SHORTEST, relax_ankles, trim_toe_contacts
from mjmotion.footsteps.contacts import (
    Contact,
    check_contacts,
    contact_sites,
    detect_contacts,
)
from mjmotion.footsteps.obstacles import find_obstacles
from mjmotion.footsteps.paths import FootPath
from mjmotion.footsteps.pelvis import mean_shift
from mjmotion.footsteps.plan import Plan, shifted
from mjmotion.footsteps.planning import place
from mjmotion.ik import IKSolver
from mjmotion.ik.solver import default_rigidity
from mjmotion.numerics.progress import Progress, no_progress
from mjmotion.output.result import Result
from mjmotion.scene import Scene, SceneLike, compose, without_scene

Array = NDArray[np.float64]

ROOT_STIFFNESS = 100.0  # how much stiffer than elsewhere against being moved the root is
STRIDES = ("keep", "scale")


def retarget(  # more than eight parameters: all but the first two have a default
    motion: Motion | str | Path,
    to: CharacterLike,
    *,
    stride: str = "keep",
    contacts: Sequence[Contact] | None = None,
    scene: SceneLike = "flat",
    constraints: Sequence[Constraint] = (),
    levels: Sequence[float] | None = None,
    tolerance: float = TOLERANCE,
    ik: str | IKSolver = "hybrid",
    progress: Progress = no_progress,
) -> Result:
    """Move a motion to another character.

    Args:
      motion: the motion on its own character; or a file or built-in name. One on a bare model
        begins at the scene's start, as a clip does; one on a model with a scene is where it is
        already.
      to: the other character, or what names one.
      stride: ``"keep"``: feet stand where they stood; ``"scale"``: the root's path and the spots
        are scaled in the plane about the start, as the legs are.
      contacts: who stands when; those of heels and toes are found in the motion without. A contact
        of any other site, such as a hand, holds that site where the motion has it, with its
        orientation.
      scene: where it is to be, or what names it.
      constraints: more that must hold on the new body.
      levels: frames a knot of each level, coarse to fine.
      tolerance: refinement stops once no constraint is off by more [m].
      ik: ``"hybrid"``, ``"numeric"`` or a solver of one's own.
      progress: called with stage, done, of.

    Returns:
      ``source`` is the motion with its joint angles copied, before the fit. A body whose joints
      are others, such as a robot's, gets angles by the roles of its bones, and sites on its
      soles where it lacks them.

    Raises:
      ModelError: a character without legs, soles or knees, or without a site that stands.
      ContactError: nothing holds: no contacts and no constraints.
      SceneError, ClipError, ConstraintError, FitError: bad input.
    """
    motion = motion if isinstance(motion, Motion) else load_clip(motion)
    where, body = Scene.of(scene).at_rest(), without_scene(Character.of(to))
    if not same_joints(motion.character, body):
        body = with_soles(body)
    progress("contacts and footholds", 0, 0)
    plan, held = plan_retarget(motion, body, where, stride, contacts, constraints)
    return fit_plan(
        plan,
        compose(body, where),
        [*held, *constraints],
        FitSettings(levels, tolerance, ik, progress),
        _rigidity(body, bool(plan.paths)),
    )


def plan_retarget(
    motion: Motion,
    body: Character,
    scene: Scene,
    stride: str = "keep",
    contacts: Sequence[Contact] | None = None,
    constraints: Sequence[Constraint] = (),
) -> tuple[Plan, tuple[SiteConstraint, ...]]:
    """Return what a motion asks of another body, and what its hands hold, before any fit.

    Args:
      motion: the motion on its own character.
      body: the other character, alone.
      scene: where it is to be.
      stride: ``"keep"`` or ``"scale"``.
      contacts: who stands or holds when; those of heels and toes are found without.
      constraints: more that must hold on the other body.

    Raises:
      FitError: an unknown stride.
      ModelError, ContactError, SceneError: as of :func:`retarget`.
    """
    if stride not in STRIDES:
        raise FitError(unknown_name("stride", stride, STRIDES))
    motion = place(motion, scene) if motion.character.alone else motion
    copied = same_joints(motion.character, body)
    guess = copy_joints(motion, body) if copied else map_bones(motion, body)
    given = detect_contacts(motion) if contacts is None else contacts
    found = check_contacts(
        check_contacts(given, motion.model, motion.nframe), body.model, motion.nframe
    )
    if not found and not constraints:
        raise ContactError(
            "nothing to keep: no foot of the motion rests on any ground; give what stands or holds"
            " with a contacts file"
        )
    soles = set(contact_sites(body.model))
    stands = [contact for contact in found if contact.site in soles]
    held = hold_constraints(motion, [contact for contact in found if contact.site not in soles])
    check_span(body.model, held)
    if not stands:
        shift = held_shift(guess, [*held, *constraints])
        return Plan(guess, found, (), (), (), shift, (), scene.ground), held
    about = motion.qpos[0, :3] * (1.0, 1.0, 0.0)
    scale = leg_ratio(motion.character, body) if stride == "scale" else 1.0
    strides = Strides.find(motion, body, stands, about, scale)
    guess = carry_root(motion, guess, about, scale, strides.support())
    return _with_paths(guess, strides, scene, found, stands), held


def _with_paths(
    guess: Motion,
    strides: Strides,
    scene: Scene,
    contacts: tuple[Contact, ...],
    stands: Sequence[Contact],
) -> Plan:
    """Return the plan of a body whose feet go on their strides: heels rise, and the hips sink.

    Args:
      guess: the motion on the other body, its root carried over.
      strides: where its feet are to be.
      scene: where it is to be.
      contacts: who stands or holds when.
      stands: those of them that are heels' and toes'.
    """
    placed = strides.place(guess, scene.ground, float(scene.start_pos[2]))
    pose = Kinematics(guess.model, guess.nframe).forward(guess.qpos)
    feet = strides.standing_feet
    legs, mean = Legs(guess, pose), mean_shift(guess, placed.moved)
    reach = legs.reach(feet, placed.paths, mean)

    def sunk(paths: Sequence[FootPath], share: float = 1.0) -> Array:
        down = share * legs.sinking(feet, paths, mean, reach)
        return mean - down[:, None] * np.array((0.0, 0.0, 1.0))

    # What is lacking is shared: heels rise for one half, and the hips sink for what is left.
    half = sunk(placed.paths, 0.5)
    paths = legs.roll_on(feet, placed.paths, half, stands, reach)
    shift = sunk(paths)
    relaxed, trimmed = relax_ankles(shifted(guess, shift), feet, paths, contacts)
    if relaxed != paths:
        paths = above_ground(feet, relaxed, paths, trimmed, scene.ground, guess.fps)
        contacts, shift = trimmed, sunk(paths)
    spots, shortest = (strides.spots, placed.footholds), SHORTEST * guess.fps
    contacts = trim_toe_contacts(contacts, guess.character.feet, paths, spots, shortest)
    obstacles = find_obstacles(scene.model, guess.qpos[:, :3] + shift, placed.footholds)
    holds = placed.footholds
    return Plan(guess, contacts, paths, strides.spots, holds, shift, obstacles, scene.ground)


def _rigidity(character: Character, carried: bool) -> Array:
    """Return rigidities (nv,): a root that goes where its legs carried it, but may turn."""
    rigidity = default_rigidity(character.model)
    rigidity[:3] *= ROOT_STIFFNESS if carried else 1.0
    return rigidity


__all__ = ["STRIDES", "plan_retarget", "retarget"]
