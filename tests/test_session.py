"""Editing sessions: what an edit changes and what not, undo, files, and bad ones."""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import command_line
import numpy as np
import pytest
from made_up import loop_sites, walk

from mjmotion.apps.session import (
    Drag,
    Edit,
    EditSession,
    Footprint,
    Pin,
    Settings,
    load_session,
    save_session,
)
from mjmotion.apps.session.applying import stay
from mjmotion.apps.session.scene_parts import moved_scene, part_of, parts
from mjmotion.body.motion import Motion
from mjmotion.exceptions import ContactError, ModelError, MotionError, SessionError
from mjmotion.output.reading import read_results
from mjmotion.scene import Scene, load_scene, stairs

NEAR = 1e-3  # what is asked for is reached to this [m]
STAYS = 5e-4  # what is held stays to this [m]
SITES = ("left_hand", "right_hand", "pelvis", "head_top", "left_toe", "right_heel")


@functools.cache
def clip() -> Motion:
    return walk()


def session() -> EditSession:
    return EditSession(clip())


def at(session: EditSession, site: str, frame: int) -> np.ndarray:
    motion = session.motion
    place = loop_sites(motion.model, motion.qpos[frame : frame + 1])
    return place[0, motion.model.site(site).id]


def drag(session: EditSession, site: str, frame: int, by: Any, **settings: Any) -> Drag:
    x, y, z = at(session, site, frame) + np.asarray(by)
    return Drag(site, frame, (float(x), float(y), float(z)), Settings(**settings))


def some_edit(session: EditSession, rng: np.random.Generator) -> Edit:
    """An edit of any kind, somewhere."""
    frame = int(rng.integers(session.motion.nframe))
    kind = rng.random()
    if kind < 0.15:
        return Pin(str(rng.choice(SITES)), max(0, frame - 6), frame + 1)
    if kind < 0.3:
        contact = session.contacts[int(rng.integers(len(session.contacts)))]
        x, y = rng.uniform(-0.04, 0.04, 2)
        return Footprint(contact.site.rpartition("_")[0], contact.start, (x, y, 0.0))
    return drag(session, str(rng.choice(SITES)), frame, rng.uniform(-0.05, 0.05, 3))


# Edits


@pytest.mark.parametrize(
    ("site", "by"),
    [
        ("right_hand", (0.1, 0.0, 0.15)),
        ("pelvis", (0.0, 0.02, -0.08)),
        ("head_top", (0.03, 0, -0.05)),
    ],
)
def test_a_drag_reaches_and_what_is_out_of_its_range_stays_to_the_bit(site: str, by: tuple) -> None:
    opened = session()
    before = opened.motion.qpos
    edit = drag(opened, site, 45, by)
    opened.do(edit)
    assert np.linalg.norm(at(opened, site, 45) - edit.position) < NEAR
    assert opened.residuals()[0] < NEAR
    changed = (before.view(np.int64) != opened.motion.qpos.view(np.int64)).any(axis=1)
    frames = np.flatnonzero(changed)
    knots = opened.span(45).knots
    assert frames.min() > knots[0] and frames.max() < knots[-1]
    assert set(opened.step.frames) >= set(frames.tolist())


def test_what_is_dragged_moves_most_and_limbs_go_before_the_trunk() -> None:
    opened = EditSession("start")
    edit = drag(opened, "right_hand", 90, (0.0, 0.0, 0.15))
    head = at(opened, "head_top", 90)
    opened.do(edit)
    assert np.linalg.norm(at(opened, "right_hand", 90) - edit.position) < NEAR
    assert np.linalg.norm(at(opened, "head_top", 90) - head) < 0.01


def test_standing_feet_stay_while_the_body_is_dragged() -> None:
    opened = session()
    before = loop_sites(opened.motion.model, opened.motion.qpos)
    opened.do(drag(opened, "pelvis", 45, (0.0, 0.0, -0.1)))
    after = loop_sites(opened.motion.model, opened.motion.qpos)
    for contact in opened.contacts:
        site = opened.motion.model.site(contact.site).id
        moved = (after - before)[contact.start : contact.end, site]
        assert np.linalg.norm(moved, axis=1).max() < STAYS, contact


def test_a_preview_is_what_is_kept() -> None:
    opened = session()
    for share in (0.3, 0.7, 1.0):  # dragged on, as with a mouse
        edit = drag(opened, "right_hand", 50, share * np.array((0.1, 0.0, 0.1)))
        step = opened.preview(edit)
    assert opened.edits == ()
    opened.do(edit, step)
    other = session()
    other.do(edit)
    assert other.motion.qpos.tobytes() == opened.motion.qpos.tobytes()


