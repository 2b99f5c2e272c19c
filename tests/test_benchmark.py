"""The benchmark's own functions, on one clip and scene each; no time is tested here."""

from __future__ import annotations

import dataclasses
import json
import math
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
from benchmarks import figures, job, levels, mink_ik, quality, readme, speed  # noqa: E402

from mjmotion.apps.adaptation import adapt  # noqa: E402
from mjmotion.clips import load_clip  # noqa: E402
from mjmotion.scene import Scene, load_scene  # noqa: E402
from mjmotion.validation import THRESHOLDS, validate  # noqa: E402


@pytest.fixture(scope="module")
def terrain_job() -> job.Job:
    return job.make_job()


@pytest.fixture(scope="module")
def short_job(terrain_job: job.Job) -> job.Job:
    frames = np.arange(40)
    return job.Job(
        terrain_job.source.replace(terrain_job.source.qpos[frames]),
        tuple(job._take(constraint, frames) for constraint in terrain_job.constraints),
        terrain_job.root_shift[frames],
    )


@pytest.fixture
def no_ground(tmp_path: Path) -> Path:
    path = tmp_path / "island.xml"
    path.write_text(
        "<mujoco><worldbody><geom type='box' size='1 1 .1' pos='50 50 0'/></worldbody></mujoco>"
    )
    return path


def figure(value: float, **target: float) -> figures.Figure:
    return figures.Figure("speed", "some ratio", value, "x", **target)  # type: ignore[arg-type]


def test_verdicts() -> None:
    assert figure(24.9, most=25).verdict == "ok"
    assert figure(25.1, most=25).verdict == "MISSED"
    assert figure(9.9, least=10).verdict == "MISSED"
    assert figure(1.0, least=0.97, most=1.03).target == "0.97 to 1.03"
    assert figure(0.96, least=0.97, most=1.03).verdict == "MISSED"
    assert figure(math.inf, most=25).verdict == "MISSED"
    assert figure(3.0).verdict == ""
    assert figure(math.nan, most=25).verdict == "skipped"
    failed = dataclasses.replace(figure(math.nan, most=25), missed=True)
    assert failed.verdict == "MISSED"


@pytest.mark.parametrize("value", [3.25, math.nan])
def test_figures_as_data_come_back(value: float) -> None:
    kept = figure(value, most=25)
    data = json.loads(json.dumps(kept.as_dict(), allow_nan=False))
    again = figures.Figure.from_dict(data)
    assert again.line() == kept.line()
    assert again.ok == kept.ok


def test_tasks_take_turns() -> None:
    order: list[str] = []
    tasks = {name: (lambda name=name: order.append(name)) for name in "ab"}
    took = figures.interleaved(tasks, 3)
    assert order == list("ab") * 4
    assert set(took) == {"a", "b"}


