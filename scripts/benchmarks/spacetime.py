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

from benchmarks.figures import Figure, interleaved
from benchmarks.job import LEVELS, Job
from benchmarks.speed import jerk
from mjmotion.apps.adaptation import plan
from mjmotion.body.kinematics import character_height, site_positions
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.constraints.shared_targets import SharedMove
from mjmotion.fitting import Fit, fit, residuals
from mjmotion.ik.solver import default_weights
from mjmotion.numerics.tangent import ominus
from mjmotion.paper.spacetime import TOLERANCE, Spacetime, objective, solve_spacetime
from mjmotion.scene import load_scene

Array = NDArray[np.float64]

FREE_OVER_FIXED, FASTER, OBJECTIVE, EXACT = 1.5, 20.0, 2.0, 0.01  # targets
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
        return fit(
            self.job.source,
            self.job.constraints,
            levels=LEVELS,
            ik=ik,
            first_guess=self.job.root_shift,
            shared=self.moves,
        )

    def solve(self, spacing: float, tolerance: float = TOLERANCE) -> Spacetime:
        """Solve it by one large optimisation."""
        return solve_spacetime(
            self.job.source,
            self.job.constraints,
            shared=self.moves,
            first_guess=self.job.root_shift,
            spacing=spacing,
            tolerance=tolerance,
        )

    def objective(self, result: Fit) -> float:
        """Return what a fit costs, in the large optimisation's terms."""
        weights = default_weights(self.job.source.model)
        return objective(result.motion, self.job.guess, weights, result.moves, self.moves)


def make_jobs(clip: str = "walk", scene: str = "terrain") -> tuple[FreeJob, FreeJob]:
    """Return a clip on a scene with fixed footholds, and with free ones."""
    what = plan(load_clip(clip), load_scene(scene))
    job = Job(what.source, tuple(what.constraints()), what.root_shift)
    return FreeJob("fixed", job, ()), FreeJob("free", job, tuple(what.free_footholds()))


def run(
    jobs: Sequence[FreeJob], say: Callable[[str], None], repeats: int = REPEATS
) -> list[Figure]:
    """Return the fits beside the large optimisations: times, objectives, errors, differences."""
    figures: list[Figure] = []
    for part in (partial(times, jobs, repeats), *(partial(quality, job) for job in jobs)):
        for figure in part():
            say(figure.line())
            figures.append(figure)
    return figures


def times(jobs: Sequence[FreeJob], repeats: int) -> list[Figure]:
    """Return all times and their ratios, of runs that take turns."""
    tasks: dict[str, Callable[[], object]] = {}
    for job in jobs:
        for ik in SOLVERS:
            tasks[f"{job.name}: fit, {ik}"] = partial(job.fit, ik)
        for name, spacing in KNOTS.items():
            tasks[f"{job.name}: spacetime, {name}"] = partial(job.solve, spacing)
    took = interleaved(tasks, repeats)
    figures = [Figure("spacetime", name, 1000.0 * value, "ms") for name, value in took.items()]
    for job in jobs:
        quicker = min(took[f"{job.name}: spacetime, {name}"] for name in KNOTS)
        for ik in SOLVERS:
            figures.append(
                Figure(
                    "spacetime",
                    f"{job.name}: spacetime, the quicker, over fit, {ik}",
                    quicker / took[f"{job.name}: fit, {ik}"],
                    "x",
                    least=FASTER if job.moves and ik == "hybrid" else None,
                )
            )
    for ik in SOLVERS if len(jobs) > 1 else ():
        fixed, free = (took[f"{job.name}: fit, {ik}"] for job in jobs)
        figures.append(
            Figure(
                *("spacetime", f"fit, {ik}: free footholds over fixed", free / fixed, "x"),
                most=FREE_OVER_FIXED if ik == "hybrid" else None,
            )
        )
    return figures


def quality(job: FreeJob) -> list[Figure]:
    """Return objectives, errors, jerk and how far the motions differ."""
    source, name = job.job.source, job.name
    percent = 100.0 / character_height(source.model)
    fits = {ik: job.fit(ik) for ik in SOLVERS}
    best = job.solve(KNOTS["one knot a frame"], TIGHT)
    usual = {knots: job.solve(spacing) for knots, spacing in KNOTS.items()}
    size = f"{best.nunknown} unknowns, {best.nresidual} residuals, {best.seconds:.2g} s"
    figures = [Figure("spacetime", f"{name}: least objective", best.objective, note=size)]
    for knots, found in usual.items():
        before = f"{percent * found.left:.2g} % of height before the exact pass"
        figures.append(
            Figure(
                *("spacetime", f"{name}: objective, {knots}", found.objective),
                note=f"{found.iterations} steps, {before}",
            )
        )
        figures.append(
            Figure(
                *("spacetime", f"{name}: error, {knots}", percent * found.max_error),
                *("% of height", EXACT),
            )
        )
    for ik, result in fits.items():
        cost = job.objective(result)
        figures += [
            Figure("spacetime", f"{name}: objective, fit, {ik}", cost),
            Figure(
                "spacetime",
                f"{name}: objective of fit, {ik}, over the least by",
                _more(cost, best.objective),
                "%",
                OBJECTIVE if job.moves else None,
            ),
            Figure(
                "spacetime",
                f"{name}: objective of fit, {ik}, over two frames a knot by",
                _more(cost, usual["two frames a knot"].objective),
                "%",
            ),
            Figure(
                "spacetime",
                f"{name}: error, fit, {ik}",
                percent * float(residuals(result.motion, result.targets).max()),
                "% of height",
                EXACT,
            ),
        ]
    return figures + differences(job, fits, best, usual)


def differences(
    job: FreeJob, fits: dict[str, Fit], best: Spacetime, usual: dict[str, Spacetime]
) -> list[Figure]:
    """Return how far each fit is from the least motion, and the jerk of all over the source's."""
    figures = []
    sites = best.targets.sites
    for ik, result in fits.items():
        label = f"{job.name}: fit, {ik}, from the least motion"
        away = ominus(best.motion.model, result.motion.qpos, best.motion.qpos)
        feet = _places(result.motion, sites) - _places(best.motion, sites)
        figures += [
            Figure("spacetime", f"{label}: joints, RMS", _rms(away[:, 6:]), "rad"),
            Figure("spacetime", f"{label}: joints, most", float(np.abs(away[:, 6:]).max()), "rad"),
            Figure("spacetime", f"{label}: root, RMS", _rms(away[:, :3], axis=1), "m"),
            Figure("spacetime", f"{label}: feet, RMS", _rms(feet, axis=2), "m"),
        ]
    before = jerk(job.job.source)
    motions = {f"fit, {ik}": result.motion for ik, result in fits.items()}
    motions |= {f"spacetime, {knots}": found.motion for knots, found in usual.items()}
    for who, motion in motions.items():
        name = f"{job.name}: joint jerk over source, RMS, {who}"
        figures.append(Figure("spacetime", name, jerk(motion) / before, "x"))
    return figures


def _places(motion: Motion, sites: NDArray[np.int64]) -> Array:
    return site_positions(motion.model, motion.qpos, sites)


def _more(value: float, least: float) -> float:
    """Return how much more a value is than another [%]."""
    return 100.0 * (value / least - 1.0)


def _rms(values: Array, axis: int | None = None) -> float:
    """Return the RMS of numbers, or of the lengths of vectors along an axis."""
    squares = values**2 if axis is None else np.sum(values**2, axis=axis)
    return float(np.sqrt(np.mean(squares)))