def test_a_pinned_hand_stays_where_it_is_when_the_body_moves() -> None:
    opened = session()
    opened.do(Pin("left_hand", 40, 50))
    before = loop_sites(opened.motion.model, opened.motion.qpos)[40:50]
    opened.do(drag(opened, "pelvis", 45, (0.0, 0.0, -0.08)))
    after = loop_sites(opened.motion.model, opened.motion.qpos)[40:50]
    hand = opened.motion.model.site("left_hand").id
    assert np.linalg.norm((after - before)[:, hand], axis=1).max() < NEAR
    free = session()
    free.do(drag(free, "pelvis", 45, (0.0, 0.0, -0.08)))
    loose = loop_sites(free.motion.model, free.motion.qpos)[40:50]
    assert np.linalg.norm((loose - before)[:, hand], axis=1).max() > 0.03


def test_a_pin_at_a_place_brings_the_site_there_for_its_frames() -> None:
    opened = session()
    x, y, z = at(opened, "right_hand", 45) + (0.05, 0.0, 0.1)
    opened.do(Pin("right_hand", 42, 49, (float(x), float(y), float(z))))
    assert opened.residuals()[0] < NEAR


@pytest.mark.parametrize("turn", [0.0, 0.2])
def test_a_footprint_moves_with_all_its_frames(turn: float) -> None:
    opened = session()
    contact = next(one for one in opened.contacts if one.site == "left_heel" and one.start > 20)
    start, end = stay(opened.contacts, "left", contact.start)
    before = loop_sites(opened.motion.model, opened.motion.qpos)
    opened.do(Footprint("left", contact.start, (0.03, 0.02, 0.0), turn))
    after = loop_sites(opened.motion.model, opened.motion.qpos)
    foot = opened.motion.model.site("left_foot").id
    both = slice(max(start, contact.start), min(end, contact.end))
    moved = (after - before)[both, foot]
    np.testing.assert_allclose(moved[:, :2], np.tile((0.03, 0.02), (len(moved), 1)), atol=2e-3)
    assert (
        np.ptp(after[both, foot], axis=0).max() < np.ptp(before[both, foot], axis=0).max() + STAYS
    )
    # The other foot stands where it stood.
    for one in opened.contacts:
        if one.site.startswith("right"):
            site = opened.motion.model.site(one.site).id
            assert np.abs((after - before)[one.start : one.end, site]).max() < STAYS


# Undo, change, delete


def test_undoing_all_gives_the_same_bytes_and_so_does_redoing() -> None:
    opened, rng = session(), np.random.default_rng(7)
    states = [opened.motion.qpos.tobytes()]
    for _ in range(12):
        opened.do(some_edit(opened, rng))
        states.append(opened.motion.qpos.tobytes())
    for way in rng.integers(2, size=30):
        opened.undo() if way else opened.redo()
        assert opened.motion.qpos.tobytes() == states[opened.can_undo]
        assert len(opened.edits) == opened.can_undo
    while opened.undo():
        pass
    assert opened.motion.qpos.tobytes() == states[0] and opened.edits == ()
    assert not opened.undo()
    while opened.redo():
        pass
    assert opened.motion.qpos.tobytes() == states[-1] and not opened.redo()


def test_an_edit_taken_out_is_as_if_it_had_never_been() -> None:
    opened, other = session(), session()
    first, third = (
        drag(opened, "pelvis", 20, (0, 0, -0.05)),
        drag(opened, "head_top", 70, (0, 0.02, 0)),
    )
    for edit in (first, drag(opened, "right_hand", 45, (0.1, 0, 0.1)), third):
        opened.do(edit)
    for edit in (first, third):
        other.do(edit)
    opened.enable(1, False)
    assert opened.motion.qpos.tobytes() == other.motion.qpos.tobytes()
    opened.enable(1, True)
    opened.delete(1)
    assert opened.edits == other.edits
    assert opened.motion.qpos.tobytes() == other.motion.qpos.tobytes()
    opened.change(0, dataclasses.replace(first, enabled=False))
    other.delete(0)
    assert opened.motion.qpos.tobytes() == other.motion.qpos.tobytes()


def test_contacts_can_be_changed_and_come_back() -> None:
    opened = session()
    before = opened.contacts
    longest = max(before, key=lambda one: one.end - one.start)
    shorter = {one for one in before if one != longest}
    shorter.add(dataclasses.replace(longest, end=longest.end - 2))
    opened.set_contacts(sorted(shorter, key=lambda one: one.start))
    assert set(opened.contacts) == shorter
    opened.undo()
    assert opened.contacts == before


