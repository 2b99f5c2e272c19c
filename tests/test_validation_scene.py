"""The scene along vertical lines, and depths in it, against MuJoCo's own rays and distances."""

from __future__ import annotations

import itertools
import math

import mujoco
import numpy as np
import pytest
from test_validation import FPS, PLANE, build, check, standing

from mjmotion.body.motion import Motion
from mjmotion.validation.ground import Ground
from mjmotion.validation.penetration import CharacterGeoms, penetration

MIXED = """
<geom type="hfield" hfield="h" pos=".1 .2 -.1" euler="0 0 30"/>
<geom type="box" size=".2 .3 .4" pos=".5 .1 .3" euler="20 30 40"/>
<geom type="sphere" size=".3" pos="-.5 .1 .5"/>
<geom type="capsule" size=".1 .4" pos="-.5 .8 .5" euler="30 60 0"/>
<geom type="cylinder" size=".1 .4" pos=".5 .9 .5" euler="30 60 0"/>
<geom type="ellipsoid" size=".1 .4 .2" pos="-1.5 -.9 .5" euler="30 60 0"/>
<geom type="mesh" mesh="L" pos="-1 -1 1"/>
<geom type="mesh" mesh="tetrahedron" pos="1 -.7 1" euler="10 20 30"/>"""
MESHES = """
<hfield name="h" nrow="13" ncol="17" size="2 1.5 .7 .1"/>
<mesh name="tetrahedron" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/>
<mesh name="L" vertex="0 0 0 2 0 0 2 1 0 1 1 0 1 2 0 0 2 0
  0 0 .4 2 0 .4 2 1 .4 1 1 .4 1 2 .4 0 2 .4"
  face="0 2 1 0 3 2 0 4 3 0 5 4 6 7 8 6 8 9 6 9 10 6 10 11 0 1 7 0 7 6 1 2 8 1 8 7
  2 3 9 2 9 8 3 4 10 3 10 9 4 5 11 4 11 10 5 0 6 5 6 11"/>"""


def test_heights_from_above_agree_with_mujocos_own_rays() -> None:
    rng = np.random.default_rng(4)
    model = build(MIXED, MESHES, rng.random((13, 17)))
    ground = Ground(model)
    assert len(ground.fields) == 1 and len(ground.convex) == 6 and len(ground.surfaces) == 1
    data = mujoco.MjData(model)
    data.qpos[:3] = 50
    mujoco.mj_kinematics(model, data)
    points = np.concatenate((rng.uniform(-2.4, 2.4, (1500, 2)), np.full((1500, 1), 5.0)), axis=1)
    height, geom = ground.heights(points)
    hit = np.zeros(1, np.int32)
    down = np.array([0.0, 0.0, -1.0])
    for point, z, owner in zip(points, height, geom, strict=True):
        distance = mujoco.mj_ray(model, data, point, down, None, 1, -1, hit)
        assert owner == hit[0]
        if owner >= 0:
            assert z == pytest.approx(5 - distance, abs=1e-6)
    assert (geom < 0).any() and (geom >= 0).any()


@pytest.mark.parametrize(
    ("z", "height", "name"),
    [
        (2.5, 2.2, "lintel"),  # over the lintel
        (1.9, 0.5, "top"),  # under it
        (0.3, 0.5, "top"),  # in the upper of two stacked boxes
        (0.05, 0.5, "top"),  # in the lower: one solid, though it reaches into the floor
        (-0.5, 0.5, "top"),  # in the floor
        (2.1, 2.2, "lintel"),  # in the lintel
    ],
)
def test_what_a_point_stands_over(z: float, height: float, name: str) -> None:
    model = build(
        PLANE
        + '<geom name="low" type="box" size="1 1 .1" pos="0 0 .05"/>'
        + '<geom name="top" type="box" size="1 1 .175" pos="0 0 .325"/>'
        + '<geom name="lintel" type="box" size="1 1 .1" pos="0 0 2.1"/>'
    )
    ground = Ground(model)
    found, geom = ground.heights(np.array([[0.2, 0.1, z], [3.0, 0.0, z]]))
    assert found[0] == pytest.approx(height)
    assert ground.name(int(geom[0])) == name
    assert found[1] == pytest.approx(0.0, abs=1e-12) and ground.name(int(geom[1])) == "floor"


def test_a_tilted_heightfield_counts_by_its_triangles() -> None:
    rng = np.random.default_rng(1)
    scene = '<geom name="field" type="hfield" hfield="h" euler="10 5 30"/>'
    model = build(
        scene, '<hfield name="h" nrow="9" ncol="7" size="1 1 .3 .1"/>', rng.random((9, 7))
    )
    ground = Ground(model)
    assert ground.fields == [] and len(ground.surfaces) == 1
    data = mujoco.MjData(model)
    data.qpos[:3] = 50
    mujoco.mj_kinematics(model, data)
    for x, y in rng.uniform(-0.6, 0.6, (100, 2)):
        point = np.array([x, y, 3.0])
        ray = mujoco.mj_ray(
            model, data, point, np.array([0, 0, -1.0]), None, 1, -1, np.zeros(1, np.int32)
        )
        assert ground.heights(point[None])[0][0] == pytest.approx(3 - ray, abs=1e-6)


