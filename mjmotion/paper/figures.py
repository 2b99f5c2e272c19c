"""One measured figure beside its target."""

from __future__ import annotations

import dataclasses
import math
from typing import Any


@dataclasses.dataclass(frozen=True)
class Figure:
    """One measured figure.

    Attributes:
      group: the part of the benchmark that measures it, such as ``quality`` or ``paper``.
      name: what people read.
      value: NaN where it could not be measured.
      unit: such as ``mm`` or ``x``.
      most, least: the target, or None; a figure without either is printed and not judged.
      note: where it is worst, or what belongs to it.
      failed: missed whatever the value, because there is no result.
      listed: whether it is a row of docs/results.md; None: if it has a target. False where the
        method meets the target by construction: that is checked, and is no result.
    """

    group: str
    name: str
    value: float
    unit: str = ""
    most: float | None = None
    least: float | None = None
    note: str = ""
    failed: bool = False
    listed: bool | None = None

    @property
    def ok(self) -> bool | None:
        """Whether the target is reached; None without a target or without a value."""
        if self.failed:
            return False
        if math.isnan(self.value) or (self.most is None and self.least is None):
            return None
        above = self.least is None or self.value >= self.least
        return above and (self.most is None or self.value <= self.most)

    @property
    def in_table(self) -> bool:
        """Whether it is a row of docs/results.md; what is missed always is."""
        if self.ok is False:
            return True
        return bool(self.target) if self.listed is None else self.listed

    @property
    def target(self) -> str:
        """The target as text."""
        if self.most is not None and self.most == self.least:
            return f"{self.most:g}"
        if self.most is not None and self.least is not None:
            return f"{self.least:g} to {self.most:g}"
        if self.least is not None:
            return f"≥ {self.least:g}"
        return "" if self.most is None else f"≤ {self.most:g}"

    @property
    def verdict(self) -> str:
        """``ok``, ``MISSED``, or ``skipped`` where there is a target and no value."""
        if self.ok is None:
            return "skipped" if self.target else ""
        return "ok" if self.ok else "MISSED"

    @property
    def measured(self) -> str:
        """The value with its unit as text."""
        if math.isnan(self.value):
            return "–"
        digits = ".0f" if 100 <= abs(self.value) < 1e6 else ".3g"
        return f"{self.value:{digits}} {self.unit}".strip()

    @property
    def miss(self) -> str:
        """What was measured and what was wanted, as one line."""
        return f"{self.name}: {self.measured}, wanted {self.target}"

    def line(self) -> str:
        """Return the figure as one line of a table."""
        text = f"  {self.name:52} {self.measured:>12}   {self.target:14} {self.verdict:7}"
        return f"{text} {self.note}".rstrip()

    def as_dict(self) -> dict[str, Any]:
        """Return the figure as data; no value is None."""
        data = dataclasses.asdict(self)
        data["value"] = self.value if math.isfinite(self.value) else None
        return {**data, "target": self.target, "ok": self.ok, "verdict": self.verdict}
