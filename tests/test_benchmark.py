"""The benchmark's own functions, on one clip and scene each; no time is tested here."""

from __future__ import annotations

import dataclasses
import json
import math
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from made_up import some

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "scripts"))

import benchmark  # noqa: E402
import results_page  # noqa: E402
from benchmarks import levels, mink_ik, quality, speed, startup  # noqa: E402
from benchmarks.figures import markdown  # noqa: E402

from mjmotion.apps.adaptation import adapt  # noqa: E402
from mjmotion.clips import builtin_clips, load_clip  # noqa: E402
from mjmotion.exceptions import OutputError  # noqa: E402
from mjmotion.paper.figures import Figure  # noqa: E402
from mjmotion.paper.job import Job  # noqa: E402
from mjmotion.paper.jobs import PAPER  # noqa: E402
from mjmotion.paper.table1 import EXACT  # noqa: E402
from mjmotion.paper.terrain import make_job  # noqa: E402
from mjmotion.paper.timing import machine  # noqa: E402
from mjmotion.scene import Scene, load_scene  # noqa: E402
from mjmotion.validation import THRESHOLDS, validate  # noqa: E402


@pytest.fixture(scope="module")
def short_job() -> Job:
    return speed.select_frames(make_job(), np.arange(40))


@pytest.fixture
def no_ground(tmp_path: Path) -> Path:
    path = tmp_path / "island.xml"
    path.write_text(
        "<mujoco><worldbody><geom type='box' size='1 1 .1' pos='50 50 0'/></worldbody></mujoco>"
    )
    return path


def figure(value: float, **target: float) -> Figure:
    return Figure("speed", "some ratio", value, "x", **target)  # type: ignore[arg-type]


def test_verdicts() -> None:
    assert figure(24.9, most=25).verdict == "ok"
    assert figure(25.1, most=25).verdict == "MISSED"
    assert figure(9.9, least=10).verdict == "MISSED"
    assert figure(1.0, least=0.97, most=1.03).target == "0.97 to 1.03"
    assert figure(0.96, least=0.97, most=1.03).verdict == "MISSED"
    assert figure(math.inf, most=25).verdict == "MISSED"
    assert figure(3.0).verdict == ""
    assert figure(math.nan, most=25).verdict == "skipped"
    failed = dataclasses.replace(figure(math.nan, most=25), failed=True)
    assert failed.verdict == "MISSED"


def test_figures_are_strict_data() -> None:
    data = json.loads(json.dumps(figure(math.nan, most=25).as_dict(), allow_nan=False))
    assert data["value"] is None and data["verdict"] == "skipped"


def test_machine_names_no_paths() -> None:
    facts = machine()
    assert {"processor", "cores", "python", "mujoco"} <= set(facts)
    assert not any(value.startswith("/") or "\\" in value for value in facts.values())


def test_quality_says_what_the_validation_says() -> None:
    clip, scene = load_clip("straight"), load_scene("slope")
    pair = quality.measure(clip, scene, "straight")
    result = adapt(clip, scene)
    validation = validate(result.source, result.motion, result.contacts)
    assert pair.error == ""
    assert list(pair.broken) == validation.broken()
    assert set(pair.metrics) == set(THRESHOLDS)
    for name in set(THRESHOLDS) - {quality.CLEARANCE}:
        assert pair.metrics[name] == pytest.approx(validation.metrics[name], nan_ok=True)
    assert (pair.metrics[quality.CLEARANCE] >= 0) == validation.holds(quality.CLEARANCE)
    json.dumps(pair.as_dict(), allow_nan=False)


def test_bounds_are_the_validations_own() -> None:
    assert quality.bounds("contact_kept_percent") == (90.0, None)
    assert quality.bounds("trunk_back_deg") == (None, 5.0)
    assert quality.bounds(quality.CLEARANCE) == (0.0, None)
    assert quality.bounds("root_travel_ratio") == (0.97, 1.03)
    assert set(quality.LABELS) == set(THRESHOLDS)


def test_spare_clearance_is_that_of_the_worst_swing() -> None:
    swings = [
        {"clearance_mm": 12.0, "source_clearance_mm": 40.0},  # 10 asked, 2 spare
        {"clearance_mm": 3.0, "source_clearance_mm": 8.0},  # 4 asked, 1 lacking
    ]
    validation = SimpleNamespace(thresholds=dict(THRESHOLDS), per_swing=swings)
    assert quality.spare_clearance(validation) == pytest.approx(-1.0)  # type: ignore[arg-type]


