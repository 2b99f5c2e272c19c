"""What a report says of one motion, as numbers and as text."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import mjmotion
from mjmotion.body.morph_body import MorphBody
from mjmotion.body.motion import Motion
from mjmotion.footsteps.contacts import Contact
from mjmotion.validation import Validation
from mjmotion.validation.result import as_numbers


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class ReportData:
    """What a report says of one motion; see :class:`mjmotion.Report`, which writes it.

    Attributes:
      source: the motion before adaptation.
      motion: the adapted motion, on the model with the scene.
      contacts: who stands when.
      validation: the figures.
      levels: a dict a level of the fit: level, frames_per_knot, seconds, max_error_percent.
      fit_seconds: how long the whole fit took; None where no fit is known.
      exact_error_percent: greatest error after the exact pass, percent of the character's height.
      unmet: a dict a constraint that was not met: constraint, frames, residual_mm or, of an
        orientation, residual_deg, index and source: the user or the scene.
      title: what the page is called.
      body: the character's size in every frame of the motion, where that changes.
      notes: what else there is to say, a line each.
      plan_svg: the plan from above, as SVG text; empty where there is none.
    """

    source: Motion
    motion: Motion
    contacts: tuple[Contact, ...]
    validation: Validation
    levels: tuple[dict[str, Any], ...] = ()
    fit_seconds: float | None = None
    exact_error_percent: float | None = None
    unmet: tuple[dict[str, Any], ...] = ()
    title: str = "Adapted motion"
    body: MorphBody | None = None
    notes: tuple[str, ...] = ()
    plan_svg: str = ""

    @property
    def metrics(self) -> dict[str, float]:
        """Every figure by name, with its unit in the name."""
        return self.validation.metrics

    @cached_property
    def broken(self) -> list[str]:
        """Names of the figures beyond their thresholds."""
        return self.validation.broken()

    @cached_property
    def judged(self) -> list[str]:
        """Names of the figures that have a threshold and could be measured."""
        return [row.figure for row in self.validation.summary() if row.ok is not None]

    def table(self) -> str:
        """Return the figures as text, for a terminal."""
        return self.validation.table()

    def as_dict(self) -> dict[str, Any]:
        """Return what ``report.json`` holds: plain numbers; None for what was not there to measure.

        An infinite figure (a foot that stands on nothing) is None as well and among the broken.
        """
        figures = self.validation
        whole = {
            "mjmotion": mjmotion.__version__,
            "title": self.title,
            "nframe": figures.nframe,
            "fps": figures.fps,
            "levels": list(self.levels),
            "fit_seconds": self.fit_seconds,
            "exact_error_percent": self.exact_error_percent,
            "metrics": figures.metrics,
            "thresholds": {name: figures.bounds(name) for name in figures.thresholds},
            "broken": self.broken,
            "worst": {name: dataclasses.asdict(worst) for name, worst in figures.worst.items()},
            "unmet": list(self.unmet),
            "notes": list(self.notes),
            "per_contact": figures.per_contact,
            "per_swing": figures.per_swing,
            "joint_jerk_rms": {
                name: {"adapted": adapted, "source": source}
                for name, (adapted, source) in figures.per_joint.items()
            },
        }
        return dict(as_numbers(whole))


def residual_text(unmet: Mapping[str, Any]) -> str:
    """Return how far an entry of :attr:`ReportData.unmet` is off, with its unit."""
    if (mm := unmet.get("residual_mm")) is not None:
        return f"{float(mm):.1f} mm"
    return f"{float(unmet.get('residual_deg') or 0.0):.1f}°"
