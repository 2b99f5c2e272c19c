"""Speed: the fit beside a plain sweep of the kinematics and beside mink, as ratios in one run."""

from __future__ import annotations

import math
from collections.abc import Callable

import mujoco
import numpy as np

from benchmarks.figures import Figure, interleaved
from benchmarks.job import Job
from benchmarks.mink_ik import make_solver
from mjmotion.apps.adaptation import adapt
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.constraints import lay_out
from mjmotion.exceptions import MotionError
from mjmotion.fitting import residuals
from mjmotion.scene import compose, load_scene
from mjmotion.validation import validate
from mjmotion.validation.figures import joint_jerk

SWEEP, MINK, LINEAR, WHOLE = 25.0, 10.0, 110.0, 15.0  # targets
TIMES = 100  # how often the job is tiled for the cost of many frames
REPEATS, SLOW_REPEATS, LONG_REPEATS = 31, 9, 3


def run(job: Job, say: Callable[[str], None]) -> list[Figure]:
    """Return all ratios of the fit's time."""
    figures: list[Figure] = []
    for part in (fit_and_sweep, against_mink, many_frames, whole_adaptation):
        for figure in part(job):
            say(figure.line())
            figures.append(figure)
    return figures


def sweep(job: Job) -> Callable[[], None]:
    """Return a function that runs ``mj_kinematics`` once over all frames."""
    model, qpos = job.source.model, job.source.qpos
    data = mujoco.MjData(model)

    def once() -> None:
        for row in qpos:
            data.qpos[:] = row
            mujoco.mj_kinematics(model, data)

    return once


def fit_and_sweep(job: Job) -> list[Figure]:
    """Return the fit's time over that of a sweep."""
    took = interleaved(
        {"sweep": sweep(job), "hybrid": job.fit, "numeric": lambda: job.fit("numeric")}, REPEATS
    )
    return [
        Figure("speed", "one mj_kinematics sweep", 1000 * took["sweep"], "ms"),
        Figure("speed", "fit, hybrid", 1000 * took["hybrid"], "ms"),
        Figure("speed", "fit, numeric", 1000 * took["numeric"], "ms"),
        Figure("speed", "fit, hybrid, over sweep", took["hybrid"] / took["sweep"], "x", SWEEP),
        Figure("speed", "fit, numeric, over sweep", took["numeric"] / took["sweep"], "x"),
    ]


def against_mink(job: Job) -> list[Figure]:
    """Return the time of mink over the fit's; beside it how smooth and how true both are.

    The fit holds joint ranges, so the comparison is with mink holding those it can, by limits made
    once beforehand. Its times with the limits of its default, and without any, are told too.
    """
    name = "mink over fit, hybrid"
    try:
        solve, default, bare = (make_solver(job, how) for how in ("made once", "default", "none"))
    except ModuleNotFoundError as error:
        why = f"{error.name} is not installed: pip install 'mjmotion[benchmark]'"
        return [Figure("speed", name, math.nan, "x", least=MINK, note=why)]
    took = interleaved(
        {"fit": job.fit, "mink": solve, "default": default, "bare": bare}, SLOW_REPEATS
    )
    solved, fitted = solve(), job.fit().motion
    theirs = job.source.replace(solved.qpos)
    note = f"{solved.steps} steps, {len(solved.unconverged)} frames not converged"
    figures = [
        Figure("speed", "mink", 1000 * took["mink"], "ms", note=note),
        Figure("speed", name, took["mink"] / took["fit"], "x", least=MINK),
        Figure("speed", "mink with default limits, over fit", took["default"] / took["fit"], "x"),
        Figure("speed", "mink without joint ranges, over fit", took["bare"] / took["fit"], "x"),
    ]
    source = jerk(job.source)
    for who, motion in (("fit", fitted), ("mink", theirs)):
        figures += [
            Figure("speed", f"joint jerk over source, RMS, {who}", jerk(motion) / source, "x"),
            Figure("speed", f"largest error of a foot, {who}", foot_error(job, motion), "mm"),
        ]
    return figures


def jerk(motion: Motion) -> float:
    """Return the RMS of the third derivative of joint angles [rad/s³], as the validation's."""
    return float(np.sqrt(np.mean(joint_jerk(motion) ** 2)))


def foot_error(job: Job, motion: Motion) -> float:
    """Return the largest distance of a constrained site from its target [mm]."""
    targets = lay_out(job.constraints, motion.model, motion.nframe)
    return 1000.0 * float(residuals(motion, targets).max())


def many_frames(job: Job) -> list[Figure]:
    """Return the time of very many frames over that of one job."""
    many = job.tiled(TIMES)
    batch = 10  # one job alone is too short beside the long one
    took = interleaved(
        {"one": lambda: [job.fit() for _ in range(batch)], "many": many.fit}, LONG_REPEATS
    )
    one = took["one"] / batch
    return [
        Figure("speed", f"fit of {many.source.nframe} frames", took["many"], "s"),
        Figure(
            *("speed", f"{many.source.nframe} frames over {job.source.nframe}", took["many"] / one),
            "x",
            most=LINEAR,
        ),
    ]


def whole_adaptation(job: Job, clip: str = "walk", scene: str = "terrain_doors") -> list[Figure]:
    """Return the time of a whole adaptation after loading, over the bare fit of the terrain job.

    ``adapt`` composes and compiles the model of character and scene, which is loading; that is
    timed on its own and taken off. All else counts, validation included.
    """
    name = f"adaptation and validation on {scene}, over fit"
    walk, place = load_clip(clip), load_scene(scene)

    def whole() -> None:
        result = adapt(walk, place)
        validate(result.source, result.motion, result.contacts)

    tasks = {"fit": job.fit, "load": lambda: compose("humanoid", place).compile(), "whole": whole}
    try:
        took = interleaved(tasks, SLOW_REPEATS)
    except MotionError as error:
        why = f"{type(error).__name__}: {error}"
        return [Figure("speed", name, math.nan, "x", most=WHOLE, note=why, missed=True)]
    work = took["whole"] - took["load"]
    return [
        Figure("speed", f"adaptation and validation on {scene}", 1000 * took["whole"], "ms"),
        Figure("speed", "of that, composing and compiling", 1000 * took["load"], "ms"),
        Figure("speed", name, work / took["fit"], "x", most=WHOLE, note="without compiling"),
    ]
