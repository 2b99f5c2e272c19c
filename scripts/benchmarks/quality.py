"""Quality: every walk on every scene, all figures of the validation at its default thresholds.

The walks of :data:`TUNED` are those that the project was tuned on: what they reach is judged. Those
of :data:`HELD_BACK` are of other people: what they reach says how far that carries.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.figures import Print
from mjmotion.apps.adaptation import adapt
from mjmotion.body.motion import Motion
from mjmotion.clips import builtin_clips, load_clip
from mjmotion.exceptions import MotionError, frame_list
from mjmotion.paper.figures import Figure
from mjmotion.scene import Scene, load_scene
from mjmotion.validation import THRESHOLDS, Validation, validate
from mjmotion.validation.result import asked_clearance
from mjmotion.validation.thresholds import AT_LEAST

MOCAP = Path(__file__).parents[3] / "shared" / "mocap" / "bvh"
TUNED = (
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
# The first two takes of each of the eight other people in shared/mocap, by number, without 14_34,
# who climbs a ladder. Chosen by that rule, before any was measured; not to be tuned on.
HELD_BACK = (
    "05_02",
    "05_04",
    "09_02",
    "09_06",
    "127_05",
    "127_16",
    "14_21",
    "29_01",
    "35_12",
    "35_17",
    "49_01",
    "49_02",
    "91_17",
)
SCENES = ("terrain", "terrain_doors", "stairs", "slope", "blocks")
CLEARANCE = "swing_clearance_mm"


class Label(NamedTuple):
    """A figure's name in a row, its name at the head of a column, and its unit."""

    text: str
    short: str
    unit: str


