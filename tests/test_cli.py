"""The command line, through a subprocess as a user runs it: good input and bad."""

from __future__ import annotations

import inspect
import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from mjmotion.body.motion import Motion
from mjmotion.cli import main as cli
from mjmotion.cli.scene import SCENES as SCENE_KINDS
from mjmotion.clips import load_clip
from mjmotion.exceptions import OutputError, RenderError
from mjmotion.output.folder import check_output, result_folder
from mjmotion.output.reading import read_results
from mjmotion.output.video import ensure_gl
from mjmotion.scene import BUILDERS

FRAMES = 100
FILES = {"motion.npz", "source.npz", "model.xml", "contacts.json", "report.json", "report.html"}


def run(*words: object, timeout: float = 120.0) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "mjmotion", *map(str, words)],
        capture_output=True,
        text=True,
        timeout=timeout,
    )


def tree(folder: Path) -> dict[str, bytes]:
    """Every file under a folder, hidden ones too, with its contents."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def cut(motion: Motion, frames: int) -> Motion:
    return motion.replace(motion.qpos[:frames])


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The beginning of the built-in walk as a motion file."""
    path = tmp_path_factory.mktemp("clip") / "walk.npz"
    cut(load_clip("walk"), FRAMES).save(path)
    return path


@pytest.fixture(scope="module")
def result(walk: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """That clip adapted to stairs; tests may read the folder, not change it."""
    out = tmp_path_factory.mktemp("result") / "deep" / "er" / "walk"
    done = run("adapt", walk, "--scene", "stairs", "--out", out, "--no-video")
    assert done.returncode in (0, 1), done.stderr
    assert "Traceback" not in done.stderr
    return out


# Help


def test_help_is_quick_and_needs_no_mujoco() -> None:
    code = "import sys, mjmotion.cli.main as c; c._parser().format_help(); print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout
    assert "mjmotion.cli.main" in loaded.split()
    assert {f"mjmotion.cli.{name.replace('-', '_')}" for name in cli.COMMANDS} <= set(
        loaded.split()
    )
    assert not {"mujoco", "numpy"} & set(loaded.split())
    times = []
    for _ in range(3):
        start = time.perf_counter()
        assert run("--help").returncode == 0
        times.append(time.perf_counter() - start)
    assert min(times) < 0.5


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_help_shows_an_example_that_parses(command: str) -> None:
    done = run(command, "--help")
    assert done.returncode == 0
    assert not done.stderr
    example = done.stdout.split("example: ")[1].strip()
    assert example.startswith(f"mjmotion {command}")
    assert cli.parse(example.split()[1:]).command == command


def test_scene_options_are_those_of_the_builders() -> None:
    assert SCENE_KINDS.keys() == BUILDERS.keys()
    for kind, (_, options) in SCENE_KINDS.items():
        parameters = inspect.signature(BUILDERS[kind]).parameters
        assert options.keys() <= parameters.keys(), kind


# Good input


def test_adapt_writes_the_files_that_were_promised(result: Path) -> None:
    names = {path.name for path in result.iterdir()}
    assert names >= FILES
    assert "video.mp4" not in names
    assert list(result.parent.iterdir()) == [result]  # nothing aside was left

    model = mujoco.MjModel.from_xml_path(str(result / "model.xml"))
    assert model.nv == 45
    with np.load(result / "motion.npz", allow_pickle=False) as data:
        nframe = len(data["qpos"])
        assert data["qpos"].shape == (nframe, model.nq)
        assert data["qpos"].dtype == np.float64
        assert float(data["fps"]) == 30.0
        assert len(data["joint_names"]) == model.njnt
    source = Motion.load(result / "source.npz", model)
    assert source.nframe == nframe
    # Climbing takes longer than the clip, which is there in its own time too.
    assert Motion.load(result / "recording.npz", model).nframe == FRAMES < nframe

    contacts = json.loads((result / "contacts.json").read_text("utf-8"))
    assert contacts
    for contact in contacts:
        assert contact.keys() == {"site", "start", "end"}
        assert 0 <= contact["start"] < contact["end"] <= nframe

    report = json.loads((result / "report.json").read_text("utf-8"))
    assert report["fit_seconds"] > 0
    assert report["metrics"]["stance_drift_mm"] >= 0
    for number, level in enumerate(report["levels"], start=1):
        assert level["level"] == number
        assert level.keys() >= {"frames_per_knot", "seconds", "max_error_percent"}
    assert "<html" in (result / "report.html").read_text("utf-8").lower()


def test_adapt_changed_the_motion(result: Path) -> None:
    results = read_results(result)
    rise = results.motion.qpos[:, 2] - results.source.qpos[:, 2]
    assert np.abs(rise).max() > 0.05  # it went up stairs


def test_force_replaces_and_a_broken_threshold_is_exit_1(walk: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ("adapt", walk, "--scene", "flat", "--out", out, "--no-video")
    assert run(*words).returncode in (0, 1)
    before = tree(out)
    expect_error(run(*words), str(out), "--force")
    assert tree(out) == before
    (out / "report.html").write_text("old", "utf-8")
    done = run(*words, "--force", "--threshold", "stance_drift_mm=-1")
    assert done.returncode == 1
    assert "stance_drift_mm" in done.stderr
    assert {path.name for path in out.iterdir()} >= FILES  # the output is written all the same
    assert (out / "report.html").read_text("utf-8") != "old"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


OFF = [
    f"--threshold={name}=none"
    for name in ("jerk_ratio_rms", "jerk_ratio_p999", "root_travel_ratio", "swing_clearance_mm")
]


def test_a_constraint_of_the_user_s_that_is_not_met_is_exit_1(walk: Path, tmp_path: Path) -> None:
    wishes = tmp_path / "wishes.yaml"
    # A hand turned further than a wrist goes: no threshold asks after it.
    wishes.write_text("- {site: left_hand, frames: [40, 44], quat: [0, 1, 0, 0]}\n", "utf-8")
    words = ("adapt", walk, "--scene", "flat", "--no-video", *OFF)
    done = run(*words, "--out", tmp_path / "without")
    assert done.returncode == 0, done.stderr
    done = run(*words, "--out", tmp_path / "with", "--constraints", wishes)
    assert done.returncode == 1, done.stderr
    assert "your constraint is not met: orientation of left_hand at frames 40" in done.stderr
    assert "threshold broken" not in done.stderr
    report = json.loads((tmp_path / "with" / "report.json").read_text("utf-8"))
    (missed,) = report["unmet"]
    assert missed["source"] == "user" and missed["index"] == 0
    assert missed["frames"] == [40, 41, 42, 43] and missed["residual_deg"] > 1
    assert "your own" in (tmp_path / "with" / "report.html").read_text("utf-8")


def test_all_options_are_taken(walk: Path, result: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    wishes = tmp_path / "wishes.yaml"
    wishes.write_text("- {site: left_hand, frames: [40, 44], position: [1.0, 0.3, 1.0]}\n", "utf-8")
    # contacts.json is in the motion's time, plan.json has the clip's.
    plan = json.loads((result / "plan.json").read_text("utf-8"))
    own = write(tmp_path / "own.json", json.dumps(plan["contacts"]))
    given = ("--contacts", own, "--constraints", wishes)
    settings = ("--levels", "8,4", "--tolerance", "0.5", "--ik", "numeric")
    words = (*given, *settings, "--character", "humanoid")
    done = run("adapt", walk, "--scene", "stairs", "--out", out, "--no-video", *words)
    assert done.returncode in (0, 1), done.stderr
    again = json.loads((out / "contacts.json").read_text("utf-8"))
    assert again == json.loads((result / "contacts.json").read_text("utf-8"))
    report = json.loads((out / "report.json").read_text("utf-8"))
    assert [level["frames_per_knot"] for level in report["levels"]][:2] == [8.0, 4.0]


def test_validate_prints_the_table_and_rewrites_the_report(result: Path, tmp_path: Path) -> None:
    import shutil

    folder = tmp_path / "copy"
    shutil.copytree(result, folder)
    old = json.loads((folder / "report.json").read_text("utf-8"))
    (folder / "report.html").unlink()
    done = run("validate", folder, "--threshold", "stance_drift_mm=-1")
    assert done.returncode == 1
    assert "stance drift" in done.stdout
    assert "stance_drift_mm" in done.stderr
    new = json.loads((folder / "report.json").read_text("utf-8"))
    assert new["levels"] == old["levels"]
    assert new["fit_seconds"] == old["fit_seconds"]
    assert new["metrics"].keys() == old["metrics"].keys()
    for name, value in old["metrics"].items():
        if value is None:
            assert new["metrics"][name] is None, name
        else:
            assert new["metrics"][name] == pytest.approx(value, rel=1e-6, abs=1e-9), name
    assert (folder / "report.html").is_file()

    # A motion that is spoilt is found out.
    spoilt = Motion.load(folder / "motion.npz", read_results(folder).model)
    qpos = np.array(spoilt.qpos)
    qpos[50:, 0] += 0.2
    spoilt.replace(qpos).save(folder / "motion.npz")
    done = run("validate", folder)
    assert done.returncode == 1
    assert "stance_drift_mm" in done.stderr


def test_render_a_result_and_a_motion_file(result: Path, tmp_path: Path) -> None:
    try:
        ensure_gl()
    except RenderError as error:
        pytest.skip(str(error))
    video = tmp_path / "both.mp4"
    done = run("render", result, "--out", video, "--size", "192x128")
    assert done.returncode == 0, done.stderr
    assert video.stat().st_size > 2000
    assert run("render", result, "--out", video, "--size", "192x128").returncode == 2
    one, short = tmp_path / "one.mp4", tmp_path / "short.npz"
    cut(read_results(result).motion, 8).save(short)
    done = run("render", short, "--model", result / "model.xml", "--out", one, "--size", "128x128")
    assert done.returncode == 0, done.stderr
    assert one.is_file()


def test_info_of_everything(walk: Path, result: Path) -> None:
    nframe = read_results(result).motion.nframe
    wanted = {
        str(walk): (f"{FRAMES} at 30 fps", "left_heel", "travel"),
        "walk": ("464 at 30 fps", "contacts"),
        "humanoid": ("1.75 m", "left_heel"),
        "stairs": ("plane", "box"),
        "terrain": ("heightfield",),
        str(result): ("stance_drift_mm", "box", f"{nframe} at 30 fps"),
        str(result / "model.xml"): ("left_heel", "box"),
    }
    for what, words in wanted.items():
        done = run("info", what)
        assert done.returncode == 0, done.stderr
        for word in words:
            assert word in done.stdout, (what, word)


@pytest.mark.parametrize("kind", [kind for kind in BUILDERS if kind != "heights"])
def test_scene_makes_what_mujoco_loads(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "new" / f"{kind}.xml"
    done = run("scene", kind, "--out", path)
    assert done.returncode == 0, done.stderr
    assert mujoco.MjModel.from_xml_path(str(path)).ngeom > 0
    assert run("scene", kind, "--out", path).returncode == 2
    assert run("scene", kind, "--out", path, "--force").returncode == 0


def test_scene_options_reach_the_builder(tmp_path: Path) -> None:
    stairs, doors = tmp_path / "stairs.xml", tmp_path / "doors.xml"
    assert run("scene", "stairs", "--steps", 2, "--rise", 0.2, "--out", stairs).returncode == 0
    model = mujoco.MjModel.from_xml_path(str(stairs))
    boxes = model.geom_type == mujoco.mjtGeom.mjGEOM_BOX
    assert (model.geom_pos[boxes, 2] + model.geom_size[boxes, 2]).max() == pytest.approx(0.4)
    assert run("scene", "doors", "--door", "x=2,width=0.7", "--out", doors).returncode == 0
    model = mujoco.MjModel.from_xml_path(str(doors))
    gap = abs(model.geom("door1_left_post").pos[1] - model.geom("door1_right_post").pos[1])
    assert gap == pytest.approx(0.8)
    heights = tmp_path / "heights.npy"
    np.save(heights, np.linspace(0.0, 0.5, 30)[:, None] * np.ones((1, 60)))
    out = tmp_path / "ground.xml"
    assert run("scene", "heights", heights, "--cell", 0.1, "--out", out).returncode == 0
    assert mujoco.MjModel.from_xml_path(str(out)).nhfield == 1


# Bad input

BVH = """HIERARCHY
ROOT thing
{{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT other
  {{
    OFFSET 0 10 0
    CHANNELS {channels} Zrotation Xrotation Yrotation
    End Site
    {{
      OFFSET 0 10 0
    }}
  }}
}}
MOTION
Frames: {frames}
Frame Time: 0.0333333
"""
ROW = "0 90 0 1 2 3 4 5 6\n"
BODY = "<mujoco><worldbody>{}</worldbody></mujoco>"


def write(path: Path, text: str) -> Path:
    path.write_text(text, "utf-8")
    return path


def bvh(rows: str, *, frames: int, channels: int = 3) -> Callable[[Path], Path]:
    text = BVH.format(frames=frames, channels=channels) + rows
    return lambda folder: write(folder / "clip.bvh", text)


def short_clip(folder: Path) -> Path:
    path = folder / "walk.npz"
    cut(load_clip("walk"), 90).save(path)
    return path


def nan_clip(folder: Path) -> Path:
    motion = cut(load_clip("walk"), 60)
    qpos = np.array(motion.qpos)
    qpos[7, 3] = np.nan
    path = folder / "walk.npz"
    np.savez(path, qpos=qpos, fps=30.0, joint_names=np.array(motion.joint_names))
    return path


CLIPS: dict[str, tuple[Callable[[Path], object], tuple[str, ...]]] = {
    "missing file": (lambda folder: folder / "no.bvh", ("no.bvh", "does not exist")),
    "unknown name": (lambda folder: "wakl", ("'walk'",)),
    "unknown kind of file": (lambda folder: write(folder / "clip.c3d", "x"), ("clip.c3d", ".bvh")),
    "empty file": (lambda folder: write(folder / "clip.bvh", ""), ("clip.bvh", "empty")),
    "truncated in the hierarchy": (
        lambda folder: write(folder / "clip.bvh", BVH.format(frames=1, channels=3)[:120]),
        ("clip.bvh", "cut off"),
    ),
    "truncated in the frames": (bvh(ROW * 3, frames=50), ("clip.bvh", "3 of its 50")),
    "truncated in a row": (bvh(ROW * 3 + "0 90\n", frames=4), ("frame 3", "9 channels")),
    "wrong channel count": (bvh(ROW * 3, frames=3, channels=6), ("clip.bvh", "CHANNELS")),
    "too many values": (bvh("0 " + ROW, frames=1), ("10 values", "9 channels")),
    "not a number": (bvh(ROW + ROW.replace("4", "nan"), frames=2), ("clip.bvh", "frames 1")),
    "no frames": (bvh("", frames=0), ("clip.bvh", "no frames")),
    "skeleton that cannot be mapped": (bvh(ROW * 40, frames=40), ("clip.bvh", "mapping")),
    "motion file with NaN": (nan_clip, ("frames 7",)),
    "motion file that is text": (lambda folder: write(folder / "a.npz", "x"), ("a.npz",)),
}


def expect_error(done: subprocess.CompletedProcess[str], *words: str) -> None:
    """Exit code 2 and exactly one line on stderr that says what is wrong."""
    assert done.returncode == 2, (done.returncode, done.stdout, done.stderr)
    lines = done.stderr.splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("mjmotion: error: ")
    for word in words:
        assert word in lines[0], lines[0]


def refuse(
    tmp_path: Path, clip: object, scene: object, words: tuple[str, ...], *more: object
) -> None:
    """Adapting fails with one line, and leaves no file that was not there before."""
    before = tree(tmp_path)
    folders = {path for path in tmp_path.rglob("*") if path.is_dir()}
    out = tmp_path / "deep" / "out"
    expect_error(run("adapt", clip, "--scene", scene, "--out", out, "--no-video", *more), *words)
    assert tree(tmp_path) == before
    assert {path for path in tmp_path.rglob("*") if path.is_dir()} == folders


@pytest.mark.parametrize("case", CLIPS)
def test_bad_clip(case: str, tmp_path: Path) -> None:
    make, words = CLIPS[case]
    refuse(tmp_path, make(tmp_path), "flat", words)


SCENES: dict[str, tuple[str | None, tuple[str, ...]]] = {
    "unknown name": (None, ("'stairs'",)),
    "not XML": ("<mujoco><worldbody>", ("scene.xml", "XML")),
    "does not compile": (BODY.format('<geom type="box"/>'), ("scene.xml",)),
    "nothing in it": (BODY.format(""), ("ground",)),
    "ground elsewhere": (
        BODY.format('<geom type="box" size="1 1 .1" pos="50 0 0"/>'),
        ("ground",),
    ),
    "door too low": (
        BODY.format(
            '<geom type="plane" size="0 0 1"/>'
            '<geom name="beam" type="box" size=".1 30 1.5" pos="1 0 1.9"/>'
        ),
        ("there is no way: lintel 'beam' bars it",),
    ),
}


@pytest.mark.parametrize("case", SCENES)
def test_bad_scene(case: str, tmp_path: Path) -> None:
    text, words = SCENES[case]
    scene = "stiars" if text is None else write(tmp_path / "scene.xml", text)
    refuse(tmp_path, short_clip(tmp_path), scene, words, "--strict", "--path", "keep")


FILES_GIVEN: dict[str, tuple[str, str, tuple[str, ...]]] = {
    "contacts past the end": (
        "--contacts",
        '[{"site": "left_heel", "start": 10, "end": 900}]',
        ("left_heel", "900"),
    ),
    "contacts at an unknown site": (
        "--contacts",
        '[{"site": "left_heal", "start": 10, "end": 20}]',
        ("left_heel",),
    ),
    "contacts that are no JSON": ("--contacts", "[{", ("given.json",)),
    "contacts without an end": ("--contacts", '[{"site": "left_heel", "start": 3}]', ("end",)),
    "constraint at an unknown site": (
        "--constraints",
        '[{"site": "nose", "frames": [1, 2], "position": [0, 0, 1]}]',
        ("nose",),
    ),
    "constraint past the end": (
        "--constraints",
        '[{"site": "left_hand", "frames": [50, 99], "position": [0, 0, 1]}]',
        ("given.json", "[50, 99]", "90"),
    ),
    "constraint of an unknown kind": (
        "--constraints",
        '[{"site": "left_hand", "frames": [1, 2], "positoin": [0, 0, 1]}]',
        ("positoin",),
    ),
}


@pytest.mark.parametrize("case", FILES_GIVEN)
def test_bad_file_given(case: str, tmp_path: Path) -> None:
    option, text, words = FILES_GIVEN[case]
    given = write(tmp_path / "given.json", text)
    refuse(tmp_path, short_clip(tmp_path), "flat", words, option, given)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), ("COMMAND",)),
        (("adpat",), ("adpat", "adapt")),
        (("adapt", "walk"), ("--scene", "--out")),
        (("adapt", "walk", "--scene", "flat", "--out", "x", "--levels", "16,a"), ("16,a",)),
        (("adapt", "walk", "--scene", "flat", "--out", "x", "--tolerance", "-1"), ("-1",)),
        (("adapt", "walk", "--scene", "flat", "--out", "x", "--ik", "magic"), ("hybrid",)),
        (("adapt", "walk", "--scene", "flat", "--out", "x", "--threshold", "drift=1"), ("drift",)),
        (("adapt", "walk", "--scene", "flat", "--out", "x", "--character", "human"), ("humanoid",)),
        (("adapt", "walk", "--scene", "flat", "--out", "x", "--contacts", "no.json"), ("no.json",)),
        (("validate", "no/such/folder"), ("no/such/folder",)),
        (("render", "no/such/folder"), ("no/such/folder",)),
        (("render", "no.npz", "--size", "10x10"), ("10x10",)),
        (("info", "no/such/file.bvh"), ("no/such/file.bvh",)),
        (("info", "wakl"), ("'walk'",)),
        (("scene", "stairs", "--rise", "-1", "--out", "x.xml"), ("rise",)),
        (("scene", "stairs", "--out", "x.png"), (".xml",)),
        (("scene", "doors", "--door", "width=1", "--out", "x.xml"), ("width=1",)),
        (("scene", "heights", "no.npy", "--out", "x.xml"), ("no.npy",)),
    ],
    ids=lambda value: "-".join(value[:2]) if value else "nothing",
)
def test_bad_words(words: tuple[str, ...], said: tuple[str, ...], tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "mjmotion", *words], capture_output=True, text=True, cwd=tmp_path
    )
    expect_error(done, *said)
    assert not list(tmp_path.iterdir())


