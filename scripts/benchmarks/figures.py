"""Figures printed as they are measured, and as the Markdown table of docs/results.md."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from mjmotion.paper.figures import Figure

Print = Callable[[str], None]

TITLES = {
    "quality": "Quality: the worst over all walks and scenes",
    "footing": "Stairs and stepping stones by seed: pairs that reach every bar, one tread a step",
    "levels": "Levels: largest error on the paper's terrain job, % of height",
    "speed": "Speed: ratios in one run",
    "planning": "Planning: ratios of processor time in one run",
    "editing": "Editing",
    "paper": "The paper's jobs, retargeting and joining",
    "spacetime": "Free footholds, and one large optimisation in place of many small",
    "batch": "Thousands at once",
    "cli": "Start",
}


def print_figures(figures: Sequence[Figure], print_line: Print) -> list[Figure]:
    """Print figures, one a line, and return them."""
    for figure in figures:
        print_line(figure.line())
    return list(figures)


def markdown(figures: Sequence[Figure]) -> str:
    """Return the table of docs/results.md: one row a figure, group by group."""
    lines = ["| figure | measured | target | |", "|---|---|---|---|"]
    for group, title in TITLES.items():
        rows = [figure for figure in figures if figure.group == group and figure.in_table]
        if rows:
            lines.append(f"| **{title}** | | | |")
        for row in rows:
            verdict = f"**{row.verdict}**" if row.ok is False else row.verdict
            lines.append(f"| {row.name} | {row.measured} | {row.target} | {verdict} |")
    return "\n".join(lines)
