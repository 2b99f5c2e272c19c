"""Speed: the fit beside a plain sweep of the kinematics and beside mink, as ratios in one run."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import mujoco
import numpy as np
from numpy.typing import NDArray

from benchmarks.figures import Print, print_figures
from benchmarks.mink_ik import make_solver
from mjmotion.apps.adaptation import adapt
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.constraints import SiteConstraint, lay_out
from mjmotion.constraints.unmet import residuals
from mjmotion.exceptions import MotionError
from mjmotion.paper.figures import Figure
from mjmotion.paper.job import Job
from mjmotion.paper.timing import median_seconds
from mjmotion.scene import compose, load_scene
from mjmotion.validation import validate
from mjmotion.validation.figures import joint_jerk_ratio

SWEEP, MINK, LINEAR, WHOLE = 25.0, 10.0, 110.0, 15.0  # targets
TIMES = 100  # how often the job is tiled for the cost of many frames
REPEATS, SLOW_REPEATS, LONG_REPEATS = 31, 9, 3


def run(job: Job, print_line: Print) -> list[Figure]:
    """Return all ratios of the fit's time."""
    figures = []
    for part in (fit_and_sweep, against_mink, many_frames, whole_adaptation):
        figures += print_figures(part(job), print_line)
    return figures


def sweep(job: Job) -> Callable[[], None]:
    """Return a function that runs ``mj_kinematics`` once over all frames."""
    model, qpos = job.motion.model, job.motion.qpos
    data = mujoco.MjData(model)

    def once() -> None:
        for row in qpos:
            data.qpos[:] = row
            mujoco.mj_kinematics(model, data)

    return once


def fit_and_sweep(job: Job) -> list[Figure]:
    """Return the fit's time over that of a sweep."""
    seconds = median_seconds(
        {"sweep": sweep(job), "hybrid": job.fit, "numeric": lambda: job.fit("numeric")}, REPEATS
    )
    over_sweep = {ik: seconds[ik] / seconds["sweep"] for ik in ("hybrid", "numeric")}
    return [
        Figure("speed", "one mj_kinematics sweep", 1000 * seconds["sweep"], "ms"),
        Figure("speed", "fit, hybrid", 1000 * seconds["hybrid"], "ms"),
        Figure("speed", "fit, numeric", 1000 * seconds["numeric"], "ms"),
        Figure("speed", "fit, hybrid, over sweep", over_sweep["hybrid"], "x", most=SWEEP),
        Figure("speed", "fit, numeric, over sweep", over_sweep["numeric"], "x"),
    ]


def against_mink(job: Job) -> list[Figure]:
    """Return the time of mink over the fit's; beside it how smooth and how true both are.

    The fit holds joint ranges, so the comparison is with mink holding those it can, by limits made
    once beforehand. Its times with the limits of its default, and without any, are printed too.
    """
    name = "mink over fit, hybrid"
    try:
        solve, default, bare = (make_solver(job, how) for how in ("made once", "default", "none"))
    except ModuleNotFoundError as error:
        why = f"{error.name} is not installed: pip install 'mjmotion[benchmark]'"
        return [Figure("speed", name, math.nan, "x", least=MINK, note=why)]
    seconds = median_seconds(
        {"fit": job.fit, "mink": solve, "default": default, "bare": bare}, SLOW_REPEATS
    )
    solved, fitted = solve(), job.fit().motion
    of_mink = job.motion.replace(solved.qpos)
    note = f"{solved.steps} steps, {len(solved.unconverged)} frames not converged"
    over_fit = {task: seconds[task] / seconds["fit"] for task in ("mink", "default", "bare")}
    figures = [
        Figure("speed", "mink", 1000 * seconds["mink"], "ms", note=note),
        Figure("speed", name, over_fit["mink"], "x", least=MINK),
        Figure("speed", "mink with default limits, over fit", over_fit["default"], "x"),
        Figure("speed", "mink without joint ranges, over fit", over_fit["bare"], "x"),
    ]
    for label, motion in (("fit", fitted), ("mink", of_mink)):
        jerk = joint_jerk_ratio(motion, [job.motion])
        figures += [
            Figure("speed", f"joint jerk over source, RMS, {label}", jerk, "x"),
            Figure("speed", f"largest error of a foot, {label}", foot_error(job, motion), "mm"),
        ]
    return figures


def foot_error(job: Job, motion: Motion) -> float:
    """Return the largest distance of a constrained site from its target [mm]."""
    targets = lay_out(job.constraints, motion.model, motion.nframe)
    return 1000.0 * float(residuals(motion, targets).max())


def many_frames(job: Job) -> list[Figure]:
    """Return the time of very many frames over that of one job."""
    many = tile(job, TIMES)
    batch = 10  # one job alone is too short beside the long one
    seconds = median_seconds(
        {"one": lambda: [job.fit() for _ in range(batch)], "many": many.fit}, LONG_REPEATS
    )
    ratio = seconds["many"] / (seconds["one"] / batch)
    return [
        Figure("speed", f"fit of {many.nframe} frames", seconds["many"], "s"),
        Figure("speed", f"{many.nframe} frames over {job.nframe}", ratio, "x", most=LINEAR),
    ]


def tile(job: Job, times: int) -> Job:
    """Return the job again and again; every second copy runs backwards, so nothing jumps."""
    frames = np.arange(job.nframe)
    return select_frames(
        job, np.concatenate([frames[:: 1 if copy % 2 == 0 else -1] for copy in range(times)])
    )


def select_frames(job: Job, frames: NDArray[np.int64]) -> Job:
    """Return a job of frames of another whose feet are posed at all of them, in a given order."""

    def select(constraint: SiteConstraint) -> SiteConstraint:
        assert constraint.position is not None and constraint.quat is not None
        return dataclasses.replace(
            constraint,
            frames=np.arange(len(frames)),
            position=constraint.position[frames],
            quat=constraint.quat[frames],
        )

    assert isinstance(job.first_guess, np.ndarray)
    return Job(
        job.name,
        job.motion.replace(job.motion.qpos[frames]),
        tuple(select(constraint) for constraint in job.constraints),
        first_guess=job.first_guess[frames],
    )


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

    tasks: dict[str, Callable[[], object]] = {
        "fit": job.fit,
        "load": lambda: compose("humanoid", place),
        "whole": whole,
    }
    try:
        seconds = median_seconds(tasks, SLOW_REPEATS)
    except MotionError as error:
        why = f"{type(error).__name__}: {error}"
        return [Figure("speed", name, math.nan, "x", most=WHOLE, note=why, failed=True)]
    work = seconds["whole"] - seconds["load"]
    return [
        Figure("speed", f"adaptation and validation on {scene}", 1000 * seconds["whole"], "ms"),
        Figure("speed", "of that, composing and compiling", 1000 * seconds["load"], "ms"),
        Figure("speed", name, work / seconds["fit"], "x", most=WHOLE, note="without compiling"),
    ]
