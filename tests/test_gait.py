"""The built-in walk: planted feet, known phases, human figures, what was asked for."""

from __future__ import annotations

import time

import mujoco
import numpy as np
import pytest

from mjmotion.body.assets import find_asset
from mjmotion.body.character import Character
from mjmotion.body.kinematics import Kinematics, Pose, character_geoms, site_id
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.clips.gait import BUILTIN, SPEED, STRIDE, TURNING, WALK, Segment, make_walk
from mjmotion.clips.gait_feet import FOOT_FLAT, HEEL_OFF, TOE_OFF
from mjmotion.exceptions import ClipError, ModelError
from mjmotion.footsteps.contacts import detect_contacts
from mjmotion.numerics.rotations import log, rotate
from mjmotion.numerics.tangent import ominus

SITES = ("left_heel", "left_toe", "right_heel", "right_toe")
STRAIGHT = (Segment("straight", 4.0),)


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(find_asset("model", "humanoid")))


@pytest.fixture(scope="module")
def walk(model: mujoco.MjModel) -> Motion:
    return load_clip("walk", model)


@pytest.fixture(scope="module")
def steady(model: mujoco.MjModel) -> Motion:
    """Four strides, left heel strikes at whole numbers of periods, 120 frames a second."""
    return make_walk(model, segments=STRAIGHT, fps=120.0)


def pose_of(motion: Motion) -> Pose:
    return Kinematics(motion.model, motion.nframe).forward(motion.qpos)


def site_path(pose: Pose, name: str) -> np.ndarray:
    return pose.site_xpos[:, site_id(pose.model, name)]


def flat_or_rolling(motion: Motion, lowest: float) -> dict[str, np.ndarray]:
    pose = pose_of(motion)
    return {name: site_path(pose, name)[:, 2] < lowest for name in SITES}


def turn_of(motion: Motion, joint: str, column: int) -> np.ndarray:
    address = int(motion.model.joint(joint).qposadr[0])
    return log(motion.qpos[:, address : address + 4])[:, column]


def angle_of(motion: Motion, joint: str) -> np.ndarray:
    return motion.qpos[:, int(motion.model.joint(joint).qposadr[0])]


def test_the_walk_has_the_papers_length(walk: Motion) -> None:
    assert walk.nframe == 464
    assert walk.fps == 30.0


def test_it_is_quick_to_make(model: mujoco.MjModel) -> None:
    load_clip("walk", model)
    begin = time.perf_counter()
    load_clip("walk", model)
    assert time.perf_counter() - begin < 0.5


@pytest.mark.parametrize("name", sorted(BUILTIN))
def test_nothing_skates_and_nothing_sinks(name: str, model: mujoco.MjModel) -> None:
    motion = load_clip(name, model)
    pose = pose_of(motion)
    for site in SITES:
        path = site_path(pose, site)
        down = path[:, 2] < 1e-6
        assert down.any()
        both = down[1:] & down[:-1]
        slip = np.linalg.norm(np.diff(path[:, :2], axis=0), axis=1)[both]
        assert slip.max() < 1e-6, f"{site} slides"
    for foot in Character.of(model).feet:
        index = site_id(model, foot.site)
        sole = foot.sole_at(foot.bend(pose))
        points = np.einsum("fij,fkj->fki", pose.site_xmat[:, index], sole)
        assert (points[..., 2] + pose.site_xpos[:, index, None, 2]).min() > -2e-3


def test_no_skate_within_detected_contacts(walk: Motion) -> None:
    pose = pose_of(walk)
    for contact in detect_contacts(walk):
        path = site_path(pose, contact.site)[contact.start : contact.end, :2]
        assert np.linalg.norm(path - path.mean(axis=0), axis=1).max() < 2e-3, contact


def test_one_foot_at_least_is_always_down(walk: Motion) -> None:
    down = flat_or_rolling(walk, 1e-4)
    assert np.any(list(down.values()), axis=0).all()


