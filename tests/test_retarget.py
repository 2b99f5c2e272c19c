"""Retargeting: contacts kept on other bodies, what is copied, what cannot be, and the command."""

from __future__ import annotations

import json
import subprocess
from functools import cache
from pathlib import Path

import command_line
import mujoco
import numpy as np
import pytest
from made_up import character, humanoid, loop_quats, loop_sites, missed, some, walk

from mjmotion.apps.retarget import (
    check_span,
    copy_joints,
    held_shift,
    hold_constraints,
    leg_ratio,
    map_bones,
    mid_hips,
    retarget,
    with_soles,
)
from mjmotion.apps.retarget.rest import RestBody, world
from mjmotion.body.character import Character
from mjmotion.body.kinematics import Kinematics
from mjmotion.body.motion import Motion
from mjmotion.body.proportions import Proportions, make_character
from mjmotion.clips import load_clip
from mjmotion.constraints import SiteConstraint
from mjmotion.exceptions import ConstraintError, ContactError, FitError, ModelError
from mjmotion.footsteps.contacts import Contact, detect_contacts
from mjmotion.numerics.rotations import exp, log
from mjmotion.output.result import Result
from mjmotion.scene import compose, load_scene, scene_of
from mjmotion.validation import validate

MOCAP = Path(__file__).parents[2] / "shared" / "mocap" / "bvh"
G1 = Path(__file__).parents[2] / "shared" / "robots" / "unitree_g1" / "g1.xml"
NEEDS_G1 = pytest.mark.skipif(not G1.is_file(), reason="needs ../shared/robots/unitree_g1")


@cache
def body(name: str | Path) -> Character:
    return Character.load(name)


@cache
def recorded(name: str) -> Motion:
    return load_clip(MOCAP / f"{name}.bvh")


@cache
def robot() -> Character:
    return with_soles(body(G1))


@cache
def stepped(to: str, stride: str) -> Result:
    """The first steps of the walk on another body."""
    return retarget(steps(), to, stride=stride)


@cache
def steps() -> Motion:
    """The first steps of the built-in walk, from a stand."""
    clip = load_clip("walk")
    return clip.replace(clip.qpos[:130])


def standing(frames: int = 40) -> Motion:
    """A stand with the arms bent forward, still."""
    model = humanoid()
    qpos = np.tile(model.qpos0, (frames, 1))
    for side in ("left", "right"):
        qpos[:, model.joint(f"{side}_elbow").qposadr[0]] = 1.5
        knee = model.joint(f"{side}_knee").qposadr[0]
        qpos[:, knee] = 0.6
        for joint, share in (("hip", -0.5), ("ankle", -0.5)):
            at = model.joint(f"{side}_{joint}").qposadr[0]
            qpos[:, at : at + 4] = exp(np.array((0.0, share * 0.6, 0.0)))
    low = loop_sites(model, qpos[:1])[0, model.site("left_foot").id, 2]
    qpos[:, 2] -= low
    return Motion(character(), qpos, 30.0)


@pytest.mark.parametrize("stride", ["keep", "scale"])
@pytest.mark.parametrize("to", ["climber", "child", "humanoid_flexible"])
def test_steps_reach_every_figure_on_another_body(to: str, stride: str) -> None:
    result = stepped(to, stride)
    validation = validate(result.source, result.motion, result.contacts)
    assert missed(validation) == []
    assert validation.metrics["stance_drift_mm"] <= 1.0
    assert result.unmet == ()


@pytest.mark.parametrize("stride", ["keep", "scale"])
@pytest.mark.parametrize("to", ["climber", "child"])
@pytest.mark.parametrize("clip", ["02_01", "16_17"])
def test_recordings_reach_every_figure(clip: str, to: str, stride: str) -> None:
    if not MOCAP.is_dir():
        pytest.skip("needs ../shared/mocap")
    result = retarget(recorded(clip), to, stride=stride)
    assert missed(validate(result.source, result.motion, result.contacts)) == []


