"""Table 1 of the paper: its four jobs run here, beside its columns, with both IK solvers.

    found = run(["terrain", "rope", "morph", "transition"])
    found.columns["rope"].column.max_error_percent, found.missed(), found.as_dict()

Times are medians of several runs in one process, in which the two solvers take turns.
"""

from __future__ import annotations

import dataclasses
import statistics
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any

import numpy as np

from mjmotion.body.kinematics import site_id, site_positions
from mjmotion.constraints import lay_out
from mjmotion.exceptions import FitError, unknown_name
from mjmotion.fitting import Fit, contact_shift
from mjmotion.paper.ablations import Way, compare
from mjmotion.paper.job import LEVELS, Job
from mjmotion.paper.jobs import PAPER, Column
from mjmotion.paper.timing import machine, take_turns
from mjmotion.validation.figures import joint_jerk, ratio

EXACT = 0.01  # most error after the exact pass [% of height]
DRIFT = 1.0  # most drift of a contact [mm]
JERK = 1.3  # most RMS jerk over the source's
FASTER = 2.0  # least time of numeric over hybrid IK on the rope job
REPEATS = 9


@dataclasses.dataclass(frozen=True)
class Measured:
    """One column of ours.

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
    """Everything that ``mjmotion table1`` tells.

    Attributes:
      columns: by the names of the examples.
      solvers: hybrid and numeric IK, job by job.
      ways: the comparisons of §7.
      repeats: times are medians of so many runs.
    """

    columns: dict[str, Measured]
    solvers: tuple[Solver, ...]
    ways: tuple[Way, ...]
    repeats: int

    def missed(self) -> list[str]:
        """Return what is not reached: one line a figure."""
        found = []
        for name, ours in self.columns.items():
            mine, paper = ours.column, PAPER[name]
            for what in ("ndof", "nreduced", "nframe", "nscalar"):
                have, want = getattr(mine, what), getattr(paper, what)
                if have != want:
                    found.append(f"{name}: {what} is {have}, the paper's {want}")
            levels = zip(mine.max_error_percent, paper.max_error_percent, strict=False)
            for number, (error, most) in enumerate(levels, start=1):
                if error > most:
                    found.append(f"{name}: error after level {number} is {error:.2f} % > {most} %")
            for label, value, most, unit in (
                ("error after the exact pass", ours.exact_error_percent, EXACT, " %"),
                ("drift", ours.drift_mm, DRIFT, " mm"),
                ("jerk ratio", ours.jerk_ratio, JERK, ""),
            ):
                if value > most:
                    found.append(f"{name}: {label} is {value:.3g}{unit} > {most:g}{unit}")
        speedup = self.speedups().get(PAPER["rope"].name, FASTER)
        if speedup < FASTER:
            found.append(f"rope: hybrid IK is {speedup:.1f} times faster than numeric < {FASTER:g}")
        return found

    def speedups(self) -> dict[str, float]:
        """Return numeric over hybrid time, by job."""
        took = {(row.job, row.ik): row.fit_seconds for row in self.solvers}
        return {
            job: took[job, "numeric"] / took[job, "hybrid"]
            for job, ik in took
            if ik == "hybrid" and (job, "numeric") in took
        }

    def as_dict(self) -> dict[str, Any]:
        """Return everything as data, with the machine that it was measured on."""
        return {
            "machine": machine(),
            "repeats": self.repeats,
            "table1": {
                name: {**dataclasses.asdict(ours), "paper": dataclasses.asdict(PAPER[name])}
                for name, ours in self.columns.items()
            },
            "solvers": [dataclasses.asdict(row) for row in self.solvers],
            "speedups": self.speedups(),
            "ways": [dataclasses.asdict(way) for way in self.ways],
            "missed": self.missed(),
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Table1:
        """Return the tables that :meth:`as_dict` made the data of."""
        columns = {}
        for name, entry in data["table1"].items():
            lists: dict[str, Any] = {
                key: tuple(v) if isinstance(v, list) else v for key, v in entry["column"].items()
            }
            known = {field.name: entry[field.name] for field in dataclasses.fields(Measured)}
            columns[name] = Measured(**{**known, "column": Column(**lists)})
        return cls(
            columns,
            tuple(Solver(**row) for row in data["solvers"]),
            tuple(Way(**way) for way in data["ways"]),
            int(data["repeats"]),
        )


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
    ways: bool = True,
    make: Callable[[str], Job] = make_job,
    progress: Callable[[str], None] | None = None,
) -> Table1:
    """Run jobs and measure them.

    Args:
      names: which of the paper's jobs.
      repeats: times are medians of so many runs.
      ways: run the comparisons of §7 too; the large optimisation takes seconds a job.
      make: makes a job of a name.
      progress: called with the name of each stage as it begins.

    Raises:
      FitError: there is no job of a name.
    """
    say = progress or (lambda stage: None)
    columns: dict[str, Measured] = {}
    solvers: list[Solver] = []
    compared: list[Way] = []
    for name in names:
        say(f"{name}: making the job")
        job = make(name)
        say(f"{name}: both solvers, {repeats} times")
        fits = {ik: lambda ik=ik, job=job: job.fit(ik) for ik in ("hybrid", "numeric")}
        runs = take_turns(fits, repeats)
        columns[name] = measure(job, [fit for _, fit in runs["hybrid"]])
        for ik, parameters in (("hybrid", job.nreduced), ("numeric", job.ndof)):
            took = statistics.median(seconds for seconds, _ in runs[ik])
            trace = runs[ik][-1][1].trace
            last = trace.levels[min(len(LEVELS), len(trace.levels)) - 1].max_error_percent
            solvers.append(Solver(job.name, ik, parameters, took, last, trace.exact_error_percent))
        if ways:
            say(f"{name}: the ways of §7")
            compared += compare(job, max(1, repeats // 2))
    return Table1(columns, tuple(solvers), tuple(compared), repeats)


def measure(job: Job, fits: Sequence[Fit]) -> Measured:
    """Return our column of a job that was fitted several times."""
    traces = [fit.trace for fit in fits]
    levels = traces[0].levels[: len(LEVELS)]
    column = Column(
        *(job.name, job.ndof, job.nreduced, job.nframe, job.nscalar),
        preprocessing_seconds=preprocessing(job, fits),
        frames_per_knot=tuple(level.frames_per_knot for level in levels),
        seconds=tuple(
            statistics.median(trace.levels[i].seconds for trace in traces)
            for i in range(len(levels))
        ),
        max_error_percent=tuple(level.max_error_percent for level in levels),
    )
    rms = [
        float(np.sqrt(np.mean(joint_jerk(motion) ** 2)))
        for motion in (fits[0].motion, job.source or job.motion)
    ]
    return Measured(
        column,
        len(traces[0].levels) - len(levels),
        statistics.median(trace.fit_seconds for trace in traces),
        traces[0].exact_error_percent,
        drift_mm(job, fits[0]),
        ratio(*rms),
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
    return statistics.median(seconds for seconds, _ in take_turns(task, len(fits))["guess"])


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


__all__ = [
    "PAPER",
    "Measured",
    "Solver",
    "Table1",
    "drift_mm",
    "make_job",
    "measure",
    "preprocessing",
    "run",
]
