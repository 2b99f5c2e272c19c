"""Scenes in which a walk has to go another way: doors aside, corners, posts, clutter, mazes.

Every kind comes by seed, so that some can be tuned on and others held back.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from benchmarks.figures import Print
from benchmarks.quality import MOCAP, SHARE
from mjmotion.apps.adaptation import adapt
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.exceptions import MotionError
from mjmotion.paper.figures import Figure
from mjmotion.scene import Scene

Array = NDArray[np.float64]

CLIPS = ("walk", "02_01", "07_01", "16_58")
THICK, TALL = 0.06, 1.25  # half sizes of walls [m]
LINTEL = 2.05  # height of a door [m]


def flat() -> mujoco.MjSpec:
    """Return a scene of a floor and a start."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_light(pos=(0.0, 0.0, 6.0))
    spec.worldbody.add_site(name="start")
    spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(40.0, 40.0, 0.1))
    return spec


def add_wall(spec: mujoco.MjSpec, name: str, start: Array, end: Array) -> None:
    """Add an upright wall from one place to another [m]."""
    middle, way = 0.5 * (start + end), end - start
    yaw = 0.5 * float(np.arctan2(way[1], way[0]))
    spec.worldbody.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=(*middle, TALL),
        size=(0.5 * float(np.hypot(*way)) + THICK, THICK, TALL),
        quat=(np.cos(yaw), 0.0, 0.0, np.sin(yaw)),
    )


def add_door(spec: mujoco.MjSpec, name: str, x: float, y: float, width: float) -> None:
    """Add a wall across the way with a doorway in it [m]."""
    for side, far in (("left", 4.0), ("right", -4.0)):
        edge = y + np.sign(far) * (0.5 * width + THICK)
        add_wall(spec, f"{name}_{side}", np.array((x, edge)), np.array((x, far)))
    spec.worldbody.add_geom(
        name=f"{name}_lintel",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=(x, y, 0.5 * (LINTEL + 2.0 * TALL)),
        size=(THICK, 0.5 * width, 0.5 * (2.0 * TALL - LINTEL)),
    )


def door(seed: int) -> mujoco.MjSpec:
    """Return a door of 0.7–1.0 m, 0.1–0.6 m to one side."""
    random = np.random.default_rng(seed)
    spec = flat()
    aside = random.uniform(0.1, 0.6) * random.choice((-1.0, 1.0))
    add_door(spec, "door", random.uniform(1.8, 2.8), aside, random.uniform(0.7, 1.0))
    return spec


def corridor(seed: int) -> mujoco.MjSpec:
    """Return a corridor of 1.0–1.5 m that turns by 45–110° to one side."""
    random = np.random.default_rng(seed)
    half = 0.5 * random.uniform(1.0, 1.5)
    turn = np.radians(random.uniform(45.0, 110.0)) * random.choice((-1.0, 1.0))
    corner, far = random.uniform(2.0, 3.2), 6.0
    ways = np.array(((1.0, 0.0), (np.cos(turn), np.sin(turn))))
    sides = np.column_stack((-ways[:, 1], ways[:, 0]))
    # Where the two walls of a side meet is on the corner's bisector.
    bisector = sides.sum(axis=0) / (1.0 + sides[0] @ sides[1])
    spec = flat()
    for name, side in (("left", 1.0), ("right", -1.0)):
        meet = np.array((corner, 0.0)) + side * (half + THICK) * bisector
        begin = np.array((-2.0, side * (half + THICK)))
        add_wall(spec, f"{name}_before", begin, meet)
        add_wall(spec, f"{name}_after", meet, meet + far * ways[1])
    return spec


def scattered(random: np.random.Generator, count: int, apart: float) -> Array:
    """Return places (n, 2) in front of the start, at least so far apart [m]."""
    places: list[Array] = []
    for _ in range(40 * count):
        place = random.uniform((0.9, -2.8), (9.0, 2.8))
        if all(np.hypot(*(place - other)) > apart for other in places):
            places.append(place)
        if len(places) == count:
            break
    return np.array(places)