def test_machine_names_no_paths() -> None:
    facts = figures.machine()
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
    pairs = [
        quality.Pair("walk", "slope", fine),
        quality.Pair(
            *("walk", "stairs", bad),
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
    assert found["sole penetration"].verdict == "ok"


def test_recordings_are_skipped_with_a_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quality, "MOCAP", ROOT / "nowhere")
    said: list[str] = []
    pairs, skipped = quality.run(["02_01"], ["slope"], said.append)
    assert pairs == []
    assert skipped and "not on this machine" in skipped[0]
    assert any("skipped" in line for line in said)


def test_the_job_is_the_papers(terrain_job: job.Job) -> None:
    assert terrain_job.source.nframe == job.NFRAME
    assert job.size(terrain_job.constraints) == job.NSCALAR
    assert terrain_job.guess[:, :3] == pytest.approx(
        terrain_job.source.qpos[:, :3] + terrain_job.root_shift
    )


def test_tiled_copies_join(short_job: job.Job) -> None:
    many = short_job.tiled(3)
    count = short_job.source.nframe
    assert many.source.nframe == 3 * count
    assert job.size(many.constraints) == 3 * job.size(short_job.constraints)
    step = np.abs(np.diff(short_job.guess, axis=0)).max()
    assert np.abs(np.diff(many.guess, axis=0)).max() <= step
    for few, all_of_them in zip(short_job.constraints, many.constraints, strict=True):
        assert np.array_equal(some(all_of_them.position)[2 * count :], some(few.position))
        assert np.array_equal(
            some(all_of_them.position)[count : 2 * count], some(few.position)[::-1]
        )


def test_levels_stand_beside_the_papers(short_job: job.Job) -> None:
    said: list[str] = []
    found = levels.run(short_job, said.append)
    assert len(said) == len(found)
    aimed = [entry.most for entry in found if entry.name.startswith("hybrid: ") and entry.target]
    assert aimed == [*levels.PAPER, levels.EXACT]
    trace = short_job.fit("numeric").trace
    by_name = {entry.name: entry.value for entry in found}
    assert by_name["numeric: after the exact pass"] == trace.exact_error_percent
    assert found[0].ok is False  # 40 frames are not the paper's 464


def test_mink_reaches_the_feet(short_job: job.Job) -> None:
    pytest.importorskip("mink", reason="mink is an extra")
    pytest.importorskip("daqp", reason="daqp is an extra")
    solved = mink_ik.make_solver(short_job)()
    assert solved.unconverged == ()
    assert solved.steps >= short_job.source.nframe
    theirs = short_job.source.replace(solved.qpos)
    assert speed.foot_error(short_job, theirs) < 1000 * mink_ik.CLOSE
    untouched = speed.foot_error(short_job, short_job.source)
    assert untouched > 1000 * mink_ik.CLOSE


def test_a_miss_is_exit_code_1(
    no_ground: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "figures.json"
    words = ["--only", "quality", "--clips", "straight", "--scenes", str(no_ground)]
    assert benchmark.main([*words, "--json", str(out)]) == 1
    assert "MISSED" in capsys.readouterr().out
    data = json.loads(out.read_text("utf-8"))
    assert data["pairs"][0]["ok"] is False


def test_an_unknown_scene_is_exit_code_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert benchmark.main(["--only", "quality", "--scenes", "nowhere"]) == 2
    assert "nowhere" in capsys.readouterr().err


def test_the_readme_gets_its_table(tmp_path: Path) -> None:
    results, page = tmp_path / "figures.json", tmp_path / "README.md"
    found = [figure(31.0, most=25), figure(12.0, least=10), figure(5.0)]
    data = {"machine": figures.machine(), "figures": [entry.as_dict() for entry in found]}
    results.write_text(json.dumps(data), "utf-8")
    page.write_text(f"before\n{readme.BEGIN}old{readme.END}\nafter\n", "utf-8")
    readme.rewrite(page, results)
    once = page.read_text("utf-8")
    assert once.startswith("before\n") and once.endswith("\nafter\n")
    assert "old" not in once.partition(readme.BEGIN)[2]
    assert "| some ratio | 31 x | ≤ 25 | **MISSED** |" in once
    assert "| some ratio | 12 x | ≥ 10 | ok |" in once
    assert once.count("some ratio") == 2  # a figure without a target is not shown
    readme.rewrite(page, results)
    assert page.read_text("utf-8") == once


@pytest.mark.parametrize("text", ["no markers", f"{readme.END} {readme.BEGIN}"])
def test_a_readme_without_markers_is_left_alone(tmp_path: Path, text: str) -> None:
    results, page = tmp_path / "figures.json", tmp_path / "README.md"
    results.write_text(json.dumps({"machine": figures.machine(), "figures": []}), "utf-8")
    page.write_text(text, "utf-8")
    with pytest.raises(readme.ReadmeError, match="no place for the table"):
        readme.rewrite(page, results)
    assert page.read_text("utf-8") == text
