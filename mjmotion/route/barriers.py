"""What bars a way, in words: a lintel, a post, a wall, a box, a ledge or a gap, by name and place.

barrier(model, geom, floor)         # "post 'door1_left_post'"
no_ground(space, place)             # "a gap"
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.route.free_space import FreeSpace, geom_name
from mjmotion.route.walkable import STRIDE

Array = NDArray[np.float64]

HANGS = 0.3  # what has its bottom higher over the floor is a lintel [m]
TALL = 1.3  # what is higher than this, and no lintel, is a wall, or a post where it is slender [m]
SLENDER = 0.45  # a post is no wider [m]


def barrier(model: mujoco.MjModel, geom: int, floor: float) -> str:
    """Return what a geom is to a walk, and its name.

    Args:
      model: holds it, at rest.
      geom: its id.
      floor: height of the ground before it [m].
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    turn = data.geom_xmat[geom].reshape(3, 3)
    middle = data.geom_xpos[geom] + turn @ model.geom_aabb[geom, :3]
    half = np.abs(turn) @ model.geom_aabb[geom, 3:]
    low, high = middle[2] - half[2] - floor, middle[2] + half[2] - floor
    kind = int(model.geom_type[geom])
    if kind in (mujoco.mjtGeom.mjGEOM_HFIELD, mujoco.mjtGeom.mjGEOM_PLANE):
        what = "ground"
    elif low > HANGS:
        what = "lintel"
    elif high > TALL:
        what = "post" if 2.0 * half[:2].max() <= SLENDER else "wall"
    else:
        what = "box" if kind == mujoco.mjtGeom.mjGEOM_BOX else "block"
    return f"{what} '{geom_name(model, geom)}'"


def no_ground(space: FreeSpace, place: Array) -> str:
    """Return what there is around a place (2,) [m] where no ground can be walked to."""
    ground = space.ground
    row, column = (int(index) for index in ground.cells(place))
    near = (
        slice(max(row - STRIDE, 0), row + STRIDE + 1),
        slice(max(column - STRIDE, 0), column + STRIDE + 1),
    )
    rise = float(np.ptp(ground.height[near]))
    if rise > ground.step:
        return f"a ledge of {rise:.2f} m"
    return "a gap" if not ground.known[near].all() else "an edge"
