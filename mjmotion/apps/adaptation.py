"""Adapting a walk to a scene: contacts, footholds, clearances, fit.

    result = adapt("walk", "terrain_doors")
    result.motion, result.source, result.contacts, result.trace

The scene tells everything: footholds come from the ground under each stance foot, clearances from
the solids near the way. Constraints of the user's own are added to those.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.clearing import (
    FitSettings,
    past_obstacles,
    what_bars,
    with_arms_clear,
    with_arms_swung,
    with_knees_apart,
)
from mjmotion.apps.steadying import steadied
from mjmotion.body.character import Character
from mjmotion.body.kinematics import Kinematics, site_id, site_positions
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.constraints import (
    Constraint,
    LookAt,
    RelativeConstraint,
    SiteConstraint,
    check_constraints,
    lay_out,
)
from mjmotion.constraints.shared_targets import with_moves
from mjmotion.constraints.unmet import find_unmet
from mjmotion.exceptions import FitError, unknown_name
from mjmotion.fitting import FINEST, TOLERANCE, Fit, fit, whole
from mjmotion.footsteps.ankles import SHORTEST, relax_ankles, trim_toe_contacts
from mjmotion.footsteps.changes import changes
from mjmotion.footsteps.contacts import Contact
from mjmotion.footsteps.heading import HEADINGS, never_met, set_off
from mjmotion.footsteps.obstacles import ObstacleClearance
from mjmotion.footsteps.paths import with_toes
from mjmotion.footsteps.plan import Plan, make_plan, shifted, with_free_footholds
from mjmotion.footsteps.settings import PlanSettings
from mjmotion.ik import IKSolver, make_solver
from mjmotion.ik.solver import default_rigidity
from mjmotion.numerics.progress import Progress, no_progress
from mjmotion.output.result import Result
from mjmotion.scene import Scene, SceneLike, compose, without_scene

Array = NDArray[np.float64]

ROOT_STIFFNESS = 15.0  # how much stiffer the root is than elsewhere: its path is planned
NEVER_MET = "the walk never came near anything of the scene but level ground"
LEAN = 0.25  # how far beyond a limb's reach the body may lean for a target [m]
RELAX_ROUNDS = 4  # times that the fitted motion is asked whether its ankles can follow


def adapt(  # more than eight parameters: all but the first two have a default
    clip: Motion | str | Path,
    scene: SceneLike,
    *,
    contacts: Sequence[Contact] | None = None,
    constraints: Sequence[Constraint] = (),
    free_footholds: bool = False,
    heading: str = "start",
    planning: PlanSettings | None = None,
    levels: Sequence[float] | None = None,
    tolerance: float = TOLERANCE,
    ik: str | IKSolver = "hybrid",
    progress: Progress = no_progress,
) -> Result:
    """Adapt a walk to a scene; it stays on the character that it is on.

    Args:
      clip: the walk, on level ground at z = 0; or a file or built-in name, put on the humanoid.
      scene: where it is to walk; or the name of one of ours, or an MJCF file. What could move in
        it stands at its rest pose; for that of a keyframe give ``Scene.at_rest(keyframe)``.
      contacts: who stands when; found in the clip without.
      constraints: more that must hold; where they name a foot, they override its foothold.
      free_footholds: let footholds move as a whole to where the walk changes least (§7).
      heading: ``"start"``: the walk sets off along the start's x-axis, whatever its own way;
        ``"keep"``: its own +x is put there.
      planning: what of the walk may change, such as its way.
      levels: frames a knot of each level, coarse to fine.
      tolerance: refinement stops once no constraint is off by more [m].
      ik: ``"hybrid"``, ``"numeric"`` or a solver of one's own.
      progress: called with stage, done, of.

    Raises:
      SceneError: no ground under the walk, or, where planning is strict, no way through.
      ClipError, ContactError, ConstraintError, ModelError, FitError: bad input, an unknown heading.
    """
    if heading not in HEADINGS:
        raise FitError(unknown_name("heading", heading, HEADINGS))
    motion, scene = as_clip(clip), Scene.of(scene).at_rest()
    motion = set_off(motion) if heading == "start" else motion
    check_constraints(constraints)
    composed = compose(motion.character, scene)
    progress("contacts and footholds", 0, 0)
    plan = make_plan(motion, scene, contacts, planning)
    if free_footholds:
        plan = with_free_footholds(plan, scene, ik)
    strict = planning is not None and planning.strict
    settings = FitSettings(levels, tolerance, ik, progress, strict)
    result = fit_plan(plan, composed, constraints, settings)
    path = plan.source.qpos[:, :3] + plan.root_shift
    met = not never_met(path, plan.footholds, scene.model)
    changed = "" if plan.route is None else plan.route.changed()
    notes = (*result.notes, changed, *changes(plan), "" if met else NEVER_MET)
    return dataclasses.replace(result, notes=tuple(note for note in notes if note))


def as_clip(clip: Motion | str | Path) -> Motion:
    """Return a clip on its character alone, from a motion, a file or a built-in name.

    Raises:
      ClipError: no such file or name, or a skeleton that cannot be mapped.
    """
    motion = clip if isinstance(clip, Motion) else load_clip(clip)
    return motion if motion.character.alone else motion.on(without_scene(motion.character))


def fit_plan(
    plan: Plan,
    composed: Character,
    constraints: Sequence[Constraint] = (),
    settings: FitSettings | None = None,
    rigidity: Array | None = None,
) -> Result:
    """Fit a motion to a plan: past obstacles first, with ankles that are relaxed at the end.

    Args:
      plan: what is asked; its source is on the character alone.
      composed: character and scene in one.
      constraints: more that must hold.
      settings: how.
      rigidity: (nv,) α of Eq. 4; that of :func:`stiff_root` without.

    Raises:
      SceneError: there is no way through, and the settings are strict.
      ConstraintError, ModelError, FitError: bad input.
    """
    settings = FitSettings() if settings is None else settings
    character = plan.source.character
    rigidity = stiff_root(character) if rigidity is None else rigidity
    solver = make_solver(character, settings.ik, rigidity)
    asked = _moved_near(constraints, shifted(plan.source, plan.root_shift))
    near = _within_reach(asked, shifted(plan.source, plan.root_shift))
    asked_for = [*plan.constraints(), *near]
    result = fit(
        plan.source,
        asked_for,
        levels=settings.levels,
        tolerance=settings.tolerance,
        ik=solver,
        first_guess=plan.root_shift,
        progress=settings.progress,
    )
    clearance = None
    if plan.obstacles:
        clearance = ObstacleClearance(character, plan.obstacles, plan.source.nframe)
        result = past_obstacles(result, asked_for, clearance, solver, settings)
    result = steadied(plan, result, asked_for, solver, clearance)
    plan, result = _with_relaxed_ankles(plan, result, near, solver, clearance)
    result = with_knees_apart(plan, result, near, clearance)
    result = with_arms_swung(plan, result, near, clearance, composed)
    result = with_arms_clear(plan, result, near, clearance, composed, settings, solver)
    barred = what_bars(clearance, result, plan, composed.model, settings)
    # Against what was asked for, not what was brought within reach; free targets where they went.
    wanted = [*plan.constraints(), *with_moves(asked, result.moves)]
    targets = lay_out(wanted, character.model, plan.source.nframe)
    return Result(
        source := (plan.recorded or plan.source).on(composed),
        source.replace(with_toes(result.motion, plan.paths).qpos),
        plan.contacts,
        result.trace,
        find_unmet(result.motion, targets, wanted),
        plan=plan if plan.stances else None,
        barred=str(barred or ""),
        recording=None if plan.original is None else plan.original.on(composed),
    )


def _with_relaxed_ankles(
    plan: Plan,
    result: Fit,
    near: Sequence[Constraint],
    solver: IKSolver,
    clearance: ObstacleClearance | None,
) -> tuple[Plan, Fit]:
    """Relax the ankles of a fitted motion, and fit it again where that asks anything of it.

    Only the fitted motion shows for certain what the ankles are asked for.
    """
    posed = {path.site for path in plan.paths}
    motion = plan.source
    feet = [foot for foot in plan.source.character.feet if foot.site in posed] if posed else []
    for _ in range(RELAX_ROUNDS):
        paths, contacts = relax_ankles(result.motion, feet, plan.paths, plan.contacts, plan.source)
        if paths == plan.paths:
            break
        contacts = trim_toe_contacts(
            contacts,
            motion.character.feet,
            paths,
            (plan.stances, plan.footholds),
            SHORTEST * motion.fps,
        )
        plan = dataclasses.replace(plan, paths=paths, contacts=contacts)
        again = fit(
            result.motion,
            [*plan.constraints(), *near],
            levels=[FINEST],
            ik=solver,
            clearance=clearance,
            first_guess=False,
        )
        trace = whole((result.trace, again.trace))
        result = dataclasses.replace(again, trace=trace)
    return plan, result


def _moved_near(constraints: Sequence[Constraint], motion: Motion) -> list[Constraint]:
    """Move targets that are free to move and out of reach, as a whole, to where the motion is."""
    near = list(constraints)
    for index, one in enumerate(constraints):
        if not (isinstance(one, SiteConstraint) and one.free and one.position is not None):
            continue
        (reached,) = _within_reach([one], motion)
        if reached is not one:
            site = np.array([site_id(motion.model, one.site)])
            own = site_positions(motion.model, motion.qpos[one.frames], site)[:, 0]
            free = np.array([name in one.free for name in "xyz"])
            step = free * np.mean(own - one.position, axis=0)
            near[index] = dataclasses.replace(one, position=one.position + step)
    return near


def _within_reach(constraints: Sequence[Constraint], motion: Motion) -> list[Constraint]:
    """Bring targets for hands and feet as near as a limb and a lean of the body can go.

    A target further away would drag the whole body after it, off its footholds.
    """
    character, model = motion.character, motion.model
    ends = character.limb_by_end
    pose = Kinematics(model, motion.nframe).forward(motion.qpos)
    near: list[Constraint] = []
    for one in constraints:
        site = site_id(model, one.site)
        limb = ends.get(int(model.site_bodyid[site]))
        inside = (one.frames >= 0).all() and (one.frames < motion.nframe).all()
        if limb is None or isinstance(one, LookAt) or one.position is None or not inside:
            near.append(one)
            continue
        base = pose.xanchor[one.frames, model.body_jntadr[limb.upper]]
        hand = float(np.linalg.norm(model.site_pos[site]))
        most = float(character.chains((limb,)).reach[0]) + hand + LEAN
        origin, turn = np.zeros(3), np.eye(3)
        if isinstance(one, RelativeConstraint):
            to = site_id(model, one.to)
            origin, turn = pose.site_xpos[one.frames, to], pose.site_xmat[one.frames, to]
            other = ends.get(int(model.site_bodyid[to]))
            if other is not None:  # which may come to meet it
                most += 2.0 * float(character.chains((other,)).reach[0])
        away = origin + (turn @ one.position[..., None])[..., 0] - base
        length = np.linalg.norm(away, axis=1, keepdims=True)
        wanted = base + away * np.minimum(1.0, most / np.maximum(length, 1e-9)) - origin
        position = (np.swapaxes(turn, -1, -2) @ wanted[..., None])[..., 0]
        near.append(dataclasses.replace(one, position=position) if (length > most).any() else one)
    return near


def stiff_root(character: Character) -> Array:
    """Return rigidities (nv,) for a fit whose root has its path already: the legs do the rest."""
    rigidity = default_rigidity(character.model)
    rigidity[:6] *= ROOT_STIFFNESS
    return rigidity
