"""Table 1 as text for a terminal and as Markdown for a page, beside the paper's columns."""

from __future__ import annotations

from collections.abc import Iterable

from mjmotion.paper.ablations import COMPARISONS
from mjmotion.paper.jobs import PAPER, Column
from mjmotion.paper.table1 import Measured, Table1

HERE, IN_PAPER = "here", "Lee and Shin 1999"
_LABEL_WIDTH, _COLUMN_WIDTH = 27, 34


def lines(table: Table1) -> list[str]:
    """Return the three tables for a terminal."""
    ablations = ["", *ablation_lines(table)] if table.ablations else []
    return [*table1_lines(table), "", *solver_lines(table), *ablations]


def table1_lines(table: Table1) -> list[str]:
    """Return the paper's table, job by job, measured here on the left, the paper's on the right."""
    text = [f"Table 1, times are medians of {table.repeats} runs"]
    for name, measured in table.columns.items():
        text.append("")
        here, paper = _cells(measured.column), _cells(PAPER[name])
        rows = [
            (measured.column.name, HERE, IN_PAPER),
            *((f"  {label}", here[label], paper[label]) for label in here),
            ("  after the exact pass [%]", _percent(measured.exact_error_percent), ""),
            ("  whole fit [ms]", f"{_ms(measured.fit_seconds)}{_extra_levels(measured)}", ""),
            ("  drift of contacts [mm]", f"{measured.drift_mm:.2g}", ""),
            ("  jerk over source, RMS", f"{measured.jerk_ratio:.2f}", ""),
        ]
        for label, left, right in rows:
            text.append(f"{label:{_LABEL_WIDTH}} {left:{_COLUMN_WIDTH}} {right}".rstrip())
    return text


def solver_lines(table: Table1) -> list[str]:
    """Return the table of numeric beside hybrid IK."""
    text = [
        "Numeric beside hybrid IK, in turns in one run",
        "",
        f"{'job':{_LABEL_WIDTH}} {'IK':8} {'parameters':>10} {'whole fit [ms]':>15}"
        f" {'error, 4th level [%]':>21} {'exact [%]':>10} {'faster':>7}",
    ]
    speedups = table.speedups()
    for solver in table.solvers:
        shown = solver.ik == "hybrid" and solver.job in speedups
        faster = f"{speedups[solver.job]:.1f} x" if shown else ""
        text.append(
            f"{solver.job:{_LABEL_WIDTH}} {solver.ik:8} {solver.parameters:10d}"
            f" {_ms(solver.fit_seconds):>15} {solver.last_level_percent:21.2f}"
            f" {_percent(solver.exact_error_percent):>10} {faster:>7}".rstrip()
        )
    return text


def ablation_lines(table: Table1) -> list[str]:
    """Return the table of the ablations of §7."""
    text = [
        "The ablations of §7, the paper's own method first",
        "",
        f"{'job':{_LABEL_WIDTH}} {'method':33} {'time [ms]':>10} {'error [%]':>10}"
        f" {'overshoot [deg]':>16} {'jerk ratio':>11} {'deviation':>10}",
    ]
    for one in sorted(table.ablations, key=lambda one: COMPARISONS.index(one.comparison)):
        text.append(
            f"{one.job:{_LABEL_WIDTH}} {one.name:33} {_ms(one.seconds):>10}"
            f" {_percent(one.max_error_percent):>10} {one.overshoot_deg:16.1f}"
            f" {one.jerk_ratio:11.2f} {one.deviation:10.2f}"
        )
    return text


def markdown(table: Table1) -> str:
    """Return the paper's table as Markdown: a column a job, each cell measured here / paper's."""
    pairs = [(measured.column, PAPER[name]) for name, measured in table.columns.items()]
    rows = [
        ["", *(here.name for here, _ in pairs)],
        ["---"] * (1 + len(pairs)),
        ["parameters (reduced)", *(_both(_parameters(a), _parameters(b)) for a, b in pairs)],
        ["frames", *(_both(str(a.nframe), str(b.nframe)) for a, b in pairs)],
        ["constraints", *(_both(f"{a.nscalar:,}", f"{b.nscalar:,}") for a, b in pairs)],
        [
            "first guess [ms]",
            *(f"{_ms(a.preprocessing_seconds)} / {_ms(b.preprocessing_seconds)}" for a, b in pairs),
        ],
    ]
    for level, knots in enumerate(pairs[0][1].frames_per_knot):
        errors = [
            f"{a.max_error_percent[level]:.2f} / {b.max_error_percent[level]:.2f}" for a, b in pairs
        ]
        times = [f"{_ms(a.seconds[level])} / {_ms(b.seconds[level])}" for a, b in pairs]
        rows.append([f"{knots:g} frames a knot: error [%]", *errors])
        rows.append([f"{knots:g} frames a knot: time [ms]", *times])
    rows += [
        [label, *(show(getattr(measured, attribute)) for measured in table.columns.values())]
        for label, attribute, show in (
            ("exact pass: error [%]", "exact_error_percent", _percent),
            ("whole fit [ms]", "fit_seconds", _ms),
        )
    ]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _cells(column: Column) -> dict[str, str]:
    """Return the rows of one column of the terminal's table, by their labels."""
    return {
        "parameters (reduced)": _parameters(column),
        "frames": str(column.nframe),
        "constraints": str(column.nscalar),
        "preprocessing [ms]": _ms(column.preprocessing_seconds),
        "frames a knot": _spaced(f"{knots:g}" for knots in column.frames_per_knot),
        "time [ms]": _spaced(_ms(seconds) for seconds in column.seconds),
        "largest error [% height]": _spaced(f"{error:.2f}" for error in column.max_error_percent),
    }


def _both(here: str, paper: str) -> str:
    return here if here == paper else f"{here} / {paper}"


def _parameters(column: Column) -> str:
    return f"{column.ndof} ({column.nreduced})"


def _spaced(values: Iterable[str]) -> str:
    return "".join(f"{value:<8}" for value in values).rstrip()


def _ms(seconds: float | None) -> str:
    if seconds is None:
        return "–"
    return f"{1000 * seconds:.3g}" if seconds < 1.0 else f"{1000 * seconds:.0f}"


def _percent(value: float) -> str:
    return "< 0.0001" if value < 1e-4 else f"{value:.4f}" if value < 0.1 else f"{value:.2f}"


def _extra_levels(measured: Measured) -> str:
    return f" with {measured.extra_levels} more levels" if measured.extra_levels else ""
