"""Planning a walk in a scene: where it goes, where it steps, how long that takes; then its ways.

plan = make_plan(clip, scene)
plan.constraints(), plan.root_shift, plan.obstacles
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.kinematics import Kinematics
from mjmotion.body.motion import Motion
from mjmotion.exceptions import ContactError
from mjmotion.fitting import fit
from mjmotion.footsteps.contacts import Contact, check_contacts, detect_contacts
from mjmotion.footsteps.footholds import Foothold, find_footholds
from mjmotion.footsteps.given import as_given, cut_to_way, given_way
from mjmotion.footsteps.pace import Pace, find_pace
from mjmotion.footsteps.plan import Plan, Walk, on_ground
from mjmotion.footsteps.settings import PlanSettings
from mjmotion.footsteps.stances import Stance, contacts_of, find_stances
from mjmotion.footsteps.steps import (
    bend_along,
    can_be_stepped,
    choose_footholds,
    loose_ends,
)
from mjmotion.ik import IKSolver
from mjmotion.numerics.rotations import multiply, yaw_quat
from mjmotion.route.way import Route, find_route, stopped_short
from mjmotion.scene import Scene

Array = NDArray[np.float64]

OFF_PLANE = 0.03  # further out of its plane than this a free foothold stands on something else [m]
_HALVINGS = 3  # of a move that would take a foothold there; after the last it stays


def place(clip: Motion, scene: Scene) -> Motion:
    """Return the clip moved to the scene's start: its origin there, its +x along the start's."""
    return clip.moved(scene.start_yaw, np.zeros(3), scene.start_pos)


def make_plan(
    clip: Motion,
    scene: Scene,
    contacts: Sequence[Contact] | None = None,
    settings: PlanSettings | None = None,
) -> Plan:
    """Find out what the scene asks of a walk.

    Args:
      clip: the walk.
      scene: where it is to go.
      contacts: who stands when; found in the clip without.
      settings: what of the walk may change.

    Raises:
      ContactError: the clip has no contacts, or the given ones do not fit it.
      ModelError: the character has no feet.
      SceneError: no ground under the walk.
    """
    settings = PlanSettings() if settings is None else settings
    scene = scene.at_rest()  # what could move is an obstacle and ground like the rest
    whole = recorded = place(clip, scene)
    detected = found = _contacts(whole, contacts)
    way = given_way(scene, settings)
    if way is not None:
        recorded, found = cut_to_way(whole, found, way)
    steps = tuple(one for one in found if not one.rests)
    feet, ground = clip.character.feet, scene.ground_without(settings.avoid)
    height = float(scene.start_pos[2])
    route = _route(recorded, steps, scene, way, settings)
    source = route.bend.apply(recorded) if route.bent else recorded
    spots = _stances(source, steps)
    footholds, turns = choose_footholds(spots, feet, ground, height)
    if settings.footholds is not None:
        footholds, turns = as_given(settings.footholds, spots, (footholds, turns), feet, ground)
    pace, bent = Pace.none(source.nframe), source
    loose: tuple[Array, ...] = ()
    if turns is not None:
        route = stopped_short(route, np.array([one.position[:2] for one in footholds[-2:]]))
        if settings.pace != "keep":
            pace = find_pace(spots, footholds, source.nframe, clip.fps)
        found, spots, source = pace.contacts(found), pace.stances(spots), pace.apply(source)
        loose = loose_ends(spots, footholds, source.nframe)
        bent = bend_along(source, spots, footholds, (turns, loose)).apply(source)
    # A foot that is in the air at an end of the clip goes where that of the bent clip goes.
    plan = on_ground(Walk(bent, source, found, spots, footholds, loose), scene)
    return dataclasses.replace(
        plan,
        route=route,
        recorded=pace.apply(recorded) if route.bent or turns is not None else None,
        original=None if pace.same and whole is recorded else whole,
        detected=detected,
    )


def _route(
    clip: Motion,
    steps: tuple[Contact, ...],
    scene: Scene,
    way: Array | None,
    settings: PlanSettings,
) -> Route:
    """Return where a clip goes, who stands when being known."""
    feet, ground = clip.character.feet, scene.ground_without(settings.avoid)

    def stepped() -> bool:
        stances = _stances(clip, steps)
        return can_be_stepped(stances, feet, ground, float(scene.start_pos[2]))

    return find_route(
        clip,
        scene,
        given=way,
        keep=isinstance(settings.path, str) and settings.path == "keep",
        climb=settings.climb,
        avoid=settings.avoid,
        stepped=stepped,
    )


def _contacts(clip: Motion, contacts: Sequence[Contact] | None) -> tuple[Contact, ...]:
    """Return who stands when: what is given, or found in the clip."""
    if contacts is None:
        found = detect_contacts(clip)
    else:
        found = check_contacts(contacts, clip.model, clip.nframe)
    if not found:
        raise ContactError(
            "no contacts: no foot of the clip rests on any ground, so there is nothing to adapt;"
            " give them with a contacts file"
        )
    return found


def _stances(clip: Motion, contacts: Sequence[Contact]) -> tuple[Stance, ...]:
    """Return the stances of a clip where it is."""
    pose = Kinematics(clip.model, clip.nframe).forward(clip.qpos)
    return find_stances(clip, pose, clip.character.feet, contacts)


def with_free_footholds(plan: Plan, scene: Scene, ik: str | IKSolver = "hybrid") -> Plan:
    """Return the plan with footholds where they change the walk least (§7).

    Each foothold is free to move and turn in its own plane as a whole; where the fit takes it, it
    is put on the ground anew, so that nothing slides and nothing floats. One that would come to
    stand on another step goes less far.

    Args:
      plan: the plan with footholds under those of the clip.
      scene: the same scene.
      ik: ``"hybrid"``, ``"numeric"`` or a solver of one's own.

    Raises:
      SceneError: there is nothing to stand on where a foothold went.
    """
    shared = plan.free_footholds()
    moves = fit(
        plan.source,
        plan.constraints(),
        ik=ik,
        first_guess=plan.root_shift,
        shared=shared,
        exact=False,
    ).moves
    feet, ground = plan.source.character.feet, scene.ground
    order = [i for foot in range(len(feet)) for i, s in enumerate(plan.stances) if s.foot == foot]
    share = np.ones(len(order))
    for halving in range(_HALVINGS + 1):
        spots = list(plan.stances)
        for index, move, found in zip(order, shared, share[:, None] * moves, strict=True):
            spots[index] = dataclasses.replace(
                plan.stances[index],
                source_pos=move.pivot + found[: len(move.directions)] @ move.directions,
                source_quat=multiply(yaw_quat(found[3]), plan.stances[index].source_quat),
            )
        new = find_footholds(spots, feet, ground, float(scene.start_pos[2]))
        off = np.array([_off_plane(plan.footholds[i], new[i]) > OFF_PLANE for i in order])
        if not off.any():
            break
        share[off] *= 0.5 if halving < _HALVINGS - 1 else 0.0
    # With every heel again that had to give where it stood before.
    found = contacts_of(plan.stances, feet)
    resting = tuple(one.contact for one in plan.rests)
    walk = Walk(
        plan.source,
        plan.still or plan.source,
        (*found, *resting),
        plan.stances,
        new,
        plan.loose,
        landed=True,
    )
    planned = on_ground(walk, scene)
    return dataclasses.replace(
        planned,
        route=plan.route,
        recorded=plan.recorded,
        original=plan.original,
        detected=plan.detected,
    )


def _off_plane(old: Foothold, new: Foothold) -> float:
    """How far a foothold left the plane of the one that it was free to move in [m]."""
    return float(abs((new.position - old.position) @ old.normal))
