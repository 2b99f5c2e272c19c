"""What is drawn: copies of models made ready for pictures, their light, ground and background.

A motion's own model is never changed. Copies hide the character or the scene, tint a ghost, and
show large heightfields through a window that follows the figure (:class:`FieldWindow`), because the
cost of a picture grows with every node of a field, seen or not.
"""

from __future__ import annotations

import copy

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.kinematics import character_geoms
from mjmotion.video.gl import Canvas

Array = NDArray[np.float64]

BACKGROUND = (0.86, 0.89, 0.92)
FLOOR = (0.62, 0.64, 0.66, 1.0)
FLOOR_LINE = (0.50, 0.52, 0.55, 1.0)

_SHADOW_REACH = 3.5  # around the figure [m]
_KEY = np.array([-0.45, 0.30, -1.0]) / np.linalg.norm([-0.45, 0.30, -1.0])
_WINDOW = 15.0  # side of what is shown of a heightfield [m]; fog hides its edge
_NODES = 128  # along each side of that window, at most
_FOG = (9.0, 15.0)  # from the camera [m], with the window's size
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
    vis.quality.shadowsize = 1024 if shadows else 0
    model.stat.extent = 1.0  # so that the distances below are metres
    vis.map.znear, vis.map.zfar = 0.1, 2.5 * _WALL
    vis.map.fogstart, vis.map.fogend = fog
    vis.map.shadowclip = _SHADOW_REACH
    vis.rgba.fog[:] = (*BACKGROUND, 1.0)
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


class FieldWindow:
    """Shows a square of each large heightfield, around a point, with nodes of the true field.

    The nodes shown are every k-th of the field, counted from its corner, so the surface does not
    change as the window moves; k is the smallest that keeps the window within ``nodes`` a side.
    Fields that are small enough, or carry a texture that would swim, or are used by several geoms,
    are shown whole, thinned to twice ``nodes`` a side.

    Args:
      model: a copy for pictures; its heightfields and their geoms are changed by ``move``.
      side: of the window [m].
      nodes: along a side, at most.
    """

    def __init__(self, model: mujoco.MjModel, side: float = _WINDOW, nodes: int = _NODES) -> None:
        self._model = model
        self._fields = [
            field
            for index in range(model.nhfield)
            if (field := _Field.of(model, index, side, nodes)) is not None
        ]

    def move(self, point: ArrayLike, canvas: Canvas | None = None) -> bool:
        """Move every window to ``point`` [m]; ``canvas`` is told. Return whether any moved."""
        moved = False
        for field in self._fields:
            if field.move(self._model, np.asarray(point, dtype=np.float64)):
                moved = True
                if canvas is not None:
                    canvas.upload_hfield(self._model, field.index)
        return moved


