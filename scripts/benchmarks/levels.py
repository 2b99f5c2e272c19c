"""Levels: the error that each level of the fit leaves, beside the paper's."""

from __future__ import annotations

import math

from benchmarks.figures import Print, print_figures
from mjmotion.exceptions import frame_list
from mjmotion.paper.figures import Figure
from mjmotion.paper.job import LEVELS, Job
from mjmotion.paper.jobs import PAPER
from mjmotion.paper.table1 import EXACT


def run(job: Job, print_line: Print) -> list[Figure]:
    """Return the errors with both solvers, and those from the paper's own first guess."""
    figures = []
    for ik in ("hybrid", "numeric"):
        for paper_guess in (False, True):
            figures += print_figures(_levels(job, ik, paper_guess), print_line)
    return figures


def _levels(job: Job, ik: str, paper_guess: bool) -> list[Figure]:
    """Return the errors of one fit; with ``paper_guess`` it begins as §4.5 has it, unjudged.

    Hybrid IK's own are in Table 1 too, so they are checked here and no rows of the results.
    """
    result = job.fit(ik, first_guess=True) if paper_guess else job.fit(ik)
    trace = result.trace
    label = f"{ik}, guess of §4.5 alone" if paper_guess else ik
    listed = False if ik == "hybrid" else None
    start = f"{label}: before the first level"
    figures = [Figure("levels", start, trace.first_error_percent, "%")]
    errors = {level.level: level.max_error_percent for level in trace.levels}
    targets = PAPER["terrain"].max_error_percent
    for number, (spacing, target) in enumerate(zip(LEVELS, targets, strict=True), start=1):
        name = f"{label}: level {number}, {spacing:g} frames a knot"
        most = None if paper_guess else target
        error = errors.get(number, math.nan)
        figures.append(Figure("levels", name, error, "%", most=most, listed=listed))
    unmet = "; ".join(
        f"{unmet.constraint}: {unmet.residual_mm:.2f} mm, frames {frame_list(unmet.frames)}"
        for unmet in result.unmet
    )
    figures.append(
        Figure(
            group="levels",
            name=f"{label}: after the exact pass",
            value=trace.exact_error_percent,
            unit="%",
            most=None if paper_guess else EXACT,
            note=unmet,
            listed=listed,
        )
    )
    return figures
