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
from mjmotion.body.kinematics import Kinematics, Pose, site_id
from mjmotion.body.motion import Motion
from mjmotion.constraints import SiteConstraint
from mjmotion.constraints.shared_targets import SharedMove
from mjmotion.exceptions import ContactError
from mjmotion.fitting import fit
from mjmotion.footsteps.above_ground import above_ground
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
from mjmotion.footsteps.obstacles import Obstacle, find_obstacles
from mjmotion.footsteps.pace import Pace, find_pace
from mjmotion.footsteps.paths import Detour, FootPath, foot_path, free_footholds
from mjmotion.footsteps.pelvis import ROLLING, push_offs, root_shift, within_reach
from mjmotion.footsteps.rests import Rest, find_rests, kneeling, sitting
from mjmotion.footsteps.settings import PlanSettings
from mjmotion.footsteps.steps import bend_along, choose_footholds, loose_ends
from mjmotion.ik import IKSolver
from mjmotion.numerics.rotations import multiply, rotate, yaw_quat
from mjmotion.route.way import Route, find_route
from mjmotion.scene import Scene
from mjmotion.scene.ground import Ground

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
      ground: the scene's surfaces.
      back: (nframe,) how far of the shift the hips stay back for the ankles uphill; None as 0 [m].
      recorded: the clip on its own way, where that is another; else None.
      route: where the walk goes, and why; None where that was not looked for.
      original: the clip in its own time, of other frames, where steps take another; else None.
      loose: (nframe, 3) of each foot, where steps were moved: how much further it goes before its
        first stance and after its last [m].
      rests: knees, palms and the seat where they rest.
    """

    source: Motion
    contacts: tuple[Contact, ...]
    paths: tuple[FootPath, ...]
    stances: tuple[Stance, ...]
    footholds: tuple[Foothold, ...]
    root_shift: Array
    obstacles: tuple[Obstacle, ...]
    ground: Ground
    back: Array | None = None
    recorded: Motion | None = None
    route: Route | None = None
    original: Motion | None = None
    loose: tuple[Array, ...] = ()
    rests: tuple[Rest, ...] = ()

    def constraints(self) -> list[SiteConstraint]:
        """Both feet posed at every frame, and what rests besides."""
        frames = np.arange(self.source.nframe)
        feet = [
            SiteConstraint(
                path.site, frames, path.position, path.quat, contact=True, source="scene"
            )
            for path in self.paths
        ]
        return feet + [rest.constraint() for rest in self.rests]

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
    recorded = place(clip, scene)
    feet = clip.character.feet
    found = (
        detect_contacts(recorded)
        if contacts is None
        else check_contacts(contacts, clip.model, clip.nframe)
    )
    if not found:
        raise ContactError(
            "no contacts: no foot of the clip rests on any ground, so there is nothing to adapt;"
            " give them with a contacts file"
        )
    # On its own way the recorded feet are still: bent, they slide a little where they stand.
    route = _routed(recorded, scene, settings)
    bent = route is not None and route.bent
    source = route.bend.apply(recorded) if route is not None and bent else recorded
    steps = tuple(one for one in found if not one.rests)
    stances = _stances(recorded, steps)
    spots = _stances(source, steps) if bent else stances
    ground = scene.ground_without(settings.avoid)
    footholds, turns = choose_footholds(spots, feet, ground, float(scene.start_pos[2]))
    if turns is None:
        walk = _Walk(source, recorded, found, stances, footholds)
        return dataclasses.replace(_on_ground(walk, scene), route=route)
    pace = find_pace(spots, footholds, clip.nframe, clip.fps)
    if settings.pace == "keep":
        pace = Pace.none(clip.nframe)
    original = None if pace.same else recorded
    source, recorded = pace.apply(source), pace.apply(recorded)
    found, stances, spots = pace.contacts(found), pace.stances(stances), pace.stances(spots)
    loose = loose_ends(spots, footholds, source.nframe)
    source = bend_along(source, spots, footholds, (turns, loose)).apply(source)
    plan = _on_ground(_Walk(source, recorded, found, stances, footholds, loose), scene)
    return dataclasses.replace(plan, route=route, original=original)


def _stances(clip: Motion, contacts: Sequence[Contact]) -> tuple[Stance, ...]:
    """Return the stances of a clip where it is."""
    pose = Kinematics(clip.model, clip.nframe).forward(clip.qpos)
    return find_stances(clip, pose, clip.character.feet, contacts)


def _routed(clip: Motion, scene: Scene, settings: PlanSettings) -> Route | None:
    """Return where a clip goes; None where it keeps its own way."""
    if isinstance(settings.path, str) and settings.path == "keep":
        return None
    return find_route(clip, scene, climb=settings.climb, avoid=settings.avoid)


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
    walk = _Walk(
        plan.source,
        plan.recorded or plan.source,
        (*found, *resting),
        plan.stances,
        new,
        plan.loose,
    )
    planned = _on_ground(walk, scene)
    return dataclasses.replace(planned, route=plan.route, original=plan.original)


def _off_plane(old: Foothold, new: Foothold) -> float:
    """How far a foothold left the plane of the one that it was free to move in [m]."""
    return float(abs((new.position - old.position) @ old.normal))


@dataclasses.dataclass(frozen=True, eq=False)
class _Walk:
    """A walk before its ways from foothold to foothold are planned.

    Attributes:
      source: the clip where its root is to go.
      recorded: the clip as recorded, where its feet are still.
      contacts: who stands when, and what rests.
      stances: where the recorded feet stand.
      footholds: where they are to stand.
      loose: how much further each foot goes before its first and after its last stance.
    """

    source: Motion
    recorded: Motion
    contacts: tuple[Contact, ...]
    stances: Sequence[Stance]
    footholds: tuple[Foothold, ...]
    loose: tuple[Array, ...] = ()


_Spots = tuple[Sequence[Stance], Sequence[Foothold]]


def _changed(old: _Spots, new: _Spots) -> set[int]:
    """Return the feet any of whose stances or footholds is another than before."""
    return {
        stance.foot
        for before, after in zip(old, new, strict=True)
        for was, now, stance in zip(before, after, new[0], strict=True)
        if now is not was
    }


def _on_ground(walk: _Walk, scene: Scene) -> Plan:
    """Plan the ways from foothold to foothold, one a stance, and what rests besides."""
    source, recorded, ground = walk.source, walk.recorded, scene.ground
    stances, footholds, feet = walk.stances, walk.footholds, source.character.feet
    pose = own = Kinematics(source.model, source.nframe).forward(source.qpos)
    if recorded is not source:
        own = Kinematics(recorded.model, recorded.nframe).forward(recorded.qpos)
    rests = find_rests(source, pose, walk.contacts, ground)
    found = tuple(one for one in walk.contacts if not one.rests)

    def planned(index: int, detour: Detour | None = None) -> FootPath:
        foot, more = feet[index], walk.loose[index] if walk.loose else None
        if more is not None and more.any():
            none = np.zeros(source.nframe)
            detour = Detour(more, none) if detour is None else detour.and_aside(more)
        path = foot_path(foot, index, own, stances, footholds, ground, source.fps, detour)
        path = path if source is recorded else _against(path, pose, own, more)
        return kneeling(foot, path, pose, rests, ground, source.fps)

    # What feet, ankles and root ask of each other, each told once, the firmest first.
    paths = tuple(planned(index) for index in range(len(feet)))
    shift, _ = root_shift(source, pose, paths, found, ROLLING)
    turned = turned_footholds(shifted(source, shift), feet, paths, stances, footholds)
    landed = flat_landings(shifted(source, shift), feet, paths, stances)
    if any(new is not old for new, old in zip(landed, stances, strict=True)):
        found = contacts_of(landed, feet)
    other = _changed((stances, footholds), (landed, turned))
    if other:
        footholds, stances = turned, landed
        paths = tuple(planned(i) if i in other else path for i, path in enumerate(paths))
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
    other = _changed(spots, (stances, footholds))
    if other:
        details = zip(paths, moves, tips, strict=True)
        paths = tuple(
            planned(index, Detour(move, tip)) if index in other else path
            for index, (path, move, tip) in enumerate(details)
        )
    shift, back = root_shift(source, pose, paths, found)
    near = within_reach(source, pose, paths, found, shift)
    relaxed, trimmed = relax_ankles(shifted(source, shift), feet, near, found)
    if relaxed != paths:
        paths, found = above_ground(feet, relaxed, paths, trimmed, ground, source.fps), trimmed
        shift, back = root_shift(source, pose, paths, found)
    found = trim_toe_contacts(found, feet, paths, (stances, footholds), SHORTEST * source.fps)
    shift = sitting(shift, rests, source.fps)
    obstacles = find_obstacles(scene.model, source.qpos[:, :3] + shift, footholds)
    found = tuple(
        sorted((*found, *(one.contact for one in rests)), key=lambda c: (c.start, c.site))
    )
    return Plan(
        *(source, found, paths, tuple(stances), footholds, shift, obstacles),
        ground=ground,
        back=back,
        recorded=None if source is recorded else recorded,
        loose=walk.loose,
        rests=rests,
    )


def _against(path: FootPath, pose: Pose, own: Pose, loose: Array | None) -> FootPath:
    """Return a path whose shift is against a clip that goes another way than the recorded one."""
    site = site_id(pose.model, path.site)
    shift = path.shift + own.site_xpos[:, site] - pose.site_xpos[:, site]
    return dataclasses.replace(path, shift=shift if loose is None else shift + loose)


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
