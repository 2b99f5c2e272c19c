"""Recordings beside what is made of them: turns on one foot, raised feet, drifting floors, noise.

The recordings are made from the built-in walk on Mixamo's skeleton, in centimetres, y up; so how
they turn, float, drift and shake is known.
"""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path

import command_line
import numpy as np
import pytest
from named_skeletons import walk_on

from mjmotion import adapt
from mjmotion.body.motion import Motion
from mjmotion.body.recording import Recording
from mjmotion.clips import find_rig, load_clip, map_recording, read_clip
from mjmotion.clips.in_place import going
from mjmotion.clips.joint_noise import joint_noise
from mjmotion.clips.mapping import Mapped
from mjmotion.clips.skeleton import Clip, pose_skeleton
from mjmotion.exceptions import ClipError
from mjmotion.footsteps.contacts import Contact, contact_mask, detect_contacts
from mjmotion.footsteps.heading import heading
from mjmotion.numerics import rotations as rot
from mjmotion.output.reading import read_results
from mjmotion.validation.mapping import beside_recording

SHARED = Path(__file__).parents[2] / "shared"
NEEDS_FAULTS = pytest.mark.skipif(not (SHARED / "faults").is_dir(), reason="no shared/faults")
NEEDS_CLIPS = pytest.mark.skipif(not (SHARED / "mocap").is_dir(), reason="no shared/mocap")
FPS = 60.0
STILL, TURNING = 40, 60  # frames at either end, and in which it turns


@cache
def walk() -> Clip:
    """The built-in walk."""
    return walk_on("Mixamo", load_clip("walk"))[0]


@cache
def stand() -> Clip:
    """The walk's first pose, both feet flat, held."""
    first = walk().cut(0, 1)
    count = 2 * STILL + TURNING
    return dataclasses.replace(
        first,
        positions=np.repeat(first.positions, count, axis=0),
        rotations=np.repeat(first.rotations, count, axis=0),
        fps=FPS,
    )


def raised(clip: Clip, foot: str, height: float) -> Clip:
    """The clip with one foot higher, by centimetres; it has been there all the time."""
    joints = [clip.index(f"mixamorig:{foot}{part}") for part in ("Foot", "ToeBase")]
    positions = np.array(clip.positions)
    positions[:, joints, 1] += height
    return dataclasses.replace(clip, positions=positions)


def spun(clip: Clip, about: str, rate: float) -> Clip:
    """The whole body turned about the vertical through a joint, at degrees a second."""
    angle = np.radians(rate) * np.clip(np.arange(clip.nframe) - STILL, 0, TURNING) / clip.fps
    half, zero = angle / 2, np.zeros_like(angle)
    turn = rot.to_matrix(np.stack([np.cos(half), zero, np.sin(half), zero], axis=-1))
    pivot = clip.positions[:, clip.index(about)][:, None]
    positions = np.einsum("fij,fkj->fki", turn, clip.positions - pivot) + pivot
    return dataclasses.replace(clip, positions=positions, rotations=turn[:, None] @ clip.rotations)


def mapped(clip: Clip, floor: str = "auto") -> Mapped:
    """The clip on the humanoid."""
    return going(clip, "humanoid", find_rig(clip), in_place="keep", floor=floor)


def figures(motion: Motion) -> dict[str, float]:
    """Its figures beside its recording."""
    assert motion.recording is not None
    return beside_recording(motion, motion.recording, detect_contacts(motion))


@pytest.mark.parametrize("rate", [60.0, 150.0, 300.0, -300.0])
@pytest.mark.parametrize("about", ["LeftToeBase", "LeftFoot"])
def test_a_foot_turns_as_recorded(rate: float, about: str) -> None:
    """Turned on one foot with the other raised: as far and as fast, its contact kept."""
    motion = mapped(spun(raised(stand(), "Right", 5.0), f"mixamorig:{about}", rate)).motion
    found = figures(motion)
    assert found["mapping_foot_turn_deg_s"] < 20.0
    assert found["mapping_facing_deg"] < 3.0
    assert found["mapping_foot_height_mm"] < 10.0
    contacts = detect_contacts(motion)
    if about == "LeftToeBase":
        toe = contact_mask(contacts, "left_toe", motion.nframe)
        assert toe.mean() > 0.97, "the ball stands all the while"
    left = contact_mask(contacts, "left_toe", motion.nframe)
    left |= contact_mask(contacts, "left_heel", motion.nframe)
    assert left[:STILL].mean() > 0.9 and left[-STILL + 5 :].mean() > 0.9


