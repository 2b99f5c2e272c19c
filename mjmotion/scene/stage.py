"""What every scene of ours begins with: sky, light, materials, and the site where a clip starts."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.boundary.limits import MOST_LENGTH, at_most, real_number
from mjmotion.exceptions import SceneError
from mjmotion.scene.composing import add_sky, add_sun
from mjmotion.scene.scene import START_SITE

GROUND = "ground"
"""Material of the ground: a tiled grid of half metres, so that a motion can be read from it."""
FLOOR = "floor"
"""Material of the level floor around steps and ramps: the same grid, darker."""
WOOD = "wood"
"""Material of door frames."""
STEP_LIGHT, STEP_DARK = "step_light", "step_dark"
"""Materials of steps and blocks, in turn."""

_RAY_START = 1000.0  # [m], above any scene


def new_scene(
    name: str, center: tuple[float, float] = (8.0, 0.0), radius: float = 15.0
) -> mujoco.MjSpec:
    """Return an empty scene with sky, light and materials, ready for geometry.

    Args:
      name: name of the model.
      center: (x, y) of the middle of the scene [m]; the light shines on it.
      radius: how far from the middle shadows are wanted [m].
    """
    spec = mujoco.MjSpec()
    spec.modelname = name
    spec.stat.center = [center[0], center[1], 1.0]
    spec.stat.extent = radius
    spec.stat.meansize = 0.1
    visual = spec.visual
    visual.global_.offwidth, visual.global_.offheight = 1920, 1080
    visual.global_.azimuth, visual.global_.elevation = 120.0, -20.0
    visual.quality.shadowsize, visual.quality.offsamples = 4096, 4
    visual.map.znear = 0.05 / radius
    visual.map.zfar = 8.0
    visual.map.fogstart, visual.map.fogend = 1.5, 5.0
    visual.headlight.ambient = [0.47, 0.48, 0.50]
    visual.headlight.diffuse = [0.12, 0.12, 0.12]
    visual.headlight.specular = [0.0, 0.0, 0.0]
    visual.rgba.haze = [0.86, 0.90, 0.94, 1.0]
    add_sun(spec, (center[0], center[1], 0.0))
    add_sky(spec)
    _add_grid(spec, GROUND, (0.76, 0.74, 0.69), (0.70, 0.68, 0.63), (0.56, 0.54, 0.49))
    _add_grid(spec, FLOOR, (0.70, 0.73, 0.75), (0.63, 0.66, 0.68), (0.54, 0.57, 0.59))
    for material, rgba in (
        (WOOD, (0.66, 0.30, 0.16, 1.0)),
        (STEP_LIGHT, (0.82, 0.78, 0.70, 1.0)),
        (STEP_DARK, (0.70, 0.64, 0.55, 1.0)),
    ):
        spec.add_material(name=material, rgba=rgba, specular=0.2, shininess=0.2)
    return spec


def add_mesh_material(spec: mujoco.MjSpec) -> str:
    """Add the ground's material for meshes whose texture coordinates are x and y [m]; its name."""
    name = f"{GROUND}_mesh"
    # A uniform texture would lie in the mesh's inertial frame instead of on its coordinates.
    material = spec.add_material(name=name, texrepeat=(1.0, 1.0), specular=0.05, shininess=0.1)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = GROUND
    return name


def add_start(spec: mujoco.MjSpec) -> None:
    """Put the start site on the ground at the origin, facing +x."""
    height = float(ground_heights(spec, [(0.0, 0.0)])[0])
    spec.worldbody.add_site(
        name=START_SITE,
        pos=(0.0, 0.0, height),
        size=(0.05, 0.05, 0.05),
        rgba=(0.1, 0.6, 0.2, 0.5),
        group=4,  # hidden unless asked for
    )


def ground_heights(spec: mujoco.MjSpec, points: ArrayLike) -> NDArray[np.float64]:
    """Return the height of the highest surface at each of ``points`` (n, 2) [m], as (n,) [m].

    Raises:
      SceneError: there is nothing under a point.
    """
    copy = spec.copy()
    model = copy.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    points = np.atleast_2d(np.asarray(points, dtype=np.float64))
    heights = np.empty(len(points))
    hit = np.zeros(1, dtype=np.int32)
    down = np.array([0.0, 0.0, -1.0])
    for index, (x, y) in enumerate(points):
        origin = np.array([x, y, _RAY_START])
        distance = mujoco.mj_ray(model, data, origin, down, None, 1, -1, hit)
        if distance < 0:
            raise SceneError(f"there is no ground at ({x:g}, {y:g}) m: move it or widen the ground")
        heights[index] = _RAY_START - distance
    return heights


def yaw_quat(yaw: float) -> tuple[float, float, float, float]:
    """Return the quaternion wxyz of a turn about z by ``yaw`` [rad]."""
    return (float(np.cos(yaw / 2)), 0.0, 0.0, float(np.sin(yaw / 2)))


def check_positive(what: str, **values: float) -> None:
    """Raise SceneError for the first of ``values`` that is not a positive finite number."""
    for name, value in values.items():
        number = real_number(value, f"{what}: {name}", SceneError)
        if not number > 0:
            raise SceneError(f"{what}: {name} is {value}, it must be a positive number")
        at_most(number, MOST_LENGTH, f"{what}: {name}", SceneError)


def check_range(what: str, **ranges: tuple[float, float]) -> None:
    """Raise SceneError for the first of ``ranges`` whose ends are not finite and in order."""
    for name, (low, high) in ranges.items():
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise SceneError(f"{what}: {name} is ({low}, {high}), it must run from low to high")
        at_most(max(abs(low), abs(high)), MOST_LENGTH, f"{what}: {name} [m]", SceneError)


def _add_grid(
    spec: mujoco.MjSpec,
    name: str,
    rgb1: tuple[float, float, float],
    rgb2: tuple[float, float, float],
    mark: tuple[float, float, float],
) -> None:
    """Add a soft checker with thin lines, half a metre a square."""
    spec.add_texture(
        name=name,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        mark=mujoco.mjtMark.mjMARK_EDGE,
        rgb1=rgb1,
        rgb2=rgb2,
        markrgb=mark,
        width=512,
        height=512,
    )
    material = spec.add_material(
        name=name, texrepeat=(2.0, 2.0), texuniform=True, specular=0.05, shininess=0.1
    )
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
