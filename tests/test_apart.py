"""Feet that would meet: swings that go aside, footholds beside each other, toes before risers."""

from __future__ import annotations

import dataclasses
import functools

import mujoco
import numpy as np
import pytest
from made_up import character, some, walk

from mjmotion.body.kinematics import Kinematics, Pose, site_id
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.footsteps.apart import ASIDE_PULL, BESIDE, aside
from mjmotion.footsteps.contacts import Contact, detect_contacts
from mjmotion.footsteps.footholds import CROSSING, FEET_APART, Foothold, find_footholds
from mjmotion.footsteps.paths import FootPath, foot_path
from mjmotion.footsteps.stances import Stance, contacts_of, find_stances
from mjmotion.numerics.rotations import rotate, yaw_quat
from mjmotion.scene import Scene
from mjmotion.scene.ground import Ground

CLOSE = 0.003  # that a smooth move may lack of a distance [m]
FLAT = '<geom type="plane" size="30 30 .1"/>'
IN_STEP = 0.002  # of a sole in a riser [m]


def ground(body: str) -> Ground:
    xml = f"<mujoco><worldbody>{body}</worldbody></mujoco>"
    return Scene.from_spec(mujoco.MjSpec.from_string(xml)).ground


@functools.cache
def flat_walk() -> tuple[Motion, Pose, list[FootPath]]:
    motion = walk(3.6)
    pose = Kinematics(motion.model, motion.nframe).forward(motion.qpos)
    feet = motion.character.feet
    stances = find_stances(motion, pose, feet, detect_contacts(motion))
    floor = ground(FLAT)
    holds = find_footholds(stances, feet, floor, 0.0)
    paths = [foot_path(f, i, pose, stances, holds, floor, motion.fps) for i, f in enumerate(feet)]
    return motion, pose, paths


def narrowed(by: float) -> list[FootPath]:
    """The paths of a walk, the feet brought so much nearer to each other."""
    left, right = flat_walk()[2]
    return [
        dataclasses.replace(path, position=path.position + (0.0, sign * by / 2.0, 0.0))
        for path, sign in ((left, -1.0), (right, 1.0))
    ]


def gap(paths: list[FootPath]) -> tuple[np.ndarray, np.ndarray]:
    """How far the left sole is left of the right one, and which frames they are side by side."""
    feet = character().feet
    left, right = (
        path.position[:, None] + rotate(path.quat[:, None], foot.shape[None])
        for path, foot in zip(paths, feet, strict=True)
    )
    beside = (left[..., 0].min(axis=1) < right[..., 0].max(axis=1)) & (
        right[..., 0].min(axis=1) < left[..., 0].max(axis=1)
    )
    return left[..., 1].min(axis=1) - right[..., 1].max(axis=1), beside


def test_feet_that_would_meet_pass_each_other() -> None:
    motion, pose, _ = flat_walk()
    paths = narrowed(0.1)
    moves = aside(motion.character.feet, paths, pose, motion.fps)
    moved = [
        dataclasses.replace(path, position=path.position + move)
        for path, move in zip(paths, moves, strict=True)
    ]
    before, _ = gap(paths)
    now, beside = gap(moved)
    # No foot can go aside at once: its first and last tenths of a second off are left out.
    off = [np.convolve(path.stance, np.ones(5), "same") == 0.0 for path in paths]
    swings = (off[0] | off[1]) & beside
    assert swings.sum() > 12
    assert before[swings].max() < BESIDE and (now[swings] > before[swings] - 1e-9).all()
    assert now[swings].min() > BESIDE - CLOSE
    for path, move, sign in zip(paths, moves, (1.0, -1.0), strict=True):
        assert (move[path.stance] == 0.0).all()
        assert (sign * move[:, 1] >= 0.0).all() and (move[:, 2] == 0.0).all()
        assert np.abs(np.diff(move, n=2, axis=0)).max() * motion.fps**2 < ASIDE_PULL


def test_feet_that_pass_with_room_go_straight() -> None:
    motion, pose, paths = flat_walk()
    assert gap(paths)[0].min() > BESIDE
    for move in aside(motion.character.feet, paths, pose, motion.fps):
        assert (move == 0.0).all()
    one = motion.character.feet[:1]
    assert len(aside(one, paths[:1], pose, motion.fps)) == 1


def test_feet_that_brush_in_the_source_may_do_so() -> None:
    motion, pose, _ = flat_walk()
    paths, places = narrowed(0.08), pose.site_xpos.copy()
    for path, foot in zip(paths, motion.character.feet, strict=True):
        places[:, site_id(motion.model, foot.site)] = path.position
    narrow = dataclasses.replace(pose, site_xpos=places)
    before, _ = gap(paths)
    assert before.max() < 0.5 * BESIDE
    for move in aside(motion.character.feet, paths, narrow, motion.fps):
        assert np.abs(move).max() < CLOSE


# Footholds


