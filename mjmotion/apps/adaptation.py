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

from mjmotion.body.feet import find_feet
from mjmotion.body.kinematics import Kinematics, site_id, site_positions
from mjmotion.body.limbs import find_limbs, limbs_of
from mjmotion.body.motion import Motion
from mjmotion.constraints import (
    Constraint,
    LookAt,
    RelativeConstraint,
    SiteConstraint,
    lay_out,
)
from mjmotion.constraints.shared_targets import with_moves
from mjmotion.exceptions import SceneError, frame_list
from mjmotion.fitting import (
    FINEST,
    Fit,
    default_levels,
    find_unmet,
    fit,
    over_all_frames,
    residuals,
)
from mjmotion.footsteps.ankles import give
from mjmotion.footsteps.contacts import Contact
from mjmotion.footsteps.obstacles import MARGIN, ObstacleClearance
from mjmotion.footsteps.plan import Plan, freed, place, plan, root_shift, shifted
from mjmotion.ik.numeric import NumericIK
from mjmotion.ik.solver import default_weights
from mjmotion.numerics.bspline import fit_level
from mjmotion.numerics.tangent import oplus
from mjmotion.output.result import Result
from mjmotion.scene import Scene, compose, load_character

Array = NDArray[np.float64]

DUCK_MARGIN = 0.05  # distance kept while the way through is found, more than in the end [m]
ROOT_STIFFNESS = 15.0  # how much stiffer the root is than elsewhere: its path is planned
LEAN = 0.25  # how far beyond a limb's reach the body may lean for a target [m]
GIVE_ROUNDS = 2  # times that the fitted motion is asked whether its ankles can follow
DUCK_ROUNDS = 6  # at most, with the finest of the knots that serve to find the way
STUCK = 0.02  # deeper than this in an obstacle after all, and the way is barred [m]


def adapt(
    clip: Motion,
    scene: Scene,
    *,
    character: str | Path = "humanoid",
    contacts: Sequence[Contact] | None = None,
    constraints: Sequence[Constraint] = (),
    free_footholds: bool = False,
    levels: Sequence[float] | None = None,
    tolerance: float = 1e-4,
    ik: str = "hybrid",
    progress: Callable[[str], None] | None = None,
) -> Result:
    """Adapt a walk to a scene.

    Args:
      clip: the walk, on the character's model, on level ground at z = 0.
      scene: where it is to walk.
      character: the character's MJCF, or the name of one of ours.
      contacts: who stands when; found in the clip without.
      constraints: more that must hold; where they name a foot, they override its foothold.
      free_footholds: let footholds move as a whole to where the walk changes least (§7).
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
    what = plan(clip, scene, contacts)
    if free_footholds:
        what = freed(what, scene, ik)
    return carry_out(
        *(what, spec, character),
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
    weights: Array | None = None,
    levels: Sequence[float] | None = None,
    tolerance: float = 1e-4,
    ik: str = "hybrid",
    progress: Callable[[str], None] | None = None,
) -> Result:
    """Fit a motion to a plan: past obstacles first, with ankles that give at the end.

    Args:
      what: what is asked.
      spec: character and scene in one.
      character: the character alone: the plan's source is on its model.
      constraints: more that must hold.
      weights: (nv,) rigidities; those of :func:`stiff_root` without.
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
    weights = stiff_root(model) if weights is None else weights
    posed = {path.site for path in what.paths}
    feet = [foot for foot in find_feet(model) if foot.site in posed] if posed else []
    guess = shifted(what.source, what.root_shift)
    asked = _moved_near(constraints, guess)
    own = _within_reach(asked, guess)
    wanted = [*what.constraints(), *own]
    began = time.perf_counter()
    start: Motion = what.source
    shift: Array | bool = what.root_shift
    clearance = None
    if what.obstacles:
        say("clearances")
        body = load_character(character, known=True)
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
        weights=weights,
        clearance=clearance,
        first_guess=shift,
    )
    contacts_left = what.contacts
    for _ in range(GIVE_ROUNDS):
        # Only the fitted motion shows for certain what the ankles are asked for.
        paths, contacts_left = give(result.motion, feet, what.paths, contacts_left)
        if paths == what.paths:
            break
        what = dataclasses.replace(what, paths=paths, contacts=contacts_left)
        again = fit(
            result.motion,
            [*what.constraints(), *own],
            levels=[FINEST],
            ik=ik,
            weights=weights,
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
    # Against what was asked for, not what was brought within reach; free targets where they went.
    targets = lay_out([*what.constraints(), *with_moves(asked, result.moves)], model, nframe)
    return Result(
        what.source.on(composed),
        result.motion.on(composed),
        what.contacts,
        dataclasses.replace(result.trace, fit_seconds=ducked + result.trace.fit_seconds),
        find_unmet(result.motion, targets, residuals(result.motion, targets)),
        spec,
    )


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
    model = motion.model
    ends = {limb.end: limb for limb in find_limbs(model)}
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
        most = float(limbs_of(model, (limb,)).reach[0]) + hand + LEAN
        origin, turn = np.zeros(3), np.eye(3)
        if isinstance(one, RelativeConstraint):
            to = site_id(model, one.to)
            origin, turn = pose.site_xpos[one.frames, to], pose.site_xmat[one.frames, to]
            other = ends.get(int(model.site_bodyid[to]))
            if other is not None:  # which may come to meet it
                most += 2.0 * float(limbs_of(model, (other,)).reach[0])
        away = origin + (turn @ one.position[..., None])[..., 0] - base
        length = np.linalg.norm(away, axis=1, keepdims=True)
        wanted = base + away * np.minimum(1.0, most / np.maximum(length, 1e-9)) - origin
        position = (np.swapaxes(turn, -1, -2) @ wanted[..., None])[..., 0]
        near.append(dataclasses.replace(one, position=position) if (length > most).any() else one)
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
    source, qpos = what.source, shifted(what.source, what.root_shift).qpos
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


__all__ = ["Plan", "adapt", "carry_out", "place", "plan", "root_shift", "stiff_root"]
