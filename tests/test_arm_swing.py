"""Arms swing with thighs that are lifted higher than the source's, and with nothing else."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from mjmotion.apps.adaptation import adapt
from mjmotion.body.character import Character
from mjmotion.body.kinematics import Kinematics, level_side
from mjmotion.body.motion import Motion
from mjmotion.clips.gait import Segment, make_walk
from mjmotion.constraints import SiteConstraint
from mjmotion.footsteps.arm_swing import MOST, SHARE, arms_swung
from mjmotion.numerics.rotations import exp, multiply
from mjmotion.scene import Scene, flat
from mjmotion.scene.builders import stairs

FPS = 60.0
RAISED = 0.6  # by how much a thigh is raised at most [rad]
ARM = ("shoulder", "elbow", "wrist")


@functools.cache
def clip() -> Motion:
    return make_walk(Character.of("humanoid"), segments=[Segment("straight", 4)], fps=FPS)


def raised(motion: Motion, size: float) -> tuple[Motion, np.ndarray]:
    """The left thigh raised further for 0.8 s, whole for 0.4 s, and by how much (nframe,) [rad]."""
    time = np.arange(motion.nframe) / motion.fps
    bump = size * np.clip(2.0 - np.abs(time - 2.0) / 0.2, 0.0, 1.0)
    at = int(motion.model.joint("left_hip").qposadr[0])
    qpos = np.array(motion.qpos)
    # About the pelvis' own side axis, which is all but level in a walk.
    back = exp(np.outer(-bump, (0.0, 1.0, 0.0)))
    qpos[:, at : at + 4] = multiply(back, qpos[:, at : at + 4])
    return motion.replace(qpos), bump


def lift(motion: Motion, upper: str, lower: str) -> np.ndarray:
    """How far forwards a bone is lifted (nframe,) [rad]."""
    pose = Kinematics(motion.model, motion.nframe).forward(motion.qpos)
    bone = pose.xpos[:, motion.model.body(lower).id] - pose.xpos[:, motion.model.body(upper).id]
    ahead = np.cross(level_side(pose), (0.0, 0.0, 1.0))
    return np.arctan2((bone * ahead).sum(axis=1), -bone[:, 2])


def numbers(motion: Motion, side: str) -> np.ndarray:
    """What of qpos is an arm's, (nframe, k)."""
    columns: list[int] = []
    for name, size in zip(ARM, (4, 1, 4), strict=True):
        at = int(motion.model.joint(f"{side}_{name}").qposadr[0])
        columns.extend(range(at, at + size))
    return motion.qpos[:, columns]


def test_the_opposite_arm_swings_by_its_share() -> None:
    source = clip()
    motion, bump = raised(source, RAISED)
    swung = arms_swung(motion, source)
    gained = lift(swung, "right_upper_arm", "right_forearm")
    gained -= lift(motion, "right_upper_arm", "right_forearm")
    whole = bump == RAISED
    # The built-in walk's arms follow its thighs by more than a third.
    assert abs(gained[whole].mean() - SHARE * RAISED) < 0.1 * SHARE * RAISED
    assert gained.max() < 1.1 * SHARE * RAISED
    elbow = int(source.model.joint("right_elbow").qposadr[0])
    bent = (swung.qpos - motion.qpos)[:, elbow]
    assert 0.3 * SHARE * RAISED < bent.max() < 0.7 * SHARE * RAISED
    # Its speed is that of a step, not of a jerk: all of it within a tenth of a second at most.
    assert np.abs(np.diff(gained)).max() * FPS < SHARE * RAISED / 0.1
    # Nothing else, and nothing when no thigh is raised.
    np.testing.assert_array_equal(numbers(swung, "left"), numbers(motion, "left"))
    far = np.abs(np.arange(source.nframe) / FPS - 2.0) > 0.9
    np.testing.assert_array_equal(swung.qpos[far], motion.qpos[far])
    moved = (swung.qpos != motion.qpos).any(axis=0)
    shoulder = int(source.model.joint("right_shoulder").qposadr[0])
    assert set(np.flatnonzero(moved)) <= {*range(shoulder, shoulder + 4), elbow}


