"""Figures of posture, effort and kept stances on made-up motions whose answers are known."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
import pytest
from made_up import character, some

from mjmotion.body.character import Character
from mjmotion.body.motion import Motion
from mjmotion.footsteps.contacts import Contact
from mjmotion.validation import Judge, Validation, validate
from mjmotion.validation.anatomy import find_anatomy
from mjmotion.validation.lowpass import low_pass
from mjmotion.validation.self_overlap import SelfOverlap

FPS = 60.0
COUNT = 120
ROBOTS = Path(__file__).parents[2] / "shared" / "robots"
FLOOR = '<geom name="floor" type="plane" size="5 5 .1"/>'
SOLES = ("left_heel", "left_toe", "right_heel", "right_toe")


@functools.cache
def on_ground(ground: str = FLOOR) -> Character:
    """The humanoid on some ground."""
    spec = character().spec.copy()
    scene = mujoco.MjSpec.from_string(f"<mujoco><worldbody>{ground}</worldbody></mujoco>")
    spec.attach(scene, frame=spec.worldbody.add_frame(), prefix="scene_")
    return Character.load(spec)


def standing(body: Character, count: int = COUNT) -> np.ndarray:
    return np.tile(body.model.qpos0, (count, 1))


def contacts(start: int = 0, end: int = COUNT) -> list[Contact]:
    return [Contact(site, start, end) for site in SOLES]


def check(
    qpos: np.ndarray,
    source: np.ndarray | None = None,
    given: Sequence[Contact] | None = None,
    body: Character | None = None,
    fps: float = FPS,
) -> Validation:
    body = on_ground() if body is None else body
    source = standing(body, len(qpos)) if source is None else source
    given = contacts(0, len(qpos)) if given is None else given
    return validate(Motion(body, source, fps), Motion(body, qpos, fps), given)


def turned(qpos: np.ndarray, joint: str, frames: slice, axis: int, degrees: float) -> np.ndarray:
    """The same frames with a ball joint, or the root, turned in some of them."""
    qpos = qpos.copy()
    at = int(on_ground().model.joint(joint).qposadr[0]) + (3 if joint == "root" else 0)
    half = math.radians(degrees) / 2.0
    turn, together = np.zeros(4), np.empty(4)
    turn[0], turn[1 + axis] = math.cos(half), math.sin(half)
    for row in qpos[frames]:
        mujoco.mju_mulQuat(together, row[at : at + 4], turn)
        row[at : at + 4] = together
    return qpos


# --- posture --------------------------------------------------------------------------------------


@pytest.mark.parametrize("heading", [0.0, 130.0])
def test_a_trunk_bent_back_is_as_far_back_as_it_is_bent(heading: float) -> None:
    source = turned(standing(on_ground()), "root", slice(None), 2, heading)
    back = turned(source, "spine", slice(40, 50), 1, -20.0)
    result = check(back, source)
    assert result.metrics["trunk_back_deg"] == pytest.approx(20.0)
    assert result.metrics["head_back_deg"] == pytest.approx(20.0)
    assert 40 <= some(result.worst["trunk_back_deg"].frame) < 50
    assert {"trunk_back_deg", "head_back_deg"} <= set(result.broken())
    assert result.per_frame["trunk_pitch_deg"][[39, 45]] == pytest.approx([0.0, -20.0], abs=1e-9)


def test_what_leans_forwards_or_as_far_back_as_the_source_is_not_further_back() -> None:
    still = standing(on_ground())
    forwards = turned(still, "spine", slice(40, 50), 1, 20.0)
    assert check(forwards).metrics["trunk_back_deg"] == 0.0
    before, after = (turned(still, "root", slice(k, k + 9), 1, -30.0) for k in (10, 60))
    assert check(after, before).metrics["trunk_back_deg"] == pytest.approx(0.0, abs=1e-9)
    aside = turned(still, "spine", slice(40, 50), 0, 25.0)
    assert check(aside).metrics["trunk_back_deg"] == pytest.approx(0.0, abs=1e-9)


def test_a_head_alone() -> None:
    back = turned(standing(on_ground()), "neck", slice(7, 8), 1, -16.0)
    result = check(back)
    assert result.metrics["head_back_deg"] == pytest.approx(16.0)
    assert result.metrics["trunk_back_deg"] == pytest.approx(0.0, abs=1e-9)


def crouched(body: Character, degrees: float, count: int = COUNT) -> np.ndarray:
    """The left knee bent by so much; the foot moves, and its contacts with it."""
    qpos = standing(body, count)
    qpos[:, body.model.joint("left_knee").qposadr[0]] = math.radians(degrees)
    return qpos


def test_a_knee_is_as_much_more_bent_as_it_is_bent() -> None:
    result = check(crouched(on_ground(), 35.0), crouched(on_ground(), 10.0))
    assert result.metrics["stance_knee_bend_deg"] == pytest.approx(25.0)
    assert "left_knee" in result.worst["stance_knee_bend_deg"].where
    assert "stance_knee_bend_deg" in result.broken()
    half = np.concatenate((crouched(on_ground(), 20.0, 60), crouched(on_ground(), 0.0, 60)))
    assert check(half).metrics["stance_knee_bend_deg"] == pytest.approx(10.0)


@pytest.mark.parametrize(
    ("ground", "judged"),
    [
        ('<geom type="plane" size="5 5 .1" euler="0 2 0"/>', True),
        ('<geom type="plane" size="5 5 .1" euler="0 4 0"/>', False),
        (FLOOR + '<geom type="box" size=".5 .5 .015" pos="0 .5 0"/>', True),  # 15 mm
        (FLOOR + '<geom type="box" size=".5 .5 .03" pos="0 .5 0"/>', False),
        ("", False),
    ],
)
def test_knees_are_judged_on_level_ground_alone(ground: str, judged: bool) -> None:
    body = on_ground(ground)
    result = check(crouched(body, 30.0), body=body)
    assert math.isnan(result.metrics["stance_knee_bend_deg"]) is not judged


# --- self-overlap ---------------------------------------------------------------------------------

ARM = """
<mujoco><worldbody><geom type="plane" size="5 5 .1"/>
<body name="pelvis" pos="0 0 1"><freejoint name="root"/><geom type="box" size=".1 .1 .1"/>
  <body name="torso" pos="0 0 .3"><joint name="spine" axis="0 1 0"/>
    <geom type="box" size=".1 .1 .15"/>
    <body name="upper_arm" pos="0 .3 0"><joint name="shoulder" axis="1 0 0"/><geom size=".03"/>
      <body name="forearm" pos="0 0 -.3"><joint name="elbow" type="slide" axis="0 -1 0"/>
        <geom size=".05"/>
      </body>
    </body>
  </body>
