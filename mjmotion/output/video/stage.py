"""What is drawn: copies of models made ready for pictures, their light, ground and background.

A motion's own model is never changed: copies hide the character or the scene, or tint a ghost.
"""

from __future__ import annotations

import copy

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.body.kinematics import character_geoms

Array = NDArray[np.float64]

BACKGROUND = (0.86, 0.89, 0.92)
FLOOR = (0.62, 0.64, 0.66, 1.0)
FLOOR_LINE = (0.50, 0.52, 0.55, 1.0)

_SHADOW_REACH = 3.5  # around the figure [m]
_KEY = (np.radians(42.0), np.radians(52.0))  # key light: from the camera's bearing, over the ground
_FOG = (7.5, 11.0)  # from the camera [m]: no farther than the window on a heightfield reaches
_WALL = 80.0  # distance of the backdrop [m]
_LINE_REACH = 12  # grid lines around the figure [m]


def picture_model(
    model: mujoco.MjModel,
    width: int,
    height: int,
    *,
    fovy: float,
    shadows: bool = True,
    samples: int = 4,
    fog: tuple[float, float] = _FOG,
) -> mujoco.MjModel:
    """Return a copy of ``model`` with settings for pictures of ``width`` × ``height`` pixels."""
    model = copy.copy(model)
    vis = model.vis
    vis.global_.offwidth, vis.global_.offheight = width, height
    vis.global_.fovy = fovy
    vis.quality.offsamples = samples
    vis.quality.shadowsize = 2048 if shadows else 0
    model.stat.extent = 1.0  # so that the distances below are metres
    vis.map.znear, vis.map.zfar = 0.1, 2.5 * _WALL
    vis.map.fogstart, vis.map.fogend = fog
    vis.map.shadowclip = _SHADOW_REACH
    vis.rgba.fog[:] = (*BACKGROUND, 1.0)
    # No picture shows the sky; whole, it takes a tenth of the time that the driver needs to start.
    sky = np.flatnonzero(model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX)
    model.tex_width[sky], model.tex_height[sky] = 1, 6
    return model