def test_a_walk_that_cannot_pass_is_missed() -> None:
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[1, 1, 0.1], pos=[50.0, 50.0, 0.0])
    pair = quality.measure(load_clip("straight"), Scene.from_spec(spec, "island"), "straight")
    assert not pair.ok
    assert "SceneError" in pair.lines()[0] and "MISSED" in pair.lines()[0]
    assert quality.summary([pair])[0].ok is False


def test_summary_takes_the_worst_and_counts_misses() -> None:
    fine = dict.fromkeys(THRESHOLDS, 0.0) | {"root_travel_ratio": 1.0}
    bad = fine | {"stance_drift_mm": 3.0, quality.CLEARANCE: -2.0, "root_travel_ratio": 0.9}
    fine, bad = fine | {"contact_kept_percent": 95.0}, bad | {"contact_kept_percent": 91.0}
    pairs = [
        quality.Pair("walk", "slope", fine),
        quality.Pair(
            "walk",
            "stairs",
            bad,
            broken=("stance_drift_mm", quality.CLEARANCE, "root_travel_ratio"),
            worst={"stance_drift_mm": "frame 7, left_toe"},
        ),
    ]
    found = {entry.name: entry for entry in quality.summary(pairs)}
    assert found["walks on scenes that reach every figure"].value == 1
    drift = found["stance drift"]
    assert (drift.value, drift.verdict) == (3.0, "MISSED")
    assert "walk on stairs, frame 7, left_toe; 1 of 2 missed" in drift.note
    assert found["swing clearance over what is asked"].value == -2.0
    assert found["root path over source"].value == 0.9
    assert found["source's stance frames in contacts"].value == 91.0
    assert found["sole penetration"].verdict == "ok"


def test_what_is_held_back_is_of_other_people_and_a_row() -> None:
    people = [
        {name.partition("_")[0] for name in part} for part in (quality.TUNED, quality.HELD_BACK)
    ]
    assert not people[0] & people[1] and not set(quality.OTHER_SCENES) & set(quality.SCENES)
    assert len(people[1]) >= (len(people[0] | people[1]) - len(builtin_clips())) / 3
    fine = dict.fromkeys(THRESHOLDS, 0.0)
    pairs = [
        quality.Pair("a", "slope", fine),
        quality.Pair("b", "slope", fine, broken=("stance_drift_mm",)),
        quality.Pair("c", "slope", {}, error="SceneError: no way"),
    ]
    row = quality.share_summary("held back", pairs, least=90.0)
    assert (row.target, row.ok) == ("≥ 90", False) and row.value == pytest.approx(100.0 / 3.0)
    assert row.in_table and row.note.startswith("1 of 3; ")
    assert "stance drift: 1 missed" in row.note and "no result: 1 missed" in row.note


def test_scenes_of_other_seeds_are_found_by_name() -> None:
    for name in quality.OTHER_SCENES:
        assert quality.find_scene(name).model.ngeom > 0


def test_recordings_are_skipped_with_a_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quality, "MOCAP", ROOT / "nowhere")
    said: list[str] = []
    pairs, skipped = quality.run(["02_01"], ["slope"], said.append)
    assert pairs == []
    assert skipped and "not on this machine" in skipped[0]
    assert any("skipped" in line for line in said)


def test_tiled_copies_join(short_job: Job) -> None:
    many = speed.tile(short_job, 3)
    count = short_job.nframe
    assert many.nframe == 3 * count
    assert many.nscalar == 3 * short_job.nscalar
    step = np.abs(np.diff(short_job.guess, axis=0)).max()
    assert np.abs(np.diff(many.guess, axis=0)).max() <= step
    for few, all_of_them in zip(short_job.constraints, many.constraints, strict=True):
        tiled, own = some(all_of_them.position), some(few.position)
        assert np.array_equal(tiled[2 * count :], own)
        assert np.array_equal(tiled[count : 2 * count], own[::-1])


def test_levels_stand_beside_the_papers(short_job: Job) -> None:
    said: list[str] = []
    found = levels.run(short_job, said.append)
    assert len(said) == len(found)
    hybrid = [entry for entry in found if entry.name.startswith("hybrid: ") and entry.target]
    assert [entry.most for entry in hybrid] == [*PAPER["terrain"].max_error_percent, EXACT]
    assert not any(entry.in_table for entry in hybrid if entry.ok)  # Table 1 has them
    trace = short_job.fit("numeric").trace
    by_name = {entry.name: entry for entry in found}
    exact = by_name["numeric: after the exact pass"]
    assert exact.value == trace.exact_error_percent and exact.in_table


