"""Table 1 as text for a terminal and as Markdown for a page, beside the paper's columns."""

from __future__ import annotations

from collections.abc import Iterable

from mjmotion.exceptions import OutputError
from mjmotion.paper.ablations import COMPARISONS
from mjmotion.paper.jobs import PAPER, Column
from mjmotion.paper.table1 import Measured, Table1

OURS, THEIRS = "ours", "Lee and Shin 1999"
BEGIN, END = "<!-- table1 -->", "<!-- /table1 -->"
_LABEL, _SIDE = 27, 34  # widths


def lines(found: Table1) -> list[str]:
    """Return the three tables for a terminal."""
    return [
        *table1_lines(found),
        "",
        *solver_lines(found),
        *(["", *way_lines(found)] if found.ways else []),
    ]


def table1_lines(found: Table1) -> list[str]:
    """Return the paper's table, job by job, ours on the left and the paper's on the right."""
    text = [f"Table 1, times are medians of {found.repeats} runs", ""]
    for name, ours in found.columns.items():
        mine, paper = ours.column, PAPER[name]
        rows = [
            (mine.name, OURS, THEIRS),
            ("  parameters (reduced)", *(_parameters(c) for c in (mine, paper))),
            ("  frames", str(mine.nframe), str(paper.nframe)),
            ("  constraints", str(mine.nscalar), str(paper.nscalar)),
            ("  preprocessing [ms]", *(_ms(c.preprocessing_seconds) for c in (mine, paper))),
            (
                "  frames a knot",
                *(_row(f"{v:g}" for v in c.frames_per_knot) for c in (mine, paper)),
            ),
            ("  time [ms]", *(_row(_ms(v) for v in c.seconds) for c in (mine, paper))),
            (
                "  largest error [% height]",
                *(_row(f"{v:.2f}" for v in c.max_error_percent) for c in (mine, paper)),
            ),
            ("  after the exact pass [%]", _small(ours.exact_error_percent), ""),
            ("  whole fit [ms]", f"{_ms(ours.fit_seconds)}{_extra(ours)}", ""),
            ("  drift of contacts [mm]", f"{ours.drift_mm:.2g}", ""),
            ("  jerk over source, RMS", f"{ours.jerk_ratio:.2f}", ""),
        ]
        text += [f"{label:{_LABEL}} {a:{_SIDE}} {b}".rstrip() for label, a, b in rows]
        text.append("")
    return text[:-1]


def solver_lines(found: Table1) -> list[str]:
    """Return the table of numeric beside hybrid IK."""
    text = [
        "Numeric beside hybrid IK, in turns in one run",
        "",
        f"{'job':{_LABEL}} {'IK':8} {'parameters':>10} {'whole fit [ms]':>15}"
        f" {'error, 4th level [%]':>21} {'exact [%]':>10} {'faster':>7}",
    ]
    speedups = found.speedups()
    for row in found.solvers:
        faster = f"{speedups[row.job]:.1f} x" if row.ik == "hybrid" and row.job in speedups else ""
        text.append(
            f"{row.job:{_LABEL}} {row.ik:8} {row.parameters:10d} {_ms(row.fit_seconds):>15}"
            f" {row.last_level_percent:21.2f} {_small(row.exact_error_percent):>10}"
            f" {faster:>7}".rstrip()
        )
    return text


def way_lines(found: Table1) -> list[str]:
    """Return the table of the three ways of §7."""
    text = [
        "The three ways of §7, the paper's own first",
        "",
        f"{'job':{_LABEL}} {'way':33} {'time [ms]':>10} {'error [%]':>10} {'overshoot [deg]':>16}"
        f" {'jerk ratio':>11} {'deviation':>10}",
    ]
    for comparison in COMPARISONS:
        for way in (way for way in found.ways if way.comparison == comparison):
            text.append(
                f"{way.job:{_LABEL}} {way.name:33} {_ms(way.seconds):>10}"
                f" {_small(way.max_error_percent):>10} {way.overshoot_deg:16.1f}"
                f" {way.jerk_ratio:11.2f} {way.deviation:10.2f}"
            )
    return text


def markdown(found: Table1) -> str:
    """Return the paper's table as Markdown: a column a job, in each cell ours / the paper's."""
    columns = list(found.columns.values())
    pairs = [(ours.column, PAPER[name]) for name, ours in found.columns.items()]
    rows = [
        ["", *(ours.name for ours, _ in pairs)],
        ["---"] * (1 + len(pairs)),
        ["parameters (reduced)", *(_both(*map(_parameters, pair)) for pair in pairs)],
        ["frames", *(_both(*(str(one.nframe) for one in pair)) for pair in pairs)],
        ["constraints", *(_both(*(f"{one.nscalar:,}" for one in pair)) for pair in pairs)],
        ["first guess [ms]", *(_beside(pair, "preprocessing_seconds", None) for pair in pairs)],
    ]
    for level, knots in enumerate(pairs[0][1].frames_per_knot):
        for label, field in (("error [%]", "max_error_percent"), ("time [ms]", "seconds")):
            cells = [_beside(pair, field, level) for pair in pairs]
            rows.append([f"{knots:g} frames a knot: {label}", *cells])
    rows += [
        ["exact pass: error [%]", *(_small(ours.exact_error_percent) for ours in columns)],
        ["whole fit [ms]", *(_ms(ours.fit_seconds) for ours in columns)],
    ]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _both(ours: str, theirs: str) -> str:
    return ours if ours == theirs else f"{ours} / {theirs}"


def _beside(pair: tuple[Column, Column], field: str, level: int | None) -> str:
    """Return ours / the paper's of one field, at one level where it has several."""
    values = []
    for column in pair:
        value = getattr(column, field)
        if level is not None:
            value = value[level] if level < len(value) else None
        percent = field == "max_error_percent" and value is not None
        values.append(f"{value:.2f}" if percent else _ms(value))
    return " / ".join(values)


def put_between(page: str, content: str, begin: str = BEGIN, end: str = END) -> str:
    """Return a page with what stands between two markers replaced.

    Raises:
      OutputError: the page has no such markers.
    """
    before, found, rest = page.partition(begin)
    _, closed, after = rest.partition(end)
    if not (found and closed):
        raise OutputError(f"the page has no place for the table: write {begin}{end} into it")
    return f"{before}{begin}\n{content}\n{end}{after}"


def _parameters(column: Column) -> str:
    return f"{column.ndof} ({column.nreduced})"


def _row(values: Iterable[str]) -> str:
    return "".join(f"{value:<8}" for value in values).rstrip()


def _ms(seconds: float | None) -> str:
    if seconds is None:
        return "–"
    return f"{1000 * seconds:.3g}" if seconds < 1.0 else f"{1000 * seconds:.0f}"


def _small(percent: float) -> str:
    return "< 0.0001" if percent < 1e-4 else f"{percent:.4f}" if percent < 0.1 else f"{percent:.2f}"


def _extra(ours: Measured) -> str:
    return f" with {ours.extra_levels} more levels" if ours.extra_levels else ""
