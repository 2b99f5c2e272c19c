"""Obstacles of a scene, and the inequalities that keep a body out of them."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from made_up import character, humanoid, walk

from mjmotion.body.kinematics import character_geoms
from mjmotion.footsteps.obstacles import (
    LONG,
    MARGIN,
    STEP_MARGIN,
    ObstacleClearance,
    convex_obstacles,
    find_obstacles,
)
from mjmotion.numerics.tangent import oplus

EXACT = 1e-6  # distances of a box as such and as the hull of its corners [m]
SLOPE = 0.04  # of a distance against finite differences [m/rad]
LINTEL = '<geom name="lintel" type="box" size=".05 2 .1" pos="1 0 {z}"/>'


def compiled(body: str, assets: str = "") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><asset>{assets}</asset><worldbody>{body}</worldbody></mujoco>"
    )


PATH = np.column_stack((np.linspace(0.0, 2.0, 31), np.zeros(31), np.full(31, 0.9)))


def clearance(body: str, nframe: int = 40, path: np.ndarray = PATH) -> ObstacleClearance:
    obstacles = find_obstacles(compiled(body), path, ())
    return ObstacleClearance(character(), obstacles, nframe)


def standing(*x: float, z: float | None = None) -> np.ndarray:
    qpos = np.tile(humanoid().qpos0, (len(x), 1))
    qpos[:, 0] = x
    if z is not None:
        qpos[:, 2] = z
    return qpos


def test_what_counts_as_an_obstacle() -> None:
    """Convex solids that collide and do not move; not planes, fields, ghosts or hollow meshes."""
    half = "0 0 0  1 0 0  0 1 0  0 0 1"
    hollow = " ".join(
        f"{x} {y} {z}"
        for x, y in ((0, 0), (1, 0), (1, 0.1), (0.1, 0.1), (0.1, 1), (0, 1))
        for z in (0, 1)
    )
    faces = (
        "0 4 2 0 6 4 0 8 6 0 10 8 1 3 5 1 5 7 1 7 9 1 9 11 0 2 3 0 3 1 2 4 5 2 5 3"
        " 4 6 7 4 7 5 6 8 9 6 9 7 8 10 11 8 11 9 10 0 1 10 1 11"
    )
    model = compiled(
        '<geom name="floor" type="plane" size="1 1 1"/><geom name="box" type="box" size="1 1 1"/>'
        '<geom name="ball" size="1"/><geom name="post" type="cylinder" size=".1 1"/>'
        '<geom name="ghost" type="box" size="1 1 1" contype="0" conaffinity="0"/>'
        '<geom name="wedge" type="mesh" mesh="wedge"/><geom name="bent" type="mesh" mesh="bent"/>'
        '<geom name="hill" type="hfield" hfield="hill"/>'
        '<body><freejoint/><geom name="moving" size=".1"/></body>'
        '<body><geom name="fixed" type="capsule" size=".1 1"/></body>',
        f'<mesh name="wedge" vertex="{half}"/><mesh name="bent" vertex="{hollow}" face="{faces}"/>'
        '<hfield name="hill" nrow="3" ncol="3" size="1 1 1 1"/>',
    )
    names = {model.geom(int(geom)).name for geom in convex_obstacles(model)}
    assert names == {"box", "ball", "post", "wedge", "fixed"}


def test_obstacles_near_the_way() -> None:
    body = (
        LINTEL.format(z=1.7)
        + '<geom name="far" type="box" size=".1 .1 1" pos="1 4 1"/>'
        + '<geom name="beyond" type="box" size=".1 1 1" pos="9 0 1"/>'
        + '<geom name="kerb" type="box" size=".1 1 .05" pos="1 0 .05"/>'
    )
    found = {obstacle.name: obstacle for obstacle in find_obstacles(compiled(body), PATH, ())}
    assert set(found) == {"lintel", "kerb"}
    assert found["lintel"].tall and not found["kerb"].tall
    points = found["kerb"].points
    np.testing.assert_allclose(points.min(axis=0), (0.9, -1.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(points.max(axis=0), (1.1, 1.0, 0.1), atol=1e-12)
    assert find_obstacles(compiled('<geom type="plane" size="1 1 1"/>'), PATH, ()) == ()


@pytest.mark.parametrize("x", [-0.5, 2.5])
def test_a_wall_that_is_not_passed_is_where_it_is(x: float) -> None:
    """What is ahead of a walk's end, or behind its beginning, is not drawn out over the walk."""
    (wall,) = find_obstacles(compiled(f'<geom type="box" size=".05 2 1" pos="{x} 0 1"/>'), PATH, ())
    assert wall.tall
    np.testing.assert_allclose(wall.drawn.min(axis=0), wall.points.min(axis=0), atol=1e-12)
    np.testing.assert_allclose(wall.drawn.max(axis=0), wall.points.max(axis=0), atol=1e-12)
    (post,) = find_obstacles(compiled('<geom type="box" size=".05 .1 1" pos="1 .4 1"/>'), PATH, ())
    np.testing.assert_allclose(np.ptp(post.drawn[:, 0]), 0.1 + 2.0 * LONG)


def test_nothing_near_nothing_needed() -> None:
    keep = clearance(LINTEL.format(z=1.7))
    lacking = keep(standing(-3.0, -2.0, 5.0), np.arange(3))
    assert len(lacking.frame) == 0 and lacking.rows.shape == (0, humanoid().nv)
    assert len(keep(np.empty((0, humanoid().nq)), np.empty(0, int)).frame) == 0
    high = clearance(LINTEL.format(z=2.2))
    assert len(high(standing(0.9, 1.0), np.arange(2)).frame) == 0


