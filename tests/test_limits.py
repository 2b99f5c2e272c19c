"""Swing and twist, and joint limits on the humanoid and on plain models."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mjmotion.body.assets import find_asset
from mjmotion.body.character import Character
from mjmotion.body.joint_limits import (
    from_swing_twist,
    swing_twist,
)
from mjmotion.exceptions import ModelError
from mjmotion.numerics import rotations as rot

PLAIN = """<mujoco><custom>{numeric}</custom><worldbody><body><freejoint/><geom size=".1"/>
<body><joint name="a" type="ball" range="0 1.2"/><geom size=".1"/>
<body><joint name="b" type="hinge" range="-0.5 0.5"/><geom size=".1"/>
<body><joint name="c" type="slide" range="0 0.1"/><geom size=".1"/>
<body><joint name="d" type="hinge"/><geom size=".1"/></body></body></body></body></body>
</worldbody><compiler angle="radian"/></mujoco>"""


def random_quats(count: int) -> np.ndarray:
    return rot.normalized(np.random.default_rng(1).normal(size=(count, 4)))


def test_swing_twist_and_back() -> None:
    quat = random_quats(500)
    again = from_swing_twist(swing_twist(quat))
    np.testing.assert_allclose(np.abs(rot.dot(again, quat)), 1, atol=1e-12)


def test_swing_twist_is_swing_after_twist() -> None:
    """The parts by themselves: a turn about z, then one about an axis square to z."""
    angles = np.array((0.4, -0.7, 1.1))
    swing, twist = rot.exp(np.array((0.4, -0.7, 0))), rot.exp(np.array((0, 0, 1.1)))
    np.testing.assert_allclose(swing_twist(rot.multiply(swing, twist)), angles, atol=1e-12)
    np.testing.assert_allclose(from_swing_twist(angles), rot.multiply(swing, twist), atol=1e-12)


def test_swing_twist_ranges_and_edges() -> None:
    angles = swing_twist(random_quats(500))
    assert np.hypot(angles[:, 0], angles[:, 1]).max() <= np.pi
    assert (angles[:, 2] > -np.pi).all() and (angles[:, 2] <= np.pi).all()
    quat = random_quats(50)
    np.testing.assert_allclose(swing_twist(quat), swing_twist(-quat), atol=1e-12)
    np.testing.assert_allclose(swing_twist([1, 0, 0, 0]), 0)
    np.testing.assert_allclose(swing_twist([0, 0, 0, 1]), (0, 0, np.pi))
    assert np.isfinite(swing_twist([0, 1, 0, 0])).all()


@pytest.fixture(scope="module")
def humanoid() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(find_asset("model", "humanoid")))


def test_clamped_poses_are_inside(humanoid: mujoco.MjModel) -> None:
    rng = np.random.default_rng(2)
    qpos = np.tile(humanoid.qpos0, (300, 1))
    for joint in range(1, humanoid.njnt):
        at = humanoid.jnt_qposadr[joint]
        if humanoid.jnt_type[joint] == mujoco.mjtJoint.mjJNT_BALL:
            qpos[:, at : at + 4] = rot.normalized(rng.normal(size=(300, 4)))
        else:
            qpos[:, at] = rng.uniform(-4, 4, 300)
    before = np.array(qpos)
    assert Character.of(humanoid).limits.excess(qpos).max() > 0.5
    clamped = Character.of(humanoid).limits.clamp(qpos)
    np.testing.assert_array_equal(qpos, before)
    assert Character.of(humanoid).limits.excess(clamped).max() < 1e-9
    inside = np.tile(humanoid.qpos0, (3, 1))
    np.testing.assert_array_equal(Character.of(humanoid).limits.clamp(inside), inside)
    assert Character.of(humanoid).limits.excess(qpos).shape == (
        300,
        len(Character.of(humanoid).limits.names),
    )
    assert Character.of(humanoid).limits.excess(humanoid.qpos0).max() == 0


def test_boxes_of_the_humanoid(humanoid: mujoco.MjModel) -> None:
    boxes = Character.of(humanoid).limits.boxes
    balls = np.flatnonzero(humanoid.jnt_type == mujoco.mjtJoint.mjJNT_BALL)
    assert set(boxes) == set(balls.tolist())
    column = Character.of(humanoid).limits.names.index("left_hip.swing_y")
    at = humanoid.joint("left_hip").qposadr[0]
    low = boxes[humanoid.joint("left_hip").id][1, 0]
    qpos = np.array(humanoid.qpos0)
    qpos[at : at + 4] = from_swing_twist((0, low - 0.25, 0))
    excess = Character.of(humanoid).limits.excess(qpos)
    assert excess[0, column] == pytest.approx(0.25)
    assert excess.sum() == pytest.approx(0.25)


def test_plain_model() -> None:
    """Without numerics MuJoCo's own ranges count: total angle of a ball, hinge, slide."""
    model = mujoco.MjModel.from_xml_string(PLAIN.format(numeric=""))
    assert Character.of(model).limits.names == ["a", "b", "c"]
    qpos = np.tile(model.qpos0, (2, 1))
    qpos[1, 7:11] = -rot.exp(np.array((1.0, 1.0, 1.0)))
    qpos[1, 11:] = (-0.7, 0.13, 9.0)
    excess = Character.of(model).limits.excess(qpos)
    np.testing.assert_allclose(excess, [[0, 0, 0], [np.sqrt(3) - 1.2, 0.2, 0.03]], atol=1e-12)
    clamped = Character.of(model).limits.clamp(qpos)
    assert Character.of(model).limits.excess(clamped).max() < 1e-12
    wanted = -rot.exp(np.full(3, 1.2 / np.sqrt(3)))
    np.testing.assert_allclose(clamped[1], [*model.qpos0[:7], *wanted, -0.5, 0.1, 9.0], atol=1e-12)


@pytest.mark.parametrize(
    "numeric",
    [
        '<numeric name="limit_b" data="0 1 0 1 0 1"/>',
        '<numeric name="limit_a" data="0 1 0 1"/>',
        '<numeric name="limit_a" data="1 0 0 1 0 1"/>',
    ],
)
def test_bad_numerics(numeric: str) -> None:
    model = mujoco.MjModel.from_xml_string(PLAIN.format(numeric=numeric))
    with pytest.raises(ModelError, match="limit_"):
        _ = Character.of(model).limits
