"""What a result can do: measured, saved whole or not at all, rendered, and shown in a notebook."""

from __future__ import annotations

import base64
import dataclasses
import json
import platform
import re
import threading
from pathlib import Path

import numpy as np
import pytest

import mjmotion.output.video
from mjmotion import read_results, render_video, write_results
from mjmotion.body.motion import Motion
from mjmotion.cli.terminal import Bar
from mjmotion.clips import load_clip
from mjmotion.constraints.unmet import Unmet
from mjmotion.exceptions import MotionError, OutputError, RenderError
from mjmotion.fitting import LevelTrace, Trace
from mjmotion.footsteps.contacts import Contact
from mjmotion.output.result import Result
from mjmotion.scene import compose
from mjmotion.validation import Validation, validate

FRAMES = 24
STANCE = Contact("left_heel", 2, 9)
UNMET = Unmet("position of left_hand", (3, 4), 12.5)


def sunk(result: Result, depth: float) -> Result:
    """The same result, its motion lowered into the ground [m]."""
    qpos = np.array(result.motion.qpos)
    qpos[:, 2] -= depth
    return dataclasses.replace(result, motion=result.motion.replace(qpos))


@pytest.fixture(scope="module")
def result() -> Result:
    """The walk's first frames on a flat floor, as if a fit had left them as they were."""
    composed = compose("humanoid", "flat")
    walk = load_clip("walk")
    motion = walk.replace(walk.qpos[:FRAMES]).on(composed)
    trace = Trace((LevelTrace(1, 4.0, 0.02, 0.5),), 0.0634, 3.0, 0.25, 7)
    return Result(motion, motion, (STANCE,), trace, (), title="walk on <flat>")


