"""Poses, Jacobians and rays of all frames at once, against MuJoCo frame by frame."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from made_up import humanoid, mixed, random_poses

from mjmotion.body.character import Character
from mjmotion.body.kinematics import (
    Kinematics,
    RayCaster,
    body_dofs,
    body_pose,
    character_geoms,
    root_body,
    site_id,
    site_positions,
)
from mjmotion.exceptions import ModelError
from mjmotion.numerics.tangent import oplus

MODELS: dict[str, Callable[[], mujoco.MjModel]] = {"humanoid": humanoid, "mixed": mixed}
JACOBIAN = 1e-12  # against mj_jac, both exact [m/rad]
DIFFERENCE = 1e-7  # against finite differences [m/rad]
FIELDS = ("xpos", "xquat", "xmat", "site_xpos", "site_xmat", "xanchor", "xaxis")


@pytest.mark.parametrize("name", sorted(MODELS))
def test_batch_equals_loop_bit_for_bit(name: str) -> None:
    model = MODELS[name]()
    qpos = random_poses(model, 50, 1, size=1.0)
    pose = Kinematics(model, 50, geoms=True).forward(qpos)
    data = mujoco.MjData(model)
    for row in range(50):
        data.qpos[:] = qpos[row]
        mujoco.mj_kinematics(model, data)
        for field in (*FIELDS, "geom_xpos", "geom_xmat"):
            mine = getattr(pose, field)[row]
            np.testing.assert_array_equal(
                mine.reshape(getattr(data, field).shape), getattr(data, field), err_msg=field
            )


def test_part_of_a_batch_and_copies() -> None:
    model = mixed()
    qpos = random_poses(model, 10, 2)
    kinematics = Kinematics(model, 10)
    whole = kinematics.forward(qpos)
    kept = whole.xpos.copy()
    some = np.array((2, 3, 7))
    part = kinematics.forward(qpos[some], some)
    np.testing.assert_array_equal(part.site_xpos, whole.site_xpos[some])
    kinematics.forward(random_poses(model, 10, 3))
    np.testing.assert_array_equal(whole.xpos, kept)
    assert whole.geom_xpos is None


@pytest.mark.parametrize("name", sorted(MODELS))
def test_jacobians_are_mujocos(name: str) -> None:
    model = MODELS[name]()
    qpos = random_poses(model, 6, 4, size=1.0)
    pose = Kinematics(model, 6).forward(qpos)
    dofs, data = np.arange(model.nv), mujoco.MjData(model)
    rng = np.random.default_rng(5)
    for body in range(1, model.nbody):
        points = pose.xpos[:, body] + rng.normal(scale=0.2, size=(6, 3))
        jacp, jacr = pose.jacobian(points, body, dofs)
        for row in range(6):
            data.qpos[:] = qpos[row]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            wanted = np.empty((3, model.nv)), np.empty((3, model.nv))
            mujoco.mj_jac(model, data, *wanted, points[row], body)
            np.testing.assert_allclose(jacp[row], wanted[0], atol=JACOBIAN)
            np.testing.assert_allclose(jacr[row], wanted[1], atol=JACOBIAN)


def test_jacobian_of_some_dofs() -> None:
    model = humanoid()
    pose = Kinematics(model, 2).forward(random_poses(model, 2, 6))
    body = model.body("left_foot").id
    whole = pose.jacobian(pose.xpos[:, body], body, np.arange(model.nv))
    dofs = np.array((3, 20, 28, 2))
    for part, all_of_it in zip(pose.jacobian(pose.xpos[:, body], body, dofs), whole, strict=True):
        np.testing.assert_array_equal(part, all_of_it[:, :, dofs])


@pytest.mark.parametrize("name", sorted(MODELS))
def test_jacobians_are_finite_differences(name: str) -> None:
    model = MODELS[name]()
    qpos = random_poses(model, 1, 7, size=0.8)
    site = model.nsite - 1
    body = int(model.site_bodyid[site])
    pose = Kinematics(model, 1).forward(qpos)
    jacp, jacr = pose.jacobian(pose.site_xpos[:, site], body, np.arange(model.nv))
    step = 1e-6
    kinematics = Kinematics(model, model.nv)
    both = [
        kinematics.forward(
            oplus(model, np.tile(qpos, (model.nv, 1)), sign * step * np.eye(model.nv))
        )
        for sign in (1.0, -1.0)
    ]
    slope = (both[0].site_xpos[:, site] - both[1].site_xpos[:, site]) / (2.0 * step)
    np.testing.assert_allclose(jacp[0], slope.T, atol=DIFFERENCE)
    spin = (both[0].site_xmat[:, site] - both[1].site_xmat[:, site]) / (2.0 * step)
    spin = spin @ pose.site_xmat[0, site].T
    turn = np.stack((spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]))
    np.testing.assert_allclose(jacr[0], turn, atol=DIFFERENCE)


def test_rows_are_jacobians_along_a_direction() -> None:
    model = humanoid()
    pose = Kinematics(model, 5).forward(random_poses(model, 5, 8))
    rng = np.random.default_rng(9)
    frames, bodies = np.array((4, 0, 0, 2)), np.array((4, 10, 13, 1))
    points, normals = rng.normal(size=(4, 3)), rng.normal(size=(4, 3))
    rows = pose.rows(frames, points, bodies, normals)
    for number, (frame, body) in enumerate(zip(frames, bodies, strict=True)):
        spread = np.tile(points[number], (5, 1))
        jacp, _ = pose.jacobian(spread, int(body), np.arange(model.nv))
        np.testing.assert_allclose(rows[number], normals[number] @ jacp[frame], atol=JACOBIAN)


@pytest.mark.parametrize("name", sorted(MODELS))
def test_a_few_bodies_and_sites_without_a_batch(name: str) -> None:
    model = MODELS[name]()
    qpos = random_poses(model, 6, 10, size=1.0)
    pose = Kinematics(model, 6).forward(qpos)
    for body in range(model.nbody):
        position, quat = body_pose(model, qpos, body)
        np.testing.assert_allclose(position, pose.xpos[:, body], atol=JACOBIAN)
        same = np.abs(np.sum(quat * pose.xquat[:, body], axis=1))
        np.testing.assert_allclose(same, 1.0, atol=JACOBIAN)
    sites = np.arange(model.nsite)[::-1]
    found = site_positions(model, qpos, sites)
    np.testing.assert_allclose(found, pose.site_xpos[:, sites], atol=JACOBIAN)


def test_dofs_of_a_body() -> None:
    model = humanoid()
    moves = body_dofs(model, model.body("left_shank").id)
    joints = {model.joint(int(model.dof_jntid[dof])).name for dof in np.flatnonzero(moves)}
    assert joints == {"root", "left_hip", "left_knee"} and moves.sum() == 10
    assert not body_dofs(model, 0).any()


def test_height_and_geoms() -> None:
    model = humanoid()
    assert Character.of(model).height == pytest.approx(1.75, abs=0.005)  # soles to crown [m]
    assert root_body(model) == model.body("pelvis").id
    colliding = character_geoms(model, colliding=True)
    assert 0 < len(colliding) <= len(character_geoms(model))
    # The floor of the other model is no part of its character.
    small = mixed()
    assert len(character_geoms(small)) == small.ngeom - 1
    assert Character.of(small).height < 1.5


def test_unknown_site_names_the_valid_ones() -> None:
    assert humanoid().site(site_id(humanoid(), "left_toe")).name == "left_toe"
    with pytest.raises(ModelError, match=r"left_hell.*left_heel"):
        site_id(humanoid(), "left_hell")


SOLIDS = """<mujoco><worldbody><geom type="plane" size="5 5 .1"/>
<geom type="box" size=".5 .5 .2" pos="1 0 .2" euler="0 20 10"/><geom size=".4" pos="-1 0 .3"/>
<geom type="capsule" size=".1 .5" pos="0 1 .5"/></worldbody></mujoco>"""


@pytest.mark.parametrize("count", [1, 63, 64, 65, 300])
def test_rays_are_mujocos(count: int) -> None:
    model = mujoco.MjModel.from_xml_string(SOLIDS)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    rng = np.random.default_rng(count)
    origins = rng.uniform((-2, -2, 1), (2, 2, 2), (count, 3))
    directions = rng.normal(size=(count, 3)) - (0, 0, 1)
    distance, geom, normal = RayCaster(model).cast(origins, directions)
    hit, plumb = np.array([-1], np.int32), np.empty(3)
    for row in range(count):
        wanted = mujoco.mj_ray(
            model, data, origins[row], directions[row], None, 1, -1, hit, normal=plumb
        )
        assert distance[row] == pytest.approx(wanted, abs=1e-12)
        assert geom[row] == hit[0]
        if hit[0] >= 0:
            np.testing.assert_allclose(normal[row], plumb, atol=1e-9)
        else:
            assert (normal[row] == 0.0).all()


def test_one_direction_for_all_rays_and_no_rays() -> None:
    model = mujoco.MjModel.from_xml_string(SOLIDS)
    caster = RayCaster(model)
    origins = np.array(((3.0, 3.0, 1.5), (-1.0, 0.0, 2.0)))
    distance, geom, normal = caster.cast(origins, np.array((0.0, 0.0, -1.0)))
    np.testing.assert_allclose(distance, (1.5, 1.3), atol=1e-12)
    np.testing.assert_array_equal(geom, (0, 2))
    np.testing.assert_allclose(normal, [(0, 0, 1), (0, 0, 1)], atol=1e-12)
    assert caster.cast(origins, np.array((0.0, 0.0, 1.0)))[0].tolist() == [-1.0, -1.0]
    assert len(caster.cast(np.empty((0, 3)), np.array((0.0, 0.0, 1.0)))[0]) == 0
