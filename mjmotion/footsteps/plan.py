"""What a scene asks of a walk, before anything is fitted: footholds, foot paths, the root's way.

plan = make_plan(clip, scene)
plan.constraints(), plan.root_shift, plan.obstacles
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.feet import Foot
from mjmotion.body.kinematics import Kinematics, Pose
from mjmotion.body.motion import Motion
from mjmotion.constraints import SiteConstraint
from mjmotion.constraints.shared_targets import SharedMove
from mjmotion.exceptions import ContactError
from mjmotion.fitting import fit
from mjmotion.footsteps.ankles import (
    SHORTEST,
    flat_landings,
    relax_ankles,
    trim_toe_contacts,
    turned_footholds,
)
from mjmotion.footsteps.apart import aside
from mjmotion.footsteps.contacts import Contact, check_contacts, detect_contacts
from mjmotion.footsteps.footholds import (
    Foothold,
    Stance,
    contacts_of,
    find_footholds,
    find_stances,
)
from mjmotion.footsteps.given import as_given, cut_to_way, given_way
from mjmotion.footsteps.obstacles import Obstacle, find_obstacles
from mjmotion.footsteps.pace import Pace, find_pace
from mjmotion.footsteps.path_maker import PathMaker
from mjmotion.footsteps.paths import Detour, FootPath, free_footholds
from mjmotion.footsteps.pelvis import ROLLING, push_offs, root_shift, within_reach
from mjmotion.footsteps.settings import PlanSettings
from mjmotion.footsteps.steps import bend_along, can_be_stepped, choose_footholds, loose_ends
from mjmotion.ik import IKSolver
from mjmotion.numerics.rotations import multiply, rotate, yaw_quat
from mjmotion.route.way import Route, find_route
from mjmotion.scene import Scene

Array = NDArray[np.float64]

OFF_PLANE = 0.03  # further out of its plane than this a free foothold stands on something else [m]
_HALVINGS = 3  # of a move that would take a foothold there; after the last it stays


@dataclasses.dataclass(frozen=True, eq=False)
class Plan:
    """What the scene asks of a walk, before anything is fitted.

    Attributes:
      source: the clip placed at the scene's start, on the character's model, on its way.
      contacts: who stands when.
      paths: where each foot goes.
      stances: the feet's stays on one spot.
      footholds: what it stands on, one a stance.
      root_shift: (nframe, 3) the first guess of §4.5 [m].
      obstacles: what to keep clear of.
      recorded: the clip on its own way, where that is another; else None.
      route: where the walk goes, and why; None where that was not looked for.
      original: the clip in its own time, of other frames, where steps take another; else None.
      loose: (nframe, 3) of each foot, where steps were moved: how much further it goes before its
        first stance and after its last [m].
      detected: who stands when in the whole clip, in its own time.
    """

    source: Motion
    contacts: tuple[Contact, ...]
    paths: tuple[FootPath, ...]
    stances: tuple[Stance, ...]
    footholds: tuple[Foothold, ...]
    root_shift: Array
    obstacles: tuple[Obstacle, ...]
    recorded: Motion | None = None
    route: Route | None = None
    original: Motion | None = None
    loose: tuple[Array, ...] = ()
    detected: tuple[Contact, ...] = ()

    def constraints(self) -> list[SiteConstraint]:
        """Both feet posed at every frame."""
        frames = np.arange(self.source.nframe)
        return [
            SiteConstraint(
                path.site, frames, path.position, path.quat, contact=True, source="scene"
            )
            for path in self.paths
        ]

    def free_footholds(self) -> list[SharedMove]:
        """One unknown move for every stance, in the plane of its foothold (§7)."""
        feet = self.source.character.feet
        return free_footholds(feet, self.stances, self.footholds, self.source.nframe)


def place(clip: Motion, scene: Scene) -> Motion:
    """Return the clip moved to the scene's start: its origin there, its +x along the start's."""
    qpos = np.array(clip.qpos)
    turn = yaw_quat(np.full(len(qpos), scene.start_yaw))
    qpos[:, :3] = rotate(turn, qpos[:, :3]) + scene.start_pos
    qpos[:, 3:7] = multiply(turn, qpos[:, 3:7])
    return clip.replace(qpos)


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
    # On its own way the recorded feet are still: bent, they slide a little where they stand.
    keep = isinstance(settings.path, str) and settings.path == "keep"
    feet, ground = clip.character.feet, scene.ground_without(settings.avoid)
    own, height = _stances(recorded, found), float(scene.start_pos[2])
    route = find_route(
        recorded,
        scene,
        given=way,
        keep=keep,
        climb=settings.climb,
        avoid=settings.avoid,
        stepped=lambda: can_be_stepped(own, feet, ground, height),
    )
    source = route.bend.apply(recorded) if route.bent else recorded
    spots = _stances(source, found)
    footholds, turns = choose_footholds(spots, feet, ground, height)
    if settings.footholds is not None:
        footholds, turns = as_given(settings.footholds, spots, (footholds, turns), feet, ground)
    pace, bent, loose = Pace.none(source.nframe), source, tuple[Array, ...]()
    if turns is not None:
        if settings.pace != "keep":
            pace = find_pace(spots, footholds, source.nframe, clip.fps)
        found, spots, source = pace.contacts(found), pace.stances(spots), pace.apply(source)
        loose = loose_ends(spots, footholds, source.nframe)
        bent = bend_along(source, spots, footholds, (turns, loose)).apply(source)
    # A foot that is in the air at an end of the clip goes where that of the bent clip goes.
    plan = _on_ground((bent, source), found, spots, footholds, scene, loose)
    return dataclasses.replace(
        plan,
        route=route,
        recorded=pace.apply(recorded) if route.bent or turns is not None else None,
        original=None if pace.same and whole is recorded else whole,
        detected=detected,
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
    clips = plan.source, plan.recorded or plan.source
    planned = _on_ground(clips, found, plan.stances, new, scene, plan.loose, landed=True)
    return dataclasses.replace(
        planned, route=plan.route, original=plan.original, detected=plan.detected
    )


def _off_plane(old: Foothold, new: Foothold) -> float:
    """How far a foothold left the plane of the one that it was free to move in [m]."""
    return float(abs((new.position - old.position) @ old.normal))


def _on_ground(
    clips: tuple[Motion, Motion],
    found: tuple[Contact, ...],
    stances: Sequence[Stance],
    footholds: tuple[Foothold, ...],
    scene: Scene,
    loose: tuple[Array, ...] = (),
    *,
    landed: bool = False,
) -> Plan:
    """Plan the ways from foothold to foothold, one a stance.

    Args:
      clips: the clip where its root is to go, and as recorded, where its feet are still.
      found: who stands when.
      stances: where the recorded feet stand.
      footholds: where they are to stand.
      scene: the scene.
      loose: how much further each foot goes before its first and after its last stance.
      landed: whether it is settled how feet land.
    """
    source, recorded = clips
    feet, ways = source.character.feet, PathMaker.of(source, recorded, scene.ground, loose)
    pose = ways.pose

    def planned(index: int, detour: Detour | None = None) -> FootPath:
        return ways.path(index, stances, footholds, detour)

    # What feet, ankles and root ask of each other, each told once, the firmest first.
    paths = tuple(planned(index) for index in range(len(feet)))
    shift = root_shift(source, pose, paths, found, ROLLING)
    turned = turned_footholds(shifted(source, shift), feet, paths, stances, footholds)
    flat = tuple(stances)
    if not landed:
        flat = flat_landings(shifted(source, shift), feet, paths, stances)
    if _changed(flat, stances):
        found = contacts_of(flat, feet)
    if _changed((*turned, *flat), (*footholds, *stances)):
        footholds, stances = turned, flat
        paths = tuple(planned(index) for index in range(len(feet)))
    moves = aside(feet, paths, pose, source.fps)
    tips = push_offs(source, pose, paths, found, shift)
    paths = tuple(
        planned(index, Detour(move, tip)) if move.any() or tip.any() else paths[index]
        for index, (move, tip) in enumerate(zip(moves, tips, strict=True))
    )
    # A ball that its foot rolls off before its time stands no longer: from then on it swings.
    spots = (stances, footholds)
    found = trim_toe_contacts(found, feet, paths, spots, SHORTEST * source.fps)
    stances = with_ends(stances, feet, found)
    if _changed(stances, spots[0]):
        details = zip(moves, tips, strict=True)
        paths = tuple(planned(index, Detour(*detail)) for index, detail in enumerate(details))
    paths, found, shift = _relaxed(source, pose, paths, found)
    found = trim_toe_contacts(found, feet, paths, (stances, footholds), SHORTEST * source.fps)
    obstacles = find_obstacles(scene.model, source.qpos[:, :3] + shift, footholds)
    other = None if source is recorded else recorded
    plan = Plan(source, found, paths, tuple(stances), footholds, shift, obstacles, other)
    return dataclasses.replace(plan, loose=loose)


def _relaxed(
    source: Motion, pose: Pose, paths: tuple[FootPath, ...], found: tuple[Contact, ...]
) -> tuple[tuple[FootPath, ...], tuple[Contact, ...], Array]:
    """Return paths within reach that ankles can follow, the contacts left, and the root's shift."""
    shift = root_shift(source, pose, paths, found)
    paths = within_reach(source, pose, paths, found, shift)
    feet = source.character.feet
    relaxed, trimmed = relax_ankles(shifted(source, shift), feet, paths, found)
    if relaxed == paths:
        return paths, found, shift
    return relaxed, trimmed, root_shift(source, pose, relaxed, trimmed)


def _changed(new: Sequence[object], old: Sequence[object]) -> bool:
    """Whether any of some things is another."""
    return any(one is not other for one, other in zip(new, old, strict=True))


def with_ends(
    stances: Sequence[Stance], feet: Sequence[Foot], contacts: Sequence[Contact]
) -> tuple[Stance, ...]:
    """Return stances that end with the last of what their toe contacts were cut to, if anything."""
    ended = []
    for stance in stances:
        name, (start, end) = f"{feet[stance.foot].side}_toe", stance.toe
        ends = [one.end for one in contacts if one.site == name and start < one.end <= end]
        last = max(ends, default=end)
        ended.append(stance if last == end else dataclasses.replace(stance, toe=(start, last)))
    return tuple(ended)


def shifted(motion: Motion, shift: Array) -> Motion:
    """Return the motion with its root shifted by (nframe, 3) [m]."""
    qpos = np.array(motion.qpos)
    qpos[:, :3] += shift
    return motion.replace(qpos)