def test_contacts_are_found_where_the_phases_say(model: mujoco.MjModel) -> None:
    motion = make_walk(model, segments=STRAIGHT)
    period = STRIDE / SPEED * motion.fps
    tolerance = 2.5  # two frames, and the rounding of the phase to a frame
    for side, offset in (("left", 0.0), ("right", 0.5)):
        found = [c for c in detect_contacts(motion) if c.site.startswith(side)]
        heel = [c for c in found if c.site.endswith("heel") and c.start > 0]
        toe = [c for c in found if c.site.endswith("toe") and c.start > 0]
        inside = [c for c in heel if c.end < motion.nframe]
        assert len(inside) >= 2
        for contact in inside:
            phase = contact.start / period - offset
            assert abs(phase - round(phase)) * period < tolerance
            # The heel counts as standing until it has risen a little.
            off = (round(phase) + offset + HEEL_OFF + 0.03) * period
            assert abs(contact.end - off) < tolerance
        for contact in (c for c in toe if c.end < motion.nframe):
            phase = contact.start / period - offset - FOOT_FLAT
            assert abs(phase - round(phase)) * period < tolerance
            off = (round(phase) + offset + TOE_OFF) * period
            assert abs(contact.end - off) < tolerance


def test_heel_strikes_first_and_toes_leave_last(steady: Motion) -> None:
    pose = pose_of(steady)
    heel, toe = site_path(pose, "left_heel")[:, 2], site_path(pose, "left_toe")[:, 2]
    period = STRIDE / SPEED * steady.fps
    strike, push = round(period), round(period * (1 + TOE_OFF))
    assert heel[strike] < 2e-3
    assert toe[strike] > 0.06
    assert toe[push] < 2e-3
    assert heel[push] > 0.1  # the ball leaves before the toes do
    swing = slice(round(period * (1 + TOE_OFF + 0.1)), round(period * 1.9))
    assert np.minimum(heel, toe)[swing].min() > 8e-3


def test_arms_swing_against_the_legs(steady: Motion) -> None:
    for side, other in (("left", "right"), ("right", "left")):
        pose = pose_of(steady)
        hand = site_path(pose, f"{side}_hand")[:, 0] - steady.qpos[:, 0]
        foot = pose.site_xpos[:, site_id(steady.model, f"{side}_foot"), 0] - steady.qpos[:, 0]
        across = pose.site_xpos[:, site_id(steady.model, f"{other}_foot"), 0] - steady.qpos[:, 0]
        assert np.corrcoef(hand, foot)[0, 1] < -0.8
        assert np.corrcoef(hand, across)[0, 1] > 0.8
        assert 0.2 < np.ptp(hand) < 0.8
        assert np.rad2deg(np.ptp(angle_of(steady, f"{side}_elbow"))) > 10


def test_pelvis_bobs_twice_and_sways_once_a_stride(steady: Motion) -> None:
    strides = int(STRAIGHT[0].strides)
    up, side = steady.qpos[:, 2], steady.qpos[:, 1]
    for values, times, low, high in ((up, 2, 0.02, 0.05), (side, 1, 0.02, 0.08)):
        spectrum = np.abs(np.fft.rfft(values - values.mean()))
        assert int(np.argmax(spectrum)) == times * strides
        assert low < np.ptp(values) < high


def test_the_head_is_steady(steady: Motion) -> None:
    head = pose_of(steady).xmat[:, int(steady.model.joint("head").bodyid[0])]
    pitch, roll = np.arcsin(-head[:, 2, 0]), np.arcsin(head[:, 2, 1])
    for angle in (pitch, roll):
        assert abs(angle.mean()) < np.deg2rad(6)
        assert np.ptp(angle) < np.deg2rad(8)


