"""Feet of a recording are denoised on the way in: flutter and noise go, a fast slap stays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mjmotion.body.character import Character
from mjmotion.body.kinematics import Kinematics
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip, map_clip
from mjmotion.clips.foot_noise import steady_turns
from mjmotion.clips.gait import Segment, make_walk
from mjmotion.clips.skeleton import Clip, axis_rotations, pose_skeleton
from mjmotion.footsteps.contacts import detect_contacts
from mjmotion.numerics import rotations as rot

FPS = 120.0
BODIES = {"pelvis": "Hips", "torso": "Spine2", "neck": "Neck", "head": "Head"} | {
    f"{side.lower()}_{body}": f"{side}{joint}"
    for side in ("Left", "Right")
    for body, joint in (
        ("thigh", "UpLeg"),
        ("shank", "Leg"),
        ("foot", "Foot"),
        ("upper_arm", "Arm"),
        ("forearm", "ForeArm"),
        ("hand", "Hand"),
    )
}


def recorded(motion: Motion, noise: float = 0.0, flutter: float = 0.0, burst: int = 0) -> Clip:
    """Write a motion of the humanoid as a recording on a skeleton with toes.

    Args:
      motion: the motion.
      noise: standard deviation of what is added to each joint of the feet, about each axis [rad].
      flutter: by how much toes turn up and down from frame to frame [rad].
      burst: so many frames, once a second, in which a whole foot flutters by as much.
    """
    model, rng = motion.model, np.random.default_rng(5)
    pose = Kinematics(model, motion.nframe).forward(motion.qpos)
    ids = [model.body(body).id for body in BODIES]
    names = [*BODIES.values(), "LeftToeBase", "RightToeBase"]
    parents = [-1, *(ids.index(int(model.body_parentid[body])) for body in ids[1:])]
    offsets = [np.array(model.body(body).pos) for body in BODIES]
    turns = [rot.to_matrix(rot.from_matrix(pose.xmat[:, body])) for body in ids]
    local = [turns[0]]
    local += [np.swapaxes(turns[parents[i]], 1, 2) @ turns[i] for i in range(1, len(ids))]
    frames = np.arange(motion.nframe)
    for side in ("left", "right"):
        foot = ids.index(model.body(f"{side}_foot").id)
        parents.append(foot)
        offsets.append(np.array(model.site(f"{side}_toe").pos))
        hit = (frames % round(FPS) >= 60) & (frames % round(FPS) < 60 + burst)
        sign = 2.0 * rng.integers(0, 2, motion.nframe) - 1.0
        shaken = np.asarray(flutter * sign * hit, dtype=np.float64)
        turned = np.asarray(flutter * (1.0 - 2.0 * (frames % 2)), dtype=np.float64)
        local[foot] = local[foot] @ axis_rotations("y", shaken)
        local.append(axis_rotations("y", turned))
        for joint in (foot, -1):
            turn = rot.exp(noise * rng.standard_normal((motion.nframe, 3)))
            local[joint] = local[joint] @ rot.to_matrix(turn)
    offset = np.array(offsets)
    offset[0] = 0.0
    shift = np.tile(offset, (motion.nframe, 1, 1))
    shift[:, 0] = motion.qpos[:, :3]
    turn = np.stack(local, axis=1)
    return pose_skeleton("made up", tuple(names), np.array(parents), offset, shift, turn, FPS, {})


def foot_turns(motion: Motion) -> np.ndarray:
    """Return (nframe, 2, 4) how the feet are turned."""
    pose = Kinematics(motion.model, motion.nframe).forward(motion.qpos)
    feet = [motion.model.body(f"{side}_foot").id for side in ("left", "right")]
    return rot.from_matrix(pose.xmat[:, feet])


def angle(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return (…,) by how much turns (…, 4) differ [deg]."""
    return np.degrees(rot.norm(rot.log(rot.multiply(rot.conjugate(first), second))))


@pytest.fixture(scope="module")
def walk() -> Motion:
    return make_walk(Character.of("humanoid"), segments=[Segment("straight", 4)], fps=FPS)


@pytest.fixture(scope="module")
def clean(walk: Motion) -> Motion:
    return map_clip(recorded(walk), "humanoid").motion


def same_contacts(motion: Motion, clean: Motion) -> bool:
    """Whether contacts are those of the clean walk, to one frame."""
    found, known = detect_contacts(motion), detect_contacts(clean)
    return [one.site for one in found] == [one.site for one in known] and all(
        max(abs(one.start - other.start), abs(one.end - other.end)) <= 1
        for one, other in zip(found, known, strict=True)
    )


