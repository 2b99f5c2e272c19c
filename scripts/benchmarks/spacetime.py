"""One large optimisation against many small (§7): the terrain job, footholds fixed and free.

The large optimisation is run in two ways. With one knot a frame it meets all constraints itself,
and converged it finds the least objective that there is: the fit's is held against that. With the
fit's own finest knots, two frames each, it cannot meet them all, and the exact pass does the rest,
as for the fit. The fit's time is held against the quicker of the two, ended as soon as a step gains
less than a thousandth.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks.figures import Print, print_figures
from mjmotion.body.kinematics import site_positions
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.constraints.shared_targets import SharedMove
from mjmotion.constraints.unmet import residuals
from mjmotion.fitting import Fit
from mjmotion.footsteps.planning import make_plan
from mjmotion.ik.solver import default_rigidity
from mjmotion.numerics.tangent import ominus
from mjmotion.paper.figures import Figure
from mjmotion.paper.job import Job
from mjmotion.paper.spacetime import TOLERANCE, Spacetime, objective, solve_spacetime
from mjmotion.paper.table1 import EXACT
from mjmotion.paper.terrain import job_of_plan
from mjmotion.paper.timing import median_seconds
from mjmotion.scene import load_scene
from mjmotion.validation.figures import joint_jerk_ratio

Array = NDArray[np.float64]

FREE_OVER_FIXED, FASTER, OBJECTIVE = 1.5, 20.0, 2.0  # targets
KNOTS = {"one knot a frame": 1.0, "two frames a knot": 2.0}
TIGHT = 1e-6  # tolerance with which the least objective is looked for
SOLVERS = ("hybrid", "numeric")
REPEATS = 9


@dataclasses.dataclass(frozen=True, eq=False)
class FreeJob:
    """A job whose footholds may be free (§7): the job, and their moves; none where fixed."""

    name: str
    job: Job
    moves: tuple[SharedMove, ...]

    def fit(self, ik: str) -> Fit:
        """Fit it by many small optimisations."""
        return self.job.fit(ik, shared=self.moves)

    def solve(self, frames_per_knot: float, tolerance: float = TOLERANCE) -> Spacetime:
        """Solve it by one large optimisation."""
        return solve_spacetime(
            self.job.motion,
            self.job.constraints,
            shared=self.moves,
            first_guess=self.job.first_guess,
            frames_per_knot=frames_per_knot,
            tolerance=tolerance,
        )

    def objective(self, result: Fit) -> float:
        """Return what a fit costs, in the large optimisation's terms."""
        rigidity = default_rigidity(self.job.motion.model)
        return objective(result.motion, self.job.guess, rigidity, result.moves, self.moves)


def make_jobs(clip: str = "walk", scene: str = "terrain") -> tuple[FreeJob, FreeJob]:
    """Return a clip on a scene with fixed footholds, and with free ones."""
    walk = make_plan(load_clip(clip), load_scene(scene))
    job = job_of_plan(walk)
    return FreeJob("fixed", job, ()), FreeJob("free", job, tuple(walk.free_footholds()))


def run(jobs: Sequence[FreeJob], print_line: Print, repeats: int = REPEATS) -> list[Figure]:
    """Return the fits beside the large optimisations: times, objectives, errors, differences."""
    figures = print_figures(times(jobs, repeats), print_line)
    for job in jobs:
        figures += print_figures(quality(job), print_line)
    return figures


def times(jobs: Sequence[FreeJob], repeats: int) -> list[Figure]:
    """Return all times and their ratios, of runs that take turns."""
    tasks: dict[str, Callable[[], object]] = {}
    for job in jobs:
        for ik in SOLVERS:
            tasks[f"{job.name}: fit, {ik}"] = partial(job.fit, ik)
        for knots, frames_per_knot in KNOTS.items():
            tasks[f"{job.name}: spacetime, {knots}"] = partial(job.solve, frames_per_knot)
    seconds = median_seconds(tasks, repeats)
    figures = [Figure("spacetime", task, 1000.0 * seconds[task], "ms") for task in tasks]
    for job in jobs:
        quicker = min(seconds[f"{job.name}: spacetime, {knots}"] for knots in KNOTS)
        for ik in SOLVERS:
            figures.append(
                Figure(
                    group="spacetime",
                    name=f"{job.name}: spacetime, the quicker, over fit, {ik}",
                    value=quicker / seconds[f"{job.name}: fit, {ik}"],
                    unit="x",
                    least=FASTER if job.moves and ik == "hybrid" else None,
                )
            )
    for ik in SOLVERS if len(jobs) > 1 else ():
        fixed, free = (seconds[f"{job.name}: fit, {ik}"] for job in jobs)
        figures.append(
            Figure(
                group="spacetime",
                name=f"fit, {ik}: free footholds over fixed",
                value=free / fixed,
                unit="x",
                most=FREE_OVER_FIXED if ik == "hybrid" else None,
            )
        )
    return figures


