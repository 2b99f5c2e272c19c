"""Bones of their own, one body or one a frame: kinematics, limbs and fits on them."""

from __future__ import annotations

import copy
import dataclasses
import functools

import mujoco
import numpy as np
import pytest
from made_up import humanoid, loop_sites, mixed, pin, some, walk
from made_up import random_poses as poses

from mjmotion.body.bones import Bones
from mjmotion.body.kinematics import Kinematics, body_pose, site_positions
from mjmotion.body.limbs import Limbs, find_limbs
from mjmotion.body.motion import Motion
from mjmotion.constraints import Constraint, LookAt, RelativeConstraint, SiteConstraint, lay_out
from mjmotion.constraints.unmet import residuals
from mjmotion.exceptions import ModelError
from mjmotion.fitting import fit
from mjmotion.ik import make_solver
from mjmotion.ik.hybrid import HybridIK
from mjmotion.ik.numeric import NumericIK
from mjmotion.numerics.tangent import oplus

ROUNDING = 1e-9  # [m]
EXACT = 0.01  # after the exact pass [% of height]
FEET = ("left_foot", "right_foot")
FIELDS = ("body_pos", "jnt_pos", "site_pos")


def jittered(model: mujoco.MjModel, nframe: int | None, seed: int, size: float = 0.03) -> Bones:
    """The model's bones, every offset changed on its own, in every frame on its own."""
    rng = np.random.default_rng(seed)
    fields = (model.body_pos, model.jnt_pos, model.site_pos)
    lead = () if nframe is None else (nframe,)
    return Bones(*(field + size * rng.normal(size=(*lead, *field.shape)) for field in fields))


def stretched(model: mujoco.MjModel, factors: np.ndarray) -> Bones:
    """The whole model larger or smaller by one factor a frame."""
    fields = (model.body_pos, model.jnt_pos, model.site_pos)
    return Bones(*(factors[:, None, None] * field for field in fields))


def body_with(model: mujoco.MjModel, bones: Bones, frame: int) -> mujoco.MjModel:
    """A copy of the model that has one frame's bones, none of its sites taken for its body."""
    one = copy.copy(model)
    for name in FIELDS:
        field = getattr(bones, name)
        getattr(one, name)[:] = field if field.ndim == 2 else field[frame]
    one.site_sameframe[:] = 0
    return one


def loop(model: mujoco.MjModel, qpos: np.ndarray, bones: Bones) -> dict[str, np.ndarray]:
    """Everything's place from MuJoCo, a model and a call a frame."""
    found: dict[str, list[np.ndarray]] = {name: [] for name in ("xpos", "site_xpos", "xanchor")}
    for row, pose in enumerate(qpos):
        one = body_with(model, bones, row)
        data = mujoco.MjData(one)
        data.qpos[:] = pose
        mujoco.mj_kinematics(one, data)
        for name, places in found.items():
            places.append(np.array(getattr(data, name)))
    return {name: np.array(places) for name, places in found.items()}


def loop_site(model: mujoco.MjModel, qpos: np.ndarray, bones: Bones, site: str) -> np.ndarray:
    return loop(model, qpos, bones)["site_xpos"][:, model.site(site).id]


# What places bodies


@pytest.mark.parametrize("name", ["humanoid", "mixed"])
@pytest.mark.parametrize("nframe", [None, 5])
def test_kinematics_is_a_loop_over_bodies(name: str, nframe: int | None) -> None:
    """Every offset changes, of sites that stand at their bodies' origins too."""
    model = humanoid() if name == "humanoid" else mixed()
    qpos, bones = poses(model, 5, 1), jittered(model, nframe, 2)
    pose, wanted = Kinematics(model, 5, bones=bones).forward(qpos), loop(model, qpos, bones)
    for field, places in wanted.items():
        np.testing.assert_allclose(getattr(pose, field), places, atol=ROUNDING, err_msg=field)
    everywhere = np.arange(model.nsite)
    sites = site_positions(model, qpos, everywhere, bones)
    np.testing.assert_allclose(sites, wanted["site_xpos"], atol=ROUNDING)
    for body in range(1, model.nbody):
        place, _ = body_pose(model, qpos, body, bones)
        np.testing.assert_allclose(place, wanted["xpos"][:, body], atol=ROUNDING)
    np.testing.assert_array_equal(model.site_pos, Bones.of(model).site_pos)


