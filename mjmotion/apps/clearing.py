"""Fitting past what a motion must keep clear of: obstacles, the ground, the body itself.

A motion that is in nothing is returned as it came. One that is in something is pushed out of it
first, smoothly and with wide knots, and fitted again from there.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.character import Character
from mjmotion.body.kinematics import Kinematics, body_dofs
from mjmotion.body.motion import Motion
from mjmotion.constraints import Constraint, RelativeConstraint
from mjmotion.exceptions import ModelError, SceneError, frame_list
from mjmotion.fitting import FINEST, TOLERANCE, Fit, default_levels, fit, whole
from mjmotion.footsteps.arm_swing import arms_swung
from mjmotion.footsteps.bow import bow
from mjmotion.footsteps.clearances import BodyClearances, Clearances, pushed_clear
from mjmotion.footsteps.knees_apart import knees_apart
from mjmotion.footsteps.obstacles import ObstacleClearance
from mjmotion.footsteps.plan import Plan
from mjmotion.footsteps.self_clearance import SelfClearance
from mjmotion.footsteps.surfaces import SurfaceClearance, find_surfaces
from mjmotion.ik import IKSolver
from mjmotion.ik.solver import Clearance, default_rigidity
from mjmotion.numerics.progress import Progress, no_progress
from mjmotion.route.barriers import barrier, no_ground
from mjmotion.route.free_space import NO_GROUND, geom_name
from mjmotion.route.way import Route

Array = NDArray[np.float64]

DUCK_MARGIN = 0.05  # distance kept while the way through is found, more than in the end [m]
DUCK_ROUNDS = 6  # at most, with the finest of the knots that serve to find the way
_STILL = 1e9  # rigidity of what does not move at all
SQUEEZED = 0.1  # no body passes where trunk and legs lack more room on a side [m]
STUCK = 0.02  # deeper than this in an obstacle after all, and the way is barred [m]


@dataclasses.dataclass(frozen=True)
class FitSettings:
    """How a plan is fitted: what every application takes, and hands on.

    Attributes:
      levels: frames a knot of each level, coarse to fine; by the motion's rate without.
      tolerance: refinement stops once no constraint is off by more [m].
      ik: ``"hybrid"``, ``"numeric"`` or a solver of one's own.
      progress: called with stage, done, of.
      strict: whether a way that is barred is an error.
    """

    levels: Sequence[float] | None = None
    tolerance: float = TOLERANCE
    ik: str | IKSolver = "hybrid"
    progress: Progress = no_progress
    strict: bool = False


def past_obstacles(
    result: Fit,
    constraints: Sequence[Constraint],
    clearance: ObstacleClearance,
    solver: IKSolver,
    settings: FitSettings,
) -> Fit:
    """Fit again where the fitted motion comes too near an obstacle: from a way past it."""
    began = time.perf_counter()
    settings.progress("clearances", 0, 0)
    start = _duck(result.motion, constraints, clearance, settings.levels)
    if start is result.motion:
        return result
    looked = _taking(result, began)
    settings.progress("fit", 0, 0)
    again = fit(
        start,
        constraints,
        levels=settings.levels,
        tolerance=settings.tolerance,
        ik=solver,
        clearance=clearance,
        first_guess=False,
        progress=settings.progress,
    )
    return dataclasses.replace(again, trace=whole((looked.trace, again.trace)))


def _duck(
    motion: Motion,
    constraints: Sequence[Constraint],
    clearance: ObstacleClearance,
    levels: Sequence[float] | None,
) -> Motion:
    """Find the way past obstacles first, with knots so wide that it begins and ends in good time.

    A motion that is nowhere too near is returned as it is.
    """
    if len(clearance(motion.qpos, np.arange(motion.nframe)).frame) == 0:
        return motion
    wider = clearance.at_margin(DUCK_MARGIN)
    levels = list(default_levels(motion.fps) if levels is None else levels)
    coarse = levels[: max(1, len(levels) - 2)]
    bowed = bow(motion, wider.overhead())
    return pushed_clear(bowed, constraints, wider, coarse + DUCK_ROUNDS * coarse[-1:], rounds=1)


def what_bars(
    clearance: ObstacleClearance | None,
    result: Fit,
    plan: Plan,
    model: mujoco.MjModel,
    settings: FitSettings,
) -> Barred | None:
    """Return what a body is still well inside of, or where it has no room; None if it passes.

    Args:
      clearance: from what it keeps clear.
      result: the fitted motion.
      plan: what was asked of it.
      model: of the scene.
      settings: whether that is an error.

    Raises:
      SceneError: something bars the way, and the settings are strict.
    """
    barred = _inside(clearance, result, plan, model) or barred_route(plan.route, model)
    if barred is not None and settings.strict:
        raise barred.error()
    return barred


def _inside(
    clearance: ObstacleClearance | None, result: Fit, plan: Plan, model: mujoco.MjModel
) -> Barred | None:
    """Return what a body is still well inside of."""
    if clearance is not None:
        depth, frame, names = clearance.inside(result.motion.qpos)
        if (depth > STUCK).any():
            worst = int(np.argmax(depth))
            frames = np.unique(frame[depth > STUCK])
            root = result.motion.qpos[frame[worst], :3]
            feet = [foothold.position for foothold in plan.footholds] or [root * (1.0, 1.0, 0.0)]
            floor = min(feet, key=lambda foot: float(np.hypot(*(foot - root)[:2])))[2]
            geom = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, names[worst])
            known = names[worst] if geom < 0 else barrier(model, geom, float(floor))
            return Barred(known, root[:2], float(depth.max()), tuple(frames.tolist()))
    return None


def barred_route(route: Route | None, model: mujoco.MjModel) -> Barred | None:
    """Return what no body can squeeze past on a line; None where it can, or there is no line."""
    if route is None or route.lack <= (STUCK if route.bars == NO_GROUND else SQUEEZED):
        return None
    if route.bars == NO_GROUND:
        return Barred(no_ground(route.space, route.place), route.place, route.lack)
    floor = float(route.space.ground.at(route.place))
    name = geom_name(route.space.model, route.bars)
    geom = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, name)
    known = name if geom < 0 else barrier(model, geom, floor)
    return Barred(known, route.place, route.lack)


@dataclasses.dataclass(frozen=True, eq=False)
class Barred:
    """What bars a way.

    Attributes:
      what: it is, and its name.
      place: (2,) where the walk is then [m].
      short: by how much there is too little room [m].
      frames: when a body is in it.
    """

    what: str
    place: Array
    short: float
    frames: tuple[int, ...] = ()

    def __str__(self) -> str:
        """Return it as a line."""
        x, y = self.place
        when = f", at frames {frame_list(self.frames)}" if self.frames else ""
        return (
            f"there is no way: {self.what} bars it at x={x:.2f}, y={y:.2f},"
            f" by {100 * self.short:.0f} cm{when}"
        )

    def error(self) -> SceneError:
        """Return it as an error."""
        return SceneError(f"{self}: widen or move it, or go another way (--path)", self.frames)


def with_knees_apart(
    plan: Plan, result: Fit, asked: Sequence[Constraint], obstacles: ObstacleClearance | None
) -> Fit:
    """Turn knees outwards where legs are in each other and the source's are not.

    Legs that something is asked of beside their feet are left alone, as are those beside a wall.
    """
    began = time.perf_counter()
    character = plan.source.character
    ends = {limb.end for limb in character.limb_by_end.values()}
    legs = {body for foot in character.feet for body in _above(character, foot.body)}
    if {_body(character.model, site) for site in _sites(asked)} & (legs - ends):
        return result
    turned = knees_apart(result.motion, plan.source)
    if turned is result.motion:
        return _taking(result, began)
    if obstacles is not None and _depth(obstacles, turned) > _depth(obstacles, result.motion):
        return _taking(result, began)
    return dataclasses.replace(_taking(result, began), motion=turned)


def with_arms_swung(
    plan: Plan,
    result: Fit,
    asked: Sequence[Constraint],
    obstacles: ObstacleClearance | None,
    composed: Character,
) -> Fit:
    """Swing arms with the legs that are lifted higher than the source's.

    Arms that something is asked of are left alone; all of them beside and under obstacles, and
    where arms are in the body or the ground, or would come to be.
    """
    began = time.perf_counter()
    model, frames = plan.source.model, np.arange(plan.source.nframe)
    held = {_body(model, site) for site in _sites(asked)}
    swung = arms_swung(result.motion, plan.source, held)
    if swung is result.motion:
        return _taking(result, began)
    _, inside = _around_arms(plan, result.motion, composed, _arms(plan.source.character))
    tight: list[Clearance] = [inside]
    if obstacles is not None:
        tight.append(obstacles.at_margin(DUCK_MARGIN))
    busy = np.zeros(len(frames), dtype=bool)
    for motion in (result.motion, swung):
        for clearance in tight:
            busy[clearance(motion.qpos, frames).frame] = True
    if busy.any():
        swung = arms_swung(result.motion, plan.source, held, busy)
    return dataclasses.replace(_taking(result, began), motion=swung)


def _sites(asked: Sequence[Constraint]) -> list[str]:
    """Return the sites that constraints are about."""
    sites = [one.site for one in asked]
    return sites + [one.to for one in asked if isinstance(one, RelativeConstraint)]


def _body(model: mujoco.MjModel, site: str) -> int:
    """Return the body of a site."""
    return int(model.site(site).bodyid[0])


def _above(character: Character, foot: int) -> set[int]:
    """Return the bodies of a leg that ends in a foot."""
    limb = character.limb_by_end.get(foot)
    return set() if limb is None else {limb.upper, limb.lower, limb.end}


def with_arms_clear(
    plan: Plan,
    result: Fit,
    near: Sequence[Constraint],
    obstacles: ObstacleClearance | None,
    composed: Character,
    settings: FitSettings,
    solver: IKSolver,
) -> Fit:
    """Take arms out of the ground and of the body, where the source's are in neither.

    Only arms move: the body goes its way, and legs have their plan. Most motions need nothing.
    """
    began = time.perf_counter()
    source, nframe = plan.source, plan.source.nframe
    arms = _arms(source.character)
    if not arms:
        return result
    body, inside = _around_arms(plan, result.motion, composed, arms)
    if len(inside(result.motion.qpos, np.arange(nframe)).frame) == 0:
        return _taking(result, began)
    keep = body if obstacles is None else Clearances((obstacles.of(arms), body))
    levels = list(default_levels(source.fps) if settings.levels is None else settings.levels)
    rigidity = default_rigidity(source.model)
    moved = [body_dofs(source.model, body) for body in arms]
    shoulders = np.any(moved, axis=0) & ~np.all(moved, axis=0)
    rigidity[~shoulders] = _STILL
    pushed = pushed_clear(result.motion, near, keep, levels[len(levels) // 2 :], rigidity=rigidity)
    pushed = pushed.replace(source.character.within_limits(pushed.qpos))
    if obstacles is not None and _depth(obstacles, pushed) > _depth(obstacles, result.motion):
        return _taking(result, began)  # no room between the body and a wall
    looked = dataclasses.replace(_taking(result, began), motion=pushed)
    if not near:
        return looked
    asked_for = [*plan.constraints(), *near]
    again = fit(
        pushed, asked_for, levels=[FINEST], ik=solver, clearance=obstacles, first_guess=False
    )
    return dataclasses.replace(again, trace=whole((looked.trace, again.trace)))


def _around_arms(
    plan: Plan, motion: Motion, composed: Character, arms: set[int]
) -> tuple[BodyClearances, BodyClearances]:
    """Return what arms keep clear of, body and ground, and the same where they are inside only."""
    source = plan.source
    surfaces = find_surfaces(composed.model, motion.qpos[:, :3])
    kinematics = Kinematics(source.model, source.nframe, geoms=True)
    resting = {_body(source.model, contact.site) for contact in plan.contacts}
    others = set(range(source.model.nbody)) - arms
    itself = SelfClearance(source, kinematics, arms)
    ground = SurfaceClearance(source.character, surfaces, resting | others)
    inside = BodyClearances(kinematics, (itself.at_margin(0.0), ground.at_margin(0.0)))
    return BodyClearances(kinematics, (itself, ground)), inside


def _depth(obstacles: ObstacleClearance, motion: Motion) -> float:
    """Return how deep a motion is in the true obstacles at most, to a tenth of a millimetre [m]."""
    depth, _, _ = obstacles.inside(motion.qpos)
    return round(float(depth.max(initial=0.0)), 4)


def _arms(character: Character) -> set[int]:
    """Return the bodies of the arms; none where it has no arms that can be told."""
    try:
        parts = character.parts
    except ModelError:
        return set()
    return {body for limb in parts.arms for body in limb.bodies}


def _taking(result: Fit, began: float) -> Fit:
    """Return a fit that took the time since ``began`` longer."""
    trace = result.trace
    seconds = trace.fit_seconds + time.perf_counter() - began
    return dataclasses.replace(result, trace=dataclasses.replace(trace, fit_seconds=seconds))
