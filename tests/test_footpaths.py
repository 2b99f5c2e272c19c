"""Foot paths of a made-up walk over slopes, steps and beams: held in stance, clear in swing."""

from __future__ import annotations

import functools
import itertools
from pathlib import Path

import mujoco
import numpy as np
import pytest
from made_up import some, walk

from mjmotion.body.kinematics import Kinematics
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.footsteps.contacts import Contact, contact_mask, detect_contacts
from mjmotion.footsteps.footholds import find_footholds
from mjmotion.footsteps.paths import FootPath, foot_path
from mjmotion.footsteps.stances import find_stances
from mjmotion.numerics.rotations import conjugate, log, multiply, rotate
from mjmotion.scene import Scene
from mjmotion.scene.ground import Ground

DRIFT = 1e-4  # of a contact's point over its contact [m]
STANDING_SINK = 0.0015  # of the sole of a foot that stands [m]
RECORDINGS = Path(__file__).parents[2] / "shared" / "mocap" / "bvh"
SINK = 0.005  # of the foot below the ground, in stance and swing [m]
FLAT = '<geom type="plane" size="30 30 .1"/>'
GROUNDS = {
    "flat": FLAT,
    "up": '<geom type="plane" size="30 30 .1" euler="0 -8 0"/>',
    "across": '<geom type="plane" size="30 30 .1" euler="6 0 0"/>',
    "step": FLAT + '<geom type="box" size="5 5 .06" pos="5.8 0 .06"/>',
}


@functools.cache
def clip(fps: float = 30.0) -> Motion:
    return walk(3.6, fps)


def paths_on(body: str, motion: Motion) -> tuple[list[FootPath], tuple[Contact, ...], Ground]:
    xml = f"<mujoco><worldbody>{body}</worldbody></mujoco>"
    ground = Scene.from_spec(mujoco.MjSpec.from_string(xml)).ground
    contacts, feet = detect_contacts(motion), motion.character.feet
    pose = Kinematics(motion.model, motion.nframe).forward(motion.qpos)
    stances = find_stances(motion, pose, feet, contacts)
    holds = find_footholds(stances, feet, ground, 0.0)
    paths = [
        foot_path(foot, index, pose, stances, holds, ground, motion.fps)
        for index, foot in enumerate(feet)
    ]
    return paths, contacts, ground


@functools.cache
def paths(name: str) -> tuple[list[FootPath], tuple[Contact, ...], Ground]:
    return paths_on(GROUNDS[name], clip())


def source(index: int) -> np.ndarray:
    motion = clip()
    pose = Kinematics(motion.model, motion.nframe).forward(motion.qpos)
    return pose.site_xpos[:, motion.model.site(motion.character.feet[index].site).id]


@pytest.mark.parametrize("name", sorted(GROUNDS))
def test_contacts_do_not_drift(name: str) -> None:
    """Heel and toe stay where they are over each contact, on the ground."""
    found, contacts, ground = paths(name)
    for path, foot in zip(found, clip().character.feet, strict=True):
        for contact in contacts:
            side, part = contact.site.split("_")
            if side != foot.side:
                continue
            span = slice(contact.start, contact.end)
            local = foot.heel if part == "heel" else foot.toe
            point = path.position[span] + rotate(path.quat[span], np.asarray(local))
            assert np.abs(point - point.mean(axis=0)).max() < DRIFT
            height, _ = ground.under(point)
            assert np.abs(point[:, 2] - height).max() < SINK
            assert path.stance[span].all()


@pytest.mark.parametrize("name", sorted(GROUNDS))
def test_feet_stay_above_the_ground(name: str) -> None:
    found, _, ground = paths(name)
    for path, foot in zip(found, clip().character.feet, strict=True):
        sole = path.position[:, None] + rotate(path.quat[:, None], foot.sole[None])
        height, _ = ground.under(sole)
        assert np.nanmin(sole[..., 2] - height) > -SINK


def test_level_ground_changes_nothing() -> None:
    """The made-up walk stands level already: stances stay, swings are lifted a little at most."""
    found, _, _ = paths("flat")
    for index, path in enumerate(found):
        np.testing.assert_allclose(path.position[:, :2], source(index)[:, :2], atol=0.005)
        np.testing.assert_allclose(path.position[:, 2], source(index)[:, 2], atol=0.025)
        assert np.median(np.abs(path.position - source(index)).max(axis=1)) < 0.001
        assert np.abs(log(path.quat)).max() < 0.02
        assert np.abs(path.shift).max() < 0.005
        assert path.lift.max() < 0.025


