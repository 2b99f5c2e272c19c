"""Scenes: any MJCF without a character, and where in it a clip begins.

scene = load_scene("terrain")              # or a path to any MJCF
scene.start_pos, scene.start_yaw
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import TypeAlias

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.assets import find_asset
from mjmotion.boundary.mjcf import check_mjcf, check_model
from mjmotion.exceptions import SceneError, mujoco_message
from mjmotion.scene.ground import Ground
from mjmotion.scene.quiet import quiet
from mjmotion.scene.rest import moves, rest_spec

START_SITE = "start"
"""Name of the site where a clip begins; its x-axis is the way it walks."""

SceneLike: TypeAlias = "Scene | mujoco.MjSpec | str | Path"
"""What names a scene: itself, a spec, the name of one of ours, or an MJCF file."""

_FILE_LIKE = (".xml", ".mjcf", ".urdf")


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """A scene without a character.

    Attributes:
      spec: the scene; treat it as read-only, :func:`compose` works on a copy.
      model: ``spec`` compiled.
      name: short name for reports.
      start_pos: (3,) where the clip begins [m]: the site ``start``, else the origin.
      start_yaw: the way the clip walks, about z from +x [rad]: the x-axis of that site, else 0.
    """

    spec: mujoco.MjSpec
    model: mujoco.MjModel
    name: str
    start_pos: NDArray[np.float64]
    start_yaw: float

    @cached_property
    def ground(self) -> Ground:
        """What one stands on."""
        return Ground(self.model)

    def ground_without(self, avoid: Sequence[str]) -> Ground:
        """Return what one stands on, without geoms that are not meant to be stood on.

        Raises:
          SceneError: the scene has no geom of such a name.
        """
        return Ground(self.model, avoid) if avoid else self.ground

    def __repr__(self) -> str:
        x, y, z = self.start_pos
        return f"<Scene {self.name!r}: {self.model.ngeom} geoms, start at {x:g} {y:g} {z:g}>"

    def at_rest(self, keyframe: str | None = None) -> Scene:
        """Return the scene with all that could move fixed at its rest pose, as an obstacle.

        Joints go, and with them actuators, sensors, tendons, equalities, contact pairs and
        keyframes; cloths, ropes and soft bodies become geoms. A scene in which nothing moves is
        returned as it is.

        Args:
          keyframe: name of a keyframe of the scene's to take in place of its rest pose, ``qpos0``.

        Raises:
          SceneError: there is no such keyframe, or the scene does not compile without its joints.
        """
        if keyframe is None and not moves(self.model):
            return self
        return Scene.from_spec(rest_spec(self.spec, self.name, keyframe), self.name)

    @classmethod
    def of(cls, source: SceneLike) -> Scene:
        """Return a scene from whatever names one; a scene itself is returned as it is.

        Raises:
          SceneError: as :func:`load_scene`.
        """
        if isinstance(source, Scene):
            return source
        return cls.from_spec(source) if isinstance(source, mujoco.MjSpec) else load_scene(source)

    @classmethod
    def from_spec(cls, spec: mujoco.MjSpec, name: str = "scene") -> Scene:
        """Compile ``spec``, such as a builder returns, into a scene.

        Raises:
          SceneError: it does not compile, or its start site points straight up or down.
        """
        spec = spec.copy()
        try:
            with quiet():
                model = spec.compile()
        except (ValueError, OSError, mujoco.FatalError) as error:
            raise SceneError(f"scene '{name}' does not compile: {mujoco_message(error)}") from error
        check_model(model, f"scene '{name}'", SceneError)
        pos, yaw = _start(model, name)
        return cls(spec, model, name, pos, yaw)


def load_scene(name_or_path: str | Path) -> Scene:
    """Load one of the project's scenes by name, or any MJCF file.

    Raises:
      SceneError: there is no such scene or file, or it does not parse or compile.
    """
    path = find_asset("scene", name_or_path).resolve()
    if path.suffix.lower() not in _FILE_LIKE:
        raise SceneError(f"scene '{path}' is not an MJCF file (.xml): give a MuJoCo model")
    check_mjcf(path, SceneError)
    try:
        with quiet():
            spec = mujoco.MjSpec.from_file(str(path))
    except (ValueError, OSError, mujoco.FatalError) as error:
        raise SceneError(
            f"scene '{path}' is not a MuJoCo model MuJoCo can read: {mujoco_message(error)}"
        ) from error
    try:
        return Scene.from_spec(spec, path.stem)
    except SceneError as error:
        raise SceneError(str(error).replace(f"'{path.stem}'", f"'{path}'", 1)) from error


def _start(model: mujoco.MjModel, name: str) -> tuple[NDArray[np.float64], float]:
    """Return position (3,) [m] and yaw [rad] of the start site in the scene's first pose."""
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, START_SITE)
    if site < 0:
        return np.zeros(3), 0.0
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    forward = data.site_xmat[site].reshape(3, 3)[:, 0]
    if np.hypot(forward[0], forward[1]) < 1e-3:
        raise SceneError(
            f"site '{START_SITE}' of scene '{name}' points straight up or down:"
            " its x-axis must show the way to walk"
        )
    return data.site_xpos[site].copy(), float(np.arctan2(forward[1], forward[0]))
