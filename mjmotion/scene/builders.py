"""Scenes made from a few numbers: every builder returns a spec to load, save or edit.

save_model(doors(seed=3), "scenes", "my_doors.xml")
scene = Scene.from_spec(stairs(rise=0.16))
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from mjmotion.boundary.limits import MOST_SCENE_PARTS, at_most
from mjmotion.exceptions import SceneError
from mjmotion.scene.heights import from_heights
from mjmotion.scene.rope_scene import rope
from mjmotion.scene.stage import (
    FLOOR,
    GROUND,
    STEP_DARK,
    STEP_LIGHT,
    WOOD,
    add_start,
    check_positive,
    check_range,
    ground_heights,
    new_scene,
    yaw_quat,
)
from mjmotion.scene.terrain_scene import terrain

_POST = 0.1  # [m], side of a door post
_LINTEL = 0.14  # [m], height of a lintel
_FOOT = 0.3  # [m], how far a post reaches into the ground at its lowest corner


@dataclasses.dataclass(frozen=True)
class Doorway:
    """A free-standing door frame.

    Attributes:
      x: middle of the opening [m].
      y: middle of the opening [m].
      yaw: the way through it, from +x [rad].
      width: clear width of the opening [m].
      height: from the ground in the middle of the opening to the lintel [m].
    """

    x: float
    y: float = 0.0
    yaw: float = 0.0
    width: float = 1.0
    height: float = 2.1


DOORWAYS = (
    Doorway(x=1.8, height=1.55),
    Doorway(x=3.6, width=0.8),
    Doorway(x=5.2, height=1.48),
)
"""The doorways of the shipped scene ``terrain_doors``: low, narrow, lower."""


def flat() -> mujoco.MjSpec:
    """Return a level floor without end, at z = 0."""
    spec = new_scene("flat")
    _add_floor(spec)
    add_start(spec)
    return spec


def doors(
    doorways: Sequence[Doorway] = DOORWAYS,
    *,
    base: mujoco.MjSpec | None = None,
    seed: int = 1,
) -> mujoco.MjSpec:
    """Return a scene with door frames across the walk.

    Args:
      doorways: the frames, in order; their geoms are named ``door1_left_post`` and so on.
      base: the ground they stand on, which is not changed; by default :func:`terrain`.
      seed: seed of that terrain.

    Raises:
      SceneError: a width or height is not positive, or there is no ground under a frame.
    """
    spec = terrain(seed) if base is None else base.copy()
    if not doorways:
        raise SceneError("doors: no doorway was given: give at least one")
    at_most(len(doorways), MOST_SCENE_PARTS, "doors: doorways", SceneError)
    if base is None:
        spec.modelname = "terrain with doors"
    for number, door in enumerate(doorways, start=1):
        _add_doorway(spec, f"door{number}", door)
    return spec


def stairs(
    *,
    steps: int = 5,
    rise: float = 0.14,
    tread: float = 0.35,
    landing: float = 1.5,
    width: float = 8.0,
    distance: float = 1.5,
) -> mujoco.MjSpec:
    """Return stairs up, a landing and as many steps down, on a level floor.

    Args:
      steps: number of risers up, and down again.
      rise: height of a riser [m].
      tread: depth of a tread [m].
      landing: depth of the landing [m].
      width: width of the stairs [m].
      distance: from the start to the first riser [m].

    Raises:
      SceneError: a size is not positive.
    """
    check_positive("stairs", steps=steps, rise=rise, tread=tread, landing=landing, width=width)
    check_positive("stairs", distance=distance)
    at_most(steps, MOST_SCENE_PARTS, "stairs: steps", SceneError)
    spec = new_scene("stairs", radius=14.0)
    _add_floor(spec)
    up = [(rise * (i + 1), tread, f"up{i + 1}") for i in range(steps - 1)]
    down = [(rise * (steps - 1 - i), tread, f"down{i + 1}") for i in range(steps - 1)]
    x = distance
    for index, (top, depth, name) in enumerate([*up, (rise * steps, landing, "landing"), *down]):
        _add_box(
            spec,
            name,
            (x, x + depth),
            (-width / 2, width / 2),
            top,
            (STEP_LIGHT, STEP_DARK)[index % 2],
        )
        x += depth
    add_start(spec)
    return spec


def slope(
    *,
    angle: float = 9.0,
    length: float = 3.0,
    plateau: float = 1.5,
    width: float = 8.0,
    distance: float = 1.5,
) -> mujoco.MjSpec:
    """Return a ramp up, a plateau and a ramp down, on a level floor.

    Three boxes, since MuJoCo's rays and distances to boxes are exact; a ray straight down an edge
    between two triangles of a mesh may miss both.

    Args:
      angle: steepness [degrees], under 60.
      length: horizontal length of each ramp [m].
      plateau: length of the level top [m].
      width: width of the ramps [m].
      distance: from the start to the foot of the ramp [m].

    Raises:
      SceneError: a size is not positive or the angle is too steep.
    """
    check_positive("slope", angle=angle, length=length, plateau=plateau, width=width)
    check_positive("slope", distance=distance)
    if angle >= 60:
        raise SceneError(f"slope: angle is {angle} degrees, it must be under 60")
    spec = new_scene("slope", radius=14.0)
    _add_floor(spec)
    tilt = float(np.radians(angle))
    top = length * float(np.tan(tilt))
    end = distance + 2 * length + plateau
    _add_ramp(spec, "ramp_up", distance, length, width, tilt, 1.0)
    _add_ramp(spec, "ramp_down", end, length, width, tilt, -1.0)
    # A little narrower than the ramps: sides in one plane would flicker.
    side = width / 2 - 0.002
    ridge = distance + length
    _add_box(spec, "plateau", (ridge, ridge + plateau), (-side, side), top, GROUND)
    add_start(spec)
    return spec


def blocks(
    seed: int = 1,
    *,
    size: float = 0.7,
    height: float = 0.14,
    x_range: tuple[float, float] = (-2.1, 14.0),
    y_range: tuple[float, float] = (-4.9, 7.0),
    start_radius: float = 0.8,
) -> mujoco.MjSpec:
    """Return a pavement of uneven blocks: boxes with level tops of random height.

    Args:
      seed: seed of the heights.
      size: side of a block [m].
      height: tops are uniform in [height / 10, height] over the floor [m], in whole millimetres.
      x_range: extent along x [m], filled with whole blocks from its low end.
      y_range: extent along y [m], likewise.
      start_radius: blocks within it of the start are level with each other [m].

    Raises:
      SceneError: a size is not positive, a range is out of order or holds no block.
    """
    check_positive("blocks", size=size, height=height, start_radius=start_radius)
    check_range("blocks", x_range=x_range, y_range=y_range)
    if seed < 0:
        raise SceneError(f"blocks: seed is {seed}, it must not be negative")
    ncol, nrow = (int(np.floor(np.ptp(span) / size + 1e-9)) for span in (x_range, y_range))
    if min(ncol, nrow) < 1:
        raise SceneError(f"blocks: no block of {size} m fits into the ranges: widen them")
    if ncol * nrow > 10_000:
        raise SceneError(f"blocks: {ncol * nrow} blocks are too many: use larger ones")
    spec = new_scene("blocks", center=(sum(x_range) / 2, sum(y_range) / 2), radius=12.0)
    _add_floor(spec)
    tops = np.round(np.random.default_rng(seed).uniform(0.1 * height, height, (nrow, ncol)), 3)
    x = x_range[0] + size * np.arange(ncol)
    y = y_range[0] + size * np.arange(nrow)
    # Nearest point of each block to the start, at the origin.
    nearest = np.hypot(np.clip(0.0, x, x + size)[None, :], np.clip(0.0, y, y + size)[:, None])
    tops[nearest < start_radius] = round(height / 2, 3)
    for row, column in np.ndindex(nrow, ncol):
        _add_box(
            spec,
            f"block_{row}_{column}",
            (float(x[column]), float(x[column] + size)),
            (float(y[row]), float(y[row] + size)),
            float(tops[row, column]),
            STEP_LIGHT if (row + column) % 2 else STEP_DARK,
        )
    add_start(spec)
    return spec


BUILDERS: dict[str, Callable[..., mujoco.MjSpec]] = {
    "flat": flat,
    "terrain": terrain,
    "doors": doors,
    "stairs": stairs,
    "slope": slope,
    "blocks": blocks,
    "heights": from_heights,
    "rope": rope,
}
"""Builders by the name that the command line gives them."""


def _add_floor(spec: mujoco.MjSpec) -> None:
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=(0.0, 0.0, 0.5),
        material=FLOOR,
        castshadow=False,
    )


def _add_box(
    spec: mujoco.MjSpec,
    name: str,
    x: tuple[float, float],
    y: tuple[float, float],
    top: float,
    material: str,
) -> None:
    """Add a box that stands on the floor, given its extents [m]."""
    spec.worldbody.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=((x[1] - x[0]) / 2, (y[1] - y[0]) / 2, top / 2),
        pos=((x[0] + x[1]) / 2, (y[0] + y[1]) / 2, top / 2),
        material=material,
        castshadow=False,  # shadows of the ground on itself only give speckles
    )


def _add_ramp(
    spec: mujoco.MjSpec,
    name: str,
    foot: float,
    length: float,
    width: float,
    tilt: float,
    sign: float,
) -> None:
    """Add a tilted box that rises from the floor at x = ``foot`` towards +x or -x (``sign``).

    Its top runs on under the floor, and a micrometre over the ridge so that there is no crack.
    """
    below, over = 0.2, 1e-6
    along = np.array([sign * np.cos(tilt), np.sin(tilt)])  # up the ramp, in x and z
    normal = np.array([-sign * np.sin(tilt), np.cos(tilt)])
    thickness = length * np.tan(tilt) + below  # reaches below the floor all the way
    start, end = -below / np.sin(tilt), length / np.cos(tilt) + over
    middle = [foot, 0.0] + (start + end) / 2 * along - thickness / 2 * normal
    spec.worldbody.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=((end - start) / 2, width / 2, thickness / 2),
        pos=(float(middle[0]), 0.0, float(middle[1])),
        quat=(np.cos(tilt / 2), 0.0, -sign * np.sin(tilt / 2), 0.0),
        material=GROUND,
        castshadow=False,
    )


def _add_doorway(spec: mujoco.MjSpec, name: str, door: Doorway) -> None:
    """Add two posts and a lintel over the ground that is there."""
    check_positive(name, width=door.width, height=door.height)
    along = np.array([np.cos(door.yaw), np.sin(door.yaw)])
    across = np.array([-along[1], along[0]])
    middle = np.array([door.x, door.y])
    offset = (door.width + _POST) / 2
    posts = {"left": middle + offset * across, "right": middle - offset * across}
    corners = [
        post + _POST / 2 * (i * along + j * across)
        for post in posts.values()
        for i in (-1, 1)
        for j in (-1, 1)
    ]
    heights = ground_heights(spec, [middle, *corners])
    under = float(heights[0]) + door.height
    if under <= heights[1:].max():
        raise SceneError(f"{name} is {door.height} m high: the ground beside it is higher")
    quat = yaw_quat(door.yaw)
    for (side, (x, y)), around in zip(posts.items(), (heights[1:5], heights[5:9]), strict=True):
        bottom = float(around.min()) - _FOOT
        spec.worldbody.add_geom(
            name=f"{name}_{side}_post",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=(_POST / 2, _POST / 2, (under - bottom) / 2),
            pos=(float(x), float(y), (under + bottom) / 2),
            quat=quat,
            material=WOOD,
        )
    # The lintel stands out a little all round: faces in one plane would flicker.
    spec.worldbody.add_geom(
        name=f"{name}_lintel",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(_POST / 2 + 0.01, door.width / 2 + _POST + 0.03, _LINTEL / 2),
        pos=(door.x, door.y, under + _LINTEL / 2),
        quat=quat,
        material=WOOD,
    )
