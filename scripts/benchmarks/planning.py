"""Planning: processor time of a walk's plan over the bare fit of the terrain job, scene by scene.

Processor time, and the least of some runs, since what else a machine does is no part of it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping

import mujoco

from benchmarks.figures import Print, print_figures
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.exceptions import MotionError
from mjmotion.footsteps.planning import make_plan
from mjmotion.paper.figures import Figure
from mjmotion.paper.job import Job
from mjmotion.scene import Scene, blocks, load_scene

SCENES = ("terrain", "terrain_doors", "stairs", "slope", "blocks")
PLAN, GEOMS, LINEAR = 10.0, 2.0, 2.0  # targets
MANY = 2000  # geoms of the larger scene
REPEATS = 7


def run(job: Job, print_line: Print) -> list[Figure]:
    """Return what planning costs: on each scene, with many geoms, and with half the frames."""
    walk = load_clip("walk")
    figures = []
    for scene in SCENES:
        figures += print_figures(over_fit(job, walk, scene), print_line)
    for part in (many_geoms, many_frames):
        figures += print_figures(part(walk), print_line)
    return figures


def least_seconds(tasks: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Return the least processor time of every task [s]; they take turns."""
    least = dict.fromkeys(tasks, math.inf)
    for _ in range(repeats + 1):  # the first, in which modules are imported, is never the least
        for name, task in tasks.items():
            start = time.process_time()
            task()
            least[name] = min(least[name], time.process_time() - start)
    return least


def over_fit(job: Job, walk: Motion, scene: str) -> list[Figure]:
    """Return the time of a plan over that of the bare fit of the terrain job."""
    name = f"planning on {scene}, over fit"
    tasks: dict[str, Callable[[], object]] = {
        "fit": job.fit,
        "plan": lambda: make_plan(walk, load_scene(scene)),
        "load": lambda: load_scene(scene),
    }
    try:
        seconds = least_seconds(tasks, REPEATS)
    except MotionError as error:
        why = f"{type(error).__name__}: {error}"
        return [Figure("planning", name, math.nan, "x", most=PLAN, note=why, failed=True)]
    plan = seconds["plan"] - seconds["load"]
    return [
        Figure("planning", f"planning on {scene}", 1000 * plan, "ms"),
        Figure("planning", name, plan / seconds["fit"], "x", most=PLAN, note="processor time"),
    ]


def many_geoms(walk: Motion) -> list[Figure]:
    """Return the time of a plan with many more blocks around over that with the own alone."""
    few, many = Scene.from_spec(blocks()), Scene.from_spec(with_blocks(blocks(), MANY))
    seconds = least_seconds(
        {"few": lambda: make_plan(walk, few), "many": lambda: make_plan(walk, many)}, REPEATS
    )
    name = f"planning with {many.model.ngeom} geoms over {few.model.ngeom}"
    return [Figure("planning", name, seconds["many"] / seconds["few"], "x", most=GEOMS)]


def with_blocks(spec: mujoco.MjSpec, count: int) -> mujoco.MjSpec:
    """Return a scene with ``count`` geoms: blocks beside where it is walked, in rows of fifty."""
    for number in range(count - len(spec.geoms)):
        row, column = divmod(number, 50)
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=(0.15, 0.15, 0.1),
            pos=(0.4 * column - 2.0, 8.0 + 0.4 * row, 0.1),
        )
    return spec


def many_frames(walk: Motion, scene: str = "terrain") -> list[Figure]:
    """Return the time of a plan over that of the same walk with half as many frames a second."""
    place = load_scene(scene)
    sparse = Motion(walk.character, walk.qpos[::2], walk.fps / 2.0)
    seconds = least_seconds(
        {"all": lambda: make_plan(walk, place), "half": lambda: make_plan(sparse, place)}, REPEATS
    )
    name = f"planning {walk.nframe} frames over {sparse.nframe}"
    return [Figure("planning", name, seconds["all"] / seconds["half"], "x", most=LINEAR)]
