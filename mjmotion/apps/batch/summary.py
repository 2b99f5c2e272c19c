"""How the figures of a batch spread, and which jobs are worst: `summarise(storage).lines()`."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.batch.record import Record
from mjmotion.apps.batch.rows import Row, is_failed
from mjmotion.apps.batch.storage import Storage
from mjmotion.boundary.words import one_line
from mjmotion.exceptions import BatchError
from mjmotion.validation.result import LABELS
from mjmotion.validation.text import number
from mjmotion.validation.thresholds import AT_LEAST, THRESHOLDS, Threshold

WORST = 3
"""Worst jobs of a figure that are named."""

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Spread:
    """One figure over all jobs that have it.

    Attributes:
      name: of the figure.
      values: (n,) sorted, in the unit of the name; infinite where a foot stands on nothing.
      worst: the worst jobs, the worst first, each with its value.
      broken: jobs that miss their threshold.
    """

    name: str
    values: Array
    worst: tuple[tuple[str, float], ...]
    broken: int

    @property
    def label(self) -> str:
        """What people read."""
        return LABELS.get(self.name, self.name)

    def percentile(self, percent: float) -> float:
        """Return a value that so many percent of the jobs do not exceed."""
        return float(np.percentile(self.values, percent, method="nearest"))


@dataclasses.dataclass(frozen=True, eq=False)
class Summary:
    """What came of a batch.

    Attributes:
      exits: exit code to number of jobs.
      errors: what failed jobs said, the commonest first, each with how many said it.
      spreads: every figure that any job has.
      seconds: mean time of a job of those that were done [s].
      worst: lines of the worst jobs, by name.
    """

    exits: dict[int, int]
    errors: tuple[tuple[str, int], ...]
    spreads: tuple[Spread, ...]
    seconds: float
    worst: dict[str, Row]

    def lines(self) -> list[str]:
        """Return the summary as text."""
        lines = [self.verdict(), ""]
        head = f"{'figure':42} {'median':>9} {'p95':>9} {'p5':>9} {'missed':>7}  worst"
        lines.append(head)
        for one in self.spreads:
            job, value = one.worst[0]
            cells = " ".join(f"{number(one.percentile(part)):>9}" for part in (50, 95, 5))
            missed = f"{one.broken:7}" if THRESHOLDS.get(one.name) is not None else " " * 7
            lines.append(f"{one.label:42} {cells} {missed}  {number(value)} {job}")
        lines += [f"failed: {count} × {one_line(error)}" for error, count in self.errors[:WORST]]
        return lines

    def verdict(self) -> str:
        """Return how many jobs there are and what came of them, as one line."""
        failed = sum(count for code, count in self.exits.items() if code not in (0, 1))
        text = (
            f"{sum(self.exits.values())} jobs: {self.exits.get(0, 0)} within all thresholds,"
            f" {self.exits.get(1, 0)} not, {failed} failed"
        )
        return text if math.isnan(self.seconds) else f"{text}; {self.seconds:.2g} s a job"


def badness(name: str) -> Callable[[Array], Array]:
    """Return what is the larger the worse a figure is."""
    bound: Threshold = THRESHOLDS.get(name)
    if isinstance(bound, tuple):
        middle = sum(bound) / 2
        return lambda values: np.abs(values - middle)
    return np.negative if name in AT_LEAST else np.asarray


def summarise(storage: Storage) -> Summary:
    """Return what came of a batch.

    Raises:
      BatchError: there is none, or it has no line yet.
    """
    record = Record(storage)
    if not record.known:
        raise BatchError(f"'{storage.address}' holds no batch with jobs: give its folder")
    exits: Counter[int] = Counter()
    errors: Counter[str] = Counter()
    names: list[str] = []
    columns: dict[str, list[float]] = {name: [] for name in LABELS}
    broken: Counter[str] = Counter()
    seconds: list[float] = []
    for row in record.rows():
        exits[row["exit"]] += 1
        if is_failed(row):
            errors[row["error"] or ""] += 1
            continue
        names.append(row["job"])
        seconds.append(row["seconds"])
        broken.update((row["broken"] or "").split())
        for name, column in columns.items():
            column.append(row[name])
    spreads = tuple(
        spread
        for name, column in columns.items()
        if (spread := _spread(name, np.array(column), names, broken[name])) is not None
    )
    wanted = {job for spread in spreads for job, _ in spread.worst[:1]}
    worst = {row["job"]: row for row in record.rows() if row["job"] in wanted}
    mean = float(np.mean(seconds)) if seconds else math.nan
    return Summary(dict(exits), tuple(errors.most_common()), spreads, mean, worst)


def _spread(name: str, values: Array, jobs: list[str], broken: int) -> Spread | None:
    """Return how a figure spreads; None where no job has it. Values (njob,), NaN for none."""
    there = np.flatnonzero(~np.isnan(values))
    if len(there) == 0:
        return None
    order = there[np.argsort(-badness(name)(values[there]), kind="stable")]
    worst = tuple((jobs[index], float(values[index])) for index in order[:WORST])
    return Spread(name, np.sort(values[there]), worst, broken)