def test_out_that_cannot_be_written(walk: Path, tmp_path: Path) -> None:
    # Root may write anywhere, but not even root a folder under a file.
    file = write(tmp_path / "file", "mine")
    for out in (file, file / "under"):
        done = run("adapt", walk, "--scene", "flat", "--out", out, "--no-video")
        expect_error(done, str(file))
    assert tree(tmp_path) == {"file": b"mine"}


def test_force_does_not_replace_a_folder_of_other_things(walk: Path, tmp_path: Path) -> None:
    write(tmp_path / "thesis.txt", "mine")
    done = run("adapt", walk, "--scene", "flat", "--out", tmp_path, "--no-video", "--force")
    expect_error(done, str(tmp_path))
    assert tree(tmp_path) == {"thesis.txt": b"mine"}


@pytest.mark.parametrize("name", ["motion.npz", "model.xml", "contacts.json", "report.json"])
def test_damaged_result(name: str, result: Path, tmp_path: Path) -> None:
    import shutil

    folder = tmp_path / "copy"
    shutil.copytree(result, folder)
    (folder / name).write_bytes((folder / name).read_bytes()[:40])
    expect_error(run("validate", folder), name)
    if name != "report.json":
        (folder / name).unlink()
        expect_error(run("validate", folder), name)


# The folder that appears whole or not at all