def quality(job: FreeJob) -> list[Figure]:
    """Return objectives, errors, jerk and how far the motions differ."""
    fits = {ik: job.fit(ik) for ik in SOLVERS}
    best = job.solve(KNOTS["one knot a frame"], TIGHT)
    usual = {knots: job.solve(frames_per_knot) for knots, frames_per_knot in KNOTS.items()}
    return [
        *_of_spacetime(job, best, usual),
        *_of_fits(job, fits, best, usual),
        *_differences(job, fits, best),
        *_jerk(job, fits, usual),
    ]


def _of_spacetime(job: FreeJob, best: Spacetime, usual: dict[str, Spacetime]) -> list[Figure]:
    """Return objectives and errors of the large optimisations."""
    percent = 100.0 / job.job.motion.character.height
    size = f"{best.nunknown} unknowns, {best.nresidual} residuals, {best.seconds:.2g} s"
    figures = [Figure("spacetime", f"{job.name}: least objective", best.objective, note=size)]
    for knots, result in usual.items():
        left = f"{percent * result.left:.2g} % of height before the exact pass"
        figures += [
            Figure(
                group="spacetime",
                name=f"{job.name}: objective, {knots}",
                value=result.objective,
                note=f"{result.iterations} steps, {left}",
            ),
            Figure(
                group="spacetime",
                name=f"{job.name}: error, {knots}",
                value=percent * result.max_error,
                unit="% of height",
                most=EXACT,
                # Fixed footholds and coarser knots: what is left is the exact pass's own.
                listed=None if job.moves or KNOTS[knots] == 1.0 else False,
            ),
        ]
    return figures


def _of_fits(
    job: FreeJob, fits: dict[str, Fit], best: Spacetime, usual: dict[str, Spacetime]
) -> list[Figure]:
    """Return objectives and errors of the fits."""
    percent = 100.0 / job.job.motion.character.height
    figures = []
    for ik, result in fits.items():
        cost = job.objective(result)
        label = f"{job.name}: objective of fit, {ik}"
        over_coarse = _percent_more(cost, usual["two frames a knot"].objective)
        figures += [
            Figure("spacetime", f"{job.name}: objective, fit, {ik}", cost),
            Figure(
                group="spacetime",
                name=f"{label}, over the least by",
                value=_percent_more(cost, best.objective),
                unit="%",
                most=OBJECTIVE if job.moves else None,
            ),
            Figure("spacetime", f"{label}, over two frames a knot by", over_coarse, "%"),
            Figure(
                group="spacetime",
                name=f"{job.name}: error, fit, {ik}",
                value=percent * float(residuals(result.motion, result.targets).max()),
                unit="% of height",
                most=EXACT,
                # Hybrid IK's limbs meet their targets exactly, and of fixed footholds the levels
                # have the figure already.
                listed=None if job.moves and ik == "numeric" else False,
            ),
        ]
    return figures


def _differences(job: FreeJob, fits: dict[str, Fit], best: Spacetime) -> list[Figure]:
    """Return how far each fit is from the motion of least objective."""
    figures = []
    sites = best.targets.sites
    for ik, result in fits.items():
        label = f"{job.name}: fit, {ik}, from the least motion"
        difference = ominus(best.motion.model, result.motion.qpos, best.motion.qpos)
        joints, root = difference[:, 6:], difference[:, :3]
        feet = _site_positions(result.motion, sites) - _site_positions(best.motion, sites)
        figures += [
            Figure("spacetime", f"{label}: joints, RMS", _rms(joints), "rad"),
            Figure("spacetime", f"{label}: joints, most", float(np.abs(joints).max()), "rad"),
            Figure("spacetime", f"{label}: root, RMS", _rms(root, axis=1), "m"),
            Figure("spacetime", f"{label}: feet, RMS", _rms(feet, axis=2), "m"),
        ]
    return figures


def _jerk(job: FreeJob, fits: dict[str, Fit], usual: dict[str, Spacetime]) -> list[Figure]:
    """Return the joint jerk of every motion over the source's."""
    motions = {f"fit, {ik}": result.motion for ik, result in fits.items()}
    motions |= {f"spacetime, {knots}": result.motion for knots, result in usual.items()}
    return [
        Figure(
            group="spacetime",
            name=f"{job.name}: joint jerk over source, RMS, {label}",
            value=joint_jerk_ratio(motion, [job.job.motion]),
            unit="x",
        )
        for label, motion in motions.items()
    ]


def _site_positions(motion: Motion, sites: NDArray[np.int64]) -> Array:
    return site_positions(motion.model, motion.qpos, sites)


def _percent_more(value: float, least: float) -> float:
    """Return how much more a value is than another [%]."""
    return 100.0 * (value / least - 1.0)


def _rms(values: Array, axis: int | None = None) -> float:
    """Return the RMS of numbers, or of the lengths of vectors along an axis."""
    squares = values**2 if axis is None else np.sum(values**2, axis=axis)
    return float(np.sqrt(np.mean(squares)))
