"""What a motion must reach: a bound for each figure, settable by name.

thresholds = read_thresholds(["stance_drift_mm=2", "root_travel_ratio=0.9,1.1"])
validate(source, motion, contacts, thresholds=thresholds)
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path

from mjmotion.exceptions import MotionError, unknown_name

Threshold = float | tuple[float, float] | None

# An upper bound, or (lower, upper); None switches one off. Those of AT_LEAST are lower bounds;
# of a swing's clearance no more than half of the source's own is asked for.
THRESHOLDS: dict[str, Threshold] = {
    "stance_drift_mm": 1.0,
    "stance_gap_max_mm": 2.0,
    "stance_gap_hfield_p95_mm": 10.0,
    "sole_penetration_mm": 5.0,
    "obstacle_penetration_mm": 0.01,
    "swing_clearance_mm": 10.0,
    "joint_limit_rad": 1e-4,
    "jerk_ratio_rms": 1.3,
    "jerk_ratio_p999": 2.0,
    "root_travel_ratio": (0.97, 1.03),
    "trunk_back_deg": 5.0,
    "head_back_deg": 15.0,
    "stance_knee_bend_deg": 8.0,
    "self_overlap_mm": 10.0,
    "com_acceleration_ratio": 1.5,
    "contact_kept_percent": 90.0,
    "unexplained_more_points": 10.0,
    "mapping_bone_deg": 8.0,
    "mapping_bone_p95_deg": 20.0,
    "mapping_facing_deg": 10.0,
    "mapping_foot_turn_deg_s": 100.0,
    "mapping_foot_height_mm": 50.0,
}
AT_LEAST = frozenset({"swing_clearance_mm", "contact_kept_percent"})


def merge_thresholds(changes: Mapping[str, object] | None) -> dict[str, Threshold]:
    """Return the default thresholds with some of them replaced.

    Args:
      changes: name to a number, to a pair (lower, upper), or to None to switch one off.

    Raises:
      MotionError: unknown name, or a value of the wrong kind.
    """
    merged = dict(THRESHOLDS)
    for name, value in (changes or {}).items():
        if name not in THRESHOLDS:
            raise MotionError(unknown_name("threshold", str(name), THRESHOLDS))
        merged[name] = _checked(name, value)
    return merged


def read_thresholds(
    source: Mapping[str, object] | str | Path | Iterable[str],
) -> dict[str, Threshold]:
    """Return a full set of thresholds from a mapping, a YAML or JSON file, or ``name=value`` texts.

    In texts a pair is ``name=lower,upper`` and ``name=none`` switches a threshold off.

    Raises:
      MotionError: unknown name, a value that is no number, or a file that cannot be read.
    """
    if isinstance(source, Mapping):
        return merge_thresholds(source)
    if isinstance(source, (str, Path)):
        return merge_thresholds(_read_file(Path(source)))
    changes: dict[str, object] = {}
    for text in source:
        name, equals, value = text.partition("=")
        if not equals or not value.strip():
            raise MotionError(
                f"threshold '{text}' is not name=value: write for example stance_drift_mm=2"
            )
        parts = [part.strip() for part in value.split(",")]
        if parts[0].lower() in ("none", "null", "off") and len(parts) == 1:
            changes[name.strip()] = None
            continue
        try:
            numbers = [float(part) for part in parts]
        except ValueError as error:
            raise MotionError(
                f"threshold '{text}': '{value.strip()}' is not a number, nor two numbers"
            ) from error
        changes[name.strip()] = numbers[0] if len(numbers) == 1 else numbers
    return merge_thresholds(changes)


def _read_file(path: Path) -> Mapping[str, object]:
    from mjmotion.boundary.structured import read_structured

    content = read_structured(path, "thresholds file")
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise MotionError(f"thresholds file '{path}' must map names to numbers")
    return content


def _checked(name: str, value: object) -> Threshold:
    pair = isinstance(THRESHOLDS[name], tuple)
    if value is None:
        return None
    if pair and isinstance(value, (tuple, list)) and len(value) == 2:
        low, high = (_number(name, part) for part in value)
        if low > high:
            raise MotionError(
                f"threshold {name}: lower bound {low:g} is above upper bound {high:g}"
            )
        return low, high
    if pair:
        raise MotionError(f"threshold {name} is {value!r}: it takes two numbers, lower and upper")
    return _number(name, value)


def _number(name: str, value: object) -> float:
    # YAML 1.1 reads 1e-4 as text; what looks like a number is one.
    try:
        if isinstance(value, bool) or not isinstance(value, (int, float, str)):
            raise ValueError
        number = float(value)
    except ValueError as error:
        raise MotionError(f"threshold {name} is {value!r}: it must be a number") from error
    if math.isnan(number):
        raise MotionError(f"threshold {name} is not a number: leave it out, or give none")
    return number
