"""Figures as text: a table for a terminal, numbers as people read them."""

from __future__ import annotations

import math
from collections.abc import Sequence

from mjmotion.validation.row import Row


def table(rows: Sequence[Row]) -> str:
    """Return the figures as lines of aligned columns: figure, value, bound, verdict, worst."""
    verdict = {True: "ok", False: "BROKEN", None: ""}
    cells = [("figure", "value", "", "bound", "", "worst")]
    for row in rows:
        cells.append(
            (
                row.label,
                number(row.value),
                row.unit,
                row.threshold,
                verdict[row.ok],
                row.where,
            )
        )
    width = [max(len(line[i]) for line in cells) for i in range(len(cells[0]))]
    lines = []
    for line in cells:
        label, value, unit, bound, ok, where = (
            text.rjust(width[i]) if i == 1 else text.ljust(width[i]) for i, text in enumerate(line)
        )
        lines.append(f"{label}  {value} {unit}  {bound}  {ok}  {where}".rstrip())
    return "\n".join(lines)


def number(value: float) -> str:
    """Return a figure as people read it: three decimals at most, ``–`` for none."""
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "-∞"
    if value != 0 and abs(value) < 1e-3:
        return "0.000" if abs(value) < 1e-9 else f"{value:.1e}"
    return f"{value:.3f}" if abs(value) < 100 else f"{value:.1f}"
