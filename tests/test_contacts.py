"""Contacts found in made-up motions whose phases are known, at any frame rate; contacts files."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
from made_up import STEP_TIME, SWING_TIME, foot_track, humanoid, walk
from numpy.typing import ArrayLike

from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.exceptions import ContactError, ModelError
from mjmotion.footsteps.contacts import (
    Contact,
    ContactSettings,
    check_contacts,
    contact_mask,
    contact_sites,
    detect_contacts,
    hysteresis,
    load_contacts,
    save_contacts,
)
from mjmotion.numerics.rotations import exp, multiply, rotate

PHASE = 0.07  # how far a found heel strike or toe-off may be from the true one [s]
RATES = (30.0, 60.0, 120.0)
# Two feet that slide freely under a root that does nothing.
TINY = """<mujoco><worldbody><body name="root"><freejoint/><geom size=".05"/>
<body name="left" pos="0 .1 0"><joint type="slide" axis="1 0 0"/>
<joint type="slide" axis="0 0 1"/><geom size=".02"/><site name="left_toe"/></body>
<body name="right" pos="0 -.1 0"><joint type="slide" axis="1 0 0"/>
<joint type="slide" axis="0 0 1"/><geom size=".02"/><site name="right_toe"/></body>
</body></worldbody></mujoco>"""
MODEL = mujoco.MjModel.from_xml_string(TINY)


def motion(
    left: ArrayLike, right: ArrayLike | None = None, fps: float = 30.0, ground: float = 0.0
) -> Motion:
    """Feet on tracks (x, z), each (nframe, 2) [m]; without a second track that foot stands."""
    left = np.asarray(left, dtype=float)
    right = np.zeros_like(left) if right is None else np.asarray(right, dtype=float)
    qpos = np.tile(MODEL.qpos0, (len(left), 1))
    qpos[:, 7:9], qpos[:, 9:11] = left, right
    qpos[:, 2] += ground
    return Motion(MODEL, qpos, fps)


def tiny_walk(fps: float, seconds: float = 4.0, ground: float = 0.0, noise: float = 0.0) -> Motion:
    time = np.arange(round(seconds * fps) + 1) / fps
    tracks = [np.column_stack(foot_track(time, phase)[:2]) for phase in (-0.3, -0.3 + STEP_TIME)]
    rng = np.random.default_rng(0)
    left, right = (track + noise * rng.normal(size=track.shape) for track in tracks)
    return motion(left, right, fps, ground)


def true_spans(seconds: float, phase: float) -> list[tuple[float, float]]:
    """When a foot of the walk stands [s], cut to the clip."""
    cycle = 2.0 * STEP_TIME
    starts = phase + SWING_TIME + cycle * np.arange(-2, 6)
    spans = [(max(0.0, s), min(seconds, s + cycle - SWING_TIME)) for s in starts]
    return [(start, end) for start, end in spans if end - start > 0.1]


def times(contacts: tuple[Contact, ...], site: str, fps: float) -> np.ndarray:
    return np.array([(c.start / fps, c.end / fps) for c in contacts if c.site == site])


@pytest.mark.parametrize("ground", [0.0, -3.2, 1.5])
@pytest.mark.parametrize("fps", RATES)
def test_known_phases(fps: float, ground: float) -> None:
    contacts = detect_contacts(tiny_walk(fps, ground=ground))
    for site, phase in (("left_toe", -0.3), ("right_toe", -0.3 + STEP_TIME)):
        found, wanted = times(contacts, site, fps), np.array(true_spans(4.0, phase))
        assert found.shape == wanted.shape
        np.testing.assert_allclose(found, wanted, atol=PHASE)
    assert list(contacts) == sorted(contacts, key=lambda c: (c.start, c.site))


def test_the_same_at_every_rate() -> None:
    at = {fps: detect_contacts(tiny_walk(fps)) for fps in RATES}
    for site in ("left_toe", "right_toe"):
        slow = times(at[30.0], site, 30.0)
        for fps in RATES[1:]:
            np.testing.assert_allclose(times(at[fps], site, fps), slow, atol=1.0 / 30.0 + 1e-9)


def test_noise_of_a_recording_does_not_cut_contacts() -> None:
    clean, noisy = (detect_contacts(tiny_walk(120.0, noise=noise)) for noise in (0.0, 5e-4))
    assert [c.site for c in clean] == [c.site for c in noisy]
    for a, b in zip(clean, noisy, strict=True):
        assert abs(a.start - b.start) <= 6 and abs(a.end - b.end) <= 6


def test_a_made_up_walk_on_the_humanoid() -> None:
    contacts = detect_contacts(walk(3.6))
    assert {c.site for c in contacts} == set(contact_sites(humanoid()))
    for part in ("heel", "toe"):
        found = times(contacts, f"right_{part}", 30.0)
        np.testing.assert_allclose(found, true_spans(3.6, STEP_TIME), atol=PHASE)


def test_standing_lifted_and_sliding() -> None:
    still = np.zeros((60, 2))
    whole = detect_contacts(motion(still))
    assert whole == (Contact("left_toe", 0, 60), Contact("right_toe", 0, 60))
    slid = still + np.column_stack((np.linspace(0.0, 2.0, 60), np.zeros(60)))  # 1 m/s
    assert {c.site for c in detect_contacts(motion(slid))} == {"right_toe"}
    # A foot that is held still in the air, once it has stood, does not stand there.
    lifted = still.copy()
    lifted[20:40, 1] = 0.15
    spans = [(c.start, c.end) for c in detect_contacts(motion(lifted)) if c.site == "left_toe"]
    assert len(spans) == 2 and spans[0][1] <= 20 and spans[1][0] >= 40


def test_hysteresis_keeps_a_wobble_together() -> None:
    """A foot that stands and rocks up to a height between the two keeps its one contact."""
    settings = ContactSettings(rise=1.0)
    rock = np.zeros((90, 2))
    rock[30:60, 1] = 0.028 * np.abs(np.sin(np.arange(30) / 29.0 * 3.0 * np.pi))
    left = [c for c in detect_contacts(motion(rock), settings=settings) if c.site == "left_toe"]
    assert [(c.start, c.end) for c in left] == [(0, 90)]


def test_hysteresis() -> None:
    def flags(text: str) -> np.ndarray:
        return np.array([letter == "x" for letter in text])

    assert hysteresis(flags("..x....x.."), flags(".xxxx.xxx.")) == [(2, 5), (7, 9)]
    assert hysteresis(flags("......"), flags("xxx.xx")) == []
    assert hysteresis(flags("x....x"), flags("xxxxxx")) == [(0, 6)]
    assert hysteresis(flags(""), flags("")) == []


def test_short_contacts_go_and_gaps_close() -> None:
    fps = 120.0
    hop = np.zeros((240, 2))
    hop[:, 1] = 0.2
    hop[:40, 1] = 0.0
    hop[100:104, 1] = 0.0  # 33 ms
    hop[180:, 1] = 0.0
    hop[:, 0] = np.interp(np.arange(240), (40, 180), (0.0, 1.0))
    hop[100:104, 0] = hop[102, 0]
    spans = [(c.start, c.end) for c in detect_contacts(motion(hop, fps=fps)) if "left" in c.site]
    assert len(spans) == 2 and spans[0][0] == 0 and spans[1][1] == 240


@pytest.mark.parametrize("degrees", [-7.0, 4.0, 7.0])
def test_a_tilted_floor_has_the_contacts_of_a_level_one(degrees: float) -> None:
    level = load_clip("walk")
    turn = exp(np.array((0.0, np.radians(degrees), 0.0)))
    qpos = np.array(level.qpos)
    qpos[:, :3] = rotate(turn, qpos[:, :3])
    qpos[:, 3:7] = multiply(turn, qpos[:, 3:7])
    assert detect_contacts(level.replace(qpos)) == detect_contacts(level)


def test_a_heel_on_a_slope_stands_beside_its_toe() -> None:
    """One foot standing still on a wedge: nothing tells a floor, but the whole foot rests."""
    motion = walk()
    qpos = np.tile(motion.qpos[:1], (60, 1))
    turn = exp(np.array((0.0, np.radians(6.0), 0.0)))
    qpos[:, :3] = rotate(turn, qpos[:, :3])
    qpos[:, 3:7] = multiply(turn, qpos[:, 3:7])
    found = {contact.site for contact in detect_contacts(motion.replace(qpos))}
    assert {"left_heel", "left_toe"} <= found or {"right_heel", "right_toe"} <= found


def test_one_frame_and_no_sites() -> None:
    assert isinstance(detect_contacts(motion(np.zeros((1, 2)))), tuple)
    bare = mujoco.MjModel.from_xml_string(TINY.replace("_toe", "_sole"))
    with pytest.raises(ContactError, match=r"\*_heel or \*_toe"):
        detect_contacts(Motion(bare, bare.qpos0[None], 30.0))
    named = detect_contacts(Motion(bare, np.tile(bare.qpos0, (30, 1)), 30.0), ["left_sole"])
    assert named == (Contact("left_sole", 0, 30),)
    with pytest.raises(ModelError, match="left_sole"):
        detect_contacts(Motion(bare, bare.qpos0[None], 30.0), ["left_sol"])


def test_save_and_load(tmp_path: Path) -> None:
    contacts = (
        Contact("left_toe", 0, 12),
        Contact("right_toe", 3, 30),
        Contact("left_toe", 20, 30),
    )
    path = tmp_path / "contacts.json"
    save_contacts(path, contacts)
    assert load_contacts(path, MODEL, 30) == contacts
    assert json.loads(path.read_text())[1] == {"site": "right_toe", "start": 3, "end": 30}
    save_contacts(path, ())
    assert load_contacts(path, MODEL, 30) == ()
    path.write_text(json.dumps([vars(c) for c in contacts[::-1]]))
    assert load_contacts(path, MODEL, 30) == contacts


GOOD = {"site": "left_toe", "start": 2, "end": 9}
BAD_FILES = {
    "not JSON": ("[{", "not JSON"),
    "empty": ("", "is empty"),
    "mapping": (json.dumps(GOOD), "list"),
    "numbers": ("[1, 2]", "entry 0"),
    "missing": (json.dumps([{"site": "left_toe", "start": 2}]), "entry 0"),
    "extra": (json.dumps([GOOD, {**GOOD, "foot": 1}]), "entry 1"),
    "float": (json.dumps([{**GOOD, "start": 2.5}]), "whole frames"),
    "text": (json.dumps([{**GOOD, "end": "9"}]), "whole frames"),
    "true": (json.dumps([{**GOOD, "start": True}]), "whole frames"),
    "unknown site": (json.dumps([{**GOOD, "site": "left_tow"}]), "left_toe"),
    "past the end": (json.dumps([{**GOOD, "end": 31}]), "30 frames"),
    "negative": (json.dumps([{**GOOD, "start": -1}]), "frames count from 0"),
    "backwards": (json.dumps([{**GOOD, "end": 2}]), "holds no frame"),
    "overlap": (json.dumps([GOOD, {**GOOD, "start": 8, "end": 12}]), "overlap"),
}


@pytest.mark.parametrize("case", sorted(BAD_FILES))
def test_bad_files(case: str, tmp_path: Path) -> None:
    text, message = BAD_FILES[case]
    path = tmp_path / "contacts.json"
    path.write_text(text)
    with pytest.raises((ContactError, ModelError), match=message) as caught:
        load_contacts(path, MODEL, 30)
    assert "\n" not in str(caught.value)


def test_missing_file_and_frames_of_errors(tmp_path: Path) -> None:
    with pytest.raises(ContactError, match="does not exist"):
        load_contacts(tmp_path / "absent.json", MODEL, 30)
    with pytest.raises(ContactError) as caught:
        check_contacts([Contact("left_toe", 2, 33)], MODEL, 30)
    assert caught.value.frames == (30, 31, 32)


def test_mask() -> None:
    contacts = (Contact("left_toe", 1, 3), Contact("right_toe", 0, 6), Contact("left_toe", 5, 6))
    mask = contact_mask(contacts, "left_toe", 6)
    np.testing.assert_array_equal(mask, [False, True, True, False, False, True])