def without_character(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy in which the character's geoms are invisible, to pictures and to rays."""
    return _repaint(model, character_geoms(model), (0.0, 0.0, 0.0, 0.0))


def without_scene(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy in which only the character's geoms are visible."""
    others = np.setdiff1d(np.arange(model.ngeom), character_geoms(model))
    return _repaint(model, others, (0.0, 0.0, 0.0, 0.0))


def ghost(model: mujoco.MjModel, rgba: ArrayLike) -> mujoco.MjModel:
    """Return a copy with the character in one colour."""
    return _repaint(model, character_geoms(model), rgba)


def _repaint(model: mujoco.MjModel, geoms: NDArray[np.int64], rgba: ArrayLike) -> mujoco.MjModel:
    model = copy.copy(model)
    model.geom_rgba[geoms] = rgba
    model.geom_matid[geoms] = -1
    return model


class Stage:
    """One MuJoCo scene that is filled anew for every frame.

    Args:
      model: from :func:`picture_model`; with its character, whether shown or not.
      extra: how many geoms are added to the model's own, at most.
      floor: height of a flat floor with a grid to draw [m]; None for none.
      shadows: whether the key light casts them.
      bearing: direction of the camera, about z from +x [rad]: the key light comes from its side.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        extra: int,
        *,
        bearing: float,
        floor: float | None = None,
        shadows: bool = True,
    ) -> None:
        self.model, self.floor, self.shadows = model, floor, shadows
        self.data = mujoco.MjData(model)
        room = 2 * model.ngeom + extra + 4 * _LINE_REACH * 2 + 100
        self.scene = mujoco.MjvScene(model, room)
        flags = mujoco.mjtRndFlag
        for flag, value in (
            (flags.mjRND_SHADOW, shadows),
            (flags.mjRND_FOG, True),
            (flags.mjRND_SKYBOX, False),
            (flags.mjRND_HAZE, False),
            (flags.mjRND_REFLECTION, False),
        ):
            self.scene.flags[flag] = value
        self._option = mujoco.MjvOption()
        self._option.sitegroup[:] = 0
        self._still = mujoco.MjvPerturb()
        turn, height = bearing + _KEY[0], _KEY[1]
        self._key = -np.array(
            [np.cos(turn) * np.cos(height), np.sin(turn) * np.cos(height), np.sin(height)]
        )
        across = bearing - np.pi / 2
        self._fill = np.array([-0.7 * np.cos(across), -0.7 * np.sin(across), -0.7])
        self._pose(model.qpos0)

    def _pose(self, qpos: Array) -> None:
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)
        if self.model.nflex:
            mujoco.mj_flex(self.model, self.data)

    def begin(self, qpos: Array, camera: mujoco.MjvCamera, aspect: float) -> None:
        """Start a frame: the model at ``qpos`` (nq,), light, floor and background."""
        self._pose(qpos)
        mujoco.mjv_updateScene(
            self.model,
            self.data,
            self._option,
            self._still,
            camera,
            mujoco.mjtCatBit.mjCAT_ALL.value,
            self.scene,
        )
        ground = int(mujoco.mjtGeom.mjGEOM_HFIELD)
        for index in range(self.scene.ngeom):
            geom = self.scene.geoms[index]
            if geom.type == ground:
                geom.castshadow = False  # flickering specks on slopes, and a third of the time
        self._light(np.asarray(camera.lookat))
        self._backdrop(camera, aspect)
        if self.floor is not None:
            self._floor(np.asarray(camera.lookat), self.floor)

    def add_figure(self, model: mujoco.MjModel, qpos: Array, data: mujoco.MjData) -> None:
        """Add the character of ``model``, a repainted copy of the stage's own, at ``qpos`` (nq,).

        ``data`` is of that copy and is changed.
        """
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mjv_addGeoms(
            model,
            data,
            self._option,
            self._still,
            mujoco.mjtCatBit.mjCAT_DYNAMIC.value,
            self.scene,
        )

    def add(
        self,
        kind: mujoco.mjtGeom,
        size: ArrayLike,
        pos: ArrayLike,
        rgba: ArrayLike,
        matrix: ArrayLike | None = None,
        *,
        emission: float = 0.0,
        shadow: bool = False,
    ) -> None:
        """Add one geom; sizes as in MJCF [m]."""
        if self.scene.ngeom >= self.scene.maxgeom:
            return
        geom = self.scene.geoms[self.scene.ngeom]
        mujoco.mjv_initGeom(
            geom,
            int(kind),
            np.asarray(size, dtype=np.float64),
            np.asarray(pos, dtype=np.float64),
            np.eye(3).ravel() if matrix is None else np.asarray(matrix, np.float64).ravel(),
            np.asarray(rgba, dtype=np.float32),
        )
        geom.category = int(mujoco.mjtCatBit.mjCAT_DECOR)
        geom.castshadow = shadow
        geom.emission = emission
        geom.specular = 0.0
        self.scene.ngeom += 1

    def _light(self, target: Array) -> None:
        """Light every scene alike, in place of its own lights; shadows follow the figure."""
        self.scene.nlight = 2
        fill, key = self.scene.lights[0], self.scene.lights[1]
        for light in (fill, key):
            light.type = int(mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
            light.headlight = False
            light.attenuation[:] = (1.0, 0.0, 0.0)
            light.pos[:] = target - 8.0 * self._key
            light.texid = -1
        fill.castshadow = False
        fill.dir[:] = self._fill
        fill.ambient[:] = (0.40, 0.41, 0.43)
        fill.diffuse[:] = (0.18, 0.19, 0.22)
        fill.specular[:] = 0.0
        key.castshadow = self.shadows
        key.dir[:] = self._key
        key.ambient[:] = 0.0
        key.diffuse[:] = (0.62, 0.60, 0.56)
        key.specular[:] = 0.15

    def _backdrop(self, camera: mujoco.MjvCamera, aspect: float) -> None:
        """Add a wall behind everything, deep in the fog: MuJoCo paints no background itself."""
        yaw, pitch = np.radians(camera.azimuth), np.radians(camera.elevation)
        forward = np.array(
            [np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)]
        )
        right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
        matrix = np.column_stack((right, np.cross(right, forward), -forward))
        reach = _WALL * np.tan(np.radians(self.model.vis.global_.fovy) / 2) * 1.3
        eye = np.asarray(camera.lookat) - camera.distance * forward
        self.add(
            mujoco.mjtGeom.mjGEOM_BOX,
            (reach * max(aspect, 1.0), reach, 0.01),
            eye + _WALL * forward,
            (*BACKGROUND, 1.0),
            matrix,
        )

    def _floor(self, target: Array, height: float) -> None:
        """Add a flat floor with lines half a metre apart, around the figure."""
        box = mujoco.mjtGeom.mjGEOM_BOX
        middle = np.array([*np.round(target[:2]), height])
        self.add(box, (40.0, 40.0, 0.05), middle - (0, 0, 0.05), FLOOR)
        for step in np.arange(-_LINE_REACH, _LINE_REACH + 0.1, 0.5):
            width = 0.010 if float(step).is_integer() else 0.004
            self.add(box, (width, _LINE_REACH, 5e-4), middle + (step, 0, 5e-4), FLOOR_LINE)
            self.add(box, (_LINE_REACH, width, 5e-4), middle + (0, step, 5e-4), FLOOR_LINE)