@pytest.mark.parametrize("error", [OutputError("no"), KeyboardInterrupt(), SystemExit(1)])
def test_a_failure_leaves_nothing(error: BaseException, tmp_path: Path) -> None:
    with pytest.raises(type(error)), result_folder(tmp_path / "a" / "b") as folder:
        (folder / "half.txt").write_text("half", "utf-8")
        raise error
    assert not list(tmp_path.iterdir())


def test_a_failure_keeps_earlier_results(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    for name in ("motion.npz", "model.xml"):
        write(out / name, "old")
    with pytest.raises(ValueError, match="no"), result_folder(out, force=True) as folder:
        write(folder / "motion.npz", "new")
        raise ValueError("no")
    assert tree(tmp_path) == {"out/model.xml": b"old", "out/motion.npz": b"old"}
    with result_folder(out, force=True) as folder:
        write(folder / "motion.npz", "new")
    assert tree(tmp_path) == {"out/motion.npz": b"new"}


def test_an_empty_folder_may_be_filled(tmp_path: Path) -> None:
    check_output(tmp_path)
    with result_folder(tmp_path / "out") as folder:
        write(folder / "motion.npz", "new")
    assert tree(tmp_path) == {"out/motion.npz": b"new"}


def test_a_kill_leaves_nothing(walk: Path, tmp_path: Path) -> None:
    out = tmp_path / "deep" / "out"
    words = ("adapt", walk, "--scene", "terrain", "--out", out, "--no-video")
    with subprocess.Popen(
        [sys.executable, "-m", "mjmotion", *map(str, words)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as job:
        while job.poll() is None and not out.parent.is_dir():  # until it writes aside
            time.sleep(0.01)
        job.terminate()
        job.wait(timeout=60)
    assert job.returncode == 128 + 15
    assert not list(tmp_path.iterdir())
