"""Quality: every walk on every scene, all figures of the validation at its default thresholds."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmarks.figures import Figure
from mjmotion.apps.adaptation import adapt
from mjmotion.body.motion import Motion
from mjmotion.clips import builtin_clips, load_clip
from mjmotion.exceptions import MotionError, frame_list
from mjmotion.scene import Scene, load_scene
from mjmotion.validation import THRESHOLDS, Validation, validate
from mjmotion.validation.result import asked_clearance

MOCAP = Path(__file__).parents[3] / "shared" / "mocap" / "bvh"
WALKS = (
    "walk",
    "02_01",
    "07_01",
    "16_58",
    "12_01_other_rig",
    "16_17",
    "16_31",
    "16_34",
    "17_03",
    "03_01",
)
SCENES = ("terrain", "terrain_doors", "stairs", "slope", "blocks")
CLEARANCE = "swing_clearance_mm"
# What stands in the table: label and unit.
LABELS: dict[str, tuple[str, str]] = {
    "stance_drift_mm": ("stance drift", "mm"),
    "stance_gap_max_mm": ("stance gap, planes and steps", "mm"),
    "stance_gap_hfield_p95_mm": ("stance gap, heightfields, p95", "mm"),
    "sole_penetration_mm": ("sole penetration", "mm"),
    "obstacle_penetration_mm": ("obstacle penetration", "mm"),
    CLEARANCE: ("swing clearance over what is asked", "mm"),
    "joint_limit_rad": ("joint limit excess", "rad"),
    "jerk_ratio_rms": ("joint jerk over source, RMS", ""),
    "jerk_ratio_p999": ("joint jerk over source, p99.9", ""),
    "root_travel_ratio": ("root path over source", ""),
}
_SHORT = {
    "stance_drift_mm": "drift",
    "stance_gap_max_mm": "gap",
    "stance_gap_hfield_p95_mm": "gap p95",
    "sole_penetration_mm": "sole",
    "obstacle_penetration_mm": "obstacle",
    CLEARANCE: "swing",
    "joint_limit_rad": "limit",
    "jerk_ratio_rms": "jerk",
    "jerk_ratio_p999": "jerk p99.9",
    "root_travel_ratio": "travel",
}


@dataclasses.dataclass(frozen=True)
class Pair:
    """One walk on one scene.

    Attributes:
      clip, scene: their names.
      metrics: figures by name, NaN where nothing was there to measure. Swing clearance is what is
        left over what is asked of the worst swing.
      broken: names of those beyond their thresholds.
      worst: where each figure is worst, as words.
      unmet: the constraints that could not be met.
      seconds: time of adaptation and validation.
      error: why there is no result.
    """

    clip: str
    scene: str
    metrics: dict[str, float]
    broken: tuple[str, ...] = ()
    worst: dict[str, str] = dataclasses.field(default_factory=dict)
    unmet: tuple[str, ...] = ()
    seconds: float = math.nan
    error: str = ""

    @property
    def ok(self) -> bool:
        """Whether all figures hold."""
        return not self.broken and not self.error

    def lines(self) -> list[str]:
        """Return the row of the table, and a line for each figure that is missed."""
        head = f"  {self.clip:16} {self.scene:14}"
        if self.error:
            return [f"{head} MISSED  {self.error}"]
        cells = " ".join(f"{self.metrics[name]:>10.3g}" for name in LABELS)
        lines = [f"{head} {'ok' if self.ok else 'MISSED':6} {cells} {self.seconds:6.2f} s"]
        for name in self.broken:
            where = self.worst.get(name, "")
            lines.append(f"{'':8}{LABELS[name][0]} {self.metrics[name]:.4g}: {where}")
        return lines + [f"{'':8}not met: {text}" for text in self.unmet]

    def as_dict(self) -> dict[str, Any]:
        """Return the pair as data; no value is None."""
        metrics = {
            name: value if math.isfinite(value) else None for name, value in self.metrics.items()
        }
        took = None if math.isnan(self.seconds) else round(self.seconds, 3)
        return {**dataclasses.asdict(self), "metrics": metrics, "seconds": took, "ok": self.ok}


def header() -> str:
    """Return the head of the table of pairs."""
    cells = " ".join(f"{_SHORT[name]:>10}" for name in LABELS)
    return f"  {'clip':16} {'scene':14} {'':6} {cells}   time"


def find_clip(name: str) -> tuple[Path | str, str]:
    """Return what ``load_clip`` takes for a name, and why it is skipped ("" if it is not)."""
    if name in builtin_clips() or Path(name).suffix:
        return name, ""
    if not MOCAP.is_dir():
        return name, "the recordings of shared/mocap are not on this machine"
    return MOCAP / f"{name}.bvh", ""


def measure(clip: Motion, scene: Scene, name: str) -> Pair:
    """Adapt one walk to one scene and measure it."""
    began = time.perf_counter()
    try:
        result = adapt(clip, scene)
        validation = validate(result.source, result.motion, result.contacts)
    except MotionError as error:
        return Pair(name, scene.name, {}, error=f"{type(error).__name__}: {error}")
    took = time.perf_counter() - began
    metrics = {figure: validation.metrics[figure] for figure in LABELS}
    metrics[CLEARANCE] = spare_clearance(validation)
    return Pair(
        name,
        scene.name,
        metrics,
        tuple(validation.broken()),
        {figure: str(place) for figure, place in validation.worst.items() if figure in LABELS},
        tuple(
            f"{unmet.constraint}, {unmet.residual_mm:.1f} mm, frames {frame_list(unmet.frames)}"
            for unmet in result.unmet
        ),
        took,
    )


def spare_clearance(validation: Validation) -> float:
    """Return how far the worst swing is above what is asked of it [mm]; NaN without swings."""
    least = validation.thresholds[CLEARANCE]
    if not isinstance(least, float):
        return math.nan
    spare = [
        swing["clearance_mm"] - asked_clearance(least, swing["source_clearance_mm"])
        for swing in validation.per_swing
    ]
    return min(spare, default=math.nan)


def run(
    clips: Sequence[str], scenes: Sequence[str], say: Callable[[str], None]
) -> tuple[list[Pair], list[str]]:
    """Measure every clip on every scene.

    Returns:
      the pairs, and what was skipped and why.
    """
    pairs: list[Pair] = []
    skipped: list[str] = []
    loaded = {name: load_scene(name) for name in scenes}
    say(header())
    for name in clips:
        source, why = find_clip(name)
        if why:
            skipped.append(f"{name}: {why}")
            say(f"  {name:16} skipped: {why}")
            continue
        try:
            clip = load_clip(source)
        except MotionError as error:
            pairs += [Pair(name, scene, {}, error=f"{error}") for scene in scenes]
            say(f"  {name:16} MISSED  {error}")
            continue
        for scene in loaded.values():
            pairs.append(measure(clip, scene, Path(name).stem))
            for line in pairs[-1].lines():
                say(line)
    return pairs, skipped


def summary(pairs: Sequence[Pair]) -> list[Figure]:
    """Return the worst of each figure over all pairs, with the number of misses."""
    figures = [
        Figure(
            "quality",
            "walks on scenes that reach every figure",
            float(sum(pair.ok for pair in pairs)),
            f"of {len(pairs)}",
            least=float(len(pairs)),
            note="; ".join(f"no result: {p.clip} on {p.scene}" for p in pairs if p.error),
        )
    ]
    for name, (label, unit) in LABELS.items():
        least, most = bounds(name)
        measured = [p for p in pairs if not math.isnan(p.metrics.get(name, math.nan))]
        if not measured:
            continue
        worst = max(measured, key=lambda pair: _badness(name, pair.metrics[name]))
        misses = sum(name in pair.broken for pair in measured)
        note = f"{worst.clip} on {worst.scene}"
        if misses:
            note += f", {worst.worst.get(name, '')}; {misses} of {len(measured)} missed"
        figures.append(
            Figure(
                *("quality", label, worst.metrics[name], unit),
                most=most,
                least=least,
                note=note,
                missed=misses > 0,
            )
        )
    return figures


def bounds(name: str) -> tuple[float | None, float | None]:
    """Return the least and the most that a figure may be, by the validation's own defaults."""
    bound = THRESHOLDS[name]
    if name == CLEARANCE:
        return 0.0, None
    return bound if isinstance(bound, tuple) else (None, bound)


def _badness(name: str, value: float) -> float:
    if name == CLEARANCE:
        return -value
    return abs(value - 1.0) if name == "root_travel_ratio" else value
