"""Arms out of the ground and of the body, where the source's are in neither."""

from __future__ import annotations

import functools

import mujoco
import numpy as np
import pytest
from made_up import character, walk

from mjmotion.apps.adaptation import adapt
from mjmotion.apps.clearing import FitSettings, with_arms_clear
from mjmotion.body.kinematics import Kinematics
from mjmotion.body.motion import Motion
from mjmotion.fitting import Fit, fit
from mjmotion.footsteps.clearances import BodyClearances, pushed_clear
from mjmotion.footsteps.plan import Plan
from mjmotion.footsteps.planning import make_plan
from mjmotion.footsteps.self_clearance import APART, SelfClearance, self_pairs
from mjmotion.footsteps.surfaces import SKIN, SurfaceClearance, find_surfaces
from mjmotion.ik import make_solver
from mjmotion.numerics.tangent import oplus
from mjmotion.scene import Scene, compose, flat, from_heights

BUMP_X, BUMP_Y, CELL = 1.0, 0.30, 0.05  # of a hill beside the way, and of its field [m]
NEAR_ENOUGH = 1e-3  # that is left of an overlap [m]


@functools.cache
def clip() -> Motion:
    return walk(2.4)


def hill(height: float) -> Scene:
    """A level field with a steep hill beside the way, where a hand swings past."""
    x, y = np.arange(-1.0, 4.0, CELL), np.arange(-2.0, 2.0, CELL)
    away = np.hypot(x[None] - BUMP_X, (y[:, None] - BUMP_Y) / 0.6)
    heights = height * np.clip(1.25 - away / 0.24, 0.0, 1.0)
    return Scene.from_spec(from_heights(heights, cell=CELL, start=(1.0, 2.0)))