def test_it_is_bounded_and_little_is_nothing() -> None:
    source = clip()
    motion, _ = raised(source, 1.5)
    gained = lift(arms_swung(motion, source), "right_upper_arm", "right_forearm")
    gained -= lift(motion, "right_upper_arm", "right_forearm")
    assert 0.9 * MOST < gained.max() < 1.02 * MOST
    little, _ = raised(source, 0.05)
    assert arms_swung(little, source) is little
    lowered, _ = raised(source, -RAISED)
    assert arms_swung(lowered, source) is lowered


def test_arms_that_are_held_stay() -> None:
    source = clip()
    motion, _ = raised(source, RAISED)
    hand = int(source.model.site("right_hand").bodyid[0])
    assert arms_swung(motion, source, {hand}) is motion
    busy = np.zeros(source.nframe, dtype=bool)
    busy[round(2.3 * FPS) :] = True
    partly = arms_swung(motion, source, busy=busy)
    np.testing.assert_array_equal(partly.qpos[busy], motion.qpos[busy])
    assert np.abs(partly.qpos - motion.qpos).max() > 0.02
    # Arms that carry something in the source do not follow its thighs: nor do they here.
    qpos, carried = np.array(source.qpos), np.array(motion.qpos)
    for side in ("left", "right"):
        for name, size in zip(ARM, (4, 1, 4), strict=True):
            at = int(source.model.joint(f"{side}_{name}").qposadr[0])
            qpos[:, at : at + size] = carried[:, at : at + size] = source.qpos[0, at : at + size]
    trunk = int(source.model.joint("spine").qposadr[0])
    qpos[:, trunk : trunk + 4] = carried[:, trunk : trunk + 4] = source.qpos[0, trunk : trunk + 4]
    swung = arms_swung(motion.replace(carried), source.replace(qpos))
    assert np.abs(swung.qpos - carried).max() < 0.01


def blind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mjmotion.apps.adaptation.with_arms_swung", lambda plan, fitted, *_: fitted)


def test_on_level_ground_arms_are_as_they_were(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene.from_spec(flat())
    result = adapt(clip(), scene)
    blind(monkeypatch)
    np.testing.assert_array_equal(adapt(clip(), scene).motion.qpos, result.motion.qpos)


def test_on_stairs_arms_swing_further(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene.from_spec(stairs(rise=0.22))
    result = adapt(clip(), scene)
    asked = SiteConstraint("left_hand", np.array([10]), None, np.array([[1.0, 0.0, 0.0, 0.0]]))
    named = adapt(clip(), scene, constraints=[asked])
    blind(monkeypatch)
    without = adapt(clip(), scene)
    gained = {
        side: lift(result.motion, f"{side}_upper_arm", f"{side}_forearm")
        - lift(without.motion, f"{side}_upper_arm", f"{side}_forearm")
        for side in ("left", "right")
    }
    # One tread a step: the side that steps up the last lifts its thigh little more than before.
    assert min(gain.max() for gain in gained.values()) > 0.04
    assert max(gain.max() for gain in gained.values()) > 0.15
    assert max(gain.max() for gain in gained.values()) < 1.05 * MOST
    figures, before = result.validate(), without.validate()
    assert figures.metrics["self_overlap_mm"] < before.metrics["self_overlap_mm"] + 1.0
    assert figures.metrics["jerk_ratio_rms"] < before.metrics["jerk_ratio_rms"] + 0.02
    # What is asked of a hand is its own; the other arm swings.
    again = adapt(clip(), scene, constraints=[asked])
    np.testing.assert_allclose(numbers(named.motion, "left"), numbers(again.motion, "left"))
    assert np.abs(numbers(named.motion, "right") - numbers(again.motion, "right")).max() > 0.05