def test_some_frames_have_their_own_bones() -> None:
    """Poses of frames 1 and 4 alone: each with its own body, not with the first two."""
    model = humanoid()
    qpos, bones, some = poses(model, 5, 3), jittered(model, 5, 4), np.array((1, 4))
    pose = Kinematics(model, 5, bones=bones).forward(qpos[some], some)
    wanted = loop(model, qpos[some], bones.at(some))
    np.testing.assert_allclose(pose.site_xpos, wanted["site_xpos"], atol=ROUNDING)
    one = Bones.of(model)
    assert one.at(some) is one and one.nframe is None and bones.at(some).nframe == 2


def test_limbs_are_where_their_bones_put_them() -> None:
    model = humanoid()
    qpos, bones = poses(model, 4, 5), jittered(model, 4, 6, 0.01)
    limbs, wanted = Limbs(model, find_limbs(model), bones), loop(model, qpos, bones)
    state = limbs.state(qpos)
    pose = Kinematics(model, 4, bones=bones).forward(qpos)
    for number, limb in enumerate(limbs.limbs):
        hip, ankle = (wanted["xanchor"][:, model.body_jntadr[b]] for b in (limb.upper, limb.end))
        np.testing.assert_allclose(state.hip[:, number], hip, atol=ROUNDING)
        local = np.einsum("nji,nj->ni", pose.xmat[:, limb.base], ankle - hip)
        np.testing.assert_allclose(state.ankle[:, number], local, atol=ROUNDING)


def test_longer_limbs_reach_further() -> None:
    model, factors = humanoid(), np.array((0.5, 1.0, 2.0))
    own = Limbs(model, find_limbs(model))
    limbs = Limbs(model, find_limbs(model), stretched(model, factors))
    np.testing.assert_allclose(limbs.reach, factors[:, None] * own.reach, rtol=1e-9)
    np.testing.assert_allclose(limbs.fold, factors[:, None] * own.fold, rtol=1e-9)


@pytest.mark.parametrize("nframe", [None, 12])
def test_closed_limbs_reach_their_targets(nframe: int | None) -> None:
    """Feet and hands where each frame's own body has to bring them, by MuJoCo itself."""
    model, rng = humanoid(), np.random.default_rng(7)
    qpos, bones = poses(model, 12, 8, 0.15), jittered(model, nframe, 9, 0.01)
    targets = []
    for site in (*FEET, "left_hand"):
        place = loop_site(model, qpos, bones, site) + 0.01 * rng.normal(size=(12, 3))
        targets.append(SiteConstraint(site, np.arange(12), place, pin(model, qpos, site).quat))
    laid = lay_out(targets, model, 12)
    solution = HybridIK(model, bones=bones).prepare(laid).enforce(qpos)
    closed = oplus(model, qpos, solution.displacement)
    for constraint in targets:
        place = loop_site(model, closed, bones, constraint.site)
        np.testing.assert_allclose(place, some(constraint.position), atol=1e-8)
    assert (solution.displacement[:, :6] == 0.0).all()
    numeric = oplus(
        model, qpos, NumericIK(model, bones=bones).prepare(laid).enforce(qpos).displacement
    )
    for constraint in targets:
        place = loop_site(model, numeric, bones, constraint.site)
        np.testing.assert_allclose(place, some(constraint.position), atol=1e-5)


# Fits


@functools.cache
def clip() -> Motion:
    return walk(2.0)


def held_feet(motion: Motion) -> list[SiteConstraint]:
    """Feet where the motion has them on the model's own body."""
    return [pin(motion.model, motion.qpos, site, contact=True) for site in FEET]


@pytest.mark.parametrize("ik", ["hybrid", "numeric"])
def test_a_body_that_changes_keeps_its_footholds(ik: str) -> None:
    """Legs and trunk grow by a tenth and shrink again; feet stay, exactly, on their own body."""
    motion = clip()
    model, s = motion.model, np.linspace(0.0, 2.0 * np.pi, motion.nframe)
    bones = stretched(model, 1.0 + 0.05 * (1.0 - np.cos(s)))
    constraints = held_feet(motion)
    result = fit(motion, constraints, ik=make_solver(motion.character, ik, bones=bones))
    assert result.trace.exact_error_percent < EXACT and result.unmet == ()
    for constraint in constraints:
        place = loop_site(model, result.motion.qpos, bones, constraint.site)
        assert np.abs(place - some(constraint.position)).max() < 1e-4
    # On the model's own body the same poses are off by what the body grew.
    own = loop_sites(model, result.motion.qpos)[:, model.site("left_foot").id]
    assert np.abs(own - some(constraints[0].position)).max() > 0.02
    assert residuals(result.motion, result.targets).max() > 0.02
    assert residuals(result.motion, result.targets, bones).max() < 1e-4