LABELS = {
    "stance_drift_mm": Label("stance drift", "drift", "mm"),
    "stance_gap_max_mm": Label("stance gap, planes and steps", "gap", "mm"),
    "stance_gap_hfield_p95_mm": Label("stance gap, heightfields, p95", "gap p95", "mm"),
    "sole_penetration_mm": Label("sole penetration", "sole", "mm"),
    "obstacle_penetration_mm": Label("obstacle penetration", "obstacle", "mm"),
    CLEARANCE: Label("swing clearance over what is asked", "swing", "mm"),
    "joint_limit_rad": Label("joint limit excess", "limit", "rad"),
    "jerk_ratio_rms": Label("joint jerk over source, RMS", "jerk", ""),
    "jerk_ratio_p999": Label("joint jerk over source, p99.9", "jerk p99.9", ""),
    "root_travel_ratio": Label("root path over source", "travel", ""),
    "trunk_back_deg": Label("trunk further back than source", "trunk", "°"),
    "head_back_deg": Label("head further back than source", "head", "°"),
    "stance_knee_bend_deg": Label("stance knee more bent than source", "knee", "°"),
    "self_overlap_mm": Label("self-overlap beyond source", "overlap", "mm"),
    "com_acceleration_ratio": Label("centre-of-mass acceleration over source", "com acc", ""),
    "contact_kept_percent": Label("source's stance frames in contacts", "kept", "%"),
    "unexplained_more_points": Label(
        "unexplained force, more frames than source", "unexplained", "points"
    ),
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
        cells = " ".join(f"{self.metrics[name]:>11.3g}" for name in LABELS)
        lines = [f"{head} {'ok' if self.ok else 'MISSED':6} {cells} {self.seconds:6.2f} s"]
        for name in self.broken:
            where = self.worst.get(name, "")
            lines.append(f"{'':8}{LABELS[name].text} {self.metrics[name]:.4g}: {where}")
        return lines + [f"{'':8}not met: {text}" for text in self.unmet]

    def as_dict(self) -> dict[str, Any]:
        """Return the pair as data; no value is None."""
        metrics = {
            name: value if math.isfinite(value) else None for name, value in self.metrics.items()
        }
        seconds = None if math.isnan(self.seconds) else round(self.seconds, 3)
        return {**dataclasses.asdict(self), "metrics": metrics, "seconds": seconds, "ok": self.ok}


def header() -> str:
    """Return the head of the table of pairs."""
    cells = " ".join(f"{label.short:>11}" for label in LABELS.values())
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
    start = time.perf_counter()
    try:
        result = adapt(clip, scene)
        validation = validate(result.source, result.motion, result.contacts)
    except MotionError as error:
        return Pair(name, scene.name, {}, error=f"{type(error).__name__}: {error}")
    seconds = time.perf_counter() - start
    metrics = {figure: validation.metrics[figure] for figure in LABELS}
    metrics[CLEARANCE] = spare_clearance(validation)
    return Pair(
        clip=name,
        scene=scene.name,
        metrics=metrics,
        broken=tuple(validation.broken()),
        worst={
            figure: str(place) for figure, place in validation.worst.items() if figure in LABELS
        },
        unmet=tuple(
            f"{unmet.constraint}, {unmet.residual_mm:.1f} mm, frames {frame_list(unmet.frames)}"
            for unmet in result.unmet
        ),
        seconds=seconds,
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
    clips: Sequence[str], scenes: Sequence[str], print_line: Print
) -> tuple[list[Pair], list[str]]:
    """Measure every clip on every scene.

    Returns:
      the pairs, and what was skipped and why.
    """
    pairs: list[Pair] = []
    skipped: list[str] = []
    loaded = {name: load_scene(name) for name in scenes}
    print_line(header())
    for name in clips:
        source, why = find_clip(name)
        if why:
            skipped.append(f"{name}: {why}")
            print_line(f"  {name:16} skipped: {why}")
            continue
        try:
            clip = load_clip(source)
        except MotionError as error:
            pairs += [Pair(name, scene, {}, error=f"{error}") for scene in scenes]
            print_line(f"  {name:16} MISSED  {error}")
            continue
        for scene in loaded.values():
            pairs.append(measure(clip, scene, Path(name).stem))
            for line in pairs[-1].lines():
                print_line(line)
    return pairs, skipped


def summary(pairs: Sequence[Pair]) -> list[Figure]:
    """Return the worst of each figure over all pairs, with the number of misses."""
    figures = [
        Figure(
            group="quality",
            name="walks on scenes that reach every figure",
            value=float(sum(pair.ok for pair in pairs)),
            unit=f"of {len(pairs)}",
            least=float(len(pairs)),
            note="; ".join(f"no result: {p.clip} on {p.scene}" for p in pairs if p.error),
        )
    ]
    for name, label in LABELS.items():
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
                group="quality",
                name=label.text,
                value=worst.metrics[name],
                unit=label.unit,
                most=most,
                least=least,
                note=note,
                failed=misses > 0,
            )
        )
    return figures


def held_back_summary(pairs: Sequence[Pair]) -> Figure:
    """Return how many pairs that nothing was tuned on reach every figure; there is no target."""
    misses = Counter(LABELS[name].text for pair in pairs for name in pair.broken)
    misses.update("no result" for pair in pairs if pair.error)
    return Figure(
        group="quality",
        name="held back: pairs that reach every figure",
        value=float(sum(pair.ok for pair in pairs)),
        unit=f"of {len(pairs)}",
        note=", ".join(f"{label}: {count} missed" for label, count in misses.most_common()),
        listed=True,
    )


def bounds(name: str) -> tuple[float | None, float | None]:
    """Return the least and the most that a figure may be, by the validation's own defaults."""
    bound = THRESHOLDS[name]
    if name == CLEARANCE:
        return 0.0, None
    if name in AT_LEAST:
        assert isinstance(bound, float)
        return bound, None
    return bound if isinstance(bound, tuple) else (None, bound)


def _badness(name: str, value: float) -> float:
    if name in AT_LEAST:
        return -value
    return abs(value - 1.0) if name == "root_travel_ratio" else value
