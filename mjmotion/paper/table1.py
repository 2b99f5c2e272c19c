"""Table 1 of the paper: its four jobs run here, beside its columns, with both IK solvers.

    table = run(["terrain", "rope", "morph", "transition"])
    table.columns["rope"].column.max_error_percent, table.missed(), table.as_dict()

Times are medians of several runs in one process, in which the two solvers take turns.
"""

from __future__ import annotations

import dataclasses
import statistics
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

import numpy as np

from mjmotion.body.kinematics import site_id, site_positions
from mjmotion.constraints import lay_out
from mjmotion.exceptions import FitError, unknown_name
from mjmotion.fitting import Fit, contact_shift
from mjmotion.numerics.progress import Progress, no_progress
from mjmotion.paper.ablations import Ablation, compare
from mjmotion.paper.figures import Figure
from mjmotion.paper.job import LEVELS, Job
from mjmotion.paper.jobs import PAPER, Column
from mjmotion.paper.timing import machine, median_seconds, run_in_turns
from mjmotion.validation.figures import joint_jerk_ratio

EXACT = 0.01  # most error after the exact pass [% of height]
DRIFT = 1.0  # most drift of a contact [mm]
JERK = 1.3  # most RMS jerk over the source's
FASTER = 2.0  # least time of numeric over hybrid IK on the rope job
REPEATS = 9

# What must equal the paper's: label, attribute of a column.
COUNTS = (
    ("frames", "nframe"),
    ("parameters", "ndof"),
    ("reduced parameters", "nreduced"),
    ("scalar constraints", "nscalar"),
)
# Jobs whose exact pass poses every site of a contact: there is no drift by construction.
POSED_CONTACTS = ("rope", "morph")


@dataclasses.dataclass(frozen=True)
class Measured:
    """One column of Table 1, measured here.

    Attributes:
      column: what the paper's column has; levels are those of its four spacings.
      extra_levels: further levels at the last spacing, for the edges of contacts to close.
      fit_seconds: the whole fit, with first guess, further levels and exact pass [s].
      exact_error_percent: largest error after the exact pass [% of height].
      drift_mm: furthest that a contact's site is from its mean place [mm]; 0 without contacts.
      jerk_ratio: RMS jerk of joint angles over the source's.
    """

    column: Column
    extra_levels: int
    fit_seconds: float
    exact_error_percent: float
    drift_mm: float
    jerk_ratio: float


@dataclasses.dataclass(frozen=True)
class Solver:
    """One job with one IK solver: time of the whole fit [s], errors [% of height]."""

    job: str
    ik: str
    parameters: int
    fit_seconds: float
    last_level_percent: float
    exact_error_percent: float


@dataclasses.dataclass(frozen=True)
class Table1:
    """Everything that ``mjmotion table1`` prints.

    Attributes:
      columns: by the names of the jobs.
      solvers: hybrid and numeric IK, job by job.
      ablations: the comparisons of §7.
      repeats: times are medians of so many runs.
    """

    columns: dict[str, Measured]
    solvers: tuple[Solver, ...]
    ablations: tuple[Ablation, ...]
    repeats: int

    def figures(self) -> list[Figure]:
        """Return what the jobs must reach, beside the paper's figures."""
        figures = []
        for name, measured in self.columns.items():
            figures += _figures_of_job(name, measured)
        speedup = self.speedups().get(PAPER["rope"].name)
        if speedup is not None:
            label = "rope: time of numeric over hybrid IK"
            figures.append(Figure("paper", label, speedup, "x", least=FASTER))
        return figures

    def missed(self) -> list[str]:
        """Return what is not reached: one line a figure."""
        return [figure.miss for figure in self.figures() if figure.ok is False]

    def speedups(self) -> dict[str, float]:
        """Return numeric over hybrid time, by job."""
        seconds = {(row.job, row.ik): row.fit_seconds for row in self.solvers}
        return {
            job: seconds[job, "numeric"] / seconds[job, "hybrid"]
            for job, ik in seconds
            if ik == "hybrid" and (job, "numeric") in seconds
        }

    def as_dict(self) -> dict[str, Any]:
        """Return everything as data, with the machine that it was measured on."""
        return {
            "machine": machine(),
            "repeats": self.repeats,
            "table1": {
                name: {**dataclasses.asdict(measured), "paper": dataclasses.asdict(PAPER[name])}
                for name, measured in self.columns.items()
            },
            "solvers": [dataclasses.asdict(row) for row in self.solvers],
            "speedups": self.speedups(),
            "ablations": [dataclasses.asdict(ablation) for ablation in self.ablations],
            "missed": self.missed(),
        }


def _figures_of_job(name: str, measured: Measured) -> list[Figure]:
    column, paper = measured.column, PAPER[name]
    figures = []
    for label, attribute in COUNTS:
        value, wanted = getattr(column, attribute), getattr(paper, attribute)
        figures.append(
            Figure("paper", f"{name}: {label}", value, most=wanted, least=wanted, listed=False)
        )
    levels = zip(column.max_error_percent, paper.max_error_percent, strict=False)
    for number, (error, most) in enumerate(levels, start=1):
        figures.append(Figure("paper", f"{name}: error after level {number}", error, "%", most))
    exact, drift = measured.exact_error_percent, measured.drift_mm
    drifts = None if name not in POSED_CONTACTS else False
    return [
        *figures,
        Figure("paper", f"{name}: error after the exact pass", exact, "%", EXACT, listed=False),
        Figure("paper", f"{name}: drift of contacts", drift, "mm", DRIFT, listed=drifts),
        Figure("paper", f"{name}: joint jerk over source, RMS", measured.jerk_ratio, most=JERK),
    ]