class _Field:
    """One heightfield of which a part is shown."""

    def __init__(
        self, model: mujoco.MjModel, index: int, geoms: NDArray[np.int64], step: int, show: int
    ) -> None:
        self.index, self._geoms, self._step, self._show = index, geoms, step, show
        rows, columns = int(model.hfield_nrow[index]), int(model.hfield_ncol[index])
        self._begin = int(model.hfield_adr[index])
        end = self._begin + rows * columns
        self._heights = model.hfield_data[self._begin : end].reshape(rows, columns).copy()
        self._half = model.hfield_size[index, :2].copy()
        self._gap = 2 * self._half / (columns - 1, rows - 1)  # between nodes, x and y [m]
        self._pos = model.geom_pos[geoms].copy()
        self._matrix = np.empty(9)
        mujoco.mju_quat2Mat(self._matrix, model.geom_quat[geoms[0]])
        self._corner: tuple[int, int] | None = None

    @classmethod
    def of(cls, model: mujoco.MjModel, index: int, side: float, nodes: int) -> _Field | None:
        """Return the window of a field; None where all of it can be shown as it is."""
        rows, columns = int(model.hfield_nrow[index]), int(model.hfield_ncol[index])
        geoms = np.flatnonzero(
            (model.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD) & (model.geom_dataid == index)
        )
        if len(geoms) == 0 or max(rows, columns) <= nodes:
            return None
        material = model.geom_matid[geoms]
        textured = bool(np.any(model.mat_texid[material[material >= 0]] >= 0))
        if textured or len(geoms) > 1 or model.geom_bodyid[geoms[0]] != 0:
            return cls(model, index, geoms, -(-max(rows, columns) // (2 * nodes)), 2 * nodes)
        gap = 2 * model.hfield_size[index, :2] / (columns - 1, rows - 1)
        count = np.minimum(side / gap, (columns - 1, rows - 1)) + 1
        return cls(model, index, geoms, max(int(np.ceil(count.max() / nodes)), 1), nodes)

    def move(self, model: mujoco.MjModel, point: Array) -> bool:
        """Show the part around ``point`` (3,) [m]; return whether that is another part."""
        rows, columns = self._heights.shape
        local = self._matrix.reshape(3, 3).T @ (point - self._pos[0])
        node = (local[:2] + self._half) / self._gap
        reach = self._step * self._show // 2
        jump = self._step * max(self._show // 16, 1)  # so that not every frame uploads
        corner = [
            int(np.clip(np.round((place - reach) / jump) * jump, 0, max(size - 1, 0)))
            for place, size in zip(node, (columns, rows), strict=True)
        ]
        last = [(size - 1) // self._step * self._step for size in (columns, rows)]
        span = self._step * (self._show - 1)
        corner = [
            max(min(c, e - span), 0) // self._step * self._step
            for c, e in zip(corner, last, strict=True)
        ]
        if self._corner == (corner[0], corner[1]):
            return False
        self._corner = (corner[0], corner[1])
        part = self._heights[
            corner[1] : corner[1] + span + 1 : self._step,
            corner[0] : corner[0] + span + 1 : self._step,
        ]
        shown = np.array(part.shape[::-1])
        model.hfield_nrow[self.index], model.hfield_ncol[self.index] = part.shape
        model.hfield_data[self._begin : self._begin + part.size] = part.ravel()
        half = (shown - 1) * self._step * self._gap / 2
        model.hfield_size[self.index, :2] = half
        shift = np.zeros(3)
        shift[:2] = np.array(corner) * self._gap + half - self._half
        for geom, pos in zip(self._geoms, self._pos, strict=True):
            matrix = np.empty(9)
            mujoco.mju_quat2Mat(matrix, model.geom_quat[geom])
            model.geom_pos[geom] = pos + matrix.reshape(3, 3) @ shift
        return True


class Stage:
    """One MuJoCo scene that is filled anew for every frame.

    Args:
      model: from :func:`picture_model`; with its character, whether shown or not.
      extra: how many geoms are added to the model's own, at most.
      floor: height of a flat floor with a grid to draw [m]; None for none.
      shadows: whether the key light casts them.
    """

    def __init__(
        self, model: mujoco.MjModel, extra: int, floor: float | None = None, shadows: bool = True
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
        self._pose(model.qpos0)

    def _pose(self, qpos: Array) -> None:
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)

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

    def add_figure(self, model: mujoco.MjModel, qpos: Array) -> None:
        """Add the character of ``model``, a repainted copy of the stage's own, at ``qpos``."""
        data = mujoco.MjData(model)
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
            light.pos[:] = target - 8.0 * _KEY
            light.texid = -1
        fill.castshadow = False
        fill.dir[:] = (0.55, -0.45, -0.70)
        fill.ambient[:] = (0.40, 0.41, 0.43)
        fill.diffuse[:] = (0.18, 0.19, 0.22)
        fill.specular[:] = 0.0
        key.castshadow = self.shadows
        key.dir[:] = _KEY
        key.ambient[:] = 0.0
        key.diffuse[:] = (0.56, 0.54, 0.50)
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