@pytest.mark.parametrize("to", ["climber", "child"])
def test_kept_strides_stand_where_they_stood(to: str) -> None:
    motion = steps()
    before = loop_sites(motion.model, motion.qpos)
    result = stepped(to, "keep")
    after = loop_sites(result.motion.model, result.motion.qpos)
    for contact in result.contacts:
        side = contact.site.split("_")[0]
        if contact.site.endswith("_heel"):
            continue
        # While it stands flat, the foot is on the spot on which the source's foot was.
        flat = [c for c in result.contacts if c.site == f"{side}_heel"]
        both = [
            f for c in flat for f in range(max(c.start, contact.start), min(c.end, contact.end))
        ]
        if both:
            was = before[both, motion.model.site(f"{side}_foot").id, :2].mean(axis=0)
            now = after[both, result.motion.model.site(f"{side}_foot").id, :2].mean(axis=0)
            assert np.linalg.norm(now - was) < 0.004


def test_scaled_strides_are_as_much_longer_as_the_legs() -> None:
    motion = steps()
    for to in ("climber", "child"):
        result = stepped(to, "scale")
        ratio = leg_ratio(motion.character, body(to))
        went, goes = (
            np.linalg.norm(m.qpos[-1, :2] - m.qpos[0, :2]) for m in (motion, result.motion)
        )
        assert goes == pytest.approx(ratio * went, rel=0.01)
        # Its joint angles fit the longer steps as they are: less is left to do than where feet
        # are to stand on the old spots.
        kept = stepped(to, "keep")
        first, others = (some(one.trace).first_error_percent for one in (result, kept))
        assert first < 0.7 * others


def test_a_body_like_the_source_moves_like_the_source() -> None:
    motion = walk(2.0)
    result = retarget(motion, "humanoid")
    np.testing.assert_allclose(result.motion.qpos[:, :3], motion.qpos[:, :3], atol=0.01)
    np.testing.assert_allclose(result.source.qpos, motion.qpos, atol=1e-9)


def test_hips_are_as_much_higher_as_the_legs_are_longer() -> None:
    motion = standing()
    result = retarget(motion, "climber")
    ratio = leg_ratio(motion.character, body("climber"))
    np.testing.assert_allclose(
        mid_hips(result.source)[:, 2], ratio * mid_hips(motion)[:, 2], atol=2e-3
    )


def test_hands_keep_what_they_hold() -> None:
    motion = standing()
    hold = Contact("left_hand", 8, 32)
    taller = make_character("humanoid", Proportions(legs=1.08, arms=0.95))
    result = retarget(motion, taller, contacts=[*detect_contacts(motion), hold])
    model = result.motion.model
    place = loop_sites(motion.model, motion.qpos)[8:32, motion.model.site("left_hand").id]
    kept = loop_sites(model, result.motion.qpos)[8:32, model.site("left_hand").id]
    np.testing.assert_allclose(kept, place, atol=1e-4)
    turn = loop_quats(motion.model, motion.qpos, "left_hand")[8:32]
    now = loop_quats(model, result.motion.qpos, "left_hand")[8:32]
    np.testing.assert_allclose(np.abs((turn * now).sum(axis=1)), 1.0, atol=1e-5)
    assert Character.of(model).limits.excess(result.motion.qpos).max() < 1e-4
    # And feet stand all the while.
    feet = [c for c in result.contacts if c.site != "left_hand"]
    assert validate(result.source, result.motion, feet).metrics["stance_drift_mm"] < 1.0


def test_a_body_that_only_holds_is_carried_by_its_holds() -> None:
    motion = standing()
    holds = [
        Contact(site, 0, 40) for site in ("left_hand", "right_hand", "left_foot", "right_foot")
    ]
    held = hold_constraints(motion, holds)
    guess = copy_joints(motion, body("climber"))
    shift = held_shift(guess, held)
    # Longer legs raise the root, longer arms would lower it: the mean of the four.
    gaps = [
        one.position[0] - loop_sites(guess.model, guess.qpos)[0, guess.model.site(one.site).id]
        for one in held
        if one.position is not None
    ]
    np.testing.assert_allclose(shift[20], np.mean(gaps, axis=0), atol=5e-3)
    result = retarget(motion, "climber", contacts=holds[1:])
    assert [one.constraint for one in result.unmet] == []


def test_holds_that_no_pose_reaches_are_refused() -> None:
    motion = standing()
    with pytest.raises(
        ConstraintError, match=r"left_hand and left_foot hold places .* m apart"
    ) as error:
        check_span(
            body("child").model,
            [
                SiteConstraint("left_hand", np.arange(5, 9), np.array((0.0, 0.0, 1.9))),
                SiteConstraint("left_foot", np.arange(7, 12), np.array((0.0, 0.0, 0.2))),
            ],
        )
    assert error.value.frames == (7, 8)
    check_span(body("climber").model, hold_constraints(motion, [Contact("left_hand", 0, 4)]))


