"""One row of the table of figures."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class Row:
    """One line of the table: a figure, its bound, and whether it holds.

    ``ok`` is None where there is no threshold or nothing was there to measure.
    """

    figure: str
    label: str
    value: float
    unit: str
    threshold: str
    ok: bool | None
    where: str
