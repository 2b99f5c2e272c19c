"""Thresholds from texts, mappings and files, and what a wrong one is told."""

from __future__ import annotations

from pathlib import Path

import pytest
from test_validation import BOTH, build, check, standing

from mjmotion.exceptions import MotionError
from mjmotion.validation import THRESHOLDS, read_thresholds


def test_thresholds_from_texts_mappings_and_files(tmp_path: Path) -> None:
    texts = ["stance_drift_mm=2", "root_travel_ratio=0.9,1.1", "jerk_ratio_rms = none"]
    wanted = THRESHOLDS | {
        "stance_drift_mm": 2.0,
        "root_travel_ratio": (0.9, 1.1),
        "jerk_ratio_rms": None,
    }
    assert read_thresholds(texts) == wanted
    file = tmp_path / "limits.yaml"
    file.write_text(
        "stance_drift_mm: 2\nroot_travel_ratio: [0.9, 1.1]\njerk_ratio_rms: null\n", "utf-8"
    )
    assert read_thresholds(file) == wanted
    file.write_text("joint_limit_rad: 1e-3\n", "utf-8")
    assert read_thresholds(file)["joint_limit_rad"] == 1e-3
    assert read_thresholds({}) == THRESHOLDS


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("stance_drift=2", "Did you mean 'stance_drift_mm'"),
        ("stance_drift_mm", "name=value"),
        ("stance_drift_mm=", "name=value"),
        ("stance_drift_mm=soft", "not a number"),
        ("stance_drift_mm=1,2", "must be a number"),
        ("stance_drift_mm=nan", "not a number"),
        ("root_travel_ratio=1", "two numbers"),
        ("root_travel_ratio=2,1", "above"),
    ],
)
def test_bad_thresholds_say_why(text: str, message: str) -> None:
    with pytest.raises(MotionError, match=message):
        read_thresholds([text])


def test_bad_threshold_files_say_why(tmp_path: Path) -> None:
    with pytest.raises(MotionError, match="does not exist"):
        read_thresholds(tmp_path / "none.yaml")
    file = tmp_path / "bad.yaml"
    for text, message in (("[1, 2", "not YAML"), ("- 1\n", "map names"), ("a: 1\n", "unknown")):
        file.write_text(text, "utf-8")
        with pytest.raises(MotionError, match=message):
            read_thresholds(file)


def test_thresholds_given_to_validate_stay_with_the_result() -> None:
    model = build()
    qpos = standing(model)
    qpos[:, 2] += 0.003
    result = check(model, qpos, BOTH, thresholds={"stance_gap_max_mm": 4})
    assert result.broken() == []
    assert result.broken({}) == ["stance_gap_max_mm"]
    row = next(row for row in result.summary() if row.figure == "stance_gap_max_mm")
    assert (row.ok, row.unit, row.threshold) == (True, "mm", "≤ 4")