def clutter(seed: int) -> mujoco.MjSpec:
    """Return boxes 0.34–0.95 m high with gaps of about 0.9 m."""
    random = np.random.default_rng(seed)
    spec = flat()
    for number, place in enumerate(scattered(random, 32, 1.15)):
        yaw = 0.5 * random.uniform(0.0, np.pi / 2.0)
        size = (*random.uniform(0.12, 0.28, 2), random.uniform(0.17, 0.475))
        spec.worldbody.add_geom(
            name=f"box{number}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=(*place, size[2]),
            size=size,
            quat=(np.cos(yaw), 0.0, 0.0, np.sin(yaw)),
        )
    return spec


def posts(seed: int) -> mujoco.MjSpec:
    """Return round posts 1–2.4 m high and 5–15 cm thick with gaps of about 0.9 m."""
    random = np.random.default_rng(seed)
    spec = flat()
    for number, place in enumerate(scattered(random, 30, 1.1)):
        half = random.uniform(0.5, 1.2)
        spec.worldbody.add_geom(
            name=f"post{number}",
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            pos=(*place, half),
            size=(random.uniform(0.025, 0.075), half, 0.0),
        )
    return spec


def maze(seed: int) -> mujoco.MjSpec:
    """Return two walls, one after the other, to be passed on one side and then on the other."""
    random = np.random.default_rng(seed)
    spec = flat()
    side = random.choice((-1.0, 1.0))
    for number, x in enumerate((random.uniform(1.4, 1.7), random.uniform(3.2, 3.6))):
        end = side * random.uniform(0.1, 0.35)
        add_wall(spec, f"wall{number}", np.array((x, end)), np.array((x, -side * 3.0)))
        side = -side
    return spec


KINDS: dict[str, Callable[[int], mujoco.MjSpec]] = {
    "door": door,
    "corridor": corridor,
    "clutter": clutter,
    "posts": posts,
    "maze": maze,
}
TUNED, HELD_BACK = range(8), range(100, 110)
"""Seeds of scenes that were tuned on, and of others."""


@dataclasses.dataclass(frozen=True)
class Passed:
    """One clip on one scene: what it misses, and how long it takes [s]."""

    kind: str
    missed: str
    seconds: float


def measure(name: str, clip: Motion, kind: str, seed: int, print_line: Print) -> Passed:
    """Adapt a clip to a scene, measure it, and print a line."""
    scene = make(kind, seed)
    began = time.perf_counter()
    try:
        result = adapt(clip, scene)
    except MotionError as error:
        passed = Passed(kind, str(error), 0.0)
    else:
        seconds = time.perf_counter() - began
        broken = ", ".join(result.validate().broken())
        passed = Passed(kind, result.barred or broken, seconds)
    print_line(f"{name:8} {scene.name:14} {passed.seconds:6.2f} s  {passed.missed or 'every bar'}")
    return passed


def run(
    seeds: Sequence[int], print_line: Print, what: str, kinds: Sequence[str] = tuple(KINDS)
) -> list[Figure]:
    """Return for each kind of scene the share of pairs that reach every bar."""
    found = []
    for name in CLIPS:
        file = MOCAP / f"{name}.bvh"
        clip = load_clip(file if file.is_file() else name)
        found += [measure(name, clip, k, seed, print_line) for k in kinds for seed in seeds]
    figures = []
    for kind in kinds:
        mine = [one for one in found if one.kind == kind]
        share = 100.0 * sum(not one.missed for one in mine) / len(mine)
        text = f"{kind}, {what}: pairs that reach every bar"
        figures.append(Figure("ways", text, share, "%", least=SHARE))
    return figures


def make(kind: str, seed: int) -> Scene:
    """Return one scene of a kind."""
    return Scene.from_spec(KINDS[kind](seed), f"{kind}{seed}")
