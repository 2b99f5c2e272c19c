"""Knees turn outwards where legs would be in each other, and nowhere else."""

from __future__ import annotations

import functools

import mujoco
import numpy as np
import pytest
from made_up import character, walk

from mjmotion.apps.adaptation import adapt
from mjmotion.apps.clearing import with_knees_apart
from mjmotion.body.assets import find_asset
from mjmotion.body.character import Character
from mjmotion.body.kinematics import Kinematics, character_geoms
from mjmotion.body.motion import Motion
from mjmotion.constraints import SiteConstraint
from mjmotion.fitting import fit
from mjmotion.footsteps.knees_apart import knees_apart
from mjmotion.footsteps.planning import make_plan
from mjmotion.numerics.tangent import oplus
from mjmotion.scene import Scene, flat
from mjmotion.validation.self_overlap import SelfOverlap, beyond

LEGS = [f"{side}_{part}" for side in ("left", "right") for part in ("thigh", "shank", "foot")]
KNOCK = 0.5  # by how much knees are turned inwards [rad]
SITES = ("left_shin", "left_foot")
ROOM = 0.3  # time before and after in which they are turned out [s]


@functools.cache
def clip() -> Motion:
    return walk(2.4)


def knocked(motion: Motion, first: int, last: int) -> Motion:
    """Both knees turned inwards from frame to frame, feet where they were."""
    limbs = motion.character.chains(
        tuple(motion.character.limb_by_end[foot.body] for foot in motion.character.feet)
    )
    _, _, swivel = limbs.closure(limbs.state(motion.qpos))
    time = np.clip((np.arange(motion.nframe) - first) / (last - first), 0.0, 1.0)
    inwards = KNOCK * np.sin(np.pi * time) ** 2
    step = np.zeros((motion.nframe, motion.model.nv))
    # About the line down the leg, the left knee goes to the right and the right one to the left.
    for number, sign in ((0, 1.0), (1, -1.0)):
        step[:, limbs.dofs[number]] = sign * inwards[:, None] * swivel[:, number]
    return motion.replace(oplus(motion.model, motion.qpos, step))


def overlap(motion: Motion, source: Motion) -> float:
    """How much deeper legs are in each other than the source's ever [m], by MuJoCo itself."""
    model = motion.model
    ids = [model.body(name).id for name in LEGS]
    geoms = character_geoms(model, colliding=True)
    geoms = geoms[np.isin(model.geom_bodyid[geoms], ids)]
    judge = SelfOverlap(model, geoms)
    return float(beyond(judge.overlaps(motion.qpos), judge.overlaps(source.qpos)).max(initial=0.0))


def places(motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """Feet (nframe, 2, 12): places and turns; and knees (nframe, 2, 3) [m]."""
    pose = Kinematics(motion.model, motion.nframe).forward(motion.qpos)
    feet = [motion.model.body(f"{side}_foot").id for side in ("left", "right")]
    shanks = [motion.model.body(f"{side}_shank").id for side in ("left", "right")]
    turns = pose.xmat[:, feet].reshape(motion.nframe, 2, 9)
    return np.concatenate((pose.xpos[:, feet], turns), axis=2), pose.xpos[:, shanks]


def test_knees_that_meet_are_turned_out() -> None:
    source = clip()
    meeting = knocked(source, 20, 50)
    assert overlap(meeting, source) > 0.02
    apart = knees_apart(meeting, source)
    assert overlap(apart, source) < 1e-3
    was, now = places(meeting), places(apart)
    np.testing.assert_allclose(now[0], was[0], atol=1e-9)
    # Outwards: the left knee to the left. Along +x that is +y.
    assert (now[1] - was[1])[:, 0, 1].min() > -1e-3 and (now[1] - was[1])[:, 0, 1].max() > 0.01
    assert (now[1] - was[1])[:, 1, 1].max() < 1e-3 and (now[1] - was[1])[:, 1, 1].min() < -0.01
    # Hips and ankles alone, around the frames that meet.
    moved = np.abs(apart.qpos - meeting.qpos)
    model = character().model
    mine = np.zeros(model.nq, dtype=bool)
    for side in ("left", "right"):
        for joint in ("hip", "ankle"):
            at = int(model.joint(f"{side}_{joint}").qposadr[0])
            mine[at : at + 4] = True
    np.testing.assert_array_equal(moved[:, ~mine], 0.0)
    room = round(ROOM * source.fps)
    assert moved[: 20 - room].max(initial=0.0) < 0.01 and moved[50 + room :].max() < 0.01
    within = source.character.limits.excess
    assert within(apart.qpos).max() <= within(meeting.qpos).max() + 1e-9


def test_the_way_out_is_smooth() -> None:
    """Its jerk is no more than that of a swivel of as much within a fifth of a second."""
    source = clip()
    meeting = knocked(source, 20, 50)
    apart = knees_apart(meeting, source)
    model = source.model
    at = int(model.joint("left_hip").qposadr[0])
    step = (apart.qpos - meeting.qpos)[:, at : at + 4]
    jerk = np.abs(np.diff(step, 3, axis=0)).max() * source.fps**3
    assert jerk < np.abs(step).max() * (np.pi / 0.2) ** 3


def test_legs_that_do_not_meet_are_left_alone() -> None:
    source = clip()
    assert knees_apart(source, source) is source
    inwards = knocked(source, 20, 50)
    assert knees_apart(inwards, inwards) is inwards  # so is the source


def test_what_is_asked_of_a_shank_comes_first() -> None:
    """Turning a knee out would take from its target what the fit has given it."""
    spec = mujoco.MjSpec.from_file(str(find_asset("model", "humanoid")))
    spec.body("left_shank").add_site(name="left_shin")
    source = Motion(Character.of(spec.compile()), clip().qpos, clip().fps)
    plan = make_plan(source, Scene.from_spec(flat()))
    fitted = fit(knocked(plan.source, 20, 50), [], levels=[8.0])
    asked = [SiteConstraint(site, np.array([30]), np.zeros((1, 3))) for site in SITES]
    assert with_knees_apart(plan, fitted, asked[:1], None) is fitted
    assert with_knees_apart(plan, fitted, asked[1:], None).motion is not fitted.motion


def test_a_level_walk_is_untouched(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene.from_spec(flat())
    result = adapt(clip(), scene)
    monkeypatch.setattr(
        "mjmotion.apps.adaptation.with_knees_apart", lambda plan, fitted, *_: fitted
    )
    np.testing.assert_array_equal(adapt(clip(), scene).motion.qpos, result.motion.qpos)
