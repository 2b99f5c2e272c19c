"""What a validation returns: figures, where they are worst, and how they stand to thresholds."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjmotion.validation.row import Row
from mjmotion.validation.text import table
from mjmotion.validation.thresholds import (
    AT_LEAST,
    THRESHOLDS,
    Threshold,
    merge_thresholds,
)

# What people read for each figure, in the order of the table.
LABELS: dict[str, str] = {
    "stance_drift_mm": "stance drift",
    "stance_gap_max_mm": "stance gap, planes and steps",
    "stance_gap_hfield_p95_mm": "stance gap, heightfields, p95",
    "foot_skate_mm_s": "mean speed of stance feet",
    "sole_penetration_mm": "sole penetration",
    "obstacle_penetration_mm": "obstacle penetration",
    "swing_clearance_mm": "swing clearance",
    "source_swing_clearance_mm": "swing clearance, source",
    "joint_limit_rad": "joint limit excess",
    "jerk_ratio_rms": "joint jerk over source, RMS",
    "jerk_ratio_p999": "joint jerk over source, p99.9",
    "raw_jerk_ratio_rms": "joint jerk over source, RMS, raw",
    "raw_jerk_ratio_p999": "joint jerk over source, p99.9, raw",
    "root_travel_ratio": "root path over source",
    "root_displacement_ratio": "root displacement over source",
    "trunk_back_deg": "trunk further back than source",
    "head_back_deg": "head further back than source",
    "stance_knee_bend_deg": "stance knee more bent than source",
    "self_overlap_mm": "self-overlap beyond source",
    "source_self_overlap_mm": "self-overlap, source",
    "com_acceleration_ratio": "centre-of-mass acceleration over source",
    "contact_kept_percent": "source's stance frames in contacts",
    "unexplained_more_points": "unexplained force, more frames than source",
    "unexplained_percent": "unexplained force, frames",
    "source_unexplained_percent": "unexplained force, frames, source",
    "mapping_bone_deg": "mapping: bones off the recording, mean",
    "mapping_bone_p95_deg": "mapping: bones off the recording, p95",
    "mapping_facing_deg": "mapping: facing off the recording, p95",
    "mapping_foot_turn_deg_s": "mapping: turn of standing feet off the recording, p95",
    "mapping_foot_height_mm": "mapping: heights of feet off the recording, p95",
    "recording_floor_mm": "recording: floor levelled by",
    "recording_noise_deg": "recording: noise of its joints",
    "contact_count": "contacts",
    "floating_percent": "no foot stands, frames",
    "floating_longest_s": "no foot stands, longest",
}
_UNITS = (
    ("_deg_s", "°/s"),
    ("_mm_s", "mm/s"),
    ("_s", "s"),
    ("_mm", "mm"),
    ("_rad", "rad"),
    ("_deg", "°"),
    ("_percent", "%"),
    ("_points", "points"),
)


@dataclasses.dataclass(frozen=True)
class Worst:
    """Where a figure is worst.

    Attributes:
      frame: the frame, or None where a figure is about the whole motion.
      where: the site, foot, body or joint, and what it touched, as words.
    """

    frame: int | None
    where: str

    def __str__(self) -> str:
        return self.where if self.frame is None else f"frame {self.frame}, {self.where}"


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Validation:
    """The figures of one motion.

    Attributes:
      metrics: figure by name, NaN where nothing was there to measure, infinite where a foot
        stands on nothing at all.
      worst: where each figure is worst.
      per_contact: a dict a contact: site, start, end, drift_mm, drift_frame, gap_mm, gap_frame,
        skate_mm_s, ground (name of what it stands on) and ground_kind (``hfield`` or ``solid``).
      per_swing: a dict a swing: foot, start, end, clearance_mm, frame, source_clearance_mm.
      per_frame: arrays, one value a frame: ``sole_penetration_mm``, ``obstacle_penetration_mm``,
        ``joint_limit_rad``, ``jerk_rms`` and ``source_jerk_rms`` [rad/s³] (low-passed, NaN in the
        last three frames), ``trunk_pitch_deg``, ``head_pitch_deg`` and ``self_overlap_mm`` (beyond
        the source's deepest), ``unexplained_bw`` [body weights] (NaN in the first and the last
        frame), all four with their ``source_…``, and for each site that feet stand with
        ``height_m/SITE``, ``ground_m/SITE`` (NaN where there is none), ``gap_mm/SITE``
        (NaN out of contact) and ``contact/SITE``.
      per_joint: joint name to RMS jerk (adapted, source), low-passed [rad/s³].
      thresholds: the thresholds it was computed with.
      fps: frames a second.
      nframe: number of frames.
    """

    metrics: dict[str, float]
    worst: dict[str, Worst]
    per_contact: list[dict[str, Any]]
    per_swing: list[dict[str, Any]]
    per_frame: dict[str, NDArray[Any]]
    per_joint: dict[str, tuple[float, float]]
    thresholds: dict[str, Threshold]
    fps: float
    nframe: int

    def __repr__(self) -> str:
        judged = [row for row in self.summary() if row.ok is not None]
        broken = self.broken()
        text = f"{len(judged) - len(broken)} of {len(judged)} figures within thresholds"
        return f"<Validation: {text}{'; broken: ' + ', '.join(broken) if broken else ''}>"

    def __str__(self) -> str:
        return self.table()

    def table(self) -> str:
        """Return the figures as lines of aligned columns: figure, value, bound, verdict, worst."""
        return table(self.summary())

    def bounds(self, name: str, thresholds: Mapping[str, Threshold] | None = None) -> Threshold:
        """Return the bound that holds for a figure here: a number, (lower, upper), or None.

        For swing clearance that is what is asked of the swing that the figure is of.
        """
        bound = (self.thresholds if thresholds is None else thresholds).get(name)
        if name == "swing_clearance_mm" and isinstance(bound, float):
            return asked_clearance(bound, self.metrics["source_swing_clearance_mm"])
        return bound

    def holds(self, name: str, thresholds: Mapping[str, Threshold] | None = None) -> bool | None:
        """Whether a figure is within its bound; None without a bound or without a value."""
        bound, value = self.bounds(name, thresholds), self.metrics[name]
        if bound is None or math.isnan(value):
            return None
        if isinstance(bound, tuple):
            return bound[0] <= value <= bound[1]
        if name == "swing_clearance_mm":  # every swing, each beside its own source
            least = (self.thresholds if thresholds is None else thresholds)[name]
            assert isinstance(least, float)
            return all(
                swing["clearance_mm"] >= asked_clearance(least, swing["source_clearance_mm"])
                for swing in self.per_swing
            )
        return value >= bound if name in AT_LEAST else value <= bound

    def broken(self, thresholds: Mapping[str, object] | None = None) -> list[str]:
        """Return the names of all figures beyond their thresholds.

        Args:
          thresholds: replaces the thresholds of the validation: changes to the defaults.

        Raises:
          MotionError: unknown name or a value of the wrong kind.
        """
        merged = self.thresholds if thresholds is None else merge_thresholds(thresholds)
        return [name for name in THRESHOLDS if self.holds(name, merged) is False]

    def summary(self) -> list[Row]:
        """Return the table: one row a figure."""
        return [
            Row(
                name,
                label,
                self.metrics[name],
                next((unit for ending, unit in _UNITS if name.endswith(ending)), ""),
                self._bound_text(name),
                self.holds(name),
                str(self.worst.get(name, "")),
            )
            for name, label in LABELS.items()
        ]

    def _bound_text(self, name: str) -> str:
        bound = self.bounds(name)
        if bound is None:
            return ""
        if isinstance(bound, tuple):
            return f"{bound[0]:g} to {bound[1]:g}"
        return f"≥ {bound:.3g}" if name in AT_LEAST else f"≤ {bound:g}"


def asked_clearance(least: float, own: float) -> float:
    """Return the clearance [mm] asked of a swing whose source has ``own``.

    No more than half of the source's where that is positive; where the source's sole is under its
    own ground, no less than that.
    """
    return min(least, own / 2 if own > 0 else own)


def as_numbers(value: Any) -> Any:
    """Return nested dicts and lists with plain Python numbers, and None for NaN and infinity."""
    if isinstance(value, Mapping):
        return {str(key): as_numbers(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [as_numbers(item) for item in value]
    if isinstance(value, np.ndarray):
        return as_numbers(value.tolist())
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
