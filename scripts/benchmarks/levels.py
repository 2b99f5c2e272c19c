"""Levels: the error that each level of the fit leaves, beside the paper's."""

from __future__ import annotations

import math
from collections.abc import Callable

from benchmarks.figures import Figure
from benchmarks.job import LEVELS, NFRAME, NSCALAR, Job, size
from mjmotion.exceptions import frame_list

PAPER = (14.31, 9.24, 3.48, 1.06)  # largest error after each level [% of height]
EXACT = 0.01  # after the exact pass [% of height]


def run(job: Job, say: Callable[[str], None]) -> list[Figure]:
    """Return the errors with both solvers, and those from the paper's own first guess."""
    figures = [
        Figure("levels", "frames", job.source.nframe, most=NFRAME, least=NFRAME),
        Figure("levels", "scalar constraints", size(job.constraints), most=NSCALAR, least=NSCALAR),
    ]
    for ik in ("hybrid", "numeric"):
        for paper_guess in (False, True):
            figures += _levels(job, ik, paper_guess)
    for figure in figures:
        say(figure.line())
    return figures


def _levels(job: Job, ik: str, paper_guess: bool) -> list[Figure]:
    result = job.fit(ik, paper_guess=paper_guess)
    trace = result.trace
    # The job is run as adapt runs it; the plain first guess of §4.5 is told beside it.
    label = f"{ik}, guess of §4.5 alone" if paper_guess else ik
    unit = "%"
    name = f"{label}: before the first level"
    figures = [Figure("levels", name, trace.first_error_percent, unit)]
    done = {level.level: level.max_error_percent for level in trace.levels}
    for number, (spacing, most) in enumerate(zip(LEVELS, PAPER, strict=True), start=1):
        name = f"{label}: level {number}, {spacing:g} frames a knot"
        value = done.get(number, math.nan)
        target = None if paper_guess else most
        figures.append(Figure("levels", name, value, unit, most=target))
    unmet = "; ".join(
        f"{unmet.constraint}: {unmet.residual_mm:.2f} mm, frames {frame_list(unmet.frames)}"
        for unmet in result.unmet
    )
    figures.append(
        Figure(
            *("levels", f"{label}: after the exact pass", trace.exact_error_percent, unit),
            most=None if paper_guess else EXACT,
            note=unmet,
        )
    )
    return figures
