"""A foot that rolls on its toe before a riser rolls less, and as before where there is none."""

from __future__ import annotations

import dataclasses

import numpy as np

from mjmotion.body.feet import Foot
from mjmotion.body.kinematics import Kinematics
from mjmotion.body.motion import Motion
from mjmotion.clips.gait import Segment, make_walk
from mjmotion.footsteps.contacts import Contact, detect_contacts
from mjmotion.footsteps.footholds import Foothold
from mjmotion.footsteps.paths import FootPath, foot_path
from mjmotion.footsteps.stances import Stance, find_stances
from mjmotion.numerics.rotations import rotate
from mjmotion.scene import Scene
from mjmotion.scene.builders import stairs

GAP, RISE = 0.012, 0.14  # of the riser before the toe, and its height [m]
GRAZE = 0.003  # how far a foot may be in it after all, between the points that are looked at [m]


def rigid(motion: Motion) -> Foot:
    """The left foot as one whose toes do not bend: it rolls over their tip."""
    foot = motion.character.feet[0]
    none = np.zeros(len(foot.shape), dtype=bool)
    return dataclasses.replace(foot, toe=foot.front, toes=None, bends=none)


def planned(gap: float) -> tuple[Motion, Stance, FootPath, float]:
    """A walk's path with a riser so far before the toe of one of its stances, and where that is."""
    motion = make_walk("humanoid", segments=[Segment("straight", 4)], fps=60.0)
    foot = rigid(motion)
    pose = Kinematics(motion.model, motion.nframe).forward(motion.qpos)
    stances = find_stances(motion, pose, (foot,), only(motion, foot.side))
    stance = stances[1]
    toe = stance.source_pos + rotate(stance.source_quat, foot.toe)
    edge = float(toe[0]) + gap
    scene = Scene.from_spec(stairs(steps=1, rise=RISE, landing=9.0, distance=edge))
    # What comes after stands on the landing.
    holds = [
        Foothold(
            s.source_pos + (0.0, 0.0, RISE if s.start > stance.start else 0.0),
            s.source_quat,
            np.array((0.0, 0.0, 1.0)),
            0.0,
        )
        for s in stances
    ]
    path = foot_path(foot, 0, pose, stances, holds, scene.ground, motion.fps)
    return motion, stance, path, edge


def only(motion: Motion, side: str) -> list[Contact]:
    """The contacts of one foot."""
    return [one for one in detect_contacts(motion) if one.site.startswith(side)]


def depth(motion: Motion, stance: Stance, path: FootPath, edge: float) -> float:
    """How far over the riser's edge, and under its top, a standing foot is [m]."""
    points = rotate(path.quat[:, None], rigid(motion).shape) + path.position[:, None]
    points = points[stance.start : stance.end]
    beyond = np.where(points[..., 2] < RISE, points[..., 0] - edge, 0.0)
    return float(beyond.max())


def tip(motion: Motion, path: FootPath) -> np.ndarray:
    """How far the heel is over the toe (nframe,) [rad]."""
    foot = rigid(motion)
    along = rotate(path.quat, foot.toe - foot.heel)
    return np.arctan2(-along[:, 2], np.hypot(along[:, 0], along[:, 1]))


def test_a_toe_does_not_tip_into_a_riser() -> None:
    motion, stance, path, edge = planned(GAP)
    far = planned(1.0)[2]
    assert depth(motion, stance, far, edge) > 2.0 * GRAZE  # as it would have rolled
    assert depth(motion, stance, path, edge) < GRAZE
    rolled = slice(stance.toe[0], stance.toe[1])
    assert tip(motion, path)[rolled].max() < tip(motion, far)[rolled].max() - 0.02
    # The toe stays on its spot, and a heel that stands is where it was.
    foot = rigid(motion)
    toe = path.position + rotate(path.quat, foot.toe)
    assert np.ptp(toe[rolled], axis=0).max() < 1e-9
    flat = slice(*stance.heel)
    np.testing.assert_array_equal(path.quat[flat], far.quat[flat])
    speed = np.diff(tip(motion, path) - tip(motion, far))
    assert np.abs(speed).max() * motion.fps < 6.0


def test_a_toe_with_room_rolls_as_it_did() -> None:
    _, stance, path, _ = planned(0.1)
    rolled = slice(stance.start, stance.end)
    np.testing.assert_array_equal(path.quat[rolled], planned(1.0)[2].quat[rolled])
