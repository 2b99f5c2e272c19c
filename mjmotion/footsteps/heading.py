"""Which way a walk sets off, and whether it came to anything of its scene.

clip = set_off(clip)                      # along +x, whatever way it was recorded
never_met(plan, scene)                    # True where there was something, and it was elsewhere
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.motion import Motion
from mjmotion.footsteps.footholds import Foothold

Array = NDArray[np.float64]

HEADINGS = ("start", "keep")
"""A walk sets off along the start's x-axis, or its own +x is put there."""

SETS_OFF = 1.0  # which way a walk goes is seen when its root is this far from its first place [m]
TRAVELS = 0.5  # one that never comes further than this goes nowhere [m]
AHEAD = np.radians(3.0)  # hips that sway are off by as much; a walk so near to +x is left
NEAR = 0.5  # what is this near to the root's path over the ground is met [m]
LEVEL = 0.01  # footholds within this height of each other are on one level [m]


def heading(clip: Motion) -> float | None:
    """Return the direction in which a clip sets off, about z from +x [rad]; None for no walk.

    From its root's first place to the first that is ``SETS_OFF`` away; of one that stays nearer, to
    the first that is ``TRAVELS`` away: where its first steps go, however it turns after them.
    """
    away = clip.qpos[:, :2] - clip.qpos[0, :2]
    far = np.hypot(away[:, 0], away[:, 1])
    beyond = np.flatnonzero(far > (SETS_OFF if far.max() > SETS_OFF else TRAVELS))
    if len(beyond) == 0:
        return None
    goal = beyond[0]
    return float(np.arctan2(away[goal, 1], away[goal, 0]))


def set_off(clip: Motion) -> Motion:
    """Return a clip turned about its root's first place so that it sets off along +x.

    Whoever walks backwards still does, and looks along -x. One that goes nowhere, or along +x to
    within ``AHEAD``, is returned as it is.
    """
    way = heading(clip)
    if way is None or abs(way) <= AHEAD:
        return clip
    return clip.moved(-way, clip.qpos[0, :3], np.zeros(3))


def never_met(root_path: Array, footholds: Sequence[Foothold], scene: mujoco.MjModel) -> bool:
    """Return whether a scene holds something that a walk never came to.

    What it walks on all the way, on one level, is the ground, and so is every plane. Everything
    else that is solid is met where it comes within ``NEAR`` of the root's path, seen from above; a
    heightfield where a foothold is on another level.

    Args:
      root_path: (nframe, 3) where the root passes [m].
      footholds: what it stands on.
      scene: the scene alone, at rest.
    """
    heights = np.array([foothold.position[2] for foothold in footholds])
    if not len(heights) or np.ptp(heights) > LEVEL:
        return False
    solid = (scene.geom_contype != 0) | (scene.geom_conaffinity != 0)
    things = np.flatnonzero(solid & (scene.geom_type != mujoco.mjtGeom.mjGEOM_PLANE))
    data = mujoco.MjData(scene)
    mujoco.mj_kinematics(scene, data)
    turn = data.geom_xmat[things].reshape(-1, 3, 3)
    box = scene.geom_aabb[things]
    middle = data.geom_xpos[things] + np.einsum("gij,gj->gi", turn, box[:, :3])
    half = np.einsum("gij,gj->gi", np.abs(turn), box[:, 3:])
    raised = middle[:, 2] + half[:, 2] > heights[0] + LEVEL
    field = scene.geom_type[things] == mujoco.mjtGeom.mjGEOM_HFIELD
    apart = np.abs(root_path[:, None, :2] - middle[:, :2]) - half[:, :2]
    near = (np.maximum(apart, 0.0) ** 2).sum(axis=2).min(axis=0, initial=np.inf) < NEAR**2
    return bool(raised.any() and not (near & raised & ~field).any())