def test_joints_stay_near_gait_norms(steady: Motion) -> None:
    knee = np.rad2deg(angle_of(steady, "left_knee"))
    hip = -np.rad2deg(turn_of(steady, "left_hip", 1))
    ankle = -np.rad2deg(turn_of(steady, "left_ankle", 1))
    assert 4 < knee.min() < 12
    assert 55 < knee.max() < 80
    assert -22 < hip.min() < -8
    assert 25 < hip.max() < 42
    assert -28 < ankle.min() < -8
    assert 8 < ankle.max() < 26


def test_left_and_right_are_mirror_images(steady: Motion) -> None:
    period = STRIDE / SPEED
    later = make_walk(steady.model, segments=STRAIGHT, fps=8 / period)  # half a stride: 4 frames
    left, right = angle_of(later, "left_knee"), angle_of(later, "right_knee")
    assert np.allclose(left[4:], right[:-4], atol=2e-3)


@pytest.mark.parametrize(("speed", "stride"), [(1.22, 1.36), (0.9, 1.1), (1.45, 1.5)])
def test_speed_and_stride_are_as_asked(speed: float, stride: float, model: mujoco.MjModel) -> None:
    motion = make_walk(model, segments=STRAIGHT, speed=speed, stride=stride, fps=60.0)
    length = motion.qpos[-1, 0] - motion.qpos[0, 0]
    assert length / motion.duration == pytest.approx(speed, rel=0.02)
    assert length == pytest.approx(4 * stride, rel=0.03)
    # Footfalls: the planted left heels are a stride apart.
    heel = site_path(pose_of(motion), "left_heel")
    down = heel[:, 2] < 1e-4
    spots = np.unique(np.round(heel[down, 0], 3))
    assert np.median(np.diff(spots)) == pytest.approx(stride, abs=5e-3)
    assert Character.of(model).limits.excess(motion.qpos).max() == 0.0


@pytest.mark.parametrize("way", ["left", "right"])
@pytest.mark.parametrize("turning", [0.2, TURNING, 0.6])
def test_turns_as_asked(way: str, turning: float, model: mujoco.MjModel) -> None:
    segments = (
        Segment("straight", 1.0),
        Segment(f"turn_{way}", 2.0),
        Segment("straight", 1.0),
    )
    motion = make_walk(model, segments=segments, turning=turning)
    period = round(STRIDE / SPEED * motion.fps)
    before = motion.qpos[period, :2] - motion.qpos[0, :2]
    after = motion.qpos[-1, :2] - motion.qpos[-1 - period, :2]
    turned = np.arctan2(after[1], after[0]) - np.arctan2(before[1], before[0])
    wanted = turning * 2.0 * STRIDE / SPEED * (1 if way == "left" else -1)
    assert turned == pytest.approx(wanted, abs=np.deg2rad(2))
    # The feet step around with the body.
    pose = pose_of(motion)
    site = site_id(model, "left_foot")
    foot = np.arctan2(pose.site_xmat[:, site, 1, 0], pose.site_xmat[:, site, 0, 0])
    assert foot[-1] - foot[0] == pytest.approx(wanted, abs=np.deg2rad(3))
    # Into the turn the body leans to its inside.
    middle = slice(int(1.5 * period), int(2.5 * period))
    side = np.array((0.0, 1.0, 0.0))
    left_up = rotate(motion.qpos[middle, 3:7], side[None])[:, 2].mean()
    assert left_up * wanted < 0


def test_limits_hold(walk: Motion) -> None:
    assert walk.character.limits.excess(walk.qpos).max() == 0.0


def test_no_joint_jumps(walk: Motion) -> None:
    speed = ominus(walk.model, walk.qpos[1:], walk.qpos[:-1]) * walk.fps
    assert np.abs(speed[:, 6:]).max() < 9.0
    # A pop would show as a change of speed between frames; recorded walks have 8 to 14 rad/s.
    assert np.abs(np.diff(speed[:, 6:], axis=0)).max() < 7.0


def test_knees_never_lock(walk: Motion) -> None:
    for side in ("left", "right"):
        assert np.rad2deg(angle_of(walk, f"{side}_knee").min()) > 4.0