def make_job(name: str) -> Job:
    """Return one of the paper's jobs.

    Raises:
      FitError: there is no job of that name.
    """
    if name not in PAPER:
        raise FitError(unknown_name("job", name, PAPER))
    job: Job = import_module(f"mjmotion.paper.{name}").make_job()
    return job


def run(
    names: Sequence[str] = tuple(PAPER),
    repeats: int = REPEATS,
    *,
    ablations: bool = True,
    make: Callable[[str], Job] = make_job,
    progress: Progress = no_progress,
) -> Table1:
    """Run jobs and measure them.

    Args:
      names: which of the paper's jobs.
      repeats: times are medians of so many runs.
      ablations: run the comparisons of §7 too; the large optimisation takes seconds a job.
      make: makes a job of a name.
      progress: called with stage, done, of.

    Raises:
      FitError: there is no job of a name.
    """
    columns: dict[str, Measured] = {}
    solvers: list[Solver] = []
    compared: list[Ablation] = []
    for name in names:
        progress(f"{name}: making the job", 0, 0)
        job = make(name)
        progress(f"{name}: both solvers, {repeats} times", 0, 0)
        fits = {ik: lambda ik=ik, job=job: job.fit(ik) for ik in ("hybrid", "numeric")}
        runs = run_in_turns(fits, repeats)
        columns[name] = measure(job, [fit for _, fit in runs["hybrid"]])
        for ik, parameters in (("hybrid", job.nreduced), ("numeric", job.ndof)):
            solvers.append(_solver(job, ik, parameters, runs[ik]))
        if ablations:
            progress(f"{name}: the ablations of §7", 0, 0)
            compared += compare(job, max(1, repeats // 2))
    return Table1(columns, tuple(solvers), tuple(compared), repeats)


def _solver(job: Job, ik: str, parameters: int, runs: Sequence[tuple[float, Fit]]) -> Solver:
    """Return the row of one solver from the times and results of its runs."""
    trace = runs[-1][1].trace
    last = trace.levels[min(len(LEVELS), len(trace.levels)) - 1]
    return Solver(
        job=job.name,
        ik=ik,
        parameters=parameters,
        fit_seconds=statistics.median(seconds for seconds, _ in runs),
        last_level_percent=last.max_error_percent,
        exact_error_percent=trace.exact_error_percent,
    )


def measure(job: Job, fits: Sequence[Fit]) -> Measured:
    """Return our column of a job that was fitted several times."""
    traces = [fit.trace for fit in fits]
    levels = traces[0].levels[: len(LEVELS)]
    column = Column(
        name=job.name,
        ndof=job.ndof,
        nreduced=job.nreduced,
        nframe=job.nframe,
        nscalar=job.nscalar,
        preprocessing_seconds=preprocessing(job, fits),
        frames_per_knot=tuple(level.frames_per_knot for level in levels),
        seconds=tuple(
            statistics.median(trace.levels[i].seconds for trace in traces)
            for i in range(len(levels))
        ),
        max_error_percent=tuple(level.max_error_percent for level in levels),
    )
    return Measured(
        column,
        len(traces[0].levels) - len(levels),
        statistics.median(trace.fit_seconds for trace in traces),
        traces[0].exact_error_percent,
        drift_mm(job, fits[0]),
        joint_jerk_ratio(fits[0].motion, [job.source or job.motion]),
    )


def preprocessing(job: Job, fits: Sequence[Fit]) -> float:
    """Return the time of the first guess of §4.5: the contacts' average shift, smoothed [s].

    Where a job brings a first guess of its own (the terrain's also keeps legs within reach), that
    was made before the fit; what is timed is then the paper's guess on the same contacts.
    """
    if job.first_guess is True:
        return statistics.median(fit.trace.preprocessing_seconds for fit in fits)
    targets = lay_out(job.constraints, job.motion.model, job.nframe)
    if not targets.contact.any():
        return 0.0
    task = {"guess": lambda: contact_shift(job.motion, targets, LEVELS, job.bones)}
    return median_seconds(task, len(fits))["guess"]


def drift_mm(job: Job, fit: Fit) -> float:
    """Return how far a contact's site is from its mean place over the contact, at most [mm]."""
    model = job.motion.model
    worst = 0.0
    for contact in job.contacts:
        frames = np.arange(contact.start, contact.end)
        sites = np.array([site_id(model, contact.site)])
        bones = None if job.bones is None else job.bones.at(frames)
        place = site_positions(model, fit.motion.qpos[frames], sites, bones)[:, 0]
        worst = max(worst, float(np.linalg.norm(place - place.mean(axis=0), axis=1).max()))
    return 1000.0 * worst
