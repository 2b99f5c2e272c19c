"""What foot paths are made of: a clip that goes where it is to go, and one whose feet are still.

maker = PathMaker.of(source, own, ground, loose)
path = maker.path(0, stances, footholds, None)
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.kinematics import Kinematics, Pose, site_id
from mjmotion.body.motion import Motion
from mjmotion.footsteps.footholds import Foothold, Stance
from mjmotion.footsteps.paths import Detour, FootPath, foot_path
from mjmotion.scene.ground import Ground

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class PathMaker:
    """Makes foot paths.

    Attributes:
      source: the clip where its root is to go.
      pose: its poses.
      own: those of the clip whose feet are still where they stand.
      ground: the surfaces of the scene.
      loose: how much further feet go before their first stance and after their last, or nothing.
    """

    source: Motion
    pose: Pose
    own: Pose
    ground: Ground
    loose: tuple[Array, ...]

    @classmethod
    def of(
        cls, source: Motion, recorded: Motion, ground: Ground, loose: tuple[Array, ...]
    ) -> PathMaker:
        """Return them, posed."""
        pose, own = (
            Kinematics(clip.model, clip.nframe).forward(clip.qpos) for clip in (source, recorded)
        )
        return cls(source, pose, own, ground, loose)

    def path(
        self,
        index: int,
        stances: Sequence[Stance],
        footholds: Sequence[Foothold],
        detour: Detour | None,
    ) -> FootPath:
        """Return the path of foot number ``index``, its shift against the clip."""
        foot, fps = self.source.character.feet[index], self.source.fps
        more = self.loose[index] if self.loose else np.zeros((self.source.nframe, 3))
        if more.any():
            none = np.zeros(self.source.nframe)
            detour = Detour(more, none) if detour is None else detour.and_aside(more)
        path = foot_path(foot, index, self.own, stances, footholds, self.ground, fps, detour)
        site = site_id(self.pose.model, path.site)
        way = self.own.site_xpos[:, site] - self.pose.site_xpos[:, site]
        return dataclasses.replace(path, shift=path.shift + way + more)