@pytest.mark.parametrize("height", [5.0, 8.0, 20.0])
@pytest.mark.parametrize("foot", ["Left", "Right"])
def test_a_raised_foot_does_not_stand(foot: str, height: float) -> None:
    motion = mapped(raised(stand(), foot, height)).motion
    sites = {contact.site for contact in detect_contacts(motion)}
    other = "right" if foot == "Left" else "left"
    assert sites == {f"{other}_heel", f"{other}_toe"}
    assert figures(motion)["mapping_foot_height_mm"] < 15.0


def test_a_foot_on_a_step_stands() -> None:
    """One up and one down, and then the upper alone: that one bears the body."""
    clip = raised(stand(), "Right", 15.0)
    lifted = np.array(clip.positions)
    ankle, toe = (clip.index(f"mixamorig:Left{part}") for part in ("Foot", "ToeBase"))
    lifted[STILL:, [ankle, toe], 1] += np.minimum(np.arange(clip.nframe - STILL), 30)[:, None]
    motion = mapped(dataclasses.replace(clip, positions=lifted)).motion
    assert {contact.site for contact in detect_contacts(motion)} >= {"right_heel", "right_toe"}


DRIFTS = {
    "sinks": lambda time: -8.0 * time,
    "rises": lambda time: 8.0 * time,
    "swings": lambda time: 4.0 * np.sin(2.0 * np.pi * time),
}


def there_and_back() -> Clip:
    """The walk on, and from its end back again as a film played backwards: no way to slope."""
    clip = walk()
    return dataclasses.replace(
        clip,
        positions=np.concatenate([clip.positions, clip.positions[::-1]]),
        rotations=np.concatenate([clip.rotations, clip.rotations[::-1]]),
    )


def drifting(clip: Clip, drift: str) -> Clip:
    """The clip with a floor that drifts by 8 cm."""
    rise = DRIFTS[drift](np.arange(clip.nframe) / clip.nframe)
    return dataclasses.replace(clip, positions=clip.positions + rise[:, None, None] * (0, 1, 0))


@pytest.mark.parametrize("drift", DRIFTS)
def test_a_drifting_floor_is_followed(drift: str) -> None:
    """Heights, and contacts, are those of the floor that does not."""
    right = mapped(there_and_back()).motion
    found = mapped(drifting(there_and_back(), drift)).motion
    assert np.abs(found.qpos[:, 2] - right.qpos[:, 2]).max() < 0.02
    assert shared(detect_contacts(right), detect_contacts(found), right.nframe) > 0.9
    assert figures(found)["recording_floor_mm"] > 60.0


def test_a_level_floor_stays_level() -> None:
    clip = there_and_back()
    plain, level = mapped(clip), mapped(clip, "level")
    np.testing.assert_allclose(plain.motion.qpos, level.motion.qpos, atol=2e-3)
    sunk = mapped(drifting(clip, "sinks"), "level").motion
    assert sunk.recording is not None and np.ptp(sunk.recording.floor) < 1e-9
    follow = mapped(drifting(clip, "sinks"), "follow").motion
    assert np.abs(follow.qpos[:, 2] - plain.motion.qpos[:, 2]).max() < 0.03
    with pytest.raises(ClipError, match="unknown floor"):
        map_recording("any.bvh", floor="tilted")


@NEEDS_CLIPS
@pytest.mark.parametrize("name", ["03_01", "14_21", "02_01", "16_17"])
def test_a_real_ground_is_not_followed(name: str) -> None:
    """Where standing feet stay at their height nothing drifts: uneven ground, a ladder, a tilt."""
    plain, level = (
        load_clip(SHARED / "mocap" / "bvh" / f"{name}.bvh", floor=floor)
        for floor in ("auto", "level")
    )
    # A tilt of the floor is a plane; a drift would move single frames against it.
    assert plain.recording is not None and level.recording is not None
    floor = plain.recording.floor[:, 0]
    place = plain.recording.positions[:, 0, :2]
    table = np.column_stack([place, np.ones(len(place))])
    left = floor - table @ np.linalg.lstsq(table, floor, rcond=None)[0]
    assert np.abs(left).max() < 1e-6


