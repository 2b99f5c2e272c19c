"""What one stands on: heights and normals of a scene's static surfaces, by rays from above.

    ground = scene.ground
    height, normal = ground.under(points)      # points (n, 3): look down from a little above each

Only static geoms that collide are ground; pictures and moving bodies are not.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.kinematics import RayCaster
from mjmotion.exceptions import SceneError, unknown_name
from mjmotion.scene.columns import Columns

Array = NDArray[np.float64]

LOOK_FROM = 1.0  # how far above a point the look down begins, less than any doorway [m]
STEEPEST = 0.35  # least upward part of a normal that can be stood on: about 70°


class Ground:
    """Static surfaces of one scene.

    Args:
      model: of the scene, without a character.
      avoid: names of geoms that are there but not meant to be stood on, such as water.

    Raises:
      SceneError: the scene has no geom of such a name.
    """

    def __init__(self, model: mujoco.MjModel, avoid: Sequence[str] = ()) -> None:
        names = [model.geom(geom).name for geom in range(model.ngeom)]
        for name in avoid:
            if name not in names:
                known = [other for other in names if other]
                raise SceneError(unknown_name("geom to avoid", name, known))
        # One more, never avoided, for rays that hit nothing.
        self._avoided = np.array([*(name in avoid and name != "" for name in names), False])
        self.model = solid_model(model)
        self._columns = Columns(self.model)

    def under(self, points: Array) -> tuple[Array, Array]:
        """Return the surface under points, seen from :data:`LOOK_FROM` above each.

        Args:
          points: (..., 3) world points near the ground [m].

        Returns:
          height (...) [m] and normal (..., 3); NaN and zero where there is nothing to stand on:
          no surface at all, a wall, or the inside of a solid.
        """
        height, normal, _ = self.standing(points)
        return height, normal

    def standing(self, points: Array) -> tuple[Array, Array, NDArray[np.int32]]:
        """Return what :meth:`under` does, and the geoms (...) that it is of; -1 for none."""
        shape = points.shape[:-1]
        origin = points.reshape(-1, 3) + (0.0, 0.0, LOOK_FROM)
        distance, geom, normal = self._columns.cast(origin)
        stands = (distance >= 0.0) & (normal[:, 2] > STEEPEST)
        height = np.where(stands, origin[:, 2] - distance, np.nan)
        normal = np.where(stands[:, None], normal, 0.0)
        geom = np.where(stands, geom, np.int32(-1))
        return height.reshape(shape), normal.reshape(*shape, 3), geom.reshape(shape)

    def firm(self, points: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return what :meth:`under` does, and where (...) that is not meant to be stood on."""
        height, normal, geom = self.standing(points)
        return height, normal, np.asarray(self._avoided[geom])

    def on_field(self, points: Array) -> bool:
        """Return whether all of points (n, 3) are over heightfields, seen as :meth:`under` does."""
        _, geom, _ = self._columns.cast(points + (0.0, 0.0, LOOK_FROM))
        kinds = self.model.geom_type[geom]
        return bool(((geom >= 0) & (kinds == mujoco.mjtGeom.mjGEOM_HFIELD)).all())

    def blocked(self, origins: Array, spans: Array, margin: float = 0.0) -> bool:
        """Return whether any segment (n, 3) + (n, 3), made longer by ``margin``, hits a wall.

        Heightfields are no walls, and slow for rays that go along them.
        """
        length = np.linalg.norm(spans, axis=1)
        longer = spans * (1.0 + margin / np.maximum(length, 1e-9))[:, None]
        corners = np.concatenate((origins, origins + longer))
        if not self._columns.any_wall_near(corners.min(axis=0), corners.max(axis=0)):
            return False
        direction = spans / np.maximum(length, 1e-9)[:, None]
        distance, _, _ = self._wall_rays.cast(origins, direction)
        return bool(((distance >= 0.0) & (distance < length + margin)).any())

    @cached_property
    def _wall_rays(self) -> RayCaster:
        walls = copy.copy(self.model)
        walls.geom_rgba[walls.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD, 3] = 0.0
        return RayCaster(walls)


def solid_model(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return the model with everything but its static colliding geoms out of the rays' way.

    Geoms keep their ids: the others are made transparent, which rays pass through.
    """
    solid = copy.copy(model)
    moving = model.body_weldid[model.geom_bodyid] != 0
    ghost = (model.geom_contype == 0) & (model.geom_conaffinity == 0)
    hidden = moving | ghost
    # MuJoCo collides with a plane wherever it ends in pictures, and its rays end there too.
    solid.geom_size[solid.geom_type == mujoco.mjtGeom.mjGEOM_PLANE, :2] = 0.0
    solid.geom_matid[:] = -1
    solid.geom_rgba[:, 3] = np.where(hidden, 0.0, 1.0)
    return solid
