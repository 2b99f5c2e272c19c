"""What a scene asks of a walk, before anything is fitted: foot paths, the root's way, obstacles.

plan = on_ground(walk, scene)       # of footholds that are chosen; planning.make_plan chooses them
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
from mjmotion.footsteps.above_ground import above_ground
from mjmotion.footsteps.ankles import (
    SHORTEST,
    flat_landings,
    relax_ankles,
    trim_toe_contacts,
    turned_footholds,
)
from mjmotion.footsteps.apart import aside
from mjmotion.footsteps.contacts import Contact
from mjmotion.footsteps.footholds import Foothold
from mjmotion.footsteps.obstacles import Obstacle, find_obstacles
from mjmotion.footsteps.paths import Detour, FootPath, foot_path, free_footholds
from mjmotion.footsteps.pelvis import ROLLING, push_offs, root_shift, within_reach
from mjmotion.footsteps.rests import Rest, find_rests, knee_paths, kneeling, sitting
from mjmotion.footsteps.stances import Stance, contacts_of
from mjmotion.route.way import Route
from mjmotion.scene import Scene
from mjmotion.scene.ground import Ground

Array = NDArray[np.float64]


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
      still: the clip along the same way as its feet were recorded, where steps moved; else None.
      recorded: the clip on its own way, where that is another; else None.
      route: where the walk goes, and why; None where that was not looked for.
      original: the clip in its own time, of other frames, where steps take another; else None.
      loose: (nframe, 3) of each foot, where steps were moved: how much further it goes before its
        first stance and after its last [m].
      detected: who stands when in the whole clip, in its own time.
      rests: knees, palms and the seat where they rest.
      knees: where knees go that are posed at every frame.
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
    still: Motion | None = None
    recorded: Motion | None = None
    route: Route | None = None
    original: Motion | None = None
    loose: tuple[Array, ...] = ()
    detected: tuple[Contact, ...] = ()
    rests: tuple[Rest, ...] = ()
    knees: tuple[SiteConstraint, ...] = ()

    def constraints(self) -> list[SiteConstraint]:
        """Both feet posed at every frame, and what rests besides."""
        frames = np.arange(self.source.nframe)
        feet = [
            SiteConstraint(
                path.site, frames, path.position, path.quat, contact=True, source="scene"
            )
            for path in self.paths
        ]
        posed = {one.site for one in self.knees}
        rests = [rest.constraint() for rest in self.rests if rest.contact.site not in posed]
        return [*feet, *self.knees, *rests]

    def free_footholds(self) -> list[SharedMove]:
        """One unknown move for every stance, in the plane of its foothold (§7)."""
        feet = self.source.character.feet
        return free_footholds(feet, self.stances, self.footholds, self.source.nframe)


@dataclasses.dataclass(frozen=True, eq=False)
class Walk:
    """A walk before its ways from foothold to foothold are planned.

    Attributes:
      source: the clip where its root is to go.
      still: the clip along the same way, as its feet are recorded, where they are still.
      contacts: who stands when, and what rests.
      stances: where the still feet stand.
      footholds: where they are to stand.
      loose: how much further each foot goes before its first and after its last stance.
      landed: whether it is settled how feet land.
    """

    source: Motion
    still: Motion
    contacts: tuple[Contact, ...]
    stances: Sequence[Stance]
    footholds: tuple[Foothold, ...]
    loose: tuple[Array, ...] = ()
    landed: bool = False


def on_ground(walk: Walk, scene: Scene) -> Plan:
    """Plan the ways from foothold to foothold, one a stance, and what rests besides."""
    source, ground, feet = walk.source, scene.ground, walk.source.character.feet
    ways = _Ways.of(walk, ground)
    stances, footholds, pose = walk.stances, walk.footholds, ways.pose
    found = tuple(one for one in walk.contacts if not one.rests)

    def planned(index: int, detour: Detour | None = None) -> FootPath:
        return ways.path(index, stances, footholds, detour)

    # What feet, ankles and root ask of each other, each told once, the firmest first.
    paths = tuple(planned(index) for index in range(len(feet)))
    shift, _ = root_shift(source, pose, paths, found, ROLLING)
    turned = turned_footholds(shifted(source, shift), feet, paths, stances, footholds)
    flat = stances
    if not walk.landed:
        flat = flat_landings(shifted(source, shift), feet, paths, stances)
    found = contacts_of(flat, feet) if _changed((stances, footholds), (flat, footholds)) else found
    others = _changed((stances, footholds), (flat, turned))
    if others:
        footholds, stances = turned, flat
        paths = tuple(planned(i) if i in others else path for i, path in enumerate(paths))
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
    others = _changed(spots, (stances, footholds))
    if others:
        details = zip(paths, moves, tips, strict=True)
        paths = tuple(
            planned(index, Detour(move, tip)) if index in others else path
            for index, (path, move, tip) in enumerate(details)
        )
    paths, found, shift, back = ways.relaxed(paths, found)
    found = trim_toe_contacts(found, feet, paths, (stances, footholds), SHORTEST * source.fps)
    shift = sitting(shift, ways.rests, source.fps)
    obstacles = find_obstacles(scene.model, source.qpos[:, :3] + shift, footholds)
    resting = tuple(one.contact for one in ways.rests)
    found = tuple(sorted((*found, *resting), key=lambda one: (one.start, one.site)))
    return Plan(
        source=source,
        contacts=found,
        paths=paths,
        stances=tuple(stances),
        footholds=footholds,
        root_shift=shift,
        obstacles=obstacles,
        ground=ground,
        back=back,
        still=None if source is walk.still else walk.still,
        loose=walk.loose,
        rests=ways.rests,
        knees=tuple(knee_paths(source, pose, paths, ways.rests, ground)),
    )


_Spots = tuple[Sequence[Stance], Sequence[Foothold]]


def _changed(old: _Spots, new: _Spots) -> set[int]:
    """Return the feet any of whose stances or footholds is another than before."""
    return {
        stance.foot
        for before, after in zip(old, new, strict=True)
        for was, now, stance in zip(before, after, new[0], strict=True)
        if now is not was
    }


@dataclasses.dataclass(frozen=True, eq=False)
class _Ways:
    """What foot paths are made of: a walk, its poses and those of still feet, and what rests."""

    walk: Walk
    pose: Pose
    own: Pose
    ground: Ground
    rests: tuple[Rest, ...]

    @classmethod
    def of(cls, walk: Walk, ground: Ground) -> _Ways:
        """Return them, posed."""
        source, still = walk.source, walk.still
        pose = own = Kinematics(source.model, source.nframe).forward(source.qpos)
        if still is not source:
            own = Kinematics(still.model, still.nframe).forward(still.qpos)
        return cls(walk, pose, own, ground, find_rests(source, pose, walk.contacts, ground))

    def path(
        self,
        index: int,
        stances: Sequence[Stance],
        footholds: Sequence[Foothold],
        detour: Detour | None,
    ) -> FootPath:
        """Return the path of foot number ``index``, its shift against the walk's source."""
        source = self.walk.source
        foot, fps = source.character.feet[index], source.fps
        more = self.walk.loose[index] if self.walk.loose else np.zeros((source.nframe, 3))
        if more.any():
            none = np.zeros(source.nframe)
            detour = Detour(more, none) if detour is None else detour.and_aside(more)
        path = foot_path(foot, index, self.own, stances, footholds, self.ground, fps, detour)
        if self.own is not self.pose:
            site = site_id(self.pose.model, path.site)
            way = self.own.site_xpos[:, site] - self.pose.site_xpos[:, site]
            path = dataclasses.replace(path, shift=path.shift + way + more)
        return kneeling(foot, path, self.pose, self.rests, self.ground, fps)

    def relaxed(
        self, paths: tuple[FootPath, ...], found: tuple[Contact, ...]
    ) -> tuple[tuple[FootPath, ...], tuple[Contact, ...], Array, Array]:
        """Return paths in reach that ankles can follow, contacts left, and the root's shifts."""
        source, feet = self.walk.source, self.walk.source.character.feet
        shift, back = root_shift(source, self.pose, paths, found)
        near = within_reach(source, self.pose, paths, found, shift)
        relaxed, trimmed = relax_ankles(shifted(source, shift), feet, near, found)
        if relaxed == paths:
            return paths, found, shift, back
        paths = above_ground(feet, relaxed, paths, trimmed, self.ground, source.fps)
        return paths, trimmed, *root_shift(source, self.pose, paths, trimmed)


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