def test_fluttering_toes_change_nothing(walk: Motion, clean: Motion) -> None:
    """Toes that turn by ±30° from frame to frame: the foot is that of the clean walk."""
    motion = map_clip(recorded(walk, flutter=np.radians(30.0)), "humanoid").motion
    assert angle(foot_turns(motion), foot_turns(clean)).max() < 0.05
    assert same_contacts(motion, clean)


def test_a_clean_walk_comes_as_it_is(walk: Motion, clean: Motion) -> None:
    """No more than planting soles and limits change, which does without the filter too: 1°."""
    off = angle(foot_turns(walk), foot_turns(clean))
    assert off.max() < 1.0
    assert np.sqrt((off**2).mean()) < 0.35


def test_noise_goes(walk: Motion, clean: Motion) -> None:
    """1° about every axis of every joint of the feet, 1.8° RMS in all: 0.8° and 3° are let pass."""
    noise = np.radians(1.0)
    motion = map_clip(recorded(walk, noise, np.radians(30.0)), "humanoid").motion
    off = angle(foot_turns(motion), foot_turns(clean))
    assert np.sqrt((off**2).mean()) < 0.8
    assert off.max() < 3.0
    assert same_contacts(motion, clean)


def test_a_foot_that_flutters_for_some_frames(walk: Motion, clean: Motion) -> None:
    """Five frames of ±30° a second are drawn between those around them, to 3°."""
    motion = map_clip(recorded(walk, flutter=np.radians(30.0), burst=5), "humanoid").motion
    assert angle(foot_turns(motion), foot_turns(clean)).max() < 3.0
    assert same_contacts(motion, clean)


def slap() -> np.ndarray:
    """Return turns (240, 4) of a foot that slaps from 20° toes up to flat at 330°/s."""
    time = np.arange(240) / FPS
    pitch = np.radians(-20.0) * np.clip((1.06 - time) / 0.06, 0.0, 1.0)
    return rot.exp(np.outer(pitch, (0.0, 1.0, 0.0)))


def test_a_fast_slap_stays() -> None:
    """Within 5 mm of the tip of the toe, 0.2 m ahead of the ankle; with noise it is no slower."""
    turn = slap()
    steady = steady_turns(turn, FPS)
    toe = np.array((0.2, 0.0, 0.0))
    assert np.linalg.norm(rot.rotate(steady, toe) - rot.rotate(turn, toe), axis=1).max() < 0.005
    rng = np.random.default_rng(2)
    noisy = rot.multiply(turn, rot.exp(np.radians(1.0) * rng.standard_normal((240, 3))))
    pitch = np.degrees(rot.log(steady_turns(noisy, FPS))[:, 1])
    down = np.flatnonzero((pitch > -18.0) & (pitch < -2.0))
    assert len(down) <= 10  # of 240; 6 in the slap as it is
    assert abs(down.mean() - 1.03 * FPS) < 1.5


def test_jumps_go_and_slow_recordings_stay() -> None:
    turn = slap()
    jumped = turn.copy()
    jumped[60:63] = rot.multiply(turn[60:63], rot.exp(np.array((0.0, 0.5, 0.0))))
    assert angle(steady_turns(jumped, FPS), steady_turns(turn, FPS)).max() < 0.1
    np.testing.assert_array_equal(steady_turns(jumped, 30.0), jumped)


def test_turns_all_the_way_round() -> None:
    """A person who turns round twice: no frame is special."""
    yaw = np.linspace(0.0, 4.0 * np.pi, 240)
    turn = rot.exp(np.outer(yaw, (0.0, 0.0, 1.0)))
    turn[100:] *= -1.0
    assert angle(steady_turns(turn, FPS), turn).max() < 0.05


RECORDING = Path(__file__).parents[2] / "shared" / "mocap" / "bvh" / "16_31.bvh"


def foot_jerk(motion: Motion) -> float:
    """Return the RMS jerk of how the feet are turned [rad/s³]."""
    turns = foot_turns(motion)
    speed = rot.log(rot.multiply(rot.conjugate(turns[:-1]), turns[1:]))
    return float(np.sqrt((np.diff(speed, 2, axis=0) ** 2).sum(axis=2).mean()) * motion.fps**3)


@pytest.mark.skipif(not RECORDING.is_file(), reason="the recordings of shared/mocap are not here")
def test_feet_of_a_recording_are_steadier(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fifth of the jerk at most, and as many contacts."""
    steady = load_clip(RECORDING)
    monkeypatch.setattr("mjmotion.clips.mapping.steady_turns", lambda turn, fps: turn)
    noisy = load_clip(RECORDING)
    assert foot_jerk(steady) < 0.2 * foot_jerk(noisy)
    assert len(detect_contacts(steady)) == len(detect_contacts(noisy))