def shaken(clip: Clip, degrees: float, seed: int) -> Clip:
    """The clip with white noise about each axis of each joint."""
    parents = np.maximum(clip.parents, 0)
    root = (clip.parents < 0)[:, None, None]
    turn = np.swapaxes(clip.rotations[:, parents], -1, -2)
    local = np.where(root, clip.rotations, turn @ clip.rotations)
    shift = (turn @ (clip.positions - clip.positions[:, parents])[..., None])[..., 0]
    shift = np.where(root[..., 0], clip.positions, shift)
    off = np.random.default_rng(seed).normal(0.0, np.radians(degrees), shift.shape)
    return pose_skeleton(
        *(clip.name, clip.joint_names, clip.parents, clip.offsets, shift),
        local @ rot.to_matrix(rot.exp(off)),
        clip.fps,
        clip.ends,
    )


def shared(right: tuple[Contact, ...], found: tuple[Contact, ...], nframe: int) -> float:
    """Share of the frames of all right contacts that are in those that were found."""
    sites = {contact.site for contact in right}
    masks = [[contact_mask(some, site, nframe) for site in sites] for some in (right, found)]
    both = sum(int((a & b).sum()) for a, b in zip(*masks, strict=True))
    return both / sum(int(a.sum()) for a in masks[0])


# Clip: least share of the frames in contact that 1 degree of noise leaves, over two seeds.
NOISY = {"02_01": 0.9, "16_17": 0.93, "16_31": 0.92, "07_01": 0.91, "walk": 0.9}


@NEEDS_CLIPS
@pytest.mark.parametrize("name", NOISY)
@pytest.mark.parametrize("seed", [1, 2])
def test_noise_costs_few_contacts(name: str, seed: int) -> None:
    clip = walk() if name == "walk" else read_clip(SHARED / "mocap" / "bvh" / f"{name}.bvh")
    right, found = mapped(clip), mapped(shaken(clip, 1.0, seed))
    contacts = [detect_contacts(one.motion) for one in (right, found)]
    assert shared(contacts[0], contacts[1], clip.nframe) >= NOISY[name]
    assert abs(len(contacts[1]) - len(contacts[0])) <= max(2, 0.1 * len(contacts[0]))
    assert any("noisy" in note for note in found.odd)
    assert not any("noisy" in note for note in right.odd)


@pytest.mark.parametrize("degrees", [0.5, 1.0, 2.0])
def test_noise_is_measured(degrees: float) -> None:
    clip = dataclasses.replace(shaken(stand(), degrees, 3), fps=FPS)
    assert np.degrees(np.median(joint_noise(clip))) == pytest.approx(degrees, rel=0.15)
    assert figures(mapped(clip).motion)["recording_noise_deg"] == pytest.approx(degrees, rel=0.2)
    assert figures(mapped(stand()).motion)["recording_noise_deg"] < 0.01


def test_a_wrong_mapping_breaks_its_figures() -> None:
    """Elbows for wrists, knees bent otherwise, feet that do not turn: each has its figure."""
    motion = mapped(walk()).motion
    assert motion.recording is not None
    model = motion.model
    wrong = {
        "left_elbow": "mapping_bone_p95_deg",
        "spine": "mapping_bone_p95_deg",
        "root": "mapping_facing_deg",
        "right_hip": "mapping_foot_height_mm",
    }
    good = figures(motion)
    for joint, name in wrong.items():
        qpos = np.array(motion.qpos)
        at = model.jnt_qposadr[model.joint(joint).id]
        if joint == "left_elbow":
            qpos[:, at] -= 1.2
        else:
            start = at + 3 if joint == "root" else at
            angle = np.linspace(0.0, 1.0, motion.nframe)
            axis = (0.0, 0.0, 1.0) if joint == "root" else (0.0, 1.0, 0.0)
            turn = rot.exp(angle[:, None] * np.array(axis))
            qpos[:, start : start + 4] = rot.multiply(qpos[:, start : start + 4], turn)
        bent = Motion(motion.character, qpos, motion.fps, motion.recording)
        assert figures(bent)[name] > 3.0 * good[name] + 5.0, joint


