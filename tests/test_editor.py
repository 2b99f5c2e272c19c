"""The editor without a window: mouse, timeline, intents, files; the server's refusals."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from mjmotion.apps.session import Drag, EditSession, Footprint, Pin, load_session
from mjmotion.cli.main import main
from mjmotion.editor import Intents, open_session, open_view
from mjmotion.editor.autosave import Autosave
from mjmotion.editor.bars import ROW, RULER, Bars, Hit
from mjmotion.editor.clock import Clock
from mjmotion.editor.files import Files
from mjmotion.editor.keys import press
from mjmotion.editor.mouse import HANDLES, NEAR, View, pull, turned
from mjmotion.editor.shown import Shown
from mjmotion.editor.stage import GHOST_GROUP, PREFIX, Stage
from mjmotion.editor.work import Task, Worker
from mjmotion.exceptions import MotionError, SessionError
from mjmotion.footsteps.contacts import Contact

FRAME = 60  # of the walk: the right foot stands, the left one swings


@pytest.fixture(scope="module")
def walk() -> Shown:
    return open_view("walk")


@pytest.fixture
def do() -> Intents:
    intents = Intents(EditSession("walk"))
    intents.seek(FRAME)
    return intents


def settle(do: Intents) -> None:
    """Let what was begun be done."""
    assert do.worker.wait(), do.doing


# --- the mouse ------------------------------------------------------------------------------------


def view(azimuth: float = 125.0, size: tuple[float, float] = (1000.0, 700.0)) -> View:
    model = mujoco.MjModel.from_xml_string("<mujoco><worldbody/></mujoco>")
    data = mujoco.MjData(model)
    camera = mujoco.MjvCamera()
    camera.lookat[:] = 1.0, 2.0, 0.9
    camera.distance, camera.azimuth, camera.elevation = 4.0, azimuth, -15.0
    return View.of(model, data, camera, size)


def test_the_camera_s_target_is_in_the_middle() -> None:
    (pixel,), depth = view().project((1.0, 2.0, 0.9))
    assert pixel == pytest.approx((500.0, 350.0), abs=1e-3)
    assert depth[0] == pytest.approx(4.0, abs=1e-6)


def test_up_and_right_are_up_and_right() -> None:
    """Seen along +y, x is to the right and z is up; what is behind has no place."""
    seen, depth = view(90.0).project([(1.5, 2.0, 0.9), (1.0, 2.0, 1.4), (1.0, -20.0, 0.9)])
    assert seen[0, 0] > 510.0
    assert seen[1, 1] < 340.0
    assert depth[2] < 0.0
    assert np.isnan(seen[2]).all()


def test_rays_meet_what_is_projected() -> None:
    points = np.random.default_rng(3).uniform((0.0, 1.0, 0.0), (2.0, 3.0, 2.0), (50, 3))
    looked = view()
    for point, pixel in zip(points, looked.project(points)[0], strict=True):
        origin, way = looked.ray((pixel[0], pixel[1]))
        assert np.linalg.norm(np.cross(point - origin, way)) < 1e-9
        place = looked.on_plane((pixel[0], pixel[1]), point, looked.forward)
        assert place == pytest.approx(point, abs=1e-9)


def test_a_plane_behind_or_edge_on_has_no_place() -> None:
    looked = view()
    assert looked.on_plane((500.0, 350.0), looked.eye - looked.forward, looked.forward) is None
    assert looked.on_plane((500.0, 350.0), (1.0, 2.0, 0.9), looked.right) is None


@pytest.mark.parametrize("handle", ["x", "y", "z"])
def test_a_handle_is_pulled_along_its_axis(handle: str) -> None:
    """From where the axis begins to a place 0.2 m along it, and nowhere else."""
    looked, place = view(), np.array((1.1, 1.9, 1.0))
    axis = np.eye(3)["xyz".index(handle)]
    start, end = looked.project(np.stack((place, place + 0.2 * axis)))[0]
    by = pull(looked, tuple(end), tuple(start), place, handle)
    assert by == pytest.approx(0.2 * axis, abs=1e-9)


def test_a_ring_is_turned_about_the_vertical() -> None:
    looked, place = view(), np.array((1.1, 1.9, 0.1))
    around = [place + (0.3 * np.cos(a), 0.3 * np.sin(a), 0.0) for a in (3.0, 3.4)]
    start, end = looked.project(around)[0]
    assert turned(looked, tuple(end), tuple(start), place) == pytest.approx(0.4, abs=1e-9)


def test_the_mouse_is_on_a_handle_that_is_near() -> None:
    looked, place = view(), np.array((1.0, 2.0, 0.9))
    for name in HANDLES:
        line = looked.project(looked.handle_lines(place, True)[name])[0]
        on = line[len(line) // 3] if name == "turn" else line[1]
        assert looked.handle_at(tuple(on), place, True) == name
    away = looked.project(looked.handle_lines(place, False)["z"])[0][1] - (0.0, 3.0 * NEAR)
    assert looked.handle_at(tuple(away), place, False) is None


# --- the timeline ---------------------------------------------------------------------------------


def bars(shown: Shown) -> Bars:
    return Bars(shown, 8.0, 500.0, 1000.0)


def test_the_ruler_scrubs(walk: Shown) -> None:
    line = bars(walk)
    for frame in (0, 17, walk.nframe - 1):
        assert line.hit((line.x(frame + 0.5), line.top + 3.0)) == Hit("scrub", frame=frame)
    assert line.frame(0.0) == 0
    assert line.frame(1e5) == walk.nframe - 1
    assert line.hit((10.0, 499.0)) is None


def test_ends_of_contacts_are_found(walk: Shown) -> None:
    line = bars(walk)
    index = next(i for i, one in enumerate(walk.contacts) if one.start > 0 and one.end < 400)
    one = walk.contacts[index]
    y = line.row(one.site) + ROW / 2
    for end, frame in (("start", one.start), ("end", one.end)):
        hit = line.hit((line.x(frame), y))
        assert hit is not None
        assert (hit.kind, hit.index, hit.end) == ("contact", index, end)
    hit = line.hit((line.x((one.start + one.end) / 2), y))
    assert hit is not None
    assert (hit.kind, hit.end) == ("contact", "")


def test_a_dragged_contact_stays_whole_and_off_its_neighbours(walk: Shown) -> None:
    contacts = (Contact("left_heel", 10, 20), Contact("left_heel", 30, 40))
    line = bars(Shown(walk.source, walk.motion, contacts))
    end, start = Hit("contact", 0, "end"), Hit("contact", 1, "start")
    assert line.moved_contact(end, line.x(25)) == Contact("left_heel", 10, 25)
    assert line.moved_contact(end, line.x(200)) == Contact("left_heel", 10, 30)
    assert line.moved_contact(end, 0.0) == Contact("left_heel", 10, 11)
    assert line.moved_contact(start, 0.0) == Contact("left_heel", 20, 40)


def test_the_seven_knots_are_drawn(walk: Shown) -> None:
    line = bars(walk)
    knots = line.knots(FRAME)
    step = walk.settings.frames_per_knot
    expected = [line.x(FRAME + 0.5 + k * step) for k in range(-3, 4)]
    assert list(knots) == pytest.approx(expected)
    left, right = line.reach(FRAME)
    assert knots[0] < left < right < knots[-1] + 0.5
    assert len(line.knots(0)) == 4  # those within the clip
    assert line.edits_top == line.top + RULER + ROW * 4


def test_the_clock() -> None:
    clock = Clock(100, 30.0)
    clock.tick(1.0)
    assert clock.frame == 0  # paused
    clock.play(True)
    clock.tick(1.0)
    assert clock.frame == 30
    clock.faster(1)
    assert clock.speed == 2.0
    clock.tick(1.0)
    assert clock.frame == 90
    clock.tick(0.25)
    assert clock.frame == 5  # it loops
    clock.loop = False
    clock.tick(2.0)
    assert (clock.frame, clock.playing) == (99, False)
    clock.play(True)
    assert clock.frame == 0
    clock.step(-3)
    assert (clock.frame, clock.playing) == (0, False)


# --- the worker -----------------------------------------------------------------------------------


def test_the_newest_preview_wins_and_none_queue() -> None:
    """While one is made a hundred are asked for: the last of them alone is made after it."""
    worker, gate, made = Worker(), threading.Event(), []
    worker.latest(lambda: gate.wait(5.0), lambda _: None, pytest.fail)
    time.sleep(0.05)  # it is being made
    for number in range(100):
        worker.latest(lambda n=number: made.append(n), lambda _: None, pytest.fail)  # type: ignore[misc]
    gate.set()
    assert worker.wait(5.0)
    assert made == [99]
    assert worker.previews == 2
    worker.close()


def test_changes_are_all_made_in_order_and_told_in_the_caller_s_thread() -> None:
    worker, told, thread = Worker(), [], threading.get_ident()
    for number in range(5):
        worker.job(
            lambda n=number: n,  # type: ignore[misc]
            lambda n: told.append((n, threading.get_ident())),
            pytest.fail,
        )
    assert worker.busy
    assert worker.wait(5.0)
    assert told == [(number, thread) for number in range(5)]
    assert not worker.busy
    worker.close()


def test_a_failure_is_told_and_the_next_job_is_done() -> None:
    told: list[Any] = []
    worker = Worker()
    worker.job(lambda: 1 // 0, pytest.fail, told.append)
    worker.job(lambda: 7, told.append, pytest.fail)
    assert worker.wait(5.0)
    assert isinstance(told[0], ZeroDivisionError)
    assert told[1] == 7
    worker.close()


def test_a_task_is_cancelled_between_its_steps() -> None:
    done = []

    def work(progress) -> None:  # type: ignore[no-untyped-def]
        for step in range(10_000):
            progress("video", step, 10_000)
            done.append(step)
            time.sleep(0.001)

    task = Task("video", work)
    time.sleep(0.05)
    assert task.running
    task.cancel()
    task.join(5.0)
    assert not task.running
    assert task.error is None
    assert 0 < len(done) < 5_000
    assert 0.0 < task.share < 0.5


# --- intents --------------------------------------------------------------------------------------


def test_a_hand_is_dragged_and_the_edit_undone(do: Intents) -> None:
    before = do.settled.motion.qpos.copy()
    assert do.grab("right_hand")
    start = do.settled.place("right_hand", FRAME)
    for step in range(1, 6):
        do.drag(start + (0.0, 0.0, 0.02 * step))
    settle(do)
    assert do.shown is not do.settled  # the preview
    assert not do.settled.edits
    assert do.shown.place("right_hand", FRAME) == pytest.approx(start + (0, 0, 0.1), abs=1e-3)
    do.release()
    settle(do)
    edit = do.settled.edits[-1]
    assert isinstance(edit, Drag)
    assert edit.position == pytest.approx(start + (0, 0, 0.1))
    assert do.settled.residuals[0] < 1e-3
    outside = np.setdiff1d(np.arange(do.settled.nframe), do.settled.changed)
    assert np.array_equal(do.settled.motion.qpos[outside], before[outside])
    do.undo()
    settle(do)
    assert np.array_equal(do.settled.motion.qpos, before)
    do.redo()
    settle(do)
    assert len(do.settled.edits) == 1


def test_the_preview_s_sites_are_those_of_its_motion(do: Intents) -> None:
    """They are found anew in the frames that changed alone."""
    do.grab("pelvis")
    do.drag(do.settled.place("pelvis", FRAME) - (0.0, 0.0, 0.08))
    settle(do)
    whole = Shown(do.shown.source, do.shown.motion, do.shown.contacts)
    assert np.array_equal(do.shown.table, whole.table)


def test_a_standing_foot_is_its_footprint_and_a_swinging_one_is_not(do: Intents) -> None:
    assert do.stands("right_heel")
    assert not do.stands("left_toe")
    do.grab("left_toe")
    assert do.dragged is not None
    assert (do.dragged.kind, do.dragged.name) == ("site", "left_toe")
    do.cancel()
    do.grab("right_heel")
    assert do.dragged is not None
    assert (do.dragged.kind, do.dragged.name) == ("footprint", "right")
    do.drag(do.dragged.start + (0.04, 0.02, 0.0), turn=0.1)
    do.release()
    settle(do)
    (edit,) = do.settled.edits
    assert isinstance(edit, Footprint)
    assert edit.move == pytest.approx((0.04, 0.02, 0.0))
    assert edit.turn == 0.1


def test_a_click_is_no_edit_and_escape_puts_back(do: Intents) -> None:
    do.grab("pelvis")
    do.release()
    settle(do)
    assert do.settled.undo == 0
    assert do.selected == "pelvis"
    do.grab("pelvis")
    do.drag(do.settled.place("pelvis", FRAME) + (0.1, 0.0, 0.0))
    settle(do)
    do.cancel()
    assert do.shown is do.settled
    assert do.settled.undo == 0


def test_playing_waits_for_what_is_in_the_hand(do: Intents) -> None:
    do.clock.play(True)
    do.grab("pelvis")
    do.tick(1.0)
    do.seek(3)
    assert do.frame == FRAME
    assert not do.clock.playing


def test_what_cannot_be_done_is_said_and_nothing_is_lost(do: Intents) -> None:
    do.set_settings(frames_per_knot=0)
    assert do.bad
    assert "frames a knot" in do.message
    do.pin(10, 20)
    assert "select a site" in do.message
    do.grab_part("no door")
    do.drag((1.0, 0.0, 0.0))
    do.release()
    settle(do)
    assert do.bad
    assert "no scene" in do.message
    do.delete(4)
    settle(do)
    assert "no edit 4" in do.message
    assert do.settled.undo == 0
    do.set_settings(levels=3)
    settle(do)
    assert not do.bad
    assert do.settled.settings.levels == 3


def test_pins_list_and_places(do: Intents) -> None:
    do.selected = "left_hand"
    do.pin(50, 70)
    settle(do)
    do.still = True
    do.pin(55, 62, "right_hand")
    settle(do)
    hold, still = do.settled.edits
    assert isinstance(hold, Pin)
    assert hold.position is None
    assert isinstance(still, Pin)
    assert still.position is not None
    assert still.position == pytest.approx(do.settled.place("right_hand", FRAME), abs=1e-3)
    do.choose(1)
    assert do.frame == 55
    x, y, z = still.position
    do.move_edit_to(1, (x, y, z + 0.05))
    settle(do)
    changed = do.settled.edits[1]
    assert isinstance(changed, Pin)
    assert changed.position == pytest.approx((x, y, z + 0.05))
    do.enable(1, False)
    settle(do)
    assert np.isnan(do.settled.residuals[1])
    do.delete(0)
    settle(do)
    assert len(do.settled.edits) == 1
    assert do.settled.undo == 5


def test_the_ends_of_contacts_can_be_moved(do: Intents) -> None:
    index = next(i for i, c in enumerate(do.settled.contacts) if c.start > 0)
    one = do.settled.contacts[index]
    do.set_contact(index, one.start + 2, one.end)
    settle(do)
    assert Contact(one.site, one.start + 2, one.end) in do.settled.contacts
    assert len(do.settled.contacts) > 4


def test_keys(do: Intents, tmp_path: Path) -> None:
    files = Files(do, str(tmp_path / "keyed"))
    assert press(do, files, "RightArrow")
    assert press(do, files, "LeftArrow", shift=True)
    assert do.frame == FRAME - 9
    assert press(do, files, "Space")
    assert do.clock.playing
    for name, flag in (("G", "ghost"), ("T", "paths"), ("M", "marks"), ("F", "follow")):
        before = getattr(do, flag)
        press(do, files, name)
        assert getattr(do, flag) is not before
    press(do, files, "RightBracket")
    settle(do)
    assert do.settled.settings.frames_per_knot == 13
    press(do, files, "Z", ctrl=True)
    settle(do)
    assert do.settled.settings.frames_per_knot == 12
    press(do, files, "S", ctrl=True)
    assert (tmp_path / "keyed.mjsession").is_file()
    assert not press(do, files, "Q")


def test_a_door_is_moved_and_the_walk_adapts() -> None:
    do = Intents(EditSession("straight", "terrain_doors"))
    before = do.settled
    assert do.grab_part("door1")
    do.drag((0.25, 0.0, 0.0))
    do.release()
    assert "door1" in do.doing
    settle(do)
    assert not do.bad, do.message
    assert do.settled.model is not before.model
    gaps = [m.geom("door1_lintel").pos[0] for m in (do.settled.model, before.model)]
    assert gaps[0] - gaps[1] == pytest.approx(0.25)


def test_looking_only_changes_nothing(walk: Shown) -> None:
    do = Intents(None, walk)
    assert not do.editable
    assert not do.grab("pelvis")
    assert "looking only" in do.message
    do.undo()
    assert do.settled is walk


def test_figures_are_measured_after_a_while(do: Intents) -> None:
    assert not do.figures.rows
    end = time.monotonic() + 30.0
    while not do.figures.fresh and time.monotonic() < end:
        do.tick(0.02)
        time.sleep(0.02)
    rows = {row.label: row for row in list(do.figures.rows)}
    drift = rows["stance drift"]
    assert drift.value == drift.source  # nothing is edited yet
    assert True in {row.ok for row in rows.values()}


@pytest.mark.parametrize(
    ("body", "sites"),
    [
        ("left_hand", {"left_hand"}),
        ("left_forearm", {"left_elbow"}),
        ("right_upper_arm", {"right_elbow"}),
        ("right_shank", {"right_knee"}),
        ("left_thigh", {"left_knee", "pelvis"}),
        ("torso", {"pelvis"}),
        ("neck", {"head_top", "face"}),
        ("left_foot", {"left_heel", "left_toe", "left_foot"}),
    ],
)
def test_every_body_has_a_site_that_moves_for_it(walk: Shown, body: str, sites: set[str]) -> None:
    assert set(walk.sites_near(body)) == sites


# --- stage, files, opening ------------------------------------------------------------------------


def test_the_stage_shows_motion_and_source(do: Intents) -> None:
    do.grab("pelvis")
    do.drag(do.settled.place("pelvis", FRAME) - (0.0, 0.0, 0.1))
    settle(do)
    stage = Stage(do.shown)
    assert stage.has_ghost
    data = mujoco.MjData(stage.model)
    stage.pose(data, do.shown, FRAME)
    own, ghost = (data.site(prefix + "pelvis").xpos for prefix in ("", PREFIX))
    assert own == pytest.approx(do.shown.place("pelvis", FRAME), abs=1e-12)
    assert ghost - own == pytest.approx((0.0, 0.0, 0.1), abs=2e-3)
    geoms = [i for i in range(stage.model.ngeom) if stage.model.geom_group[i] == GHOST_GROUP]
    assert len(geoms) == len(do.shown.motion.character.geoms)
    assert not stage.without_ghost(mujoco.MjvOption()).geomgroup[GHOST_GROUP]
    assert stage.character_bodies().sum() * 2 == stage.model.nbody - 1


def test_files_are_not_replaced_unasked(do: Intents, tmp_path: Path) -> None:
    files = Files(do, str(tmp_path / "sub" / "lift"))
    files.export_motion()
    assert not do.bad, do.message
    files.export_motion()
    assert "is there already" in do.message
    files.replace = True
    files.export_motion()
    files.export_contacts()
    assert not do.bad, do.message
    names = {path.name for path in (tmp_path / "sub").iterdir()}
    assert names == {"lift.npz", "lift.contacts.json"}
    files.name = " "
    files.export_motion()
    assert "give a name" in do.message


def test_what_is_kept_aside_is_offered_and_restored(tmp_path: Path) -> None:
    keep = Autosave(tmp_path / "walk.autosave.mjsession")
    assert not keep.offered
    do = Intents(EditSession("walk"), autosave=keep)
    do.seek(FRAME)
    do.grab("pelvis")
    do.drag(do.settled.place("pelvis", FRAME) - (0.0, 0.0, 0.05))
    do.release()
    settle(do)
    assert load_session(keep.path).edits == do.settled.edits
    do.undo()
    settle(do)
    assert not keep.path.exists()  # nothing is left to lose
    do.redo()
    settle(do)

    again = Intents(EditSession("walk"), autosave=Autosave(keep.path))
    assert again.autosave is not None
    assert again.autosave.offered
    assert not again.grab("pelvis")  # nothing is lost by an edit meanwhile
    assert "autosave" in again.message
    files = Files(again, str(tmp_path / "saved"))
    files.restore()
    settle(again)
    assert np.array_equal(again.settled.motion.qpos, do.settled.motion.qpos)
    files.save_session()
    assert not keep.path.exists()
    assert load_session(tmp_path / "saved.mjsession").edits == do.settled.edits


def test_a_broken_session_is_one_line_and_the_present_one_goes_on(
    do: Intents, tmp_path: Path
) -> None:
    (tmp_path / "broken.mjsession").write_text("{")
    files = Files(do, str(tmp_path / "broken"))
    files.load_session()
    settle(do)
    assert do.bad
    assert "broken.mjsession' cannot be read, it is not JSON" in do.message
    assert "\n" not in do.message
    assert do.settled.nframe == 464


@pytest.mark.parametrize(
    ("name", "beside"),
    [
        ("walk", "walk.autosave.mjsession"),
        ("{0}/a.bvh", "{0}/a.autosave.mjsession"),
        ("{0}/r", "{0}/r/r.autosave.mjsession"),
        ("{0}/s.mjsession", "{0}/s.autosave.mjsession"),
    ],
)
def test_where_changes_are_kept(name: str, beside: str, tmp_path: Path) -> None:
    (tmp_path / "r").mkdir()
    for file in ("a.bvh", "s.mjsession"):
        (tmp_path / file).touch()
    assert Autosave.of(name.format(tmp_path)).path == Path(beside.format(tmp_path))


def test_opening(tmp_path: Path) -> None:
    for what, scene in (("demo", "flat"), ("no such clip", None), ("none.mjsession", None)):
        with pytest.raises(MotionError):
            open_session(what, scene)
    with pytest.raises(SessionError):
        open_session("a.mjsession", "stairs")
    session, name = open_session("walk")
    assert (name, session.name, session.motion.nframe) == ("walk", "walk", 464)
    assert open_view("straight", "stairs").model.nhfield == 0


# --- the server's refusals ------------------------------------------------------------------------


def test_a_port_in_use_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    import socket

    pytest.importorskip("mujoco.studio")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert main(["view", "straight", "--no-open", "--web", "--port", str(port)]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert f"port {port} is in use" in err


def test_an_address_of_another_machine_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("mujoco.studio")
    assert main(["view", "straight", "--no-open", "--web", "--host", "192.0.2.7"]) == 2
    warning, error = capsys.readouterr().err.splitlines()
    assert "anyone who can reach" in warning
    assert "cannot listen" in error


def test_other_origins_than_its_own_are_none_of_the_server_s() -> None:
    from mjmotion.editor.server import address, is_loopback, origins

    assert origins("127.0.0.1", 80) == ["http://127.0.0.1:80", "http://localhost:80", None]
    assert "http://192.0.2.7:80" in origins("192.0.2.7", 80)
    assert address("0.0.0.0", 8080) == "http://127.0.0.1:8080/"
    assert address("::1", 8080) == "http://[::1]:8080/"
    assert [is_loopback(host) for host in ("127.0.0.1", "::1", "localhost", "0.0.0.0")] == [
        True,
        True,
        True,
        False,
    ]


def test_the_command_line_stays_light() -> None:
    import subprocess
    import sys

    code = (
        "import sys\nfrom mjmotion.cli.main import parse\nparse(['edit', '--no-open'])\n"
        "print(*[m for m in sys.modules if m.startswith(('mujoco', 'websockets'))])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""