def test_the_carry_is_constant_in_stance_and_tilted_like_the_slope() -> None:
    found, contacts, _ = paths("up")
    for index, (path, foot) in enumerate(zip(found, clip().character.feet, strict=True)):
        heel, toe = (
            contact_mask(contacts, f"{foot.side}_{p}", clip().nframe) for p in ("heel", "toe")
        )
        flat = heel & toe
        pitch = log(path.quat)[:, 1]
        np.testing.assert_allclose(pitch[flat], -np.radians(8.0), atol=0.005)
        slope = path.shift[:, 2] - source(index)[:, 0] * np.tan(np.radians(8.0))
        assert np.abs(slope[flat]).max() < 0.005
        edges = np.flatnonzero(np.diff(flat.astype(int)) == 0)
        same = edges[flat[edges]]
        assert np.abs(np.diff(path.shift, axis=0)[same]).max() < 1e-12


def test_a_step_up_is_stepped_on() -> None:
    found, _, _ = paths("step")
    for path in found:
        ends = path.position[path.stance]
        on = ends[ends[:, 0] > 1.1]
        before = ends[ends[:, 0] < 0.4]
        assert len(on) and len(before)
        np.testing.assert_allclose(on[:, 2], 0.12, atol=SINK)
        np.testing.assert_allclose(before[:, 2], 0.0, atol=SINK)


def test_a_beam_across_the_way_is_lifted_over() -> None:
    """A beam as high as the swing, between two footholds: the foot rises in that swing alone."""
    flat, _, _ = paths("flat")
    index = 0
    stance = flat[index].stance
    position = flat[index].position
    swings = np.flatnonzero(np.diff(stance.astype(int)))
    # The second swing of the left foot, from where it leaves to where it lands.
    leave, land = next((a, b) for a, b in itertools.pairwise(swings) if not stance[b])
    x = 0.5 * (position[leave, 0] + 0.197 + position[land + 1, 0] - 0.058)
    y = float(position[leave, 1])
    beam = f'<geom type="box" size=".015 .08 .035" pos="{x} {y} .035"/>'
    found, _, ground = paths_on(FLAT + beam, clip())
    path, foot = found[index], clip().character.feet[index]
    sole = path.position[:, None] + rotate(path.quat[:, None], foot.sole[None])
    height, _ = ground.under(sole)
    assert np.nanmin(sole[..., 2] - height) > -SINK
    raised = np.flatnonzero(path.lift > flat[index].lift + 0.003)
    assert len(raised) and raised.min() > leave - 1 and raised.max() < land + 2
    np.testing.assert_allclose(found[1].position, flat[1].position, atol=1e-9)


@pytest.mark.parametrize("name", ["up", "across", "step"])
def test_paths_are_smooth(name: str) -> None:
    """Accelerations of the posed site stay within what the source's own are, and some [m/s²]."""
    found, _, _ = paths(name)
    for index, path in enumerate(found):
        mine, own = (
            np.linalg.norm(np.diff(p, n=2, axis=0), axis=1).max() * 30.0**2
            for p in (path.position, source(index))
        )
        assert mine < 1.6 * own + 12.0
        turn = log(multiply(conjugate(path.quat[:-1]), path.quat[1:])) * 30.0
        assert np.abs(turn).max() < 6.0  # [rad/s]


def test_the_same_at_120_frames_a_second() -> None:
    slow, fast = paths("up")[0], paths_on(GROUNDS["up"], clip(120.0))[0]
    for a, b in zip(slow, fast, strict=True):
        assert np.linalg.norm(a.position - b.position[::4], axis=1).mean() < 0.01
        assert np.linalg.norm(a.position - b.position[::4], axis=1).max() < 0.06


def test_a_foot_that_never_stands_keeps_its_path() -> None:
    motion = clip()
    feet = motion.character.feet
    pose = Kinematics(motion.model, motion.nframe).forward(motion.qpos)
    only = [c for c in detect_contacts(motion) if c.site.startswith("left")]
    stances = find_stances(motion, pose, feet, only)
    ground = paths("up")[2]
    holds = find_footholds(stances, feet, ground, 0.0)
    path = foot_path(feet[1], 1, pose, stances, holds, ground, 30.0)
    np.testing.assert_allclose(path.position, source(1), atol=1e-12)
    assert not path.stance.any() and (path.lift == 0.0).all() and (path.shift == 0.0).all()


@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="there are no recordings here")
@pytest.mark.parametrize("name", ["16_31", "03_01"])
def test_what_fades_in_after_a_contact_puts_no_sole_under_the_ground(name: str) -> None:
    """Recorded feet roll and flutter where contacts begin and end."""
    motion = load_clip(RECORDINGS / f"{name}.bvh")
    found, contacts, _ = paths_on(FLAT, motion)
    for path, foot in zip(found, motion.character.feet, strict=True):
        stands = np.zeros(motion.nframe, dtype=bool)
        for part in ("heel", "toe"):
            stands |= contact_mask(contacts, f"{foot.side}_{part}", motion.nframe)
        posed = foot.sole_at(some(foot.toes).settled(path.toes))
        sole = (path.position[:, None] + rotate(path.quat[:, None], posed))[..., 2]
        assert sole[stands].min() > -STANDING_SINK