def test_the_recording_goes_with_the_frames_it_is_of(tmp_path: Path) -> None:
    motion = mapped(walk()).motion
    assert motion.moved(1.0, np.zeros(3), np.ones(3)).recording is motion.recording
    assert motion.replace(motion.qpos).recording is None
    assert figures(motion.moved(2.0, np.zeros(3), np.ones(3)))["mapping_bone_deg"] == pytest.approx(
        figures(motion)["mapping_bone_deg"], abs=1e-6
    )
    with pytest.raises(ClipError, match="frames"):
        Motion(motion.character, motion.qpos[:5], motion.fps, motion.recording)
    result = adapt(motion, "flat", levels=(8.0, 2.0))
    result.save(tmp_path / "out")
    again = read_results(tmp_path / "out")
    first, second = result.validate().metrics, again.validate().metrics
    for name in ("mapping_bone_deg", "mapping_foot_turn_deg_s", "floating_percent"):
        assert first[name] == pytest.approx(second[name], abs=1e-9), name
        assert np.isfinite(first[name])


def test_a_damaged_recording_is_refused(tmp_path: Path) -> None:
    recording = mapped(walk()).motion.recording
    assert recording is not None
    for number, changes in enumerate(
        (
            {"positions": recording.positions[:-1]},
            {"positions": np.full_like(recording.positions, np.nan)},
            {"turns": 2.0 * recording.turns},
            {"floor": recording.floor[:, :-1]},
        )
    ):
        path = tmp_path / f"{number}.npz"
        dataclasses.replace(recording, **changes).save(path)  # type: ignore[arg-type]
        with pytest.raises(ClipError, match="does not hold the recording"):
            Recording.load(path, recording.nframe)


def test_how_long_no_foot_stands() -> None:
    motion = mapped(stand()).motion
    contacts = (Contact("left_toe", 0, 30), Contact("right_toe", 50, 60))
    assert motion.recording is not None
    found = beside_recording(motion, motion.recording, contacts)
    assert found["contact_count"] == 2
    assert found["floating_percent"] == pytest.approx(100.0 * (motion.nframe - 40) / motion.nframe)
    assert found["floating_longest_s"] == pytest.approx((motion.nframe - 60) / FPS)


def test_heading_is_that_of_the_first_steps() -> None:
    """A walk in a small circle sets off along its first steps, not to its furthest place."""
    still = load_clip("straight")
    qpos = np.array(still.qpos)
    angle = np.linspace(0.0, 2.0 * np.pi, len(qpos))
    qpos[:, 0], qpos[:, 1] = 0.4 * np.sin(angle), 0.4 * (1.0 - np.cos(angle))
    way = heading(still.replace(qpos))
    assert way is not None and 0.0 < way < np.radians(45.0)


@NEEDS_FAULTS
def test_shared_pivot(tmp_path: Path) -> None:
    motion = load_clip(SHARED / "faults" / "pivot_on_ball_300.bvh")
    assert figures(motion)["mapping_foot_turn_deg_s"] < 20.0
    result = adapt(motion, "flat")
    assert not result.validate().broken()
    assert contact_mask(result.contacts, "left_toe", motion.nframe).all()
    metrics = result.validate().metrics
    assert metrics["floating_percent"] == 0.0


@NEEDS_FAULTS
def test_shared_floating_and_in_place(tmp_path: Path) -> None:
    floats = SHARED / "faults" / "floating_after_standing.bvh"
    assert figures(load_clip(floats))["floating_longest_s"] > 2.5
    told = command_line.run("info", floats)
    assert "no foot stands in" in told.stdout
    glides = SHARED / "faults" / "inplace_loop.bvh"
    done = command_line.run(
        "adapt", glides, "--scene", "flat", "--no-video", "--out", tmp_path / "o"
    )
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1 and "--in-place travel" in done.stderr


@pytest.mark.parametrize(
    "words", ["adapt", "retarget", "morph", "join", "transition", "edit-frame", "info", "view"]
)
def test_every_command_reads_alike(words: str) -> None:
    done = command_line.run(words, "--help")
    for option in ("--in-place", "--loop", "--floor", "--fps", "--asf", "--mapping"):
        assert option in done.stdout, option
