"""Retargeting: a motion moves to a character of other proportions, its contacts kept.

Joint angles are copied, or, where the other body has other joints, found such that its bones point
where the motion's do; the root is carried as high as the other legs hold it (§4.5), and sinks
where one would not reach; feet get paths through the spots they stood on, or through spots as far
apart as the other legs are long; hands keep what they hold. Then the same fit as everywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.adaptation import carry_out
from mjmotion.apps.retarget.copying import carry_root, copy_joints, leg_ratio, same_joints
from mjmotion.apps.retarget.grasps import check_span, held_shift, hold_constraints
from mjmotion.apps.retarget.reaching import Legs
from mjmotion.apps.retarget.roles import map_bones, with_soles
from mjmotion.apps.retarget.strides import Strides
from mjmotion.body.feet import find_feet
from mjmotion.body.kinematics import Kinematics, character_geoms
from mjmotion.body.motion import Motion
from mjmotion.constraints import Constraint, SiteConstraint
from mjmotion.exceptions import ContactError, FitError, unknown_name
from mjmotion.footsteps.ankles import give
from mjmotion.footsteps.contacts import Contact, check_contacts, contact_sites, detect_contacts
from mjmotion.footsteps.obstacles import find_obstacles
from mjmotion.footsteps.paths import FootPath
from mjmotion.footsteps.plan import Plan, mean_shift, place, shifted
from mjmotion.ik.solver import default_weights
from mjmotion.output.result import Result
from mjmotion.scene import Scene, compose, load_character, load_scene
from mjmotion.scene.ground import Ground

Array = NDArray[np.float64]

ROOT_STIFFNESS = 100.0  # how much stiffer than elsewhere against being moved the root is
STRIDES = ("keep", "scale")


def retarget(
    motion: Motion,
    to: str | Path | mujoco.MjSpec,
    *,
    stride: str = "keep",
    contacts: Sequence[Contact] | None = None,
    scene: str | Path | Scene = "flat",
    constraints: Sequence[Constraint] = (),
    levels: Sequence[float] | None = None,
    tolerance: float = 1e-4,
    ik: str = "hybrid",
    progress: Callable[[str], None] | None = None,
) -> Result:
    """Move a motion to another character.

    Args:
      motion: the motion on its own character. One on a bare model begins at the scene's start, as
        a clip does; one on a model with a scene is where it is already.
      to: name of one of our models, an MJCF file, or a spec.
      stride: ``"keep"``: feet stand where they stood; ``"scale"``: the root's path and the spots
        are scaled in the plane about the start, as the legs are.
      contacts: who stands when; those of heels and toes are found in the motion without. A contact
        of any other site, such as a hand, holds that site where the motion has it, with its
        orientation.
      scene: where it is to be: a name, an MJCF file, or a scene.
      constraints: more that must hold on the new body.
      levels: frames a knot, coarse to fine.
      tolerance: refinement stops once no constraint is off by more [m].
      ik: ``"hybrid"`` or ``"numeric"``.
      progress: called with the name of each stage as it begins.

    Returns:
      ``source`` is the motion with its joint angles copied, before the fit. A body whose joints
      are others, such as a robot's, gets angles by the roles of its bones, and sites on its
      soles where it lacks them.

    Raises:
      ModelError: a character without legs, soles or knees, or without a site that stands.
      ContactError: nothing holds: no contacts and no constraints.
      SceneError, ConstraintError, FitError: bad input.
    """
    say = progress or (lambda stage: None)
    where = scene if isinstance(scene, Scene) else load_scene(scene)
    body = load_character(to)
    if not same_joints(motion.model, body.compile()):
        body = with_soles(body)
    say("contacts and footholds")
    what, held = plan_retarget(motion, body, where, stride, contacts, constraints)
    return carry_out(
        *(what, compose(body, where), body),
        constraints=[*held, *constraints],
        weights=_rigidity(what.source.model, bool(what.paths)),
        levels=levels,
        tolerance=tolerance,
        ik=ik,
        progress=progress,
    )


def plan_retarget(
    motion: Motion,
    body: mujoco.MjSpec,
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
    alone = len(character_geoms(motion.model)) == motion.model.ngeom
    motion = place(motion, scene) if alone else motion
    found = (
        detect_contacts(motion)
        if contacts is None
        else check_contacts(contacts, motion.model, motion.nframe)
    )
    model = body.compile()
    if same_joints(motion.model, model):
        guess = copy_joints(motion, model)
    else:
        guess = map_bones(motion, body).on(model)
    found = check_contacts(found, model, motion.nframe)
    if not found and not constraints:
        raise ContactError(
            "nothing to keep: no foot of the motion rests on any ground; give what stands or holds"
            " with a contacts file"
        )
    soles = set(contact_sites(model))
    standing = [contact for contact in found if contact.site in soles]
    held = hold_constraints(motion, [contact for contact in found if contact.site not in soles])
    check_span(model, held)
    about = motion.qpos[0, :3] * (1.0, 1.0, 0.0)
    scale = 1.0
    if stride == "scale":
        scale = leg_ratio(motion.model, model)
    if not standing:
        shift = held_shift(guess, [*held, *constraints])
        return Plan(guess, found, (), (), (), shift, ()), held
    strides = Strides.find(motion, find_feet(model), standing, about, scale)
    guess = carry_root(motion, guess, about, scale, strides.support())
    placed = strides.place(guess, Ground(scene), float(scene.start_pos[2]))
    pose = Kinematics(model, guess.nframe).forward(guess.qpos)
    feet = strides.standing_feet
    legs, mean = Legs(guess, pose), mean_shift(guess, placed.moved)
    reach = legs.reach(feet, placed.paths, mean)

    def sunk(paths: Sequence[FootPath], share: float = 1.0) -> Array:
        down = share * legs.sinking(feet, paths, mean, reach)
        return mean - down[:, None] * np.array((0.0, 0.0, 1.0))

    # What is lacking is shared: heels rise for one half, and the hips sink for what is left.
    half = sunk(placed.paths, 0.5)
    paths = legs.roll_on(feet, placed.paths, half, standing, reach)
    shift = sunk(paths)
    given, left = give(shifted(guess, shift), feet, paths, found)
    if given != paths:
        paths, found = given, left
        shift = sunk(paths)
    obstacles = find_obstacles(scene.model, guess.qpos[:, :3] + shift, placed.footholds)
    return Plan(guess, found, paths, strides.spots, placed.footholds, shift, obstacles), held


def _rigidity(model: mujoco.MjModel, carried: bool) -> Array:
    """Return rigidities (nv,): a root that goes where its legs carried it, but may turn."""
    weights = default_weights(model)
    weights[:3] *= ROOT_STIFFNESS if carried else 1.0
    return weights


__all__ = ["STRIDES", "plan_retarget", "retarget"]