def test_mink_reaches_the_feet(short_job: Job) -> None:
    pytest.importorskip("mink", reason="mink is an extra")
    pytest.importorskip("daqp", reason="daqp is an extra")
    solved = mink_ik.make_solver(short_job)()
    assert solved.unconverged == ()
    assert solved.steps >= short_job.nframe
    theirs = short_job.motion.replace(solved.qpos)
    assert speed.foot_error(short_job, theirs) < 1000 * mink_ik.CLOSE
    untouched = speed.foot_error(short_job, short_job.motion)
    assert untouched > 1000 * mink_ik.CLOSE


def test_the_whole_command_writes_its_report(tmp_path: Path) -> None:
    startup.adapt("straight", tmp_path / "out", "flat")
    assert "<svg" in (tmp_path / "out" / "report.html").read_text("utf-8")
    with pytest.raises(subprocess.CalledProcessError):
        startup.adapt("straight", tmp_path / "out", "nowhere")


def test_a_miss_is_exit_code_1(
    no_ground: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "figures.json"
    words = ["--only", "quality", "--clips", "straight", "--scenes", str(no_ground)]
    assert benchmark.main([*words, "--json", str(out)]) == 1
    assert "MISSED" in capsys.readouterr().out
    data = json.loads(out.read_text("utf-8"))
    assert data["pairs"][0]["ok"] is False
    assert "held_back" not in data  # clips of one's own are measured alone


def test_an_unknown_scene_is_exit_code_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert benchmark.main(["--only", "quality", "--clips", "walk", "--scenes", "nowhere"]) == 2
    assert "nowhere" in capsys.readouterr().err


def test_a_part_does_not_replace_the_whole_table(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        benchmark.main(["--only", "cli", "--write"])
    assert "needs all parts" in capsys.readouterr().err


def test_the_page_gets_its_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "results.md"
    page.write_text("before\n<!-- benchmark -->old<!-- /benchmark -->\nafter\n", "utf-8")
    monkeypatch.setattr(results_page, "PAGE", page)
    exact = dataclasses.replace(figure(0.0, most=0.01), name="exact", listed=False)
    broken = dataclasses.replace(exact, name="not exact", value=1.0)
    found = [figure(31.0, most=25), figure(12.0, least=10), figure(5.0), exact, broken]
    results_page.write("benchmark", markdown(found), machine(), ("mujoco",))
    once = page.read_text("utf-8")
    assert once.startswith("before\n") and once.endswith("\nafter\n")
    assert "old" not in once and "mujoco" in once
    assert "| some ratio | 31 x | ≤ 25 | **MISSED** |" in once
    assert "| some ratio | 12 x | ≥ 10 | ok |" in once
    assert once.count("some ratio") == 2  # a figure without a target is not shown
    assert "| exact |" not in once  # nor one that holds by construction,
    assert "| not exact |" in once  # unless it does not
    results_page.write("benchmark", markdown(found), machine(), ("mujoco",))
    assert page.read_text("utf-8") == once


@pytest.mark.parametrize("text", ["no markers", "<!-- /benchmark --> <!-- benchmark -->"])
def test_a_page_without_markers_is_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str
) -> None:
    page = tmp_path / "results.md"
    page.write_text(text, "utf-8")
    monkeypatch.setattr(results_page, "PAGE", page)
    with pytest.raises(OutputError, match="no place for the table"):
        results_page.write("benchmark", "table", machine(), ("mujoco",))
    assert page.read_text("utf-8") == text


def test_the_results_are_complete() -> None:
    """What stands in docs/results.md was written by both scripts, all rows once."""
    text = results_page.PAGE.read_text("utf-8")
    for mark, row in (
        ("benchmark", "held back, other people: pairs that reach every figure"),
        ("table1", "exact pass: error [%]"),
    ):
        table = text.partition(f"<!-- {mark} -->")[2].partition(f"<!-- /{mark} -->")[0]
        assert f"| {row} |" in table and "Measured on: " in table
        labels = [line.split("|")[1] for line in table.splitlines() if line.startswith("| ")]
        assert len(labels) == len(set(labels))
