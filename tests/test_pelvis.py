"""The root's way on to a step, between what legs reach and what ankles bend; ankles that give."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
from made_up import SHANK, THIGH, humanoid

from mjmotion.apps.adaptation import adapt
from mjmotion.body.feet import Foot
from mjmotion.body.kinematics import Kinematics, site_id
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.footsteps.ankles import (
    SHORTEST,
    flat_landings,
    relax_ankles,
    trim_heel_contacts,
)
from mjmotion.footsteps.contacts import Contact, contact_mask
from mjmotion.footsteps.paths import FootPath
from mjmotion.footsteps.pelvis import MOST_BACK, ROLLING, mean_shift, push_offs, root_shift
from mjmotion.footsteps.plan import Plan
from mjmotion.footsteps.planning import make_plan
from mjmotion.footsteps.stances import Stance
from mjmotion.numerics.rotations import exp, rotate
from mjmotion.output.result import Result
from mjmotion.scene import Scene, flat, stairs

RISE = 0.15  # of the step [m]
SAME = 1e-12
KEPT, KNEE, EFFORT = 90.0, 8.0, 1.5  # [%], [°], and of the source's


@functools.cache
def clip() -> Motion:
    motion = load_clip("walk")
    return motion.replace(motion.qpos[:200])


@functools.cache
def scene(name: str) -> Scene:
    step = stairs(steps=1, rise=RISE, landing=12.0, distance=1.5)
    return Scene.from_spec(flat() if name == "level" else step, name)


@functools.cache
def planned(name: str) -> Plan:
    return make_plan(clip(), scene(name))


@functools.cache
def adapted(name: str) -> Result:
    return adapt(clip(), scene(name))


def test_a_step_is_walked_up() -> None:
    result = adapted("step")
    risen = result.motion.qpos[:, 2] - result.source.qpos[:, 2]
    assert risen[-1] == pytest.approx(RISE, abs=0.02) and abs(risen[0]) < 0.02
    figures = result.validate().metrics
    assert figures["contact_kept_percent"] >= KEPT
    assert figures["stance_knee_bend_deg"] <= KNEE
    assert figures["com_acceleration_ratio"] <= EFFORT
    assert figures["stance_gap_max_mm"] < 1.0 and figures["obstacle_penetration_mm"] == 0.0


def test_on_level_ground_the_root_stays() -> None:
    plan = planned("level")
    assert np.abs(plan.root_shift).max() < 0.01
    assert plan.contacts == make_plan(clip(), scene("level"), plan.contacts).contacts


def hips_apart(plan: Plan, shift: np.ndarray, heel: bool) -> tuple[np.ndarray, np.ndarray]:
    """How far hip and ankle are apart where a foot stands, and how far they were [m]."""
    model, source = plan.source.model, plan.source
    pose = Kinematics(model, source.nframe).forward(source.qpos)
    now, was = [], []
    for path, foot in zip(plan.paths, source.character.feet, strict=True):
        hip = pose.xanchor[:, model.joint(f"{foot.side}_hip").id]
        joint = model.joint(f"{foot.side}_ankle").id
        lever = model.jnt_pos[joint] - model.site_pos[model.site(path.site).id]
        ankle = path.position + rotate(path.quat, np.broadcast_to(lever, path.position.shape))
        frames = path.stance.copy()
        if heel:
            frames &= contact_mask(plan.contacts, f"{foot.side}_heel", source.nframe)
        now.append(np.linalg.norm(hip + shift - ankle, axis=1)[frames])
        was.append(np.linalg.norm(hip - pose.xanchor[:, joint], axis=1)[frames])
    return np.concatenate(now), np.concatenate(was)


def test_no_standing_leg_is_asked_for_more_than_it_reaches() -> None:
    """The paper's shift, the feet's mean, asks the lower leg for centimetres too many."""
    plan = planned("step")
    long = THIGH + SHANK
    most = 0.0
    for shift in (plan.root_shift, mean_shift(plan.source, plan.paths)):
        now, was = hips_apart(plan, shift, heel=True)
        over = now - np.clip(was, 0.97 * long, 0.995 * long)
        if shift is plan.root_shift:
            assert over.max() < 0.006
        else:
            most = over.max()
    assert most > 0.015


def test_a_foot_pushes_off_where_the_root_rises_too_early() -> None:
    plan = planned("level")
    source = plan.source
    pose = Kinematics(source.model, source.nframe).forward(source.qpos)
    rolling, _ = root_shift(source, pose, plan.paths, plan.contacts, ROLLING)
    for tip in push_offs(source, pose, plan.paths, plan.contacts, rolling):
        assert tip.max() < 0.02  # 2 mm at the ankle, over a ball that is 0.14 m from it
    risen = rolling + (0.0, 0.0, 0.06)
    tips = push_offs(source, pose, plan.paths, plan.contacts, risen)
    for tip, foot in zip(tips, source.character.feet, strict=True):
        heel = contact_mask(plan.contacts, f"{foot.side}_heel", source.nframe)
        assert tip.max() > 0.1 and (tip[heel] == 0.0).all() and tip.min() >= 0.0


# Ankles


def standing(foot: Foot, position: np.ndarray, nframe: int) -> FootPath:
    """A foot that stands at a place all the time."""
    still = np.tile((1.0, 0.0, 0.0, 0.0), (nframe, 1))
    place, none = np.tile(position, (nframe, 1)), np.zeros((nframe, 3))
    return FootPath(foot.site, place, still, none, np.ones(nframe, bool), *np.zeros((2, nframe)))


def test_a_heel_keeps_both_stretches_about_a_bad_frame() -> None:
    foot, nframe, bad = clip().character.feet[0], 200, 100
    still = standing(foot, np.zeros(3), nframe)
    tip = np.zeros((nframe, 3))
    tip[bad, 1] = 0.1
    quat = exp(tip)
    position = rotate(still.quat, foot.toe) - rotate(quat, foot.toe)
    turned = dataclasses.replace(still, position=position, quat=quat)
    heel, toe = Contact("left_heel", 0, nframe), Contact("left_toe", 0, nframe)
    other = Contact("right_heel", 0, nframe)
    shortest = SHORTEST * 30.0
    left = trim_heel_contacts([heel, other, toe], foot, still, turned, shortest)
    assert set(left) == {
        Contact("left_heel", 0, bad),
        Contact("left_heel", bad + 1, nframe),
        toe,
        other,
    }
    assert set(trim_heel_contacts([heel, toe], foot, still, still, shortest)) == {heel, toe}
    short = Contact("left_heel", bad - 1, nframe)
    assert trim_heel_contacts([short], foot, still, turned, shortest) == [
        Contact("left_heel", bad + 1, nframe)
    ]


def crouch(ankle: float, nframe: int = 60) -> Motion:
    """Standing still on flat feet with both shanks tilted forwards by ``ankle``, hips over them."""
    model = humanoid()
    qpos = np.tile(model.qpos0, (nframe, 1))
    back = np.arcsin(SHANK * np.sin(ankle) / THIGH)  # of the thighs
    for side in ("left", "right"):
        for joint, angle in ((f"{side}_hip", -back), (f"{side}_ankle", -ankle)):
            at = model.joint(joint).qposadr[0]
            qpos[:, at], qpos[:, at + 2] = np.cos(angle / 2.0), np.sin(angle / 2.0)
        qpos[:, model.joint(f"{side}_knee").qposadr[0]] = ankle + back
    hip = THIGH * np.cos(back) + SHANK * np.cos(ankle)
    qpos[:, 2] -= THIGH + SHANK - hip
    return Motion(clip().character, qpos, 30.0)


@pytest.mark.parametrize("spare", [0.1, 0.003])
def test_an_ankle_at_its_limit_stands_on_level_ground(spare: float) -> None:
    """What the source bends is no lack, however near the limit it is."""
    motion = crouch(0.6981 - spare)
    contacts = [
        Contact(f"{side}_{part}", 0, 60) for side in ("left", "right") for part in ("heel", "toe")
    ]
    plan = make_plan(motion, scene("level"), contacts)
    assert set(plan.contacts) == set(contacts)
    result = adapt(motion, scene("level"), contacts=contacts)
    assert set(result.contacts) == set(contacts)
    assert np.abs(result.motion.qpos - result.source.qpos).max() < 0.01


def test_an_ankle_that_can_bend_no_further_holds_the_root_up() -> None:
    """One foot on a step, knees well bent: the higher foot's heel asks for more than the mean."""
    motion, rise = crouch(0.60), 0.12
    pose = Kinematics(motion.model, motion.nframe).forward(motion.qpos)
    paths = []
    for foot, height in zip(motion.character.feet, (0.0, rise), strict=True):
        place = pose.site_xpos[0, site_id(motion.model, foot.site)] + (0.0, 0.0, height)
        path = standing(foot, place, motion.nframe)
        paths.append(dataclasses.replace(path, shift=path.shift + (0.0, 0.0, height)))
    low = [Contact("left_heel", 0, 60), Contact("left_toe", 0, 60)]
    both = [*low, Contact("right_heel", 0, 60), Contact("right_toe", 0, 60)]
    free = root_shift(motion, pose, paths, low)[0][:, 2]
    held = root_shift(motion, pose, paths, both)[0][:, 2]
    np.testing.assert_allclose(free, rise / 2.0, atol=0.003)
    assert (held > rise / 2.0 + 0.01).all() and (held < rise + 0.003).all()