def test_a_hand_goes_over_a_hill(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = hill(0.85)
    result = adapt(clip(), scene)
    monkeypatch.setattr("mjmotion.apps.adaptation.with_arms_clear", lambda plan, fitted, *_: fitted)
    blind = adapt(clip(), scene)
    depths = [one.validate().metrics["obstacle_penetration_mm"] for one in (blind, result)]
    assert depths[0] > 20.0 and depths[1] <= 0.01
    # Only the arms took part, and only beside the hill.
    moved = np.abs(result.motion.qpos - blind.motion.qpos)
    model = character().model
    arms = [model.joint(f"left_{name}").qposadr[0] for name in ("shoulder", "elbow")]
    others = np.ones(model.nq, dtype=bool)
    others[arms[0] : arms[1] + 5] = False
    assert moved[:, others].max() < 1e-6 and moved.max() > 0.02
    assert moved[np.abs(blind.motion.qpos[:, 0] - BUMP_X) > 0.8].max() < 0.01


def sunk(depth: float) -> tuple[Motion, Kinematics, SurfaceClearance]:
    """Standing with a hand so much below a field, the hand alone looked at."""
    motion = clip()
    model = motion.model
    kinematics = Kinematics(model, motion.nframe, geoms=True)
    data = mujoco.MjData(model)
    lowest = np.inf
    for pose in motion.qpos:
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        lowest = min(lowest, float(data.body("left_hand").xpos[2]))
    heights = np.full((80, 120), lowest + depth)
    field = from_heights(heights, cell=CELL, start=(1.0, 2.0)).compile()
    surfaces = find_surfaces(field, motion.qpos[:, :3])
    others = set(range(model.nbody)) - {model.body("left_hand").id}
    return motion, kinematics, SurfaceClearance(motion.character, surfaces, others)


def test_a_hand_below_a_field_is_lifted_out() -> None:
    motion, kinematics, keep = sunk(0.05)
    clearance = BodyClearances(kinematics, (keep,))
    frames = np.arange(motion.nframe)
    lacking = clearance(motion.qpos, frames)
    assert len(lacking.frame) and lacking.needed.max() > 0.03
    np.testing.assert_allclose(lacking.needed + lacking.distance, SKIN, atol=1e-12)
    np.testing.assert_allclose(lacking.rows[:, :3], [(0.0, 0.0, 1.0)] * len(lacking.frame))
    freed = pushed_clear(motion, (), clearance, (8.0, 4.0, 2.0))
    left = clearance(freed.qpos, frames).needed
    assert left.max(initial=0.0) < NEAR_ENOUGH
    shallow = BodyClearances(kinematics, (keep.at_margin(-0.5),))
    np.testing.assert_array_equal(pushed_clear(motion, (), shallow, (4.0,)).qpos, motion.qpos)


def test_rows_of_a_field_are_how_heights_change() -> None:
    motion, kinematics, keep = sunk(0.05)
    clearance, model = BodyClearances(kinematics, (keep,)), motion.model
    frame = int(clearance(motion.qpos, np.arange(motion.nframe)).frame[0])
    one = np.tile(motion.qpos[frame], (model.nv, 1))
    rows = clearance(one[:1], np.array([frame])).rows
    step, at = 1e-5, np.full(model.nv, frame)
    ahead, back = (
        clearance(oplus(model, one, sign * step * np.eye(model.nv)), at) for sign in (1.0, -1.0)
    )
    checked = 0
    for dof in range(model.nv):
        high, low = ahead.distance[ahead.frame == dof], back.distance[back.frame == dof]
        if len(high) == len(low) == len(rows):
            np.testing.assert_allclose((high - low) / (2.0 * step), rows[:, dof], atol=0.02)
            checked += 1
    assert checked > 20


# Arms in the body


@functools.cache
def planned() -> Plan:
    return make_plan(clip(), Scene.from_spec(flat()))


def folded(motion: Motion, frames: slice, turn: float) -> Motion:
    """The right arm turned inwards, into thigh and pelvis, in some frames."""
    model, qpos = motion.model, np.array(motion.qpos)
    at = int(model.joint("right_shoulder").qposadr[0])
    count = len(qpos[frames])
    bell = turn * np.sin(np.pi * (np.arange(count) + 0.5) / count) ** 2
    for row, angle in zip(qpos[frames], bell, strict=True):
        own, new = np.array((np.cos(angle / 2.0), np.sin(angle / 2.0), 0.0, 0.0)), np.empty(4)
        mujoco.mju_mulQuat(new, own, row[at : at + 4])
        row[at : at + 4] = new
    return motion.replace(qpos)


def overlap(motion: Motion) -> np.ndarray:
    """How deep the right forearm and hand are in pelvis, torso or thigh (nframe,) [m]."""
    model = motion.model
    data, depth = mujoco.MjData(model), np.zeros(motion.nframe)
    arm = {model.body(f"right_{name}").id for name in ("forearm", "hand")}
    pairs = [
        (int(a), int(b))
        for a, b in self_pairs(model)
        if len(arm & {int(model.geom_bodyid[a]), int(model.geom_bodyid[b])}) == 1
    ]
    for frame, pose in enumerate(motion.qpos):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        apart = [mujoco.mj_geomDistance(model, data, a, b, 0.1, None) for a, b in pairs]
        depth[frame] = max(0.0, -min(apart))
    return depth


INSIDE = slice(25, 50)


def cleared(source: Motion, motion: Motion) -> Motion:
    """What is made of a motion whose source is another, on level ground."""
    plan = make_plan(source, Scene.from_spec(flat()))
    composed = compose(character(), Scene.from_spec(flat()))
    solver = make_solver(character(), "hybrid", None)
    trace = fit(source, plan.constraints(), levels=[8.0]).trace
    fitted = Fit(motion, trace, (), np.zeros((0, 4)), None)  # type: ignore[arg-type]
    return with_arms_clear(plan, fitted, (), None, composed, FitSettings(), solver).motion


def test_a_forearm_comes_out_of_the_body() -> None:
    source = planned().source
    motion = folded(source, INSIDE, 0.5)
    assert overlap(source).max() == 0.0 and overlap(motion).max() > 0.02
    freed = cleared(source, motion)
    assert overlap(freed).max() < NEAR_ENOUGH
    off = np.abs(freed.qpos - motion.qpos).max(axis=1)
    assert off[:10].max() < 1e-3 and off[-8:].max() < 1e-3
    # What no arm moves stays to the last bit; the way in is not undone more than is needed.
    assert np.abs(freed.qpos[:, :7] - motion.qpos[:, :7]).max() < 1e-6
    assert np.abs(freed.qpos - source.qpos)[INSIDE].max() > 0.1


def test_a_source_in_itself_may_stay_so() -> None:
    source = folded(planned().source, INSIDE, 0.5)
    assert overlap(source).max() > 0.02
    assert cleared(source, source) is source
    # Nor is it pushed any deeper: what is deeper than in the source comes back to that.
    deeper = folded(planned().source, INSIDE, 0.6)
    was, more = overlap(source), overlap(deeper)
    now = overlap(cleared(source, deeper))
    assert (more - was).max() > 0.005 and (now - was).max() < 0.003
    assert now.max() > was.max() - 0.01


def test_what_is_near_in_the_source_is_near_enough() -> None:
    """Nothing is asked where nothing changed, however close the source's own arm is."""
    source = folded(planned().source, INSIDE, 0.3)
    kinematics = Kinematics(source.model, source.nframe, geoms=True)
    itself = BodyClearances(kinematics, (SelfClearance(source, kinematics, margin=APART),))
    assert len(itself(source.qpos, np.arange(source.nframe)).frame) == 0
