"""A figure beside its target, and what machine it was measured on."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from mjmotion.paper.timing import interleaved, machine, seconds

__all__ = ["Figure", "interleaved", "machine", "seconds"]


@dataclasses.dataclass(frozen=True)
class Figure:
    """One measured figure.

    Attributes:
      group: ``quality``, ``levels``, ``speed``, ``paper``, ``spacetime`` or ``cli``.
      name: what people read.
      value: NaN where it could not be measured.
      unit: such as ``mm`` or ``x``.
      most, least: the target, or None; a figure without either is only told.
      note: where it is worst, or what belongs to it.
      missed: counts as missed whatever the value: there is none because something failed.
    """

    group: str
    name: str
    value: float
    unit: str = ""
    most: float | None = None
    least: float | None = None
    note: str = ""
    missed: bool = False

    @property
    def ok(self) -> bool | None:
        """Whether the target is reached; None without a target or without a value."""
        if self.missed:
            return False
        if math.isnan(self.value) or (self.most is None and self.least is None):
            return None
        above = self.least is None or self.value >= self.least
        return above and (self.most is None or self.value <= self.most)

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

    def line(self) -> str:
        """Return the figure as one line of a table."""
        text = f"  {self.name:52} {self.measured:>12}   {self.target:14} {self.verdict:7}"
        return f"{text} {self.note}".rstrip()

    def as_dict(self) -> dict[str, Any]:
        """Return the figure as data; no value is None."""
        data = dataclasses.asdict(self)
        data["value"] = self.value if math.isfinite(self.value) else None
        return {**data, "target": self.target, "ok": self.ok, "verdict": self.verdict}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Figure:
        """Return the figure that ``as_dict`` made the data of."""
        names = {field.name for field in dataclasses.fields(cls)}
        kept = {name: value for name, value in data.items() if name in names}
        value = math.nan if kept["value"] is None else float(kept["value"])
        return cls(**{**kept, "value": value})