def test_a_spine_is_divided_and_put_together_again() -> None:
    model, bent = humanoid(), body("humanoid_flexible").model
    rng = np.random.default_rng(3)
    qpos = np.tile(model.qpos0, (5, 1))
    at = model.joint("spine").qposadr[0]
    turn = rng.uniform(-0.4, 0.4, (5, 3))
    qpos[:, at : at + 4] = exp(turn)
    flexible = copy_joints(Motion(model, qpos, 30.0), bent)
    shares = {"spine_lower": 0.4, "spine_middle": 0.3, "spine_upper": 0.3}
    for joint, share in shares.items():
        start = bent.joint(joint).qposadr[0]
        np.testing.assert_allclose(
            log(flexible.qpos[:, start : start + 4]), share * turn, atol=1e-9
        )
    back = copy_joints(flexible, model)
    np.testing.assert_allclose(np.abs((back.qpos * qpos).sum(axis=1)), (qpos**2).sum(axis=1))
    again = copy_joints(flexible, bent)
    np.testing.assert_allclose(again.qpos, flexible.qpos, atol=1e-9)


def test_joints_that_mean_something_else_are_not_copied() -> None:
    turned = body("humanoid").spec.copy()
    turned.body("left_shank").quat = (0.0, 0.0, 0.0, 1.0)
    with pytest.raises(ModelError, match="'left_knee' turns about other axes"):
        copy_joints(standing(), Character.load(turned))


@NEEDS_G1
def test_joints_of_another_make_are_not_copied() -> None:
    with pytest.raises(ModelError, match="the motion has no joints left_hip_pitch_joint"):
        copy_joints(standing(), body(G1))


@NEEDS_G1
def test_steps_reach_every_figure_on_a_robot_of_hinges() -> None:
    result = retarget(steps(), body(G1), stride="scale")
    validation = validate(result.source, result.motion, result.contacts)
    assert missed(validation) == []


@NEEDS_G1
def test_bones_point_where_the_motions_bones_point() -> None:
    motion = steps()
    mapped = map_bones(motion, robot())
    rests = RestBody(motion.character), RestBody(mapped.character)
    for limb in ("left_leg", "right_leg", "left_arm", "right_arm"):
        ways = []
        for one, rest in zip((motion, mapped), rests, strict=True):
            pose = Kinematics(one.model, one.nframe).forward(one.qpos)
            line = [world(pose, *joint) for joint in rest.joints(rest.limbs[limb])]
            bones = np.stack((line[1] - line[0], line[2] - line[1]), axis=1)
            ways.append(bones / np.linalg.norm(bones, axis=2, keepdims=True))
        angle = np.arccos(np.clip((ways[0] * ways[1]).sum(axis=2), -1.0, 1.0))
        assert np.degrees(np.median(angle)) < 8.0, limb
        assert np.degrees(angle.max()) < 25.0, limb
    assert mapped.character.limits.excess(mapped.qpos).max() < 1e-9


@NEEDS_G1
def test_which_way_a_body_faces_at_rest_does_not_matter() -> None:
    turned = body(G1).spec.copy()
    turned.body("pelvis").quat = (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))
    motions = [map_bones(steps(), one) for one in (robot(), with_soles(Character.load(turned)))]
    np.testing.assert_allclose(RestBody(motions[1].character).forward, (0, 1, 0), atol=1e-9)
    np.testing.assert_allclose(motions[1].qpos, motions[0].qpos, atol=1e-9)


@NEEDS_G1
def test_a_robot_gets_sites_on_its_soles() -> None:
    model = robot().model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    heel, toe = data.site("left_heel").xpos, data.site("left_toe").xpos
    assert 0.15 < toe[0] - heel[0] < 0.25 and toe[2] == pytest.approx(heel[2], abs=1e-9)
    assert data.site("left_toe").xpos[1] == pytest.approx(-data.site("right_toe").xpos[1], abs=1e-3)
    # Those that are there stay: the robot's own left_foot, the humanoid's all.
    assert model.nsite == body(G1).model.nsite + 4
    assert with_soles(body("humanoid")).spec.to_xml() == body("humanoid").spec.to_xml()