@pytest.fixture
def no_gl(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine without OpenGL."""

    def refuse(*_: object, **__: object) -> None:
        raise RenderError("no <OpenGL> here")

    for name in ("ensure_gl", "render_strip"):
        monkeypatch.setattr(mjmotion.output.video, name, refuse)


@pytest.fixture
def plain_strip(monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    """A machine with OpenGL whose strips are all alike."""
    strip = np.zeros((4, 6, 3), np.uint8)
    strip[:, 3:] = (200, 30, 10)
    monkeypatch.setattr(mjmotion.output.video, "render_strip", lambda *_, **__: strip)
    return strip


# --- measured -------------------------------------------------------------------------------------


def test_validate_is_the_functions(result: Result) -> None:
    low = sunk(result, 0.05)
    ours = low.validate()
    theirs = validate(low.source, low.motion, low.contacts)
    assert ours.metrics.keys() == theirs.metrics.keys()
    for name, value in theirs.metrics.items():
        assert ours.metrics[name] == pytest.approx(value, nan_ok=True), name
    assert "sole_penetration_mm" in ours.broken()
    assert "sole_penetration_mm" not in low.validate({"sole_penetration_mm": 500.0}).broken()
    with pytest.raises(MotionError, match="sole_penetration"):
        low.validate({"sole_penetratoin_mm": 1.0})


def test_the_report_is_of_the_fit(result: Result) -> None:
    report = dataclasses.replace(result, unmet=(UNMET,)).report()
    assert report.fit_seconds == 0.0634 and report.exact_error_percent == 0.25
    assert [level["frames_per_knot"] for level in report.levels] == [4.0]
    assert report.title == "walk on <flat>"
    assert [entry["residual_mm"] for entry in report.unmet] == [12.5]
    within = len(report.judged) - len(report.broken)
    assert repr(report) == (
        f"<Report 'walk on <flat>': {within} of {len(report.judged)} figures within thresholds,"
        " 1 unmet>"
    )
    assert result.report(title="other").title == "other"


# --- shown ----------------------------------------------------------------------------------------


def test_repr_is_one_short_line(result: Result) -> None:
    assert repr(result) == "<Result: 24 frames at 30 fps, 1 contact, fitted in 63 ms, all met>"
    missed = dataclasses.replace(result, unmet=(UNMET, UNMET), trace=None)
    assert repr(missed) == "<Result: 24 frames at 30 fps, 1 contact, 2 unmet>"


def test_a_notebook_shows_poses_and_verdict(result: Result, plain_strip: np.ndarray) -> None:
    import io

    from PIL import Image

    html = result._repr_html_()
    found = re.search(r'src="data:image/png;base64,([^"]+)"', html)
    assert found is not None
    shown = np.asarray(Image.open(io.BytesIO(base64.b64decode(found.group(1)))))
    assert np.array_equal(shown, plain_strip)
    figures = result.validate()
    judged = sum(row.ok is not None for row in figures.summary())
    count = judged - len(figures.broken())
    assert f"{count} of {judged} figures within thresholds" in html
    assert "walk on &lt;flat&gt;" in html


@pytest.mark.usefixtures("no_gl")
def test_a_notebook_without_opengl_shows_words(result: Result) -> None:
    low = dataclasses.replace(sunk(result, 0.05), unmet=(UNMET,))
    html = low._repr_html_()
    assert "<img" not in html and "no &lt;OpenGL&gt; here" in html
    depth = low.validate().metrics["sole_penetration_mm"]
    assert f"sole penetration: {depth:.3f} mm" in html and "position of left_hand" in html
    assert "12.5 mm" in html
    assert "sole penetration" not in result._repr_html_()


# --- saved ----------------------------------------------------------------------------------------


@pytest.mark.usefixtures("no_gl")
def test_what_is_saved_is_read_again(result: Result, tmp_path: Path) -> None:
    stages: list[tuple[str, int, int]] = []
    out = dataclasses.replace(result, unmet=(UNMET,)).save(
        tmp_path / "deep" / "out", progress=lambda *told: stages.append(told)
    )
    assert out == tmp_path / "deep" / "out"
    assert stages == [("measuring", 0, 0), ("report", 0, 0)]
    again = read_results(out)
    assert isinstance(again, Result) and again.trace is None
    assert np.array_equal(again.motion.qpos, result.motion.qpos)
    assert again.model is again.motion.model and again.contacts == (STANCE,)
    assert again.unmet == (UNMET,) and again.title == "walk on <flat>"
    assert again.saved_report["metrics"].keys() == result.validate().metrics.keys()
    assert repr(again) == "<Result: 24 frames at 30 fps, 1 contact, fitted in 63 ms, 1 unmet>"
    report = again.report()
    assert report.as_dict() == dataclasses.replace(result, unmet=(UNMET,)).report().as_dict()


@pytest.mark.usefixtures("no_gl")
def test_orientations_that_were_not_met_are_not_lost(result: Result, tmp_path: Path) -> None:
    out = result.save(tmp_path / "out")
    saved = json.loads((out / "report.json").read_text("utf-8"))
    turned = {"constraint": "orientation of head", "frames": [5], "residual_deg": 4.0}
    turned |= {"residual_mm": None, "index": 0, "source": "user"}
    (out / "report.json").write_text(json.dumps({**saved, "unmet": [turned]}), "utf-8")
    again = read_results(out)
    assert again.unmet == (Unmet("orientation of head", (5,), None, 4.0),)
    assert "1 unmet" in repr(again)
    assert again.report().unmet == (turned,)
    assert "4.0°" in again._repr_html_()


@pytest.mark.usefixtures("no_gl")
def test_saving_is_whole_or_not_at_all(
    result: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Motion, "save", full)
        with pytest.raises(OutputError, match="No space left"):
            result.save(tmp_path / "a" / "b")
    assert not list(tmp_path.iterdir())
    with pytest.raises(RenderError, match="OpenGL"):
        result.save(tmp_path / "out", video=True)
    with pytest.raises(MotionError, match="drift"):
        result.save(tmp_path / "out", thresholds={"drift": 1.0})
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("no_gl")
def test_saving_replaces_only_by_force(result: Result, tmp_path: Path) -> None:
    out = result.save(tmp_path / "out")
    before = (out / "report.json").read_bytes()
    with pytest.raises(OutputError, match="force"):
        result.save(out, title="another")
    assert (out / "report.json").read_bytes() == before
    result.save(out, title="another", force=True)
    assert json.loads((out / "report.json").read_text("utf-8"))["title"] == "another"


@pytest.mark.usefixtures("no_gl")
def test_a_result_that_was_read_is_saved_again(result: Result, tmp_path: Path) -> None:
    out = result.save(tmp_path / "out")
    copy = read_results(out).save(tmp_path / "copy")
    assert np.array_equal(read_results(copy).motion.qpos, result.motion.qpos)
    first, second = (json.loads((at / "report.json").read_text("utf-8")) for at in (out, copy))
    assert first == second and first["levels"] and first["fit_seconds"] == 0.0634


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("{", "delimiter|property name"),
        ("[]", "not an object"),
        ('{"levels": 3}', "levels is 3, no list"),
        ('{"unmet": [1]}', "unmet holds 1, no object"),
        ('{"unmet": [{"frames": [1], "residual_mm": 2}]}', "constraint"),
    ],
)
@pytest.mark.usefixtures("no_gl")
def test_a_damaged_report_is_one_line(
    result: Result, tmp_path: Path, content: str, reason: str
) -> None:
    out = result.save(tmp_path / "out")
    (out / "report.json").write_text(content, "utf-8")
    with pytest.raises(MotionError, match=reason) as caught:
        read_results(out)
    assert "report.json" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(("backend", "aside"), [("egl", True), ("", True), ("glfw", False)])
def test_the_strip_is_drawn_while_figures_are_measured(
    result: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, backend: str, aside: bool
) -> None:
    """In a thread, from start to end in one; GLFW wants the main one."""
    drawing, measured = threading.Event(), threading.Event()
    where: list[threading.Thread] = []

    def draw(*_: object, **__: object) -> np.ndarray:
        where.append(threading.current_thread())
        drawing.set()
        assert measured.wait(30)
        return np.zeros((4, 6, 3), np.uint8)

    def measure(self: Result, thresholds: object = None) -> Validation:
        assert not aside or drawing.wait(30)
        measured.set()
        return validate(self.source, self.motion, self.contacts)

    monkeypatch.setenv("MUJOCO_GL", backend)
    monkeypatch.setattr(platform, "system", lambda: "Linux")
    monkeypatch.setattr(mjmotion.output.video, "render_strip", draw)
    monkeypatch.setattr(Result, "validate", measure)
    result.save(tmp_path / "out")
    assert len(where) == 1
    assert (where[0] is not threading.current_thread()) == aside
    assert "<img " in (tmp_path / "out" / "report.html").read_text("utf-8")


def test_what_goes_wrong_beside_the_strip_is_told(
    result: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, plain_strip: np.ndarray
) -> None:
    with pytest.raises(MotionError, match="no_such"):
        result.save(tmp_path / "out", thresholds={"no_such": 1.0})

    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError("in the strip")

    monkeypatch.setattr(mjmotion.output.video, "render_strip", fail)
    with pytest.raises(ZeroDivisionError, match="in the strip"):
        result.save(tmp_path / "out")
    assert not list(tmp_path.iterdir())
    assert not [t for t in threading.enumerate() if t.name.startswith("strip of poses")]


@pytest.mark.usefixtures("no_gl")
def test_a_machine_without_opengl_saves_a_report_that_says_so(
    result: Result, tmp_path: Path
) -> None:
    result.save(tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert "no &lt;OpenGL&gt; here" in page and "<img " not in page


# --- rendered -------------------------------------------------------------------------------------


def test_render_shows_the_source_and_replaces_only_by_force(
    result: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def record(path: Path, *motions: Motion, **options: object) -> Path:
        calls.append((motions, options))
        path.write_text("video", "utf-8")
        return path

    monkeypatch.setattr(mjmotion.output.video, "render_video", record)
    low, file = sunk(result, 0.01), tmp_path / "a.mp4"
    assert low.render(file, layout="ghost") == file
    ((motions, options),) = calls
    assert motions[0] is low.motion and motions[1] is low.source
    assert options == {"contacts": (STANCE,), "body": None, "layout": "ghost"}
    with pytest.raises(OutputError, match="exists already"):
        low.render(file)
    assert len(calls) == 1
    low.render(file, force=True, contacts=())
    assert calls[1][1] == {"contacts": (), "body": None}


def test_a_video_tells_of_every_frame(result: Result, tmp_path: Path) -> None:
    told: list[tuple[str, int, int]] = []
    short = dataclasses.replace(
        result,
        source=result.source.replace(result.source.qpos[:3]),
        motion=result.motion.replace(result.motion.qpos[:3]),
        contacts=(),
    )
    try:
        write_results(
            tmp_path, short, short.validate(), video=True, progress=lambda *one: told.append(one)
        )
    except RenderError as error:
        pytest.skip(str(error))
    assert told == [("report", 0, 0), ("video", 1, 3), ("video", 2, 3), ("video", 3, 3)]
    assert (tmp_path / "video.mp4").stat().st_size > 500
    path = render_video(tmp_path / "small.mp4", short.motion, width=64, height=64, progress=Bar())
    assert path.is_file()


# --- the bar of the command line ------------------------------------------------------------------


def test_the_bar_takes_stages_and_amounts(monkeypatch: pytest.MonkeyPatch) -> None:
    class Fake:
        made: list[Fake] = []  # noqa: RUF012

        def __init__(self, **settings: object) -> None:
            self.settings, self.n, self.closed = settings, 0, False
            self.made.append(self)

        def update(self, more: int) -> None:
            self.n += more

        def close(self) -> None:
            self.closed = True

    with Bar() as bar:
        monkeypatch.setattr(bar, "_make", Fake)
        bar("fit")  # as the applications tell of their stages
        bar("video", 1, 3)
        bar("video", 3, 3)
        bar("report", 0, 0)
    fit, video, report = Fake.made
    assert fit.settings["desc"] == "fit …" and report.settings["desc"] == "report …"
    assert (video.settings["desc"], video.settings["total"], video.n) == ("video", 3, 3)
    assert fit.closed and video.closed and report.closed