def test_rigid_joints_move_less() -> None:
    def knee(settings: Settings) -> float:
        opened = session()
        x, y, z = at(opened, "head_top", 45) + (0.08, 0.0, -0.06)
        was = opened.motion.qpos[45].copy()
        opened.do(Drag("head_top", 45, (float(x), float(y), float(z)), settings))
        first = int(opened.motion.model.joint("neck").qposadr[0])
        return float(np.abs(opened.motion.qpos[45] - was)[first : first + 4].max())

    assert knee(Settings(rigidity=(("neck", 100.0),))) < 0.5 * knee(Settings())


# Scenes


def test_parts_of_a_scene_are_doors_and_bodies_and_not_the_ground() -> None:
    scene = load_scene("terrain_doors")
    found = parts(scene)
    assert found["door1"] == ("door1_left_post", "door1_right_post", "door1_lintel")
    assert "terrain" not in found
    assert part_of(scene, "door2_lintel") == "door2" and part_of(scene, "terrain") is None
    moved = moved_scene(scene, [("door1", (0.1, 0.0, 0.0))])
    for name in found["door1"]:
        step = moved.model.geom(name).pos - scene.model.geom(name).pos
        np.testing.assert_allclose(step, (0.1, 0.0, 0.0), atol=1e-12)
    assert parts(load_scene("blocks"))["block_0_0"] == ("block_0_0",)


def test_a_moved_step_is_stood_on_where_it_is() -> None:
    scene = Scene.from_spec(stairs(steps=1, rise=0.1, landing=12.0, distance=0.7), "step")
    (name,) = (one for one in parts(scene) if one.startswith("landing"))
    opened = EditSession(clip(), scene)
    opened.do(drag(opened, "right_hand", 10, (0.05, 0.0, 0.05)))
    before, height = opened.motion.qpos.tobytes(), opened.motion.qpos[-1, 2]
    opened.move_scene(name, (0.0, 0.0, -0.04))
    assert opened.motion.qpos[-1, 2] == pytest.approx(height - 0.04, abs=0.01)
    assert opened.residuals()[0] < NEAR and opened.state.scene_moves == ((name, (0.0, 0.0, -0.04)),)
    opened.undo()
    assert opened.motion.qpos.tobytes() == before
    opened.redo()
    assert opened.motion.qpos[-1, 2] == pytest.approx(height - 0.04, abs=0.01)


# Files


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, bytes]:
    folder = tmp_path_factory.mktemp("session")
    clip().save(folder / "walk.npz")
    opened = EditSession(folder / "walk.npz")
    opened.do(drag(opened, "right_hand", 45, (0.1, 0.0, 0.15)))
    opened.do(Footprint("left", opened.contacts[0].start, (0.02, 0.0, 0.0)))
    opened.do(Pin("left_hand", 60, 66))
    opened.do(drag(opened, "pelvis", 62, (0.0, 0.0, -0.05), frames_per_knot=8, hold="contacts"))
    save_session(folder / "a.mjsession", opened)
    return folder / "a.mjsession", opened.motion.qpos.tobytes()


def test_a_saved_session_gives_the_same_bytes(saved: tuple[Path, bytes], tmp_path: Path) -> None:
    path, motion = saved
    again = load_session(path)
    assert again.motion.qpos.tobytes() == motion
    save_session(tmp_path / "b.mjsession", again)
    kept, written = (json.loads(one.read_text()) for one in (path, tmp_path / "b.mjsession"))
    assert kept == written
    assert not list(tmp_path.glob(".*"))


def test_our_own_session_bends_the_walk() -> None:
    """Figure 2's bend; where the built-in walk was changed: scripts/make_sessions.py."""
    opened = load_session("bend")
    moved = loop_sites(opened.motion.model, opened.motion.qpos)
    moved = moved - loop_sites(opened.source.model, opened.source.qpos)
    head = moved[60, opened.motion.model.site("head_top").id]
    assert head[0] > 0.15 and head[2] < -0.15
    assert max(opened.residuals()) < NEAR
    with pytest.raises(SessionError, match="does not exist"):
        load_session("bent")


def test_replay_writes_the_same_motion(saved: tuple[Path, bytes], tmp_path: Path) -> None:
    path, motion = saved
    done = command_line.run("replay", path, "--out", tmp_path / "out", "--no-video")
    assert done.returncode in (0, 1), done.stderr
    result = read_results(tmp_path / "out")
    assert result.motion.qpos.tobytes() == motion
    assert result.model.key("first_frame").qpos.tobytes() == result.motion.qpos[0].tobytes()


def broken(name: str, value: Any) -> Callable[[dict[str, Any]], None]:
    def put(session: dict[str, Any]) -> None:
        session[name] = value

    return put


def of_another_clip(session: dict[str, Any]) -> None:
    session["clip"]["sha256"] = "0" * 64