def test_pruned_pairs_are_all_that_touch() -> None:
    """The same depths as measuring every pair of every frame."""
    rng = np.random.default_rng(2)
    boxes = "".join(
        f'<geom type="box" size="{s[0]:.3f} {s[1]:.3f} {s[2]:.3f}" pos="{p[0]:.3f} {p[1]:.3f}'
        f' {p[2]:.3f}" euler="{e[0]:.1f} {e[1]:.1f} {e[2]:.1f}"/>'
        for s, p, e in zip(
            rng.uniform(0.05, 0.4, (15, 3)),
            rng.uniform(-1, 1, (15, 3)),
            rng.uniform(-180, 180, (15, 3)),
            strict=True,
        )
    )
    rods = '<geom type="capsule" size=".1 .5" pos="1 1 .5"/><geom type="sphere" size=".4"/>'
    model = build(boxes + rods)
    qpos = standing(model, 60)
    qpos[:, :3] = rng.uniform(-1, 1, (60, 3))
    qpos[:, 3:7] = rng.standard_normal((60, 4))
    qpos = Motion(model, qpos, FPS).qpos
    ground, geoms = Ground(model), CharacterGeoms.of(model, ())
    data = mujoco.MjData(model)
    expected = np.zeros((60, 2))
    position, matrix = np.empty((60, 2, 3)), np.empty((60, 2, 3, 3))
    for frame, i in itertools.product(range(60), range(2)):
        data.qpos[:] = qpos[frame]
        mujoco.mj_kinematics(model, data)
        geom = int(geoms.ids[i])
        position[frame, i] = data.geom_xpos[geom]
        matrix[frame, i] = data.geom_xmat[geom].reshape(3, 3)
        for other in ground.convex:
            gap = mujoco.mj_geomDistance(model, data, geom, other, 0.0, None)
            expected[frame, i] = max(expected[frame, i], -gap)
    depth, touched = penetration(ground, geoms, position, matrix)
    assert (expected > 0.01).sum() > 20 and (expected == 0).sum() > 20
    np.testing.assert_allclose(depth, expected, atol=1e-8)
    assert ((touched >= 0) == (depth > 0)).all()


def test_depth_in_a_rough_heightfield_is_as_found_by_many_rays() -> None:
    rng = np.random.default_rng(3)
    nrow, ncol = 31, 41
    model = build(
        '<geom name="field" type="hfield" hfield="h" euler="0 0 25"/>',
        f'<hfield name="h" nrow="{nrow}" ncol="{ncol}" size=".8 .6 .03 .1"/>',
        rng.random((nrow, ncol)),
    )
    qpos = standing(model, 30)
    qpos[:, :2] = rng.uniform(-0.4, 0.4, (30, 2))
    qpos[:, 2] += rng.uniform(-0.02, 0.04, 30)
    qpos[:, 3:7] = np.array([1, 0, 0, 0]) + 0.1 * rng.standard_normal((30, 4))
    qpos[:, 7] = rng.uniform(-0.3, 0.3, 30)
    result = check(model, qpos)
    data = mujoco.MjData(model)
    sole, field = model.geom("sole").id, model.geom("field").id
    up, down = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0])
    grid = np.stack(np.meshgrid(np.linspace(-0.16, 0.16, 65), np.linspace(-0.16, 0.16, 65)), -1)
    yaw = math.radians(25)
    turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
    nodes = np.stack(np.meshgrid(np.linspace(-0.8, 0.8, ncol), np.linspace(-0.6, 0.6, nrow)), -1)
    nodes = nodes.reshape(-1, 2) @ turn
    x, y, z = model.geom("sole").size
    corner = np.array([[-x, -y, -z], [x, -y, -z], [x, y, -z], [-x, y, -z], [-x, -y, -z]])
    part = np.linspace(0, 1, 100)[:, None]
    outline = np.concatenate([(1 - part) * corner[i] + part * corner[i + 1] for i in range(4)])
    for frame, q in enumerate(Motion(model, qpos, FPS).qpos):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        deepest = 0.0
        lines = grid.reshape(-1, 2) + data.geom_xpos[sole, :2]
        edge = outline * 0.99999 @ data.geom_xmat[sole].reshape(3, 3).T + data.geom_xpos[sole]
        for x, y in np.concatenate((lines, nodes, edge[:, :2])):
            bottom = mujoco.mju_rayGeom(
                data.geom_xpos[sole],
                data.geom_xmat[sole],
                model.geom_size[sole],
                np.array([x, y, -3.0]),
                up,
                mujoco.mjtGeom.mjGEOM_BOX,
            )
            if bottom < 0:
                continue
            top = mujoco.mj_rayHfield(model, data, field, np.array([x, y, 3.0]), down)
            if top >= 0:
                deepest = max(deepest, (3 - top) - (bottom - 3))
        found = result.per_frame["sole_penetration_mm"][frame]
        # rays 5 mm apart, along the outline, and through all grid points
        assert found == pytest.approx(1000 * deepest, abs=2.5)