def stance(x: float, y: float, foot: int, start: int) -> Stance:
    span = (start, start + 12)
    return Stance(foot, span, span, np.array((x, y, 0.0)), yaw_quat(np.asarray(0.0)))


def stone(x: float, y: float) -> str:
    """A stepping stone just large enough for one foot that stands at (x, y)."""
    return f'<geom type="box" size=".18 .09 .1" pos="{x + 0.07} {y} -.1"/>'


def soles(holds: tuple[Foothold, ...]) -> list[np.ndarray]:
    feet = character().feet
    return [h.position + rotate(h.quat, feet[i].sole) for i, h in enumerate(holds)]


def test_two_feet_do_not_stand_on_one_stone() -> None:
    """The nearest stone for the right foot is the left one's: it takes the next."""
    feet = character().feet
    left, right = stance(0.0, 0.09, 0, 0), stance(0.03, -0.05, 1, 8)
    stones = ground(stone(0.0, 0.08) + stone(0.0, -0.22))
    alone = find_footholds((right,), feet, stones, 0.0)[0]
    assert alone.position[1] > 0.0  # it would be on the left foot's
    holds = find_footholds((left, right), feet, stones, 0.0)
    mine, other = soles(holds)
    assert mine[:, 1].min() - other[:, 1].max() > FEET_APART - 1e-9
    np.testing.assert_allclose([h.position[2] for h in holds], 0.0, atol=0.002)


def test_a_stone_ahead_may_be_across() -> None:
    """Behind or before the other a foot may cross over, by some centimetres."""
    feet = character().feet
    left, right = stance(0.0, 0.06, 0, 0), stance(0.24, -0.08, 1, 8)
    stones = ground(stone(0.0, 0.06) + stone(0.36, -0.03))
    mine, other = soles(find_footholds((left, right), feet, stones, 0.0))
    assert other[:, 0].min() > mine[:, 0].max()
    assert -CROSSING < mine[:, 1].min() - other[:, 1].max() < FEET_APART


def test_a_narrow_source_may_stand_as_narrow() -> None:
    """On level ground nothing moves, also where the source's feet are closer than ours may be."""
    feet, level = character().feet, ground(FLAT)
    for apart in (0.10, 0.18):
        pair = stance(0.0, apart / 2.0, 0, 0), stance(0.1, -apart / 2.0, 1, 8)
        assert max(hold.moved for hold in find_footholds(pair, feet, level, 0.0)) < 1e-9


def test_stances_give_back_their_contacts() -> None:
    motion, pose, _ = flat_walk()
    feet, contacts = motion.character.feet, detect_contacts(motion)
    again = contacts_of(find_stances(motion, pose, feet, contacts), feet)
    assert set(again) == set(contacts)
    assert [c.start for c in again] == sorted(c.start for c in again)
    toe = dataclasses.replace(stance(0.0, 0.0, 1, 0), heel=(0, 0), toe=(4, 9))
    rolled = dataclasses.replace(stance(0.0, 0.0, 0, 0), heel=(2, 5), toe=(3, 9))
    assert contacts_of((toe, rolled), feet) == (
        Contact("left_heel", 2, 5),
        Contact("left_toe", 3, 9),
        Contact("right_toe", 4, 9),
    )


# A swing next to a riser


@pytest.mark.parametrize("before", [0.04, 0.03])
@pytest.mark.parametrize("rise", [0.12, 0.2])
def test_a_toe_before_a_riser_comes_off_it_clear(before: float, rise: float) -> None:
    """The foot rolls on its toe a hand's breadth before a step: it is held back, then lifted."""
    clip = load_clip("walk")
    motion = clip.replace(clip.qpos[:160])
    feet = motion.character.feet
    pose = Kinematics(motion.model, motion.nframe).forward(motion.qpos)
    stances = find_stances(motion, pose, feet, detect_contacts(motion))
    level = find_footholds(stances, feet, ground(FLAT), 0.0)
    last = next(n for n, s in enumerate(stances) if s.foot == 0 and s.start > 60)
    edge = level[last].position[0] + feet[0].front[0] + before
    step = FLAT + f'<geom type="box" size="9 9 {rise / 2}" pos="{edge + 9} 0 {rise / 2}"/>'
    floor = ground(step)
    on = find_footholds(stances, feet, floor, 0.0)
    # Until then the feet stand where they did, however near that is to the step.
    holds = [*level[: last + 1], *on[last + 1 :]]
    path = foot_path(feet[0], 0, pose, stances, holds, floor, motion.fps)
    assert path.position[-1, 2] > rise - 0.01
    off = np.arange(stances[last].heel[1], motion.nframe)
    points = path.position[off, None] + rotate(
        path.quat[off, None], feet[0].shape_at(some(feet[0].toes).settled(path.toes))[off]
    )
    inside = np.minimum(points[..., 0] - edge, rise - points[..., 2])
    assert inside.max() < IN_STEP
