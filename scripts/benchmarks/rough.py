"""Rough ground: what a sole cannot lie flat on. Fields of bumps, many small boxes, rods underfoot.

Cells of 8 cm with heights of 0 to 5 cm that know nothing of each other; 200 to 400 boxes of any
size, 1 to 5 cm high; lying rods of 3 to 8 cm. Each with several seeds, the last of them held back.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import repeat

import mujoco
import numpy as np

from benchmarks import quality
from benchmarks.figures import Print, print_figures
from mjmotion.clips import load_clip
from mjmotion.exceptions import MotionError
from mjmotion.paper.figures import Figure
from mjmotion.scene import Scene
from mjmotion.scene.builders import flat
from mjmotion.scene.heights import add_heightfield
from mjmotion.scene.stage import STEP_DARK, STEP_LIGHT, WOOD, add_start, new_scene
from mjmotion.validation import THRESHOLDS

CLIPS = ("walk", "02_01", "07_01", "16_13")
HELD_BACK = ("29_01", "35_12", "49_01", "91_17", "127_05")
SEEDS = (1, 2, 3)
HELD_SEED = 11
X_RANGE, Y_RANGE = (-4.0, 16.0), (-6.0, 6.0)  # of fields [m]
CELL, BUMP = 0.08, 0.05  # of fields [m]
AREA = ((-1.0, 9.0), (-1.5, 1.5))  # where boxes and rods lie [m]
BOXES = (200, 400)  # fewest and most
BOX_SIDE, BOX_HEIGHT = (0.04, 0.30), (0.01, 0.05)  # [m]
RODS = 50
ROD_DIAMETER, ROD_LENGTH = (0.03, 0.08), (0.2, 1.0)  # [m]
WANTED = ("sole_penetration_mm", "stance_gap_hfield_p95_mm", "stance_gap_max_mm")
SHOWN = (*WANTED, "stance_drift_mm", "contact_kept_percent", "jerk_ratio_rms")


def field(seed: int) -> mujoco.MjSpec:
    """Return a heightfield of bumps, one to a cell."""
    shape = tuple(round((span[1] - span[0]) / CELL) + 1 for span in (Y_RANGE, X_RANGE))
    spec = new_scene("rough field")
    heights = np.random.default_rng(seed).uniform(0.0, BUMP, shape)
    add_heightfield(spec, "field", heights, X_RANGE, Y_RANGE)
    add_start(spec)
    return spec


def boxes(seed: int) -> mujoco.MjSpec:
    """Return a level floor with hundreds of small boxes."""
    rng = np.random.default_rng(seed)
    spec = flat()
    for number in range(rng.integers(*BOXES, endpoint=True)):
        x, y = (rng.uniform(*span) for span in AREA)
        height = rng.uniform(*BOX_HEIGHT)
        yaw = rng.uniform(0.0, np.pi)
        spec.worldbody.add_geom(
            name=f"box{number}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=(*(0.5 * rng.uniform(*BOX_SIDE, 2)), 0.5 * height),
            pos=(x, y, 0.5 * height),
            quat=(math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)),
            material=(STEP_LIGHT, STEP_DARK)[number % 2],
        )
    return spec


def rods(seed: int) -> mujoco.MjSpec:
    """Return a level floor with lying cylinders."""
    rng = np.random.default_rng(seed)
    spec = flat()
    for number in range(RODS):
        x, y = (rng.uniform(*span) for span in AREA)
        radius, half = 0.5 * rng.uniform(*ROD_DIAMETER), 0.5 * rng.uniform(*ROD_LENGTH)
        yaw = rng.uniform(0.0, np.pi)
        along = half * np.array((math.cos(yaw), math.sin(yaw), 0.0))
        spec.worldbody.add_geom(
            name=f"rod{number}",
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=(radius, 0.0, 0.0),
            fromto=(*((x, y, radius) - along), *((x, y, radius) + along)),
            material=WOOD,
        )
    return spec


MAKERS: dict[str, Callable[[int], mujoco.MjSpec]] = {"field": field, "boxes": boxes, "rods": rods}


def measure_clip(name: str, kinds: Sequence[str], seeds: Sequence[int]) -> list[quality.Pair]:
    """Adapt one clip to every kind of ground with every seed, and measure it."""
    where = [f"{kind}, seed {seed}" for kind in kinds for seed in seeds]
    try:
        clip = load_clip(quality.find_clip(name)[0])
    except MotionError as error:
        return [quality.Pair(name, scene, {}, error=f"{error}") for scene in where]
    return [
        dataclasses.replace(
            quality.measure(clip, Scene.from_spec(MAKERS[kind](seed)), name),
            scene=f"{kind}, seed {seed}",
        )
        for kind in kinds
        for seed in seeds
    ]


def line(pair: quality.Pair) -> str:
    """Return the row of one pair."""
    if pair.error:
        return f"  {pair.clip:10} {pair.scene:16} no result: {pair.error}"
    cells = " ".join(f"{quality.LABELS[n].short} {pair.metrics[n]:8.3g}" for n in SHOWN)
    broken = [quality.LABELS[name].short for name in pair.broken]
    return f"  {pair.clip:10} {pair.scene:16} {cells} {pair.seconds:5.1f} s  {', '.join(broken)}"


def figures_of(what: str, pairs: Sequence[quality.Pair]) -> list[Figure]:
    """Return the worst of each wanted figure over pairs, kind by kind."""
    found = []
    for kind in MAKERS:
        mine = [pair for pair in pairs if pair.scene.startswith(kind)]
        failed = [pair for pair in mine if pair.error]
        for name in WANTED:
            measured = [p for p in mine if not math.isnan(p.metrics.get(name, math.nan))]
            if not measured:
                continue
            worst = max(measured, key=lambda pair: pair.metrics[name])
            most = THRESHOLDS[name]
            assert isinstance(most, float)
            misses = sum(name in pair.broken for pair in measured)
            note = f"{worst.clip} on {worst.scene}, {worst.worst.get(name, '')}"
            note += f"; {misses} of {len(measured)} missed" if misses else ""
            found.append(
                Figure(
                    group="rough ground",
                    name=f"{kind}, {what}: {quality.LABELS[name].text}",
                    value=worst.metrics[name],
                    unit=quality.LABELS[name].unit,
                    most=most,
                    note=note,
                    failed=bool(failed),
                )
            )
    return found


def run(print_line: Print, clips: Sequence[str] | None = None) -> list[Figure]:
    """Return the figures: walks and seeds that were tuned on, and those that were not."""
    figures = []
    sets = (("tuned on", CLIPS, SEEDS), ("held back", HELD_BACK, (HELD_SEED,)))
    for what, names, seeds in sets if clips is None else (("given walks", clips, SEEDS),):
        found = [name for name in names if not quality.find_clip(name)[1]]
        with ProcessPoolExecutor(os.cpu_count()) as pool:
            pairs = []
            for measured in pool.map(measure_clip, found, repeat(tuple(MAKERS)), repeat(seeds)):
                pairs += measured
                for pair in measured:
                    print_line(line(pair))
        figures += print_figures(figures_of(what, pairs), print_line)
    return figures