def test_hips_stay_back_where_an_ankle_would_bend_too_far() -> None:
    """On a slope of 34°, facing up it: an upright shank needs hips further back."""
    motion, slope = crouch(0.2), np.radians(34.0)
    pose = Kinematics(motion.model, motion.nframe).forward(motion.qpos)
    flat_paths, paths, contacts = [], [], []
    for foot in motion.character.feet:
        place = pose.site_xpos[0, site_id(motion.model, foot.site)]
        flat_paths.append(standing(foot, place, motion.nframe))
        tilted = np.tile(exp(np.array((0.0, -slope, 0.0))), (motion.nframe, 1))
        paths.append(dataclasses.replace(flat_paths[-1], quat=tilted))
        contacts += [Contact(f"{foot.side}_{part}", 0, motion.nframe) for part in ("heel", "toe")]
    level, _ = root_shift(motion, pose, flat_paths, contacts)
    uphill, back = root_shift(motion, pose, paths, contacts)
    assert np.abs(level).max() < 0.003
    # Back along the way that it faces, which is +x, and no further than it may.
    assert (uphill[:, 0] < -0.02).all() and (uphill[:, 0] >= -MOST_BACK).all()
    np.testing.assert_allclose(uphill[:, 1], 0.0, atol=1e-6)
    np.testing.assert_allclose(back, -uphill[:, 0], atol=0.003)
    # With heels off the ground nothing asks for it.
    toes = [contact for contact in contacts if contact.site.endswith("toe")]
    np.testing.assert_allclose(root_shift(motion, pose, paths, toes)[0][:, 0], 0.0, atol=1e-6)