@pytest.mark.parametrize("ik", ["hybrid", "numeric"])
def test_one_body_for_all_frames_is_the_same_body_in_every_frame(ik: str) -> None:
    motion = clip()
    fields = (motion.model.body_pos, motion.model.jnt_pos, motion.model.site_pos)
    one = Bones(*(1.06 * field for field in fields))
    many = stretched(motion.model, np.full(motion.nframe, 1.06))
    solvers = [make_solver(motion.character, ik, bones=bones) for bones in (one, many)]
    both = [fit(motion, held_feet(motion), ik=solver) for solver in solvers]
    np.testing.assert_allclose(both[0].motion.qpos, both[1].motion.qpos, atol=1e-9)
    place = loop_site(motion.model, both[0].motion.qpos, one, "left_foot")
    assert np.abs(place - some(held_feet(motion)[0].position)).max() < 1e-4


def test_the_model_s_own_bones_change_nothing() -> None:
    motion = clip()
    plain = fit(motion, held_feet(motion), first_guess=False)
    solver = HybridIK(motion.character, bones=Bones.of(motion.model))
    own = fit(motion, held_feet(motion), ik=solver, first_guess=False)
    np.testing.assert_array_equal(plain.motion.qpos, own.motion.qpos)


def test_held_hands_look_ats_and_free_feet_on_a_changing_body() -> None:
    """All that is measured in the motion's frames is measured on the body of those frames."""
    motion = clip()
    model, middle = motion.model, np.arange(20, 40)
    bones = stretched(model, np.linspace(1.0, 1.08, motion.nframe))
    still = SiteConstraint("left_foot", middle, some(pin(model, motion.qpos, FEET[0]).position)[30])
    constraints: list[Constraint] = [
        dataclasses.replace(still, free=("x", "y")),
        RelativeConstraint("left_hand", middle, "pelvis", np.array((0.02, 0.24, 0.0))),
        LookAt("face", middle, np.array((4.0, 1.0, 1.5))),
    ]
    for ik in ("hybrid", "numeric"):
        result = fit(motion, constraints, ik=make_solver(motion.character, ik, bones=bones))
        assert result.unmet == ()
        foot = loop_site(model, result.motion.qpos, bones, "left_foot")[middle]
        assert np.abs(foot - foot.mean(axis=0)).max() < 1e-4
        pose = Kinematics(model, motion.nframe, bones=bones).forward(result.motion.qpos)
        pelvis, hand = model.site("pelvis").id, model.site("left_hand").id
        away = pose.site_xpos[middle, hand] - pose.site_xpos[middle, pelvis]
        local = np.einsum("nji,nj->ni", pose.site_xmat[middle, pelvis], away)
        np.testing.assert_allclose(local, np.tile((0.02, 0.24, 0.0), (20, 1)), atol=1e-4)


# Bad input


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (((5, 3, 3), (2, 3), (1, 3)), "shapes"),
        (((5, 3, 3), (5, 2, 3), (4, 1, 3)), "shapes"),
        (((3,), (3,), (3,)), "shapes"),
    ],
)
def test_bad_shapes(fields: tuple[tuple[int, ...], ...], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        Bones(*(np.zeros(shape) for shape in fields))


def test_bones_that_do_not_fit() -> None:
    model, motion = humanoid(), clip()
    fields = [np.array(getattr(model, name)) for name in FIELDS]
    fields[1][2, 0] = np.nan
    with pytest.raises(ModelError, match="not finite"):
        Bones(*fields)
    few = stretched(model, np.ones(motion.nframe - 1))
    with pytest.raises(ModelError, match=f"over {motion.nframe - 1} frames"):
        fit(motion, held_feet(motion), ik=HybridIK(model, bones=few))
    with pytest.raises(ModelError, match="make them for this model"):
        Kinematics(model, 3, bones=Bones.of(mixed()))
