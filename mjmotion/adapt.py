"""Adapting a walk to a scene: contacts, footholds, clearances, fit.

    scene = load_scene("terrain_doors")
    result = adapt(load_clip("walk"), scene)
    result.motion, result.source, result.contacts, result.trace

The scene tells everything: footholds come from the ground under each stance foot, clearances from
the solids near the way. Constraints of the user's own are added to those.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.ankles import give
from mjmotion.clearance import MARGIN, Obstacle, ObstacleClearance, find_obstacles
from mjmotion.constraints import Constraint, SiteConstraint, lay_out
from mjmotion.contacts import Contact, check_contacts, detect_contacts
from mjmotion.exceptions import ContactError, SceneError, frame_list
from mjmotion.fit import (
    FINEST,
    Fit,
    Trace,
    Unmet,
    default_levels,
    find_unmet,
    fit,
    over_all_frames,
    residuals,
)
from mjmotion.footholds import Foothold, Stance, find_feet, find_footholds, find_stances
from mjmotion.footpaths import FootPath, foot_path, free_footholds
from mjmotion.ik.limb import find_limbs, limbs_of
from mjmotion.ik.numeric import NumericIK
from mjmotion.ik.solver import default_weights
from mjmotion.kinematics import Kinematics, Pose
from mjmotion.motion import Motion
from mjmotion.rotations import multiply, rotate, yaw_quat
from mjmotion.scene import Scene, compose, load_character
from mjmotion.scene.ground import Ground
from mjmotion.shared import SharedMove
from mjmotion.smoothing import cover
from mjmotion.spline import fit_level, fit_multilevel
from mjmotion.tangent import oplus

Array = NDArray[np.float64]

DUCK_MARGIN = 0.05  # distance kept while the way through is found, more than in the end [m]
REACH_FREE = 0.97  # share of a leg's length that a root path may always ask for
REACH_MOST = 0.995  # the most it may ask for, where the source did
DROP_TIME = 0.3  # how far on either side it is felt that a leg would not reach [s]
ROOT_STIFFNESS = 15.0  # how much stiffer the root is than elsewhere: its path is planned
LEAN = 0.25  # how far beyond a limb's reach the body may lean for a target [m]
GIVE_ROUNDS = 2  # times that the fitted motion is asked whether its ankles can follow
DUCK_ROUNDS = 6  # at most, with the finest of the knots that serve to find the way
STUCK = 0.02  # deeper than this in an obstacle after all, and the way is barred [m]


@dataclasses.dataclass(frozen=True, eq=False)
class Adaptation:
    """A walk adapted to a scene.

    Attributes:
      source: the clip on the composed model, on level ground, placed at the scene's start.
      motion: the adapted motion, the same frames.
      contacts: who stands when.
      trace: what the fit did.
      unmet: constraints that could not be met.
      spec: character and scene in one.
    """

    source: Motion
    motion: Motion
    contacts: tuple[Contact, ...]
    trace: Trace
    unmet: tuple[Unmet, ...]
    spec: mujoco.MjSpec


@dataclasses.dataclass(frozen=True, eq=False)
class Plan:
    """What the scene asks of a walk, before anything is fitted.

    Attributes:
      source: the clip placed at the scene's start, on the character's model.
      contacts: who stands when.
      paths: where each foot goes.
      stances: the feet's stays on one spot.
      footholds: what it stands on, one a stance.
      root_shift: (nframe, 3) the first guess of §4.5 [m].
      obstacles: what to keep clear of.
    """

    source: Motion
    contacts: tuple[Contact, ...]
    paths: tuple[FootPath, ...]
    stances: tuple[Stance, ...]
    footholds: tuple[Foothold, ...]
    root_shift: Array
    obstacles: tuple[Obstacle, ...]

    def constraints(self) -> list[SiteConstraint]:
        """Both feet posed at every frame."""
        frames = np.arange(self.source.nframe)
        return [
            SiteConstraint(path.site, frames, path.position, path.quat, contact=True)
            for path in self.paths
        ]

    def free_footholds(self) -> list[SharedMove]:
        """One unknown move for every stance, in the plane of its foothold (§7)."""
        feet = find_feet(self.source.model)
        return free_footholds(feet, self.stances, self.footholds, self.source.nframe)


def place(clip: Motion, scene: Scene) -> Motion:
    """Return the clip moved to the scene's start: its origin there, its +x along the start's."""
    qpos = np.array(clip.qpos)
    turn = yaw_quat(np.full(len(qpos), scene.start_yaw))
    qpos[:, :3] = rotate(turn, qpos[:, :3]) + scene.start_pos
    qpos[:, 3:7] = multiply(turn, qpos[:, 3:7])
    return clip.replace(qpos)


def plan(clip: Motion, scene: Scene, contacts: Sequence[Contact] | None = None) -> Plan:
    """Find out what the scene asks of a walk.

    Raises:
      ContactError: the clip has no contacts, or the given ones do not fit it.
      ModelError: the character has no feet.
      SceneError: no ground under the walk.
    """
    source = place(clip, scene)
    feet = find_feet(clip.model)
    found = (
        detect_contacts(source)
        if contacts is None
        else check_contacts(contacts, clip.model, clip.nframe)
    )
    if not found:
        raise ContactError(
            "no contacts: no foot of the clip rests on any ground, so there is nothing to adapt;"
            " give them with a contacts file"
        )
    pose = Kinematics(source.model, source.nframe).forward(source.qpos)
    stances = find_stances(source, pose, feet, found)
    ground = Ground(scene)
    footholds = find_footholds(stances, feet, ground, float(scene.start_pos[2]))
    paths = tuple(
        foot_path(foot, index, pose, stances, footholds, ground, source.fps)
        for index, foot in enumerate(feet)
    )
    shift = root_shift(source, pose, paths)
    given, standing = give(_shifted(source, shift), feet, paths, found)
    if given != paths:
        paths, found = given, standing
        shift = root_shift(source, pose, paths)
    obstacles = find_obstacles(scene.model, source.qpos[:, :3] + shift, footholds)
    return Plan(source, found, paths, stances, footholds, shift, obstacles)


def _shifted(motion: Motion, shift: Array) -> Motion:
    qpos = np.array(motion.qpos)
    qpos[:, :3] += shift
    return motion.replace(qpos)


def root_shift(source: Motion, pose: Pose, paths: Sequence[FootPath]) -> Array:
    """Return the first guess of §4.5 (nframe, 3) [m]: the mean shift of the feet's contacts.

    Each foot's shift is blended through its swing, so the mean is smooth; it is fitted with the
    coarse knots alone. Where a leg would then be longer than it is, the root goes down.
    """
    mean = np.mean([path.shift for path in paths], axis=0)
    spacings = default_levels(source.fps)
    shift = fit_multilevel(np.arange(source.nframe), mean, source.nframe, spacings[:-1])
    shift[:, 2] -= _drop(source, pose, paths, shift)
    return shift


def _drop(source: Motion, pose: Pose, paths: Sequence[FootPath], shift: Array) -> Array:
    """How far the root must go down for every foot to be within reach (nframe,) [m]."""
    ends = {limb.end: limb for limb in find_limbs(source.model)}
    need = np.full(source.nframe, -np.inf)
    for path in paths:
        site = source.model.site(path.site)
        limb = ends.get(int(site.bodyid[0]))
        if limb is None:
            continue
        limbs = limbs_of(source.model, (limb,))
        hip = pose.xanchor[:, source.model.body_jntadr[limb.upper]]
        ankle = pose.xanchor[:, source.model.body_jntadr[limb.end]]
        was = np.linalg.norm(hip - ankle, axis=1)
        reach = float(limbs.reach[0])
        most = np.clip(was, REACH_FREE * reach, REACH_MOST * reach)
        local = source.model.jnt_pos[source.model.body_jntadr[limb.end]] - site.pos
        goal = path.position + rotate(path.quat, np.broadcast_to(local, path.position.shape))
        apart = hip + shift - goal
        flat = np.linalg.norm(apart[:, :2], axis=1)
        allowed = np.sqrt(np.maximum(most**2 - flat**2, (0.5 * reach) ** 2))
        need = np.maximum(need, apart[:, 2] - allowed)
    return cover(need, DROP_TIME * source.fps)


def adapt(
    clip: Motion,
    scene: Scene,
    *,
    character: str | Path = "humanoid",
    contacts: Sequence[Contact] | None = None,
    constraints: Sequence[Constraint] = (),
    levels: Sequence[float] | None = None,
    tolerance: float = 1e-4,
    ik: str = "hybrid",
    progress: Callable[[str], None] | None = None,
) -> Adaptation:
    """Adapt a walk to a scene.

    Args:
      clip: the walk, on the character's model, on level ground at z = 0.
      scene: where it is to walk.
      character: the character's MJCF, or the name of one of ours.
      contacts: who stands when; found in the clip without.
      constraints: more that must hold; where they name a foot, they override its foothold.
      levels: frames a knot, coarse to fine.
      tolerance: refinement stops once no constraint is off by more [m].
      ik: ``"hybrid"`` or ``"numeric"``.
      progress: called with the name of each stage as it begins.

    Raises:
      SceneError: no ground under the walk, or a doorway that cannot be passed.
      ContactError, ConstraintError, ModelError, FitError: bad input.
    """
    say = progress or (lambda stage: None)
    spec = compose(character, scene)
    say("contacts and footholds")
    return carry_out(
        *(plan(clip, scene, contacts), spec, character),
        constraints=constraints,
        levels=levels,
        tolerance=tolerance,
        ik=ik,
        progress=progress,
    )


def carry_out(
    what: Plan,
    spec: mujoco.MjSpec,
    character: str | Path | mujoco.MjSpec,
    *,
    constraints: Sequence[Constraint] = (),
    levels: Sequence[float] | None = None,
    tolerance: float = 1e-4,
    ik: str = "hybrid",
    progress: Callable[[str], None] | None = None,
) -> Adaptation:
    """Fit a motion to a plan: past obstacles first, with ankles that give at the end.

    Args:
      what: what is asked.
      spec: character and scene in one.
      character: the character alone: the plan's source is on its model.
      constraints: more that must hold.
      levels: frames a knot, coarse to fine.
      tolerance: refinement stops once no constraint is off by more [m].
      ik: ``"hybrid"`` or ``"numeric"``.
      progress: called with the name of each stage as it begins.

    Raises:
      SceneError: a doorway that cannot be passed.
      ConstraintError, ModelError, FitError: bad input.
    """
    say = progress or (lambda stage: None)
    composed, model, nframe = spec.compile(), what.source.model, what.source.nframe
    own = _within_reach(constraints, _shifted(what.source, what.root_shift))
    wanted = [*what.constraints(), *own]
    began = time.perf_counter()
    start: Motion = what.source
    shift: Array | bool = what.root_shift
    clearance = None
    if what.obstacles:
        say("clearances")
        body = load_character(character)
        clearance = ObstacleClearance(body, what.obstacles, find_feet(model), nframe)
        start, shift = _duck(what, wanted, clearance, levels), False
    say("fit")
    ducked = time.perf_counter() - began
    result = fit(
        start,
        wanted,
        levels=levels,
        tolerance=tolerance,
        ik=ik,
        weights=stiff_root(model),
        clearance=clearance,
        first_guess=shift,
    )
    contacts_left = what.contacts
    for _ in range(GIVE_ROUNDS):
        # Only the fitted motion shows for certain what the ankles are asked for.
        paths, contacts_left = give(result.motion, find_feet(model), what.paths, contacts_left)
        if paths == what.paths:
            break
        what = dataclasses.replace(what, paths=paths, contacts=contacts_left)
        again = fit(
            result.motion,
            [*what.constraints(), *own],
            levels=[FINEST],
            ik=ik,
            weights=stiff_root(model),
            clearance=clearance,
            first_guess=False,
        )
        result = dataclasses.replace(
            again,
            trace=dataclasses.replace(
                result.trace,
                fit_seconds=result.trace.fit_seconds + again.trace.fit_seconds,
                exact_error_percent=again.trace.exact_error_percent,
            ),
        )
    if clearance is not None:
        _check_passage(clearance, result)
    # Against what was asked for, not what was brought within reach.
    asked = lay_out([*what.constraints(), *constraints], model, nframe)
    return Adaptation(
        what.source.on(composed),
        result.motion.on(composed),
        what.contacts,
        dataclasses.replace(result.trace, fit_seconds=ducked + result.trace.fit_seconds),
        find_unmet(result.motion, asked, residuals(result.motion, asked)),
        spec,
    )


def _within_reach(constraints: Sequence[Constraint], motion: Motion) -> list[Constraint]:
    """Bring targets for hands and feet as near as a limb and a lean of the body can go.

    A target further away would drag the whole body after it, off its footholds.
    """
    model = motion.model
    ends = {limb.end: limb for limb in find_limbs(model)}
    pose = Kinematics(model, motion.nframe).forward(motion.qpos)
    near: list[Constraint] = []
    for constraint in constraints:
        if not isinstance(constraint, SiteConstraint):
            near.append(constraint)
            continue
        site = model.site(constraint.site)
        limb = ends.get(int(site.bodyid[0]))
        inside = (constraint.frames >= 0).all() and (constraint.frames < motion.nframe).all()
        if limb is None or constraint.position is None or not inside:
            near.append(constraint)
            continue
        base = pose.xanchor[constraint.frames, model.body_jntadr[limb.upper]]
        hand = float(np.linalg.norm(site.pos))
        most = float(limbs_of(model, (limb,)).reach[0]) + hand + LEAN
        away = constraint.position - base
        length = np.linalg.norm(away, axis=1, keepdims=True)
        position = base + away * np.minimum(1.0, most / np.maximum(length, 1e-9))
        near.append(dataclasses.replace(constraint, position=position))
    return near


def stiff_root(model: mujoco.MjModel) -> Array:
    """Return rigidities (nv,) for a fit whose root has its path already: the legs do the rest."""
    weights = default_weights(model)
    weights[:6] *= ROOT_STIFFNESS
    return weights


def _duck(
    what: Plan,
    wanted: Sequence[Constraint],
    clearance: ObstacleClearance,
    levels: Sequence[float] | None,
) -> Motion:
    """Find the way past obstacles first, with knots so wide that it begins and ends in good time.

    Only frames that come too near an obstacle take part, so the displacement spreads smoothly to
    the frames around them, which full constraints at every frame would forbid.
    """
    source, qpos = what.source, _shifted(what.source, what.root_shift).qpos
    spacings = list(default_levels(source.fps) if levels is None else levels)
    coarse = spacings[: max(1, len(spacings) - 2)]
    frames = np.arange(source.nframe)
    targets = over_all_frames(lay_out(wanted, source.model, source.nframe), source.nframe)
    solver = NumericIK(source.model, iterations=1)  # the rounds are its iterations
    clearance.margin = DUCK_MARGIN
    for spacing in coarse + DUCK_ROUNDS * coarse[-1:]:
        broken = np.unique(clearance(qpos, frames).frame)
        if len(broken) == 0:
            break
        wish = solver.solve(qpos[broken], targets.at(broken), clearance)
        qpos = oplus(
            source.model, qpos, fit_level(broken, wish.displacement, source.nframe, spacing)
        )
    clearance.margin = MARGIN
    return source.replace(qpos)


def _check_passage(clearance: ObstacleClearance, result: Fit) -> None:
    depth, frame, names = clearance.inside(result.motion.qpos)
    if (depth > STUCK).any():
        frames = np.unique(frame[depth > STUCK])
        raise SceneError(
            f"'{names[int(np.argmax(depth))]}' bars the way: a body is {100 * depth.max():.0f} cm"
            f" inside it after all at frames {frame_list(frames.tolist())}: a doorway is too low or"
            " too narrow, or stands off the walk's path; widen or move it",
            frames.tolist(),
        )


__all__ = ["Adaptation", "Plan", "adapt", "carry_out", "place", "plan", "root_shift", "stiff_root"]