@pytest.mark.parametrize("fps", [30.0, 120.0])
def test_a_little_lack_of_an_ankle_costs_a_heel_little(fps: float) -> None:
    """2° too much at one moment lift the heel for a tenth of a second or so, at every rate."""
    count, (foot, _) = round(3.0 * fps), clip().character.feet
    still = crouch(0.5, 2)
    motion = Motion(still.character, np.tile(still.qpos[:1], (count, 1)), fps)
    pose = Kinematics(motion.model, 1).forward(motion.qpos[:1])
    path = standing(foot, pose.site_xpos[0, site_id(motion.model, foot.site)], count)
    # The foot tips up about its heel for a moment, to beyond what an ankle bends.
    time = (np.arange(count) / fps - 1.5) / 0.1
    beyond = 0.6981 + np.radians(2.0) - 0.5
    tip = np.zeros((count, 3))
    tip[:, 1] = -beyond * np.exp(-(time**2))
    path = dataclasses.replace(path, quat=exp(tip))
    contacts = [Contact("left_heel", 0, count), Contact("left_toe", 0, count)]
    (given, *_), left = relax_ankles(motion, (foot,), (path,), contacts)
    heels = [contact for contact in left if contact.site == "left_heel"]
    lost = count - sum(contact.end - contact.start for contact in heels)
    assert len(heels) == 2 and 0 < lost <= 0.3 * fps
    kept = contact_mask(left, "left_heel", count)
    np.testing.assert_allclose(given.quat[kept], path.quat[kept], atol=SAME)


def test_a_foot_lands_flat_where_its_ankle_cannot_land_on_the_heel() -> None:
    count, (foot, _) = 60, clip().character.feet
    motion = crouch(0.6, count)
    pose = Kinematics(motion.model, 1).forward(motion.qpos[:1])
    path = standing(foot, pose.site_xpos[0, site_id(motion.model, foot.site)], count)
    tip = np.zeros((count, 3))
    tip[10:20, 1] = -np.linspace(0.3, 0.0, 10)  # on its heel, down to flat
    heel_first = dataclasses.replace(path, quat=exp(tip))
    stance = Stance(0, (10, 50), (20, 55), path.position[0], path.quat[0])
    (landed,) = flat_landings(motion, (foot,), (heel_first,), (stance,))
    assert landed.toe == (10, 55) and landed.heel == stance.heel
    easy = crouch(0.1, count)
    assert flat_landings(easy, (foot,), (heel_first,), (stance,)) == (stance,)
    for heel in ((20, 50), (0, 0)):  # toes first, and toes alone
        other = dataclasses.replace(stance, heel=heel)
        assert flat_landings(motion, (foot,), (heel_first,), (other,)) == (other,)
