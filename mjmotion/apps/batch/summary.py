"""How the figures of a batch spread, and which jobs are worst: as lines, and as one page.

summary = summarise(open_storage("out/all"))
summary.lines()
write_page(storage, summary)
"""

from __future__ import annotations

import dataclasses
import math
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.batch.jobs import Source
from mjmotion.apps.batch.record import Record
from mjmotion.apps.batch.rows import Row, is_failed
from mjmotion.apps.batch.shards import copy_files
from mjmotion.apps.batch.storage import Storage
from mjmotion.body.character import Character
from mjmotion.boundary.words import first_line, one_line
from mjmotion.exceptions import BatchError, MotionError
from mjmotion.numerics.progress import Progress, no_progress
from mjmotion.output.folder import MODEL, MOTION
from mjmotion.validation.result import LABELS
from mjmotion.validation.text import number
from mjmotion.validation.thresholds import AT_LEAST, THRESHOLDS, Threshold

PAGE = "summary.html"
WORST = 3
"""Worst jobs of a figure that are named."""
STRIPS = 8
"""Strips that are drawn at most: each takes a second."""

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


def write_page(storage: Storage, summary: Summary, progress: Progress = no_progress) -> str:
    """Write ``summary.html``: one page that needs nothing else; return its name.

    Args:
      storage: of the batch.
      summary: of it.
      progress: told of the strips of poses.

    Raises:
      OSError: it cannot be written.
    """
    from mjmotion.apps.batch.page import page

    strips: dict[str, bytes | str] = {}
    # Those first that miss a threshold, and most of them.
    order = sorted(summary.spreads, key=lambda spread: -spread.broken)
    jobs = list(dict.fromkeys(spread.worst[0][0] for spread in order))[:STRIPS]
    for done, job in enumerate(jobs):
        progress("strips of the worst", done, len(jobs))
        strips[job] = strip_of(storage, summary.worst[job])
    storage.write(PAGE, page(summary, strips).encode("utf-8"))
    return PAGE


def strip_of(storage: Storage, row: Row) -> bytes | str:
    """Return a strip of poses of a job as PNG, or why there is none, as one line."""
    from mjmotion.apps.batch.making import composed_at
    from mjmotion.body.motion import Motion
    from mjmotion.footsteps.contacts import load_contacts
    from mjmotion.output.folder import CONTACTS
    from mjmotion.output.report.summary import png_bytes
    from mjmotion.output.video import render_strip

    try:
        with tempfile.TemporaryDirectory(prefix="mjmotion-") as name:
            folder = Path(name)
            copy_files(storage, row, folder)
            body: str | Path | Character = folder / MODEL
            if not (folder / MODEL).is_file():
                parts = [(row[kind], row[f"{kind}_from"]) for kind in ("character", "scene")]
                body = composed_at(*(Source.at(*part) for part in parts))
            motion = Motion.load(folder / MOTION, body)
            contacts = load_contacts(folder / CONTACTS, motion.model, motion.nframe)
            return png_bytes(render_strip(motion, contacts=contacts))
    except (MotionError, OSError) as error:
        return first_line(error)
