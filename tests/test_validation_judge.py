"""What a judge knows: its own joint limits, contacts by attributes, and models as they are now."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
from made_up import humanoid, mixed

from mjmotion.body.joint_limits import JointLimits
from mjmotion.body.motion import Motion
from mjmotion.exceptions import ModelError, MotionError
from mjmotion.numerics.tangent import ominus
from mjmotion.validation import Judge, validate
from mjmotion.validation.figures import joint_jerk
from mjmotion.validation.inputs import stands
from mjmotion.validation.limits import limit_excess

FPS = 30.0
CHAINED = """<mujoco><compiler angle="radian"/><custom>{numeric}</custom><worldbody>
<geom name="floor" type="plane" size="5 5 .1" pos="1 0 0"/>
<body name="foot" pos="0 0 .1"><freejoint/><geom type="box" size=".1 .05 .1"/>
<site name="foot_heel" pos="-.1 0 -.1"/>
<body><joint name="a" type="ball" range="0 1.2"/><geom size=".01" pos="0 0 .5"/>
<body><joint name="b" axis="0 1 0" range="-.5 .5"/><geom size=".01" pos="0 0 .5"/>
<body><joint name="c" type="slide" range="0 .1"/><geom size=".01" pos="0 0 .5"/>
<body><joint name="d"/><geom size=".01" pos="0 0 .5"/>
<body><joint name="e" type="ball"/><geom size=".01" pos="0 0 .5"/></body></body></body></body>
</body></body></worldbody></mujoco>"""
BOX = '<numeric name="limit_e" data="-.3 .4 -.2 .5 -1 2"/>'


@dataclasses.dataclass(frozen=True)
class Stands:
    """Three attributes are all that a contact needs."""

    site: str
    start: int
    end: int


def chained(numeric: str = BOX) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(CHAINED.format(numeric=numeric))


def still(model: mujoco.MjModel, nframe: int = 10) -> Motion:
    return Motion(model, np.tile(model.qpos0, (nframe, 1)), FPS)


def poses(model: mujoco.MjModel, count: int, seed: int) -> np.ndarray:
    """Poses of all sizes: near the limits, far beyond them, and turned by nearly nothing or π."""
    rng = np.random.default_rng(seed)
    qpos = np.tile(model.qpos0, (count, 1))
    qpos[:, 7:] += rng.normal(size=(count, model.nq - 7)) * 10.0 ** rng.uniform(-9, 0.5, (count, 1))
    for joint in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_BALL):
        at = int(model.jnt_qposadr[joint])
        axis = rng.normal(size=(count, 3)) * rng.integers(0, 2, (count, 3))
        axis[(axis == 0.0).all(axis=1), joint % 3] = 1.0
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        near = 10.0 ** rng.uniform(-9, 0, count)
        angle = np.where(rng.random(count) < 0.5, near, np.pi - near)
        angle = np.where(rng.random(count) < 0.5, rng.uniform(-7, 7, count), angle)
        qpos[:, at] = np.cos(angle / 2)
        qpos[:, at + 1 : at + 4] = axis * np.sin(angle / 2)[:, None]
    return Motion(model, qpos, FPS).qpos


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("make", [humanoid, chained, lambda: chained("")])
def test_joint_limits_are_those_that_the_fit_keeps(
    make: Callable[[], mujoco.MjModel], seed: int
) -> None:
    """Two implementations that share no line, over poses within, near and beyond the limits."""
    model = make()
    qpos = poses(model, 2000, seed)
    excess, names = limit_excess(model, qpos)
    kept = JointLimits(model)
    assert list(names) == kept.names
    np.testing.assert_allclose(excess, kept.excess(qpos), atol=1e-7)
    assert (excess > 0.1).any() and (excess == 0.0).any()


def test_joint_limits_of_known_turns() -> None:
    """A turn about x alone is swing x, about z alone twist; two of them the twist first."""
    model = chained()
    at = model.joint("e").qposadr[0]
    qpos = np.tile(model.qpos0, (3, 1))
    qpos[0, at : at + 4] = np.cos(0.5), np.sin(0.5), 0, 0
    qpos[1, at : at + 4] = np.cos(0.7), 0, 0, -np.sin(0.7)
    # q = q_swing q_twist, of a swing of 1 about y and a twist of 2.5
    mujoco.mju_mulQuat(
        qpos[2, at : at + 4],
        np.array([np.cos(0.5), 0, np.sin(0.5), 0]),
        np.array([np.cos(1.25), 0, 0, np.sin(1.25)]),
    )
    excess, names = limit_excess(model, qpos)
    columns = [names.index(f"e.{part}") for part in ("swing_x", "swing_y", "twist")]
    np.testing.assert_allclose(
        excess[:, columns], [[0.6, 0, 0], [0, 0, 0.4], [0, 0.5, 0.5]], atol=1e-12
    )


@pytest.mark.parametrize(
    "numeric",
    [
        '<numeric name="limit_b" data="0 1 0 1 0 1"/>',
        '<numeric name="limit_a" data="0 1 0 1"/>',
        '<numeric name="limit_a" data="1 0 0 1 0 1"/>',
    ],
)
def test_a_wrong_numeric_is_told(numeric: str) -> None:
    model = chained(numeric)
    with pytest.raises(ModelError, match="limit_"):
        limit_excess(model, model.qpos0[None])


def test_jerk_is_of_the_differences_that_the_fit_takes() -> None:
    model = mixed()
    motion = Motion(model, poses(model, 30, 3), FPS)
    velocity = ominus(model, motion.qpos[1:], motion.qpos[:-1]) * FPS
    angles = np.isin(model.jnt_type[model.dof_jntid], (1, 3))  # balls and hinges
    expected = np.diff(velocity[:, angles], n=2, axis=0) * FPS**2
    np.testing.assert_allclose(joint_jerk(motion), expected, rtol=1e-12)


def test_contacts_need_no_class_of_ours() -> None:
    names = ("left_heel", "left_toe", "left_hand")
    assert [stands(Stands(name, 0, 1)) for name in names] == [True, True, False]
    motion = still(chained())
    result = validate(motion, motion, [Stands("foot_heel", 2, 7)])
    assert result.metrics["stance_gap_max_mm"] == pytest.approx(0.0, abs=1e-9)


def test_a_change_of_the_model_is_seen_by_the_next_validation() -> None:
    model = chained()
    motion, contacts = still(model), [Stands("foot_heel", 0, 10)]

    def figures() -> tuple[float, float, float]:
        metrics = validate(motion, motion, contacts).metrics
        return (
            metrics["stance_gap_max_mm"],
            metrics["sole_penetration_mm"],
            metrics["joint_limit_rad"],
        )

    assert figures() == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    model.geom_pos[model.geom("floor").id, 2] = 0.003
    assert figures() == pytest.approx((3.0, 3.0, 0.0), abs=1e-6)
    model.geom_size[1, 2] = 0.102  # the foot's box reaches 2 mm deeper
    assert figures() == pytest.approx((3.0, 5.0, 0.0), abs=1e-6)
    model.jnt_range[model.joint("b").id] = 0.25, 0.5
    model.numeric("limit_e").data[:2] = 0.3, 0.4
    assert figures() == pytest.approx((3.0, 5.0, 0.3), abs=1e-6)


def test_a_judge_gives_the_figures_of_validate_and_keeps_its_shapes() -> None:
    model = chained()
    contacts = [Stands("foot_heel", 0, 10)]
    judge = Judge(model, contacts)
    rng = np.random.default_rng(1)
    for _ in range(3):
        qpos = np.tile(model.qpos0, (10, 1))
        qpos[:, :3] += rng.normal(scale=0.01, size=(10, 3))
        motion = Motion(model, qpos, FPS)
        whole, kept = validate(still(model), motion, contacts), judge.validate(still(model), motion)
        assert kept.metrics == pytest.approx(whole.metrics, abs=0.0, nan_ok=True)
        assert kept.per_contact == whole.per_contact and kept.worst == whole.worst
    model.geom_pos[model.geom("floor").id, 2] = 0.003
    before = judge.validate(still(model), still(model))
    assert before.metrics["stance_gap_max_mm"] == pytest.approx(0.0, abs=1e-6)
    other = still(chained())
    with pytest.raises(MotionError, match="another model"):
        judge.validate(other, other)


def test_nothing_in_the_validation_keeps_models() -> None:
    """A cache by model would answer for shapes that a model no longer has."""
    folder = Path(__file__).parents[1] / "mjmotion" / "validation"
    cached = [path.name for path in folder.glob("*.py") if "lru_cache" in path.read_text("utf-8")]
    assert cached == []
