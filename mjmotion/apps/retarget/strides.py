"""Where the feet of another body go: on the same spots, or as far apart as its legs are long.

A foot's path is told by the stances: on a spot while it stands, and on the way from spot to spot
between. What the source's foot does besides (it rolls, and rises in the swing) is taken over: near
the ground as much larger or smaller as the foot is, so that a foot that rolls on its toe fits the
toe it has, and well between stances as much as steps and legs are.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.retarget.copying import leg_ratio, mid_hips
from mjmotion.body.character import Character
from mjmotion.body.feet import Foot
from mjmotion.body.kinematics import Kinematics, Pose, site_id
from mjmotion.body.motion import Motion
from mjmotion.footsteps.contacts import Contact
from mjmotion.footsteps.footholds import Foothold, find_footholds
from mjmotion.footsteps.paths import FootPath, foot_path
from mjmotion.footsteps.stances import Stance, find_stances
from mjmotion.numerics.rotations import from_matrix
from mjmotion.numerics.smoothing import ease
from mjmotion.scene.ground import Ground

Array = NDArray[np.float64]

LIFT_SHARE = 0.25  # share of a swing in which a foot comes to its own height, at either end
LIFT_TIME = 0.1  # the same for a swing that the motion cuts off [s]
FOLLOW_TIME = 0.3  # in which a foot outside its stances comes to go along with the hips [s]


@dataclasses.dataclass(frozen=True, eq=False)
class Strides:
    """Stances of the source's feet, and which feet of the other body take them over.

    Attributes:
      pose: the source at every frame.
      source: the source's feet.
      feet: the other body's, side by side with those.
      stances: all stances on the source's spots.
      spots: the same on the other body's spots.
      hips: (nframe, 3) the middle of the source's hips [m].
      scale: factor on the plane.
      legs: how much longer the other body's legs are.
      fps: frames a second.
    """

    pose: Pose
    source: tuple[Foot, ...]
    feet: tuple[Foot, ...]
    stances: tuple[Stance, ...]
    spots: tuple[Stance, ...]
    hips: Array
    scale: float
    legs: float
    fps: float

    @classmethod
    def find(
        cls,
        motion: Motion,
        character: Character,
        contacts: Sequence[Contact],
        about: Array,
        scale: float,
    ) -> Strides:
        """Return the strides of a motion for other feet.

        Args:
          motion: the motion on its own body.
          character: the other body.
          contacts: those of heels and toes.
          about: (3,) the point of the ground about which spots are scaled in the plane [m].
          scale: by how much.
        """
        sides = {foot.side: foot for foot in motion.character.feet}
        mine = tuple(foot for foot in character.feet if foot.side in sides)
        theirs = tuple(sides[foot.side] for foot in mine)
        pose = Kinematics(motion.model, motion.nframe).forward(motion.qpos)
        stances = find_stances(motion, pose, theirs, contacts)
        spots = []
        for stance in stances:
            spot = about + scale * (stance.source_pos - about)
            spot[2] = stance.source_pos[2]
            spots.append(dataclasses.replace(stance, source_pos=spot))
        return cls(
            pose,
            theirs,
            mine,
            stances,
            tuple(spots),
            mid_hips(motion),
            scale,
            leg_ratio(motion.character, character),
            motion.fps,
        )

    def blended(self, foot: int, values: Sequence[Array]) -> Array:
        """Return values (k,), one a stance of all, for one foot at every frame (nframe, k).

        Constant in a stance and eased through the swings.
        """
        nframe = len(self.pose.xpos)
        mine = [(s, v) for s, v in zip(self.stances, values, strict=True) if s.foot == foot]
        blend = np.tile(np.asarray(mine[0][1], dtype=np.float64), (nframe, 1))
        for (before, old), (after, new) in pairwise(mine):
            count = after.start - before.end
            share = ease((np.arange(count) + 1.0) / (np.float64(count) + 1.0))[:, None]
            blend[before.end : after.start] = old + share * (np.asarray(new) - old)
            blend[after.start :] = new
        return blend

    def _swinging(self, foot: int) -> Array:
        """Return how far off its stances a foot is (nframe,): 0 where it stands, 1 well between."""
        frame = np.arange(len(self.hips))
        share = np.zeros(len(frame))
        mine = [stance for stance in self.stances if stance.foot == foot]
        ends = [-np.inf, *(float(stance.end - 1) for stance in mine)]
        starts = [*(float(stance.start) for stance in mine), np.inf]
        for end, start in zip(ends, starts, strict=True):
            inside = (frame > end) & (frame < start)
            time = LIFT_SHARE * (start - end)
            if not np.isfinite(time):
                time = LIFT_TIME * self.fps
            apart = np.minimum(frame - end, start - frame)[inside]
            share[inside] = ease(np.minimum(1.0, apart / time))
        return share

    def _following(self, foot: int) -> Array:
        """Return how far a foot goes along with the hips (nframe, 3) [m] outside its stances.

        Before its first and after its last there is no spot to come from or go to.
        """
        mine = [stance for stance in self.stances if stance.foot == foot]
        frame = np.arange(len(self.hips))
        away = np.maximum(mine[0].start - frame, frame - mine[-1].end + 1)
        share = ease(np.clip(away / (FOLLOW_TIME * self.fps), 0.0, 1.0))
        speed = np.diff(self.hips, axis=0, prepend=self.hips[:1]) * (1.0, 1.0, 0.0)
        way = np.cumsum(share[:, None] * speed, axis=0)
        return np.asarray(way - way[mine[0].start])

    def standing(self) -> list[int]:
        """Return the numbers of the feet that stand at all."""
        return sorted({stance.foot for stance in self.stances})

    @property
    def standing_feet(self) -> tuple[Foot, ...]:
        """The other body's feet that stand at all."""
        return tuple(self.feet[foot] for foot in self.standing())

    def support(self) -> Array:
        """Return the height of what the source stands on at every frame (nframe,) [m]."""
        heights = [stance.source_pos[2:] for stance in self.stances]
        return np.mean([self.blended(foot, heights) for foot in self.standing()], axis=0)[:, 0]

    def place(self, guess: Motion, ground: Ground, start_height: float) -> Placed:
        """Return where the other body's feet go on some ground.

        Args:
          guess: the motion on the other body.
          ground: the scene's surfaces.
          start_height: height of the ground where the motion begins [m].

        Raises:
          SceneError: nothing to stand on.
        """
        footholds = find_footholds(self.spots, self.feet, ground, start_height)
        pose = self._on(guess)
        paths, moved = [], []
        for foot in self.standing():
            path = foot_path(
                self.feet[foot], foot, pose, self.stances, footholds, ground, guess.fps
            )
            planned = [
                spot.source_pos * (1, 1, 0) - stance.source_pos * (1, 1, 0)
                for spot, stance in zip(self.spots, self.stances, strict=True)
            ]
            paths.append(path)
            moved.append(dataclasses.replace(path, shift=path.shift - self.blended(foot, planned)))
        return Placed(tuple(paths), tuple(moved), footholds)

    def _on(self, guess: Motion) -> Pose:
        """Return the guess's poses with its feet as the source's, to its own feet's measure."""
        pose = Kinematics(guess.model, guess.nframe).forward(guess.qpos)
        place, turn, bodies = (x.copy() for x in (pose.site_xpos, pose.site_xmat, pose.xquat))
        anchors = [stance.source_pos for stance in self.stances]
        legs = self.legs
        for index in self.standing():
            mine, theirs = self.feet[index], self.source[index]
            column, other = site_id(pose.model, mine.site), site_id(self.pose.model, theirs.site)
            long = np.linalg.norm(mine.front - mine.heel)
            long = long / np.linalg.norm(theirs.front - theirs.heel)
            anchor = self.blended(index, anchors)
            along = self._following(index)
            besides = long * (self.pose.site_xpos[:, other] - anchor - along)
            # Well between stances it is the body and its steps that count, not the foot alone:
            # longer legs lift it higher, as the same joint angles would.
            swinging, size = self._swinging(index)[:, None], max(legs, float(long))
            most = np.array((min(self.scale, size), min(self.scale, size), size)) / long
            besides *= 1.0 + (most - 1.0) * swinging
            place[:, column] = anchor + self.scale * along + besides
            turn[:, column] = self.pose.site_xmat[:, other]
            if mine.toes is not None:
                quat = from_matrix(turn[:, column])
                bodies[:, mine.toes.body] = mine.toes.placed(quat, theirs.bend(self.pose))
        return dataclasses.replace(pose, site_xpos=place, site_xmat=turn, xquat=bodies)


@dataclasses.dataclass(frozen=True, eq=False)
class Placed:
    """Where feet go on some ground.

    Attributes:
      paths: one a foot that stands.
      moved: the same, but with the shift that the ground asked alone, without that of a scale.
      footholds: one a stance.
    """

    paths: tuple[FootPath, ...]
    moved: tuple[FootPath, ...]
    footholds: tuple[Foothold, ...]
