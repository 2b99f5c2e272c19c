"""The same figures for a body that changes from frame to frame, on level ground.

Every frame's sizes are written into a private copy of the model, and MuJoCo places it: nothing here
knows how the motion was made. Shapes are taken point by point, as they are in that frame.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.motion import Motion
from mjmotion.exceptions import MotionError
from mjmotion.validation.figures import Poses, Swing
from mjmotion.validation.ground import Ground
from mjmotion.validation.inputs import ChangingBody
from mjmotion.validation.morph_poses import body_poses
from mjmotion.validation.penetration import CharacterGeoms
from mjmotion.validation.solids import reach, solid_of

Array = NDArray[np.float64]
_NOISE = 1e-9  # [m] shallower than rounding


class Changing:
    """Where a body that changes is in every frame, and how far its shapes are from planes.

    Args:
      motion: the motion.
      body: the body of every frame.
      geoms: the character's geoms to measure.
      ground: the scene: planes alone.

    Raises:
      MotionError: the body has other frames than the motion, or the scene is not just planes.
    """

    def __init__(
        self, motion: Motion, body: ChangingBody, geoms: CharacterGeoms, ground: Ground
    ) -> None:
        if body.nframe != motion.nframe:
            raise MotionError(
                f"the body has {body.nframe} frames and the motion {motion.nframe}: they must be of"
                " the same run"
            )
        if ground.convex or ground.fields or ground.surfaces:
            raise MotionError("a body that changes is measured on level ground: use a flat scene")
        self._body, self._geoms, self._ground = body.on(motion.model), geoms, ground
        poses = body_poses(self._body, motion.qpos)
        self.poses = Poses(poses.site, poses.geom[:, geoms.ids], poses.geom_matrix[:, geoms.ids])
        self._distance = self._distances()

    def penetration(self) -> tuple[Array, NDArray[np.int64]]:
        """Return depths (nframe, ngeom) [m], and the plane each is in, -1 where clear."""
        depth = np.maximum(-self._distance.min(axis=0, initial=0.0), 0.0)
        other = np.full(depth.shape, -1)
        if self._ground.planes:
            deepest = np.array(self._ground.planes)[self._distance.argmin(axis=0)]
            other = np.where(depth > _NOISE, deepest, -1)
        return np.where(depth > _NOISE, depth, 0.0), other

    def clearances(self, swings: Sequence[Swing]) -> list[tuple[float, int]]:
        """Return the least height [m] of the sole over the ground in each swing, and its frame."""
        owner = self._geoms.owner
        result = []
        for swing in swings:
            near = self._distance[:, swing.first : swing.last, owner == swing.foot]
            if near.size == 0:
                result.append((np.inf, swing.first))
                continue
            height = near.min(axis=(0, 2))
            result.append((float(height.min()), swing.first + int(height.argmin())))
        return result

    def _distances(self) -> Array:
        """Signed distances (nplane, nframe, ngeom) of geoms over planes [m]."""
        ground, poses = self._ground, self.poses
        shape = (len(ground.planes), *poses.geom.shape[:2])
        distance = np.empty(shape)
        for row, plane in enumerate(ground.planes):
            normal = ground.matrix[plane][:, 2]
            toward = np.einsum("fgji,j->fgi", poses.turn, -normal)
            distance[row] = (poses.geom - ground.position[plane]) @ normal - self._reach(toward)
        return distance

    def _reach(self, toward: Array) -> Array:
        """How far geoms reach (nframe, ngeom) [m] along directions (nframe, ngeom, 3) in theirs."""
        body, geoms = self._body, self._geoms
        result = np.empty(toward.shape[:2])
        model = copy.copy(body.model)
        meshes = model.geom_type[geoms.ids] == mujoco.mjtGeom.mjGEOM_MESH
        for i in np.flatnonzero(meshes):
            mesh = model.geom_dataid[geoms.ids[i]]
            start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            vertex = body.fields["mesh_vert"][:, start : start + count]
            result[:, i] = np.einsum("fvi,fi->fv", vertex, toward[:, i]).max(axis=1)
        for frame in range(body.nframe):  # the rest are few, and each has a shape of its own
            model.geom_size[:] = body.fields["geom_size"][frame]
            for i in np.flatnonzero(~meshes):
                solid = solid_of(model, int(geoms.ids[i]))
                result[frame, i] = reach(solid, toward[frame, i][None])[0]
        return result