</body></worldbody></mujoco>"""


def test_a_forearm_in_the_pelvis_counts_beyond_the_sources() -> None:
    body = Character.of(mujoco.MjModel.from_xml_string(ARM))
    own, source = standing(body), standing(body)
    own[30, -1] = 0.15 + 0.030  # the ball touches the box after 150 mm
    result = check(own, source, (), body)
    assert result.metrics["self_overlap_mm"] == pytest.approx(30.0, abs=0.01)
    assert result.metrics["source_self_overlap_mm"] == 0.0
    assert str(result.worst["self_overlap_mm"]) == "frame 30, pelvis in forearm"
    assert "self_overlap_mm" in result.broken()
    source[80, -1] = 0.15 + 0.012
    result = check(own, source, (), body)
    assert result.metrics["self_overlap_mm"] == pytest.approx(18.0, abs=0.01)
    assert result.metrics["source_self_overlap_mm"] == pytest.approx(12.0, abs=0.01)
    assert math.isnan(result.metrics["stance_knee_bend_deg"])  # it has no legs


def test_a_foot_in_the_floor_is_no_overlap() -> None:
    """Not even where the model names the two as a pair, which collides whatever its bits are."""
    named = ARM.replace('type="plane"', 'name="floor" type="plane"').replace(
        '<geom size=".05"/>', '<geom name="ball" size=".05"/>'
    )
    pair = '<contact><pair geom1="floor" geom2="ball"/></contact></mujoco>'
    body = Character.of(mujoco.MjModel.from_xml_string(named.replace("</mujoco>", pair)))
    own = standing(body)
    own[9, 2] = 0.02  # the ball's middle is as high as the root
    assert check(own, standing(body), (), body).metrics["self_overlap_mm"] == 0.0


def test_overlaps_are_those_of_mujocos_distances() -> None:
    body = character()
    model, rng = body.model, np.random.default_rng(3)
    qpos = standing(body, 12)
    for row in qpos:
        mujoco.mj_integratePos(model, row, 0.6 * rng.normal(size=model.nv), 1.0)
    qpos = body.limits.clamp(qpos)
    geoms = Judge(model, ()).geoms.ids
    found = SelfOverlap(model, geoms).overlaps(qpos)
    data, owner = mujoco.MjData(model), model.geom_bodyid
    wanted: dict[tuple[int, int], float] = {}
    for frame, pose in enumerate(qpos):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        for i, one in enumerate(geoms.tolist()):
            for other in geoms[i + 1 :].tolist():
                a, b = sorted((int(owner[one]), int(owner[other])))
                up = model.body_parentid[[a, b]]
                if a == b or up[1] == a or up[0] == up[1]:
                    continue
                depth = -mujoco.mj_geomDistance(model, data, one, other, 0.0, None)
                if depth > 0.0:
                    key = frame, a * model.nbody + b
                    wanted[key] = max(wanted.get(key, 0.0), depth)
    mine: dict[tuple[int, int], float] = {}
    rows = zip(found.frame.tolist(), found.pair.tolist(), found.depth.tolist(), strict=True)
    for frame, pair, deep in rows:
        mine[frame, pair] = max(mine.get((frame, pair), 0.0), deep)
    assert len(wanted) > 20
    for key in wanted.keys() | mine.keys():
        assert mine.get(key, 0.0) == pytest.approx(wanted.get(key, 0.0), abs=2e-3)


# --- effort ---------------------------------------------------------------------------------------


def test_twice_the_sway_is_twice_the_acceleration() -> None:
    sway = np.sin(2.0 * np.pi * np.arange(COUNT) / 60.0)
    own, source = standing(on_ground()), standing(on_ground())
    own[:, 1], source[:, 1] = 0.04 * sway, 0.02 * sway
    result = check(own, source)
    assert result.metrics["com_acceleration_ratio"] == pytest.approx(2.0, rel=1e-5)
    assert "com_acceleration_ratio" in result.broken()


def test_acceleration_is_low_passed() -> None:
    time = np.arange(COUNT) / FPS
    source = standing(on_ground())
    source[:, 1] = 0.05 * np.sin(2.0 * np.pi * time)
    own = source.copy()
    own[:, 1] += 2e-4 * np.sin(2.0 * np.pi * 25.0 * time)  # 5 m/s² of them, beside 1.4
    assert check(own, source).metrics["com_acceleration_ratio"] == pytest.approx(1.0, abs=0.05)


def test_who_stands_is_explained() -> None:
    result = check(standing(on_ground()))
    assert result.metrics["unexplained_percent"] == 0.0
    assert result.metrics["source_unexplained_percent"] == 0.0
    assert result.metrics["unexplained_more_points"] == 0.0
    assert np.nanmax(result.per_frame["unexplained_bw"]) < 1e-6


def test_who_floats_is_not() -> None:
    result = check(standing(on_ground()), given=())
    assert result.metrics["unexplained_percent"] == 100.0
    assert result.per_frame["unexplained_bw"][5] == pytest.approx(1.0)
    # Half of the time nobody stands, and the body hangs in the air all the same.
    half = check(standing(on_ground()), given=contacts(0, 60))
    assert half.metrics["unexplained_percent"] == pytest.approx(50.0, abs=2.0)


def test_who_flies_needs_no_ground() -> None:
    time = np.arange(COUNT) / FPS
    own = standing(on_ground())
    own[:, 2] += 9.0 * time - 9.81 / 2.0 * time**2
    result = check(own, given=())
    assert result.metrics["unexplained_percent"] == 0.0
    assert result.metrics["source_unexplained_percent"] == 100.0
    assert result.metrics["unexplained_more_points"] == -100.0


def test_a_push_aside_that_friction_cannot_give_is_unexplained() -> None:
    time = np.arange(COUNT) / FPS
    own = standing(on_ground())
    own[:, 1] = 0.5 * 1.5 * 9.81 * time**2  # 1.5 of the weight, on a floor of friction 1
    result = check(own)
    assert result.metrics["unexplained_percent"] == 100.0
    assert result.metrics["unexplained_more_points"] == 100.0
    assert "unexplained_more_points" in result.broken()


def test_a_hand_that_holds_on_leaves_the_force_unjudged() -> None:
    given = [*contacts(), Contact("left_hand", 0, COUNT)]
    result = check(standing(on_ground()), given=given)
    assert math.isnan(result.metrics["unexplained_more_points"])
    assert result.metrics["contact_kept_percent"] == 100.0


# --- contacts kept --------------------------------------------------------------------------------


def test_a_fifth_of_the_stances_given_up() -> None:
    result = check(standing(on_ground()), given=contacts(0, 96))
    assert result.metrics["contact_kept_percent"] == pytest.approx(80.0)
    assert "contact_kept_percent" in result.broken()
    whole = check(standing(on_ground()))
    assert whole.metrics["contact_kept_percent"] == 100.0
    assert whole.holds("contact_kept_percent") and not whole.broken()


def test_what_moves_or_is_high_does_not_stand() -> None:
    source = standing(on_ground())
    source[60:, 0] = 0.1 * np.arange(60) / FPS  # faster than 0.08 m/s
    assert check(source, source, contacts(0, 61)).metrics["contact_kept_percent"] == 100.0
    source = standing(on_ground())
    source[60:, 2] += 0.021
    result = check(source, source, contacts(0, 60))
    assert result.metrics["contact_kept_percent"] == 100.0


# --- jerk -----------------------------------------------------------------------------------------


def test_what_is_faster_than_10_hz_is_no_jerk() -> None:
    fps, count = 120.0, 240
    time = np.arange(count) / fps
    source = standing(on_ground(), count)
    at = on_ground().model.joint("left_elbow").qposadr[0]
    source[:, at] = 1.0 + 0.3 * np.sin(4.0 * np.pi * time)
    own = source.copy()
    own[:, at] += 3e-4 * np.sin(2.0 * np.pi * 40.0 * time)
    result = check(own, source, fps=fps)
    assert result.metrics["jerk_ratio_rms"] == pytest.approx(1.0, abs=0.02)
    assert result.metrics["jerk_ratio_p999"] == pytest.approx(1.0, abs=0.05)
    assert result.metrics["raw_jerk_ratio_rms"] > 3.0
    assert result.metrics["raw_jerk_ratio_p999"] > 3.0
    slow = check(own, source, fps=25.0)  # there is nothing to take away
    for name in ("jerk_ratio_rms", "jerk_ratio_p999"):
        assert slow.metrics[name] == pytest.approx(slow.metrics[f"raw_{name}"])


@pytest.mark.parametrize(("count", "fps", "cutoff"), [(200, 30.0, 10.0), (343, 120.0, 6.0)])
def test_the_low_pass_is_scipys(count: int, fps: float, cutoff: float) -> None:
    signal = pytest.importorskip("scipy.signal")
    walk = np.random.default_rng(1).normal(size=(count, 2, 3)).cumsum(axis=0)
    b, a = signal.butter(2, cutoff, fs=fps)
    wanted = signal.filtfilt(b, a, walk, axis=0)
    assert low_pass(walk, cutoff, fps) == pytest.approx(wanted, abs=1e-10)
    assert low_pass(walk, 0.4 * fps, fps) is walk
    for few in (1, 2, 3, 5):
        assert np.isfinite(low_pass(walk[:few], cutoff, fps)).all()


# --- what is not there ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "trunk", "head"),
    [
        ("humanoid", "torso", "head"),
        ("child", "torso", "head"),
        ("climber", "torso", "head"),
        ("humanoid_flexible", "chest", "head"),
        ("unitree_g1/g1.xml", "torso_link", ""),
        ("unitree_h1/h1.xml", "torso_link", ""),
        ("booster_t1/t1.xml", "Trunk", "H2"),
        ("pal_talos/talos.xml", "torso_2_link", "head_1_link"),
    ],
)
def test_trunk_and_head_are_found(name: str, trunk: str, head: str) -> None:
    if "/" in name and not (ROBOTS / name).exists():
        pytest.skip("no robots on this machine")
    model = Character.load(ROBOTS / name if "/" in name else name).model
    found = find_anatomy(model)
    assert model.body(found.trunk).name == trunk
    assert (model.body(found.head).name if found.head is not None else "") == head


def test_a_robot_is_judged_by_what_it_has() -> None:
    path = ROBOTS / "unitree_g1" / "g1.xml"
    if not path.exists():
        pytest.skip("no robots on this machine")
    body = Character.load(path)
    result = check(standing(body, 30), given=(), body=body)
    assert result.metrics["trunk_back_deg"] == 0.0
    for name in ("head_back_deg", "stance_knee_bend_deg", "contact_kept_percent"):
        assert math.isnan(result.metrics[name])
    assert result.metrics["self_overlap_mm"] == 0.0 and result.broken() == []
