"""⊕ and ⊖ (Eq. 1) on every kind of joint, against SciPy's rotations and MuJoCo's own calls."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_up import humanoid, mixed, random_poses
from scipy.spatial.transform import Rotation

from mjmotion.numerics.tangent import ominus, oplus

ROUNDING = 1e-12  # [rad] or [m]
MODELS: dict[str, Callable[[], mujoco.MjModel]] = {"humanoid": humanoid, "mixed": mixed}
SOME = settings(deadline=None, max_examples=25, derandomize=True)
seeds = st.integers(0, 2**31)
names = st.sampled_from(sorted(MODELS))


def displacements(model: mujoco.MjModel, count: int, seed: int, longest: float) -> np.ndarray:
    """Tangent vectors whose rotations turn by up to ``longest`` [rad], lengths spread evenly."""
    rng = np.random.default_rng(seed)
    rows = rng.uniform(-1.0, 1.0, (count, model.nv))
    for joint in range(model.njnt):
        first = model.jnt_dofadr[joint]
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            first += 3
        elif model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_BALL:
            continue
        block = rows[:, first : first + 3]
        length = rng.uniform(0.0, longest, (count, 1))
        block *= length / np.linalg.norm(block, axis=1, keepdims=True)
    return rows


@SOME
@given(name=names, seed=seeds)
def test_ominus_inverts_oplus_below_pi(name: str, seed: int) -> None:
    model = MODELS[name]()
    qpos = random_poses(model, 4, seed, size=1.0)
    step = displacements(model, 4, seed + 1, 0.999 * np.pi)
    np.testing.assert_allclose(ominus(model, oplus(model, qpos, step), qpos), step, atol=1e-9)


@SOME
@given(name=names, seed=seeds)
def test_oplus_inverts_ominus(name: str, seed: int) -> None:
    """m0 ⊕ (m ⊖ m0) is the pose m: quaternions may come back with the other sign."""
    model = MODELS[name]()
    origin, goal = random_poses(model, 4, seed, 1.0), random_poses(model, 4, seed + 1, 1.0)
    again = oplus(model, origin, ominus(model, goal, origin))
    assert np.abs(ominus(model, again, goal)).max() < 1e-9


@SOME
@given(name=names, seed=seeds)
def test_zero_moves_nothing(name: str, seed: int) -> None:
    model = MODELS[name]()
    qpos = random_poses(model, 3, seed)
    np.testing.assert_allclose(oplus(model, qpos, np.zeros((3, model.nv))), qpos, atol=ROUNDING)
    assert np.abs(ominus(model, qpos, qpos)).max() < ROUNDING


@SOME
@given(seed=seeds)
def test_equation_1(seed: int) -> None:
    """Translation adds in world axes; rotations are multiplied on the right, hinges add."""
    model = mixed()
    qpos = random_poses(model, 1, seed, 1.0)
    step = displacements(model, 1, seed + 1, 3.0)
    moved, v, q = oplus(model, qpos, step)[0], step[0], qpos[0]
    np.testing.assert_allclose(moved[:3], q[:3] + v[:3], atol=ROUNDING)
    np.testing.assert_allclose(moved[11:], q[11:] + v[9:], atol=ROUNDING)
    for at, dof in ((3, 3), (7, 6)):
        turned = Rotation.from_quat(q[at : at + 4], scalar_first=True) * Rotation.from_rotvec(
            v[dof : dof + 3]
        )
        mine = Rotation.from_quat(moved[at : at + 4], scalar_first=True)
        assert (turned.inv() * mine).magnitude() < ROUNDING


@pytest.mark.parametrize("name", sorted(MODELS))
def test_same_as_mujoco_frame_by_frame(name: str) -> None:
    model = MODELS[name]()
    qpos, step = random_poses(model, 20, 1), displacements(model, 20, 2, 2.0)
    moved, back = oplus(model, qpos, step), ominus(model, qpos[::-1], qpos)
    for row in range(20):
        pose, velocity = qpos[row].copy(), np.empty(model.nv)
        mujoco.mj_integratePos(model, pose, step[row], 1.0)
        np.testing.assert_array_equal(moved[row], pose)
        mujoco.mj_differentiatePos(model, velocity, 1.0, qpos[row], qpos[19 - row].copy())
        np.testing.assert_array_equal(back[row], velocity)


def test_arguments_stay_as_they_are() -> None:
    """Read-only and strided arrays will do, and come out as they went in."""
    model = humanoid()
    qpos, step = random_poses(model, 8, 3)[::2], displacements(model, 4, 4, 1.0)
    kept = qpos.copy(), step.copy()
    qpos.flags.writeable = step.flags.writeable = False
    moved = oplus(model, qpos, step)
    ominus(model, moved, qpos)
    np.testing.assert_array_equal(qpos, kept[0])
    np.testing.assert_array_equal(step, kept[1])
    assert moved.flags.writeable and not np.shares_memory(moved, qpos)


def test_submaps_do_not_add_up() -> None:
    """(m ⊕ a) ⊕ b is not m ⊕ (a + b), the frequent mistake of §4.1; for hinges alone it is."""
    model = humanoid()
    qpos = random_poses(model, 5, 5)
    a, b = displacements(model, 5, 6, 0.5), displacements(model, 5, 7, 0.5)
    apart = ominus(model, oplus(model, oplus(model, qpos, a), b), oplus(model, qpos, a + b))
    balls = np.concatenate(
        [model.joint(name).dofadr[0] + np.arange(3) for name in ("left_hip", "spine", "neck")]
    )
    hinges = [model.joint(name).dofadr[0] for name in ("left_knee", "right_elbow")]
    assert np.abs(apart[:, balls]).max() > 0.01  # [rad]
    assert np.abs(apart[:, hinges]).max() < ROUNDING


def test_lengths_must_agree() -> None:
    model = mixed()
    qpos = random_poses(model, 3, 8)
    with pytest.raises(ValueError):
        oplus(model, qpos, np.zeros((2, model.nv)))
    with pytest.raises(ValueError):
        ominus(model, qpos, qpos[:2])
