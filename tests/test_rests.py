"""Knees, palms and a seat that rest are contacts; tiptoe stays; a foot without toes is level."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from made_up import character, walk
from named_skeletons import walk_on
from postures import all_fours, crawl, held, on_knees, on_one_knee, seated

from mjmotion.apps.adaptation import adapt
from mjmotion.body.kinematics import Kinematics, site_id, site_positions
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.clips.mapping import map_clip
from mjmotion.clips.skeleton import Clip
from mjmotion.constraints import SiteConstraint
from mjmotion.fitting import fit
from mjmotion.footsteps.contacts import Contact, detect_contacts, load_contacts, save_contacts
from mjmotion.footsteps.planning import make_plan
from mjmotion.numerics.rotations import exp, from_matrix, multiply, rotate
from mjmotion.scene import Scene, load_scene
from mjmotion.scene.builders import flat
from mjmotion.validation import validate

KNEES, PALMS = {"left_knee", "right_knee"}, {"left_palm", "right_palm"}
LEFT_FOOT = {"left_heel", "left_toe"}
FEET = LEFT_FOOT | {"right_heel", "right_toe"}
POSTURES = {
    "all fours": (all_fours, KNEES | PALMS),
    "both knees": (on_knees, KNEES),
    "one knee": (on_one_knee, {"right_knee"} | LEFT_FOOT),
    "seated": (seated, {"seat"} | FEET),
}
HEEL = 0.01  # [m] heels of a mapped clip are within this of the recording's
FIGURES = ("stance_drift_mm", "stance_gap_max_mm", "sole_penetration_mm", "contact_kept_percent")


def step(height: float, x: float) -> Scene:
    """A level floor with a wide step from x on."""
    spec = flat()
    spec.worldbody.add_geom(
        name="step", type=6, size=(2.0, 2.0, 0.5), pos=(x + 2.0, 0.0, height - 0.5)
    )
    return Scene.from_spec(spec)


def heights(motion: Motion, *sites: str) -> np.ndarray:
    ids = np.array([site_id(motion.model, site) for site in sites])
    return site_positions(motion.model, motion.qpos, ids)[..., 2]


@pytest.mark.parametrize("name", POSTURES)
def test_what_rests_is_a_contact_for_as_long_as_it_does(name: str) -> None:
    posture, sites = POSTURES[name]
    motion = held(posture(), seconds=2.0)
    found = detect_contacts(motion)
    assert {one.site for one in found} == sites
    assert all((one.start, one.end) == (0, motion.nframe) and one.stands for one in found)


def test_a_walk_rests_on_nothing_but_its_feet() -> None:
    found = detect_contacts(load_clip("walk"))
    assert found and not any(one.rests for one in found)
    scene = load_scene("flat")
    assert make_plan(walk(), scene).rests == () and make_plan(walk(), scene).knees == ()


@pytest.mark.parametrize("name", POSTURES)
def test_a_recorded_posture_is_mapped_and_adapted_as_it_is(name: str) -> None:
    """Written on a skeleton and read again: as high as it was, and every figure holds."""
    posture, sites = POSTURES[name]
    motion = held(posture(), seconds=2.0)
    mapped = map_clip(walk_on("Mixamo", motion)[0], character()).motion
    names = ("pelvis", "left_knee", "right_knee", "left_heel", "right_toe", "seat")
    np.testing.assert_allclose(heights(mapped, *names), heights(motion, *names), atol=0.002)
    result = adapt(mapped, "flat")
    assert {one.site for one in result.contacts} == sites and not result.unmet
    broken = validate(result.source, result.motion, result.contacts).broken()
    assert not set(broken) & set(FIGURES)


def test_a_crawl_keeps_its_spots() -> None:
    motion = crawl(cycles=2)
    mapped = map_clip(walk_on("Mixamo", motion)[0], character()).motion
    result = adapt(mapped, "flat")
    assert {one.site for one in result.contacts} == KNEES | PALMS
    figures = validate(result.source, result.motion, result.contacts).metrics
    assert figures["stance_drift_mm"] < 1.0 and figures["stance_gap_max_mm"] < 2.0
    assert figures["sole_penetration_mm"] < 10.0 and figures["jerk_ratio_rms"] < 1.3


def test_palms_go_up_on_to_a_step_before_the_knees() -> None:
    motion = held(all_fours(), seconds=2.0)
    model = character().model
    ids = np.array([site_id(model, site) for site in ("left_palm", "left_knee")])
    palm, knee = site_positions(model, motion.qpos[:1], ids)[0, :, 0]
    assert palm > knee + 0.2
    result = adapt(motion, step(0.05, 0.5 * (palm + knee)), heading="keep")
    assert not result.unmet
    np.testing.assert_allclose(heights(result.motion, *PALMS), 0.05, atol=0.002)
    np.testing.assert_allclose(heights(result.motion, *KNEES), 0.0, atol=0.002)


def test_contacts_files_name_knees_and_palms(tmp_path) -> None:  # type: ignore[no-untyped-def]
    contacts = (Contact("left_knee", 0, 9), Contact("right_palm", 3, 7), Contact("seat", 1, 4))
    save_contacts(tmp_path / "c.json", contacts)
    model = character().model
    assert set(load_contacts(tmp_path / "c.json", model, 10)) == set(contacts)


def test_a_palm_over_the_ground_is_a_gap() -> None:
    """The figures tell it, and a fit cannot hide it."""
    motion = held(all_fours(), seconds=1.0)
    result = adapt(motion, "flat", heading="keep")
    raised = np.array(result.motion.qpos)
    raised[:, 2] += 0.02
    figures = validate(result.source, result.motion.replace(raised), result.contacts)
    assert figures.metrics["stance_gap_max_mm"] == pytest.approx(20.0, abs=1.0)


def on_tiptoe(motion: Motion, angle: float) -> Motion:
    """Return a walk whose feet are turned heel up by an angle about their balls [rad]."""
    pose = Kinematics(motion.model, motion.nframe).forward(motion.qpos)
    tip, frames = exp(np.array((0.0, angle, 0.0))), np.arange(motion.nframe)
    constraints = []
    for foot in character().feet:
        site = site_id(motion.model, foot.site)
        quat, place = from_matrix(pose.site_xmat[:, site]), pose.site_xpos[:, site]
        turned = multiply(quat, tip[None])
        ball = rotate(quat, foot.toe[None]) - rotate(turned, foot.toe[None])
        constraints.append(SiteConstraint(foot.site, frames, place + ball, turned))
    guess = np.zeros((motion.nframe, 3))
    guess[:, 2] = 0.13 * np.sin(angle)
    qpos = fit(motion, constraints, first_guess=guess).motion.qpos
    for foot in character().feet:
        assert foot.toes is not None
        qpos = foot.toes.put(qpos, foot.bend(pose) + angle)
    return motion.replace(qpos)


def without_toes(clip: Clip) -> Clip:
    """Return a clip whose feet have neither toes nor ends."""
    keep = [i for i, name in enumerate(clip.joint_names) if "Toe" not in name]
    number = {old: new for new, old in enumerate(keep)}
    return dataclasses.replace(
        clip,
        joint_names=tuple(clip.joint_names[i] for i in keep),
        parents=np.array([number.get(int(clip.parents[i]), -1) for i in keep]),
        offsets=clip.offsets[keep],
        positions=clip.positions[:, keep],
        rotations=clip.rotations[:, keep],
        ends={name: end for name, end in clip.ends.items() if "Toe" not in name},
    )


@pytest.mark.parametrize("toes", [True, False])
@pytest.mark.parametrize("degrees", [0.0, 15.0, 30.0])
def test_a_walk_on_tiptoe_stays_on_tiptoe(degrees: float, toes: bool) -> None:
    motion = on_tiptoe(load_clip("straight"), np.radians(degrees))
    clip, _ = walk_on("Mixamo", motion)
    mapped = map_clip(clip if toes else without_toes(clip), character()).motion
    names = ("left_heel", "right_heel", "left_toe", "right_toe")
    np.testing.assert_allclose(heights(mapped, *names), heights(motion, *names), atol=HEEL)
    result = adapt(mapped, "flat", heading="keep")
    heels = any(one.site.endswith("_heel") for one in result.contacts)
    assert heels == (degrees == 0.0)


def test_heels_that_rise_within_a_stance_and_come_down_again_are_up_between() -> None:
    stand = np.array(character().model.qpos0)
    still = held(stand, seconds=1.0)
    up = on_tiptoe(held(stand, seconds=1.0), np.radians(30.0))
    motion = held(still.qpos[0], up.qpos[0], still.qpos[0], moving=0.5)
    result = adapt(motion, "flat", heading="keep")
    middle = motion.nframe // 2
    source, fitted = (heights(one, "left_heel", "left_toe") for one in (motion, result.motion))
    assert source[middle, 0] > 0.08
    np.testing.assert_allclose(fitted[middle], source[middle], atol=HEEL)
    assert sum(one.site == "left_heel" for one in result.contacts) == 2
