"""The README's table, made from what a benchmark wrote."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from benchmarks.figures import Figure

BEGIN, END = "<!-- benchmark -->", "<!-- /benchmark -->"
TITLES = {
    "quality": "Quality: the worst over all walks and scenes",
    "levels": "Levels: largest error on the paper's terrain job, % of height",
    "speed": "Speed: ratios in one run",
    "paper": "The paper's jobs, retargeting and joining",
    "spacetime": "Free footholds, and one large optimisation in place of many small",
    "cli": "Start",
}


class ReadmeError(ValueError):
    """The README or the results cannot be used: one line, what and where."""


def table(data: dict[str, Any]) -> str:
    """Return results as Markdown: every figure that has a target, group by group."""
    lines = ["| figure | measured | target | |", "|---|---|---|---|"]
    figures = [Figure.from_dict(entry) for entry in data["figures"]]
    for group, title in TITLES.items():
        rows = [figure for figure in figures if figure.group == group and figure.target]
        if rows:
            lines.append(f"| **{title}** | | | |")
        for row in rows:
            verdict = f"**{row.verdict}**" if row.ok is False else row.verdict
            lines.append(f"| {row.name} | {row.measured} | {row.target} | {verdict} |")
    facts = data["machine"]
    versions = ", ".join(
        f"{name} {facts[name]}" for name in ("mujoco", "numpy", "mink") if name in facts
    )
    where = f"{facts['processor']}, {facts['cores']} cores, Python {facts['python']}, {versions}"
    return "\n".join([*lines, "", f"Measured on: {where}."])


def rewrite(readme: Path, results: Path) -> None:
    """Replace what stands between the README's markers.

    Raises:
      ReadmeError: no markers, or a file that cannot be read.
    """
    try:
        data = json.loads(results.read_text("utf-8"))
        content = table(data)
    except OSError as error:
        raise ReadmeError(f"'{results}' cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise ReadmeError(f"'{results}' is not what --json writes: {error}") from error
    text = readme.read_text("utf-8")
    if BEGIN not in text or END not in text.partition(BEGIN)[2]:
        raise ReadmeError(f"'{readme.name}' has no place for the table: write {BEGIN}{END} into it")
    before, _, rest = text.partition(BEGIN)
    after = rest.partition(END)[2]
    readme.write_text(f"{before}{BEGIN}\n{content}\n{END}{after}", "utf-8")
