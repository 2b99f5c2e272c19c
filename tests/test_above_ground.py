"""The last word on a foot path, a swing near its hip, and a trunk that leans into a climb."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
from made_up import SHANK, THIGH

from mjmotion.body.kinematics import Kinematics, Pose, site_id
from mjmotion.clips import load_clip
from mjmotion.footsteps.above_ground import above_ground
from mjmotion.footsteps.lean import LEAN, leaning
from mjmotion.footsteps.paths import FootPath
from mjmotion.footsteps.pelvis import FOLDED, within_reach
from mjmotion.footsteps.plan import Plan
from mjmotion.footsteps.planning import make_plan
from mjmotion.numerics.rotations import rotate
from mjmotion.scene import Scene, flat

UNDER = 0.002  # how far a cleared foot may be in the ground [m]


@functools.cache
def planned() -> Plan:
    motion = load_clip("walk")
    return make_plan(motion.replace(motion.qpos[:200]), Scene.from_spec(flat(), "flat"))


def poses(plan: Plan) -> Pose:
    return Kinematics(plan.source.model, plan.source.nframe).forward(plan.source.qpos)


def deepest(plan: Plan, path: FootPath, index: int) -> np.ndarray:
    """How far the sole is under z = 0 at each frame [m]."""
    foot = plan.source.character.feet[index]
    assert foot.toes is not None
    sole = foot.sole_at(foot.toes.settled(path.toes))
    points = path.position[:, None] + rotate(path.quat[:, None], sole)
    return np.asarray(-points[..., 2].min(axis=1))


def bump(path: FootPath, size: float) -> np.ndarray:
    """A smooth bump of so many metres in the middle of the longest swing (nframe,)."""
    swing = ~path.stance
    edges = np.flatnonzero(np.diff(np.concatenate(([0], swing, [0])).astype(np.int8)))
    start, end = max(edges.reshape(-1, 2), key=lambda span: span[1] - span[0])
    curve = np.zeros(len(swing))
    curve[start:end] = size * np.sin(np.pi * np.linspace(0.0, 1.0, end - start)) ** 2
    return curve


@pytest.mark.parametrize("index", [0, 1])
def test_a_swing_that_was_moved_into_the_ground_comes_out_of_it(index: int) -> None:
    plan = planned()
    feet, path = plan.source.character.feet, plan.paths[index]
    down = bump(path, 0.12)[:, None] * np.array((0.0, 0.0, 1.0))
    sunk = dataclasses.replace(path, position=path.position - down)
    assert deepest(plan, sunk, index).max() > 0.05
    fps = plan.source.fps
    (lifted,) = above_ground(
        feet[index : index + 1], (sunk,), (path,), plan.contacts, plan.ground, fps
    )
    assert deepest(plan, lifted, index).max() < UNDER
    np.testing.assert_array_equal(lifted.position[path.stance], path.position[path.stance])
    same = above_ground(feet, plan.paths, plan.paths, plan.contacts, plan.ground, fps)
    assert all(new is old for new, old in zip(same, plan.paths, strict=True))


def hip_to_ankle(plan: Plan, path: FootPath, index: int) -> np.ndarray:
    """How far they are apart (nframe,), as a share of the leg's length."""
    model, foot = plan.source.model, plan.source.character.feet[index]
    hip = poses(plan).xanchor[:, model.joint(f"{foot.side}_hip").id] + plan.root_shift
    joint = model.joint(f"{foot.side}_ankle").id
    lever = model.jnt_pos[joint] - model.site_pos[site_id(model, path.site)]
    ankle = path.position + rotate(path.quat, np.broadcast_to(lever, path.position.shape))
    return np.asarray(np.linalg.norm(hip - ankle, axis=1) / (THIGH + SHANK))


@pytest.mark.parametrize("size", [0.6, -0.6])
def test_a_swing_is_neither_nearer_than_its_knee_folds_nor_further_than_it_reaches(
    size: float,
) -> None:
    plan = planned()
    path = plan.paths[0]
    up = bump(path, size)[:, None] * np.array((0.0, 0.0, 1.0))
    carried = dataclasses.replace(path, position=path.position + up)
    apart = hip_to_ankle(plan, carried, 0)
    assert apart.min() < 0.35 if size > 0.0 else apart.max() > 1.2
    both = (carried, plan.paths[1])
    near, _ = within_reach(plan.source, poses(plan), both, plan.contacts, plan.root_shift)
    apart = hip_to_ankle(plan, near, 0)
    assert apart.min() > FOLDED - 0.02 and apart.max() < 1.005
    np.testing.assert_array_equal(near.position[path.stance], path.position[path.stance])


def test_a_trunk_leans_forwards_by_what_the_hips_stay_back() -> None:
    motion = planned().source
    back = np.full(motion.nframe, 0.1)
    leant = leaning(motion, back)
    pose = [Kinematics(m.model, m.nframe).forward(m.qpos) for m in (motion, leant)]
    head = motion.model.body("head").id
    ahead = pose[1].xpos[:, head] - pose[0].xpos[:, head]
    assert (ahead[:, 0] > 0.05).all()  # it walks along +x
    torso = motion.model.body("torso").id
    pitch = [np.arcsin(p.xmat[:, torso][:, 0, 2]) for p in pose]
    np.testing.assert_allclose(pitch[1] - pitch[0], LEAN * 0.1, atol=0.05)
    np.testing.assert_array_equal(leant.qpos[:, :3], motion.qpos[:, :3])
    assert leaning(motion, np.zeros(motion.nframe)) is motion