def test_begins_and_ends_in_quiet_standing(walk: Motion) -> None:
    speed = ominus(walk.model, walk.qpos[1:], walk.qpos[:-1]) * walk.fps
    assert np.abs(speed[:3]).max() < 0.03
    assert np.abs(speed[-5:]).max() < 0.03
    pose = pose_of(walk)
    for frame in (0, -1):
        forward = rotate(walk.qpos[frame, 3:7], np.array((1.0, 0.0, 0.0)))[:2]
        forward /= np.linalg.norm(forward)
        apart = site_path(pose, "left_foot")[frame] - site_path(pose, "right_foot")[frame]
        assert abs(apart[:2] @ forward) < 0.01, "feet side by side"
        assert 0.12 < np.linalg.norm(apart[:2]) < 0.25
        for site in SITES:
            assert abs(site_path(pose, site)[frame, 2]) < 1e-6


def test_the_first_six_metres_are_straight(walk: Motion) -> None:
    x, y = walk.qpos[:, 0], walk.qpos[:, 1]
    assert np.abs(y[x < 6.0]).max() < 0.06
    assert (np.diff(x) > -1e-3).all()
    assert y.max() > 1.5


def test_frame_rate_changes_nothing(walk: Motion) -> None:
    finer = make_walk(walk.model, segments=WALK, seconds=464 / 30, fps=120.0)
    assert finer.nframe == 4 * 464
    assert np.allclose(finer.qpos[::4], walk.qpos, atol=1e-9)


def test_parts_join_where_they_are_cut(model: mujoco.MjModel) -> None:
    """A straight part ends as it begins, a whole number of strides on."""
    motion = make_walk(model, segments=STRAIGHT, fps=SPEED / STRIDE * 32)  # 32 frames a stride
    assert np.allclose(motion.qpos[32:64, 7:], motion.qpos[64:96, 7:], atol=1e-6)


def test_other_models_are_told_what_is_missing() -> None:
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint name='root'/><geom size='.1'/></body></worldbody>"
        "</mujoco>"
    )
    with pytest.raises(ModelError, match=r"joints spine, .*right_ankle"):
        make_walk(model)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"segments": ()}, "needs segments"),
        ({"segments": (Segment("hop"),)}, "unknown segment 'hop'"),
        ({"segments": (Segment("straight", 0.3),)}, "multiple of 0.5"),
        ({"segments": (Segment("straight"), Segment("start"))}, "at the walk's begin"),
        ({"segments": (Segment("stop"), Segment("straight"))}, "at the walk's end"),
        ({"speed": 5.0}, "speed is 5"),
        ({"stride": float("nan")}, "stride is nan"),
        ({"speed": 1.9, "stride": 0.6}, "strides a second"),
        ({"seconds": 3.0}, "the segments take"),
        ({"fps": 0.0}, "fps is 0"),
    ],
)
def test_senseless_walks_are_refused(options: dict, says: str, model: mujoco.MjModel) -> None:
    with pytest.raises(ClipError, match=says):
        make_walk(model, **options)


@pytest.mark.parametrize("name", ["walk", "start", "straight", "turn_left", "turn_right", "stop"])
def test_no_leg_passes_through_the_other(name: str) -> None:
    """In turns the straight way of a foot would cut through the one that stands."""
    motion = load_clip(name)
    model, data = motion.model, mujoco.MjData(motion.model)
    legs = [
        [
            geom
            for geom in character_geoms(model, colliding=True)
            if model.body(model.geom_bodyid[geom]).name.startswith(side)
            and model.body(model.geom_bodyid[geom]).name.endswith(("thigh", "shank", "foot"))
        ]
        for side in ("left", "right")
    ]
    least = 1.0
    for qpos in motion.qpos:
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        for left in legs[0]:
            for right in legs[1]:
                least = min(least, mujoco.mj_geomDistance(model, data, left, right, 0.1, None))
    assert least > -1e-3
