"""The paper's four jobs beside Table 1, and what else its section 6 shows, with their targets."""

from __future__ import annotations

import itertools
from collections.abc import Callable

from benchmarks.figures import Figure
from benchmarks.quality import MOCAP
from mjmotion.apps.retarget import retarget
from mjmotion.apps.rope import climb_rope
from mjmotion.apps.transition import join
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.exceptions import MotionError
from mjmotion.paper.table1 import DRIFT, EXACT, FASTER, JERK, REPEATS
from mjmotion.paper.table1 import run as run_table1
from mjmotion.validation import Validation, validate
from mjmotion.validation.figures import joint_jerk_ratio

JOBS = ("terrain", "rope", "morph", "transition")
BODIES, STRIDES = ("climber", "child"), ("keep", "scale")
CLIPS = ("walk", "02_01", "16_17")
CHAINS = (
    ("walk", "sneak", "walk"),
    ("02_01", "17_03", "02_01"),
    ("start", "straight", "turn_left", "turn_right", "stop"),
)
HELD = 5.0  # most distance of a held point from the rope [mm]


def run(say: Callable[[str], None]) -> list[Figure]:
    """Return all figures."""
    figures: list[Figure] = []
    for part in (table1, rope, retargeting, joining):
        for figure in part():
            say(figure.line())
            figures.append(figure)
    return figures


def table1() -> list[Figure]:
    """Return the four jobs' sizes, errors, drift and jerk, and both solvers on the rope."""
    from mjmotion.paper.jobs import PAPER

    found = run_table1(JOBS, repeats=REPEATS, ways=False)
    figures = []
    for name in JOBS:
        mine, column, paper = found.columns[name], found.columns[name].column, PAPER[name]
        for what in ("nframe", "ndof", "nreduced", "nscalar"):
            ours, theirs = getattr(column, what), getattr(paper, what)
            figures.append(Figure("paper", f"{name}: {what}", ours, most=theirs, least=theirs))
        for level, (error, most) in enumerate(
            zip(column.max_error_percent, paper.max_error_percent, strict=True), 1
        ):
            figures.append(Figure("paper", f"{name}: level {level}", error, "%", most=most))
        figures += [
            Figure("paper", f"{name}: exact", mine.exact_error_percent, "%", most=EXACT),
            Figure("paper", f"{name}: drift", mine.drift_mm, "mm", most=DRIFT),
            Figure("paper", f"{name}: joint jerk over source", mine.jerk_ratio, most=JERK),
        ]
    took = {
        solver.ik: solver.fit_seconds
        for solver in found.solvers
        if solver.job == found.columns["rope"].column.name
    }
    ratio = took["numeric"] / took["hybrid"]
    return [*figures, Figure("paper", "rope: numeric over hybrid", ratio, "x", least=FASTER)]


def rope() -> list[Figure]:
    """Return how the simulated rope is held, by both bodies."""
    climb = climb_rope("climber")
    figures = []
    for who, found in (("humanoid", climb.original_figures), ("climber", climb.figures)):
        figures += [
            Figure("paper", f"rope, {who}: held points", found.held_mm, "mm", most=HELD),
            Figure("paper", f"rope, {who}: other parts, least", found.free_mm, "mm", least=0.0),
        ]
    return figures


def retargeting() -> list[Figure]:
    """Return the worst of walks on other bodies, both ways of striding."""
    worst: dict[str, list[tuple[float, str]]] = {}
    broken, count = [], 0
    for clip, body, stride in itertools.product(CLIPS, BODIES, STRIDES):
        motion = _clip(clip)
        if motion is None:
            continue
        count += 1
        what = f"{clip} to {body}, {stride}"
        result = retarget(motion, body, stride=stride)
        measured = validate(result.source, result.motion, result.contacts)
        _collect(worst, measured, what)
        broken += [what] if measured.broken() else []
    return _worst(worst, "retarget", broken, count)


def joining() -> list[Figure]:
    """Return the worst of chains of clips; jerk over the clip that has most."""
    worst: dict[str, list[tuple[float, str]]] = {}
    broken, count = [], 0
    for chain in CHAINS:
        clips = [_clip(name) for name in chain]
        if any(clip is None for clip in clips):
            continue
        count += 1
        what = " ".join(chain)
        motions = [clip for clip in clips if clip is not None]
        result = join(motions)
        measured = validate(result.source, result.motion, result.contacts)
        _collect(worst, measured, what)
        worst["jerk_ratio_rms"][-1] = (joint_jerk_ratio(result.motion, motions), what)
        broken += [what] if measured.broken() else []
        if chain[0] == "start":
            size = result.motion.nframe
            worst["frames of the paper's walk"] = [(float(size), what)]
    frames = worst.pop("frames of the paper's walk")[0][0]
    return [
        *_worst(worst, "join", broken, count),
        Figure("paper", "join: frames of the paper's walk", frames, most=464, least=464),
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


def _collect(worst: dict[str, list[tuple[float, str]]], measured: Validation, what: str) -> None:
    for name in ("stance_drift_mm", "joint_limit_rad", "jerk_ratio_rms", "sole_penetration_mm"):
        worst.setdefault(name, []).append((measured.metrics[name], what))


def _worst(
    worst: dict[str, list[tuple[float, str]]], group: str, broken: list[str], count: int
) -> list[Figure]:
    bounds = {
        "stance_drift_mm": ("drift", "mm", DRIFT),
        "joint_limit_rad": ("joint limit excess", "rad", 1e-4),
        "jerk_ratio_rms": ("joint jerk", "", JERK),
        "sole_penetration_mm": ("sole penetration", "mm", 5.0),
    }
    figures = [
        Figure(
            "paper",
            f"{group}: figures all reached",
            float(count - len(broken)),
            f"of {count}",
            least=float(count),
            note="; ".join(broken),
        )
    ]
    for name, (label, unit, most) in bounds.items():
        value, where = max(worst[name])
        figures.append(Figure("paper", f"{group}: {label}", value, unit, most=most, note=where))
    return figures
