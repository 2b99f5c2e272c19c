"""The paper's four jobs beside Table 1, and what else its section 6 shows, with their targets."""

from __future__ import annotations

import dataclasses
import itertools

from benchmarks.figures import Print, print_figures
from benchmarks.quality import LABELS, MOCAP, bounds
from mjmotion.apps.retarget import retarget
from mjmotion.apps.rope import climb_rope
from mjmotion.apps.transition import join
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.exceptions import MotionError
from mjmotion.paper.figures import Figure
from mjmotion.paper.jobs import PAPER
from mjmotion.paper.table1 import run as run_table1
from mjmotion.validation import Validation, validate
from mjmotion.validation.figures import joint_jerk_ratio

BODIES, STRIDES = ("climber", "child"), ("keep", "scale")
CLIPS = ("walk", "02_01", "16_17")
CHAINS = (
    ("walk", "sneak", "walk"),
    ("02_01", "17_03", "02_01"),
    ("start", "straight", "turn_left", "turn_right", "stop"),
)
HELD = 5.0  # most distance of a held point from the rope [mm]
# Joint limits are clamped in the solvers: those are met by construction.
JUDGED = ("stance_drift_mm", "joint_limit_rad", "jerk_ratio_rms", "sole_penetration_mm")


def run(print_line: Print) -> list[Figure]:
    """Return all figures."""
    figures = []
    for part in (table1, rope, retargeting, joining):
        figures += print_figures(part(), print_line)
    return figures


def table1() -> list[Figure]:
    """Return the four jobs' sizes, errors, drift and jerk, and both solvers on the rope."""
    return run_table1(ablations=False).figures()


def rope() -> list[Figure]:
    """Return how the simulated rope is held, by both bodies."""
    climb = climb_rope("climber")
    figures = []
    for body, measured in (("humanoid", climb.original_figures), ("climber", climb.figures)):
        label = f"rope, {body}"
        figures += [
            Figure("paper", f"{label}: held points", measured.held_mm, "mm", most=HELD),
            Figure("paper", f"{label}: other parts, least", measured.free_mm, "mm", least=0.0),
        ]
    return figures


@dataclasses.dataclass
class Worst:
    """The worst figures of several results of one application.

    Attributes:
      application: name that stands before every figure.
      values: every figure that is judged: value and result, one a result.
      broken: results that miss a figure.
      count: number of results.
    """

    application: str
    values: dict[str, list[tuple[float, str]]] = dataclasses.field(
        default_factory=lambda: {name: [] for name in JUDGED}
    )
    broken: list[str] = dataclasses.field(default_factory=list)
    count: int = 0

    def add(self, result: str, validation: Validation, jerk_ratio: float | None = None) -> None:
        """Add a result; its jerk may be taken against something else than its source."""
        self.count += 1
        metrics = dict(validation.metrics)
        if jerk_ratio is not None:
            metrics["jerk_ratio_rms"] = jerk_ratio
        for name in JUDGED:
            self.values[name].append((metrics[name], result))
        if validation.broken():
            self.broken.append(result)

    def figures(self) -> list[Figure]:
        """Return how many results reach every figure, and the worst of each figure."""
        good = Figure(
            group="paper",
            name=f"{self.application}: figures all reached",
            value=float(self.count - len(self.broken)),
            unit=f"of {self.count}",
            least=float(self.count),
            note="; ".join(self.broken),
        )
        return [good, *(self._figure(name) for name in JUDGED)]

    def _figure(self, name: str) -> Figure:
        value, result = max(self.values[name])
        return Figure(
            group="paper",
            name=f"{self.application}: {LABELS[name].text}",
            value=value,
            unit=LABELS[name].unit,
            most=bounds(name)[1],
            note=result,
            listed=False if name == "joint_limit_rad" else None,
        )


def retargeting() -> list[Figure]:
    """Return the worst of walks on other bodies, strides kept and scaled."""
    worst = Worst("retarget")
    for clip, body, stride in itertools.product(CLIPS, BODIES, STRIDES):
        motion = _clip(clip)
        if motion is None:
            continue
        result = retarget(motion, body, stride=stride)
        validation = validate(result.source, result.motion, result.contacts)
        worst.add(f"{clip} to {body}, {stride}", validation)
    return worst.figures()


def joining() -> list[Figure]:
    """Return the worst of chains of clips; jerk over the clip that has most."""
    worst = Worst("join")
    nframe = 0  # of the paper's walk
    for chain in CHAINS:
        clips = [clip for clip in map(_clip, chain) if clip is not None]
        if len(clips) < len(chain):
            continue
        result = join(clips)
        validation = validate(result.source, result.motion, result.contacts)
        worst.add(" ".join(chain), validation, joint_jerk_ratio(result.motion, clips))
        if chain[0] == "start":
            nframe = result.motion.nframe
    wanted = PAPER["terrain"].nframe
    return [
        *worst.figures(),
        Figure(
            group="paper",
            name="join: frames of the paper's walk",
            value=float(nframe),
            most=wanted,
            least=wanted,
            listed=False,
        ),
    ]


def _clip(name: str) -> Motion | None:
    """Return a built-in clip or a recording; None where the recordings are not."""
    path = MOCAP / f"{name}.bvh"
    if path.is_file():
        return load_clip(path)
    try:
        return load_clip(name)
    except MotionError:
        return None