@pytest.mark.parametrize("z", [1.72, 1.80, 1.86])
def test_a_lintel_over_the_head(z: float) -> None:
    """Under its middle the crown (1.75 m) lacks what the lintel's bottom and the margin take."""
    lacking = clearance(LINTEL.format(z=z))(standing(1.0), np.arange(1))
    bottom = z - 0.1
    if bottom - 1.75 > MARGIN:
        assert len(lacking.frame) == 0
        return
    worst = int(np.argmax(lacking.needed))
    assert lacking.needed[worst] == pytest.approx(1.75 + MARGIN - bottom, abs=0.003)
    np.testing.assert_allclose(lacking.needed + lacking.distance, MARGIN, atol=1e-12)
    # The way out is down: the root's z alone, at one metre a metre.
    np.testing.assert_allclose(lacking.rows[worst, :3], (0.0, 0.0, -1.0), atol=0.05)


def test_only_the_frames_that_lack() -> None:
    keep = clearance(LINTEL.format(z=1.7))
    lacking = keep(standing(-1.0, 1.0, 0.99, 2.9), np.array((7, 8, 9, 10)))
    assert set(lacking.frame.tolist()) == {1, 2}
    assert (lacking.needed > 0.0).all()


def test_distances_are_mujocos() -> None:
    """A kerb against shins and knees: the least of all geoms, measured in a model of both."""
    kerb = '<geom name="kerb" type="box" size=".1 1 .2" pos="1 0 .2"/>'
    spec = character().spec.copy()
    box = spec.worldbody.add_geom(name="kerb", size=(0.1, 1.0, 0.2), pos=(1.0, 0.0, 0.2))
    box.type = mujoco.mjtGeom.mjGEOM_BOX
    model = spec.compile()
    data, feet = mujoco.MjData(model), {body for foot in character().feet for body in foot.bodies}
    solids = [g for g in character_geoms(model, colliding=True) if model.geom_bodyid[g] not in feet]
    keep = clearance(kerb)
    places = (0.83, 0.85, 0.87, 0.90)
    lacking = keep(standing(*places), np.arange(4))
    for row, pose in enumerate(standing(*places)):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        wall = model.geom("kerb").id
        true = [mujoco.mj_geomDistance(model, data, g, wall, 1.0, None) for g in solids]
        near = np.sort([d for d in true if d < STEP_MARGIN])
        mine = np.sort(lacking.distance[lacking.frame == row])
        np.testing.assert_allclose(mine, near, atol=EXACT)
    assert len(np.unique(lacking.frame)) >= 2


@pytest.mark.parametrize("height", [0.9275, 0.88])
def test_rows_are_how_distances_change(height: float) -> None:
    """needed falls by ``rows @ d`` when the pose moves by a small d, joint by joint."""
    body = LINTEL.format(z=1.75) + '<geom name="post" type="box" size=".05 .05 1" pos="1 .36 1"/>'
    keep = clearance(body, nframe=60)
    qpos, nv, step = standing(0.97, z=height), humanoid().nv, 1e-4
    lacking = keep(qpos, np.arange(1))
    assert len(lacking.needed) >= 2
    moves = step * np.eye(nv)
    there, back = (
        keep(oplus(humanoid(), np.tile(qpos, (nv, 1)), sign * moves), np.arange(nv))
        for sign in (1.0, -1.0)
    )
    checked = 0
    for dof in range(nv):
        ahead, behind = there.distance[there.frame == dof], back.distance[back.frame == dof]
        if len(ahead) != len(lacking.distance) or len(behind) != len(lacking.distance):
            continue  # a pair came within the margin or left it
        slope = (ahead - behind) / (2.0 * step)
        # On a flat face the nearest point is any of it, so turns are told to some centimetres.
        np.testing.assert_allclose(slope, lacking.rows[:, dof], atol=SLOPE)
        checked += 1
    assert checked > 0.8 * nv


def test_what_is_inside() -> None:
    keep = clearance(LINTEL.format(z=1.7))
    depth, frame, names = keep.inside(standing(1.0, -2.0))
    assert set(frame.tolist()) == {0} and set(names) == {"lintel"}
    assert 0.05 < depth.max() < 0.2
    assert len(keep.inside(standing(-2.0))[0]) == 0


def test_feet_may_touch() -> None:
    """A foot stands on a step with its sole: feet are left out, shins are not."""
    step = '<geom name="step" type="box" size=".5 1 .1" pos="1 0 .1"/>'
    on = clearance(step)(standing(1.0, z=0.9275 + 0.2), np.arange(1))
    assert len(on.frame) == 0
    inside = clearance(step)(standing(1.0), np.arange(1))
    bodies = {humanoid().body(int(b)).name for b in range(humanoid().nbody)}
    assert len(inside.frame) > 0 and "left_shank" in bodies


def test_a_walk_under_a_lintel_lacks_only_there() -> None:
    motion = walk(3.0)
    keep = clearance(LINTEL.format(z=1.65), nframe=motion.nframe, path=motion.qpos[:, :3])
    lacking = keep(motion.qpos, np.arange(motion.nframe))
    x = motion.qpos[np.unique(lacking.frame), 0]
    assert len(x) > 5 and (np.abs(x - 1.0) < 0.6).all()
    assert lacking.rows.shape == (len(lacking.frame), motion.model.nv)
    assert np.isfinite(lacking.rows).all()
