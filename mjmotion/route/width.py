"""How wide a walk is: what its body takes up beside its line, by height over the ground.

width = BodyWidth.of(source, line)
width.swung, width.trunk      # half widths of every band of heights, along the line
"""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.geom_points import geom_points
from mjmotion.body.kinematics import Kinematics, character_geoms
from mjmotion.body.motion import Motion
from mjmotion.exceptions import ModelError
from mjmotion.route.centreline import Centreline, headings

Array = NDArray[np.float64]

STEP_HEIGHT = 0.45  # what is higher over the ground is walked round [m]
BANDS = (0.05, STEP_HEIGHT, 0.8, 1.1)  # lower ends of the bands of heights over the ground [m]
LOWEST = 1.1  # what hangs higher can be bowed under [m]
_RATE = 15.0  # poses a second that are looked at
_NEAR = 0.6  # how far before and after a place the widest pose counts [s]


@dataclasses.dataclass(frozen=True, eq=False)
class BodyWidth:
    """Half widths of a walking body beside its line, in bands of heights over the ground.

    Attributes:
      length: (n,) arc lengths along the line, rising [m].
      swung: (n, nband) with the arms as they swing [m].
      trunk: (n, nband) without them [m].
      height: of what is highest, over the ground [m].
    """

    length: Array
    swung: Array
    trunk: Array
    height: float

    @classmethod
    def of(cls, motion: Motion, line: Centreline, ground: float = 0.0) -> BodyWidth:
        """Return the widths of a walk over level ground at height ``ground`` [m]."""
        frames = np.arange(0, motion.nframe, max(1, round(motion.fps / _RATE)))
        model = motion.model
        pose = Kinematics(model, len(frames), geoms=True).forward(motion.qpos[frames])
        assert pose.geom_xpos is not None and pose.geom_xmat is not None
        heading = headings(line.points, line.length, line.length[frames])
        side = np.column_stack((-np.sin(heading), np.cos(heading)))
        arms = _arms(motion)
        edges = np.array((*BANDS, np.inf))
        wide = np.zeros((2, len(frames), len(BANDS)))
        top = 0.0
        for geom in character_geoms(model, colliding=True):
            local = geom_points(model, int(geom))
            points = np.einsum("fij,kj->fki", pose.geom_xmat[:, geom], local)
            points += pose.geom_xpos[:, geom, None]
            off = points[..., :2] - line.points[frames, None]
            beside = np.abs(np.einsum("fki,fi->fk", off, side))
            up = points[..., 2] - ground
            top = max(top, float(up.max()))
            low, high = up.min(axis=1), up.max(axis=1)
            of_arm = int(model.geom_bodyid[geom]) in arms
            # Of what a band cuts no point need be in it: the nearest of its ends counts then too.
            for band, (floor, above) in enumerate(pairwise(edges)):
                cut = np.flatnonzero((low < above) & (high > floor))
                if len(cut) == 0:
                    continue
                height = up[cut]
                within = (height > floor - 0.1) & (height < above + 0.1)
                found = np.where(within, beside[cut], 0.0).max(axis=1)
                for kind in range(1 if of_arm else 2):
                    wide[kind, cut, band] = np.maximum(wide[kind, cut, band], found)
        widest = _sliding(wide, 2 * round(_NEAR * _RATE) + 1)
        return cls(line.length[frames], widest[0], widest[1], top)

    def at(self, lengths: Array) -> tuple[Array, Array]:
        """Return half widths (m, nband) at arc lengths (m,): with arms as they swing, without."""
        place = np.clip(np.searchsorted(self.length, lengths), 0, len(self.length) - 1)
        return self.swung[place], self.trunk[place]


def _arms(motion: Motion) -> set[int]:
    try:
        parts = motion.character.parts
    except ModelError:
        return set()
    return {body for limb in parts.arms for body in limb.bodies}


def _sliding(wide: Array, size: int) -> Array:
    """Return the greatest within ``size`` frames around each."""
    from scipy.ndimage import maximum_filter1d

    return np.asarray(maximum_filter1d(wide, size, axis=1, mode="nearest"))


def is_solid(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Return (ngeom,) which geoms stand still and collide with anything."""
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    return np.asarray(solid & (model.body_weldid[model.geom_bodyid] == 0))