def test_joints_that_only_the_other_body_has_stay_at_rest() -> None:
    spec = body("humanoid").spec.copy()
    spec.body("head").add_body(name="jaw", pos=(0.05, 0, -0.05)).add_joint(
        name="jaw", axis=(0, 1, 0)
    )
    spec.body("jaw").add_geom(size=[0.01, 0, 0])
    copied = copy_joints(walk(1.0), Character.load(spec))
    model = copied.model
    np.testing.assert_array_equal(copied.qpos[:, model.joint("jaw").qposadr[0]], 0.0)


def test_a_motion_without_contacts_is_refused() -> None:
    motion = standing()
    lifted = np.array(motion.qpos)
    lifted[:, :3] += np.linspace(0, 30, len(lifted))[:, None]
    with pytest.raises(ContactError, match="nothing to keep"):
        retarget(motion.replace(lifted), "climber")
    with pytest.raises(FitError, match="stride"):
        retarget(motion, "climber", stride="long")


def test_a_motion_in_a_scene_stays_where_it_is() -> None:
    composed = compose("humanoid", load_scene("blocks"))
    scene = scene_of(composed)
    assert scene is not None and scene_of("humanoid") is None
    assert scene.model.ngeom == load_scene("blocks").model.ngeom
    motion = standing()
    moved = np.array(motion.qpos)
    moved[:, 1] += 0.1
    placed = Motion(composed, moved, 30.0)
    result = retarget(placed, "climber", scene=scene)
    assert np.abs(result.motion.qpos[:, 1] - 0.1).max() < 0.03


def run(*words: object) -> subprocess.CompletedProcess[str]:
    return command_line.run("retarget", *words)


def test_the_command_writes_a_result_that_can_be_retargeted_again(tmp_path: Path) -> None:
    clip = tmp_path / "steps.npz"
    steps().save(clip)
    out = tmp_path / "climber"
    done = run(clip, "--to", "climber", "--out", out, "--stride", "scale", "--no-video")
    assert done.returncode == 0, done.stderr
    assert {path.name for path in out.iterdir()} >= {"motion.npz", "source.npz", "model.xml"}
    report = json.loads((out / "report.json").read_text("utf-8"))
    assert report["metrics"]["stance_drift_mm"] <= 1.0
    back = tmp_path / "back"
    done = run(out, "--to", "humanoid", "--out", back, "--stride", "scale", "--no-video")
    assert done.returncode == 0, done.stderr
    model = mujoco.MjModel.from_xml_path(str(back / "model.xml"))
    again = Motion.load(back / "motion.npz", model)
    went = np.linalg.norm(steps().qpos[-1, :2] - steps().qpos[0, :2])
    assert np.linalg.norm(again.qpos[-1, :2] - again.qpos[0, :2]) == pytest.approx(went, rel=0.02)


def test_hands_and_feet_of_the_climb_keep_what_they_hold(tmp_path: Path) -> None:
    out = tmp_path / "climb"
    done = run("climb", "--to", "climber", "--out", out, "--no-video")
    assert done.returncode == 0, done.stderr
    contacts = json.loads((out / "contacts.json").read_text("utf-8"))
    assert {one["site"] for one in contacts} >= {"left_hand", "right_hand", "left_foot"}
    metrics = json.loads((out / "report.json").read_text("utf-8"))["metrics"]
    assert metrics["stance_drift_mm"] <= 1.0
    assert metrics["stance_gap_max_mm"] is None  # what is held is no ground


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["climb", "--to", "child"], "out of reach"),
        (["walk", "--to", "nobody"], "unknown model 'nobody'"),
        (["wlak", "--to", "climber"], "unknown clip 'wlak'"),
        (["walk", "--to", "climber", "--stride", "long"], "invalid choice: 'long'"),
        (["walk", "--to", "climber", "--scene", "moon"], "unknown scene 'moon'"),
        (
            ["walk", "--to", "climber", "--contacts", "none.json"],
            "contacts file 'none.json' does not exist",
        ),
    ],
)
def test_the_command_refuses_bad_input(tmp_path: Path, words: list[str], line: str) -> None:
    done = run(*words, "--out", tmp_path / "out", "--no-video")
    assert done.returncode == 2
    assert line in done.stderr and done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())