def first_edit(**fields: Any) -> Callable[[dict[str, Any]], None]:
    def put(session: dict[str, Any]) -> None:
        session["edits"][0] |= fields

    return put


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (broken("format", "something else"), "no session"),
        (broken("version", 99), "version 99"),
        (broken("version", "1" * 5000), "version 11"),
        (broken("clip", 3), "must be an object"),
        (broken("edits", 3), "edits must be a list"),
        (broken("edits", [3]), "edit 0 is no object"),
        (broken("scene", 3), "scene must be"),
        (broken("scene_moves", [["door1", [0, 0, 1]]]), "no scene"),
        (broken("contacts", [["left_heel", 0]]), "list of lists"),
        (broken("settings", {"levels": 0}), "0 levels"),
        (broken("contacts", [["left_heel", 0.5, 3]]), "whole number"),
        (broken("contacts", [["left_heel", 0, 10**6]]), "ends at frame"),
        (broken("scene_moves", 5), "list of lists"),
        (broken("scene_moves", [["door1", ["nan", 0, 0]]]), "must be a number"),
        (broken("clip", {"name": "walk"}), "name, character and sha256"),
        (broken("settings", {"hold": "air"}), "hold"),
        (broken("settings", {"rigidity": [["neck", 1e300]]}), "at most 1e+06"),
        (broken("settings", {"rigidity": [["nape", 2]]}), "unknown joint 'nape'"),
        (broken("edits", [{}] * 2000), "at most 1,000"),
        (broken("settings", {"rigidity": [["neck", -1]]}), "above 0"),
        (of_another_clip, "another clip"),
        (first_edit(kind="wish"), "wish"),
        (first_edit(site="nose"), "nose"),
        (first_edit(site=3), "site must be a name"),
        (first_edit(frame=1.5), "frame must be a whole number"),
        (first_edit(frame=True), "frame must be a whole number"),
        (first_edit(frame=100000), "not within"),
        (first_edit(position=[0, 0]), "edit 0"),
        (first_edit(position=["a", 0, 0]), "edit 0"),
        (first_edit(position=[float("1e300"), 0, 0]), "at most 10,000"),
        (first_edit(enabled="yes"), "true or false"),
        (first_edit(frame=float("inf")), "holds Infinity"),
        (first_edit(kind=[1]), "unknown kind 'a list'"),
        (first_edit(position=["1", "2", "3"]), "position is '1'"),
        (first_edit(colour="red"), "unknown key 'colour'"),
    ],
)
def test_a_bad_file_is_one_line_and_exit_2(
    saved: tuple[Path, bytes],
    tmp_path: Path,
    change: Callable[[dict[str, Any]], None],
    words: str,
) -> None:
    value = json.loads(saved[0].read_text())
    change(value)
    bad = saved[0].with_name("bad.mjsession")
    bad.write_text(json.dumps(value))
    with pytest.raises(MotionError) as caught:
        load_session(bad)
    assert words in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "{", "[]", "\x00", "[" * 100000, '{"format": NaN}'])
def test_what_is_no_session_is_told(tmp_path: Path, text: str) -> None:
    path = tmp_path / "x.mjsession"
    path.write_text(text)
    said = "x.mjsession' (is empty|cannot be read|has lists|holds NaN|is no session)"
    with pytest.raises(SessionError, match=said):
        load_session(path)
    with pytest.raises(SessionError, match="does not exist"):
        load_session(tmp_path / "none.mjsession")
    done = command_line.run("replay", path, "--out", tmp_path / "out")
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("edit", "error"),
    [
        (Drag("nose", 3, (0.0, 0.0, 0.0)), ModelError),
        (Drag("pelvis", -1, (0.0, 0.0, 0.0)), SessionError),
        (Drag("pelvis", 91, (0.0, 0.0, 0.0)), SessionError),
        (Pin("pelvis", 5, 5), SessionError),
        (Footprint("middle", 5, (0.0, 0.0, 0.0)), SessionError),
        (Drag("pelvis", 3, (0.0, 0.0, 0.9), Settings(rigidity=(("no", 2.0),))), SessionError),
    ],
)
def test_bad_edits_change_nothing(edit: Edit, error: type[Exception]) -> None:
    opened = session()
    before = opened.motion.qpos.tobytes()
    with pytest.raises(error):
        opened.do(edit)
    assert opened.motion.qpos.tobytes() == before and opened.can_undo == 0
    for wrong in (lambda: opened.delete(0), lambda: opened.move_scene("door", (0, 0, 0))):
        with pytest.raises(SessionError):
            wrong()
    with pytest.raises(ContactError):
        opened.set_contacts([dataclasses.replace(opened.contacts[0], end=10**6)])
    assert opened.motion.qpos.tobytes() == before and opened.can_undo == 0
