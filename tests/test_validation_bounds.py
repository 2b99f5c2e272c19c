"""What prunes the measuring: bounds that must hold, and figures that must not depend on them."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mjmotion.body.motion import Motion
from mjmotion.validation.field import BoxTops, Tops
from mjmotion.validation.figures import Swing, poses_of, swing_clearances
from mjmotion.validation.ground import Ground
from mjmotion.validation.penetration import CharacterGeoms, sample_spacing, sole_points

SCENE = """
<geom type="hfield" hfield="h" pos=".1 .2 -.1" euler="0 0 30"/>
<geom type="box" size=".2 .3 .4" pos=".5 .1 .3" euler="20 30 40"/>
<geom type="box" size=".2 .3 .05" pos="-.5 .1 .4" euler="0 0 40"/>
<geom type="capsule" size=".1 .4" pos="-.5 .8 .3" euler="30 60 0"/>
<geom type="mesh" mesh="L" pos="-1 -1 .2"/>
<geom type="plane" size="1 1 1" pos="0 0 -.05" euler="3 2 0"/>"""
ASSETS = """
<hfield name="h" nrow="33" ncol="47" size="2 1.5 .3 .1"/>
<mesh name="L" vertex="0 0 0 2 0 0 2 1 0 1 1 0 1 2 0 0 2 0
  0 0 .4 2 0 .4 2 1 .4 1 1 .4 1 2 .4 0 2 .4"
  face="0 2 1 0 3 2 0 4 3 0 5 4 6 7 8 6 8 9 6 9 10 6 10 11 0 1 7 0 7 6 1 2 8 1 8 7
  2 3 9 2 9 8 3 4 10 3 10 9 4 5 11 4 11 10 5 0 6 5 6 11"/>"""
CHARACTER = """
<body name="foot" pos="0 0 1"><freejoint name="root"/>
  <geom name="sole" type="box" size=".12 .05 .02"/>
  <geom name="cap" type="ellipsoid" size=".06 .05 .05" pos="-.05 0 .02"/>
  <site name="foot_heel" pos="-.12 0 -.02"/><site name="foot_toe" pos=".12 0 -.02"/>
</body>"""


def build(scene: str = SCENE, seed: int = 5) -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_string(
        f"<mujoco><asset>{ASSETS}</asset><worldbody>{scene}{CHARACTER}</worldbody></mujoco>"
    )
    spec.hfields[0].userdata = np.random.default_rng(seed).random(33 * 47)
    return spec.compile()


def test_tops_are_the_highest_of_each_rectangle() -> None:
    rng = np.random.default_rng(1)
    values = rng.random((19, 31))
    tops = Tops(values)
    first = rng.integers(-8, 36, (400, 2))
    last = first + rng.integers(0, 25, (400, 2))
    found = tops.over(first, last)
    for (r, c), (end_r, end_c), top in zip(first, last, found, strict=True):
        part = values[max(r, 0) : max(end_r + 1, 0), max(c, 0) : max(end_c + 1, 0)]
        assert top == (part.max() if part.size else -np.inf)
    assert np.isinf(found).any() and np.isfinite(found).sum() > 100


def test_box_tops_miss_no_box_and_reach_little_beyond() -> None:
    rng = np.random.default_rng(2)
    low = rng.uniform(-3, 3, (50, 3))
    high = low + rng.uniform(0.01, 0.6, (50, 3))
    centre, extent = rng.uniform(-4, 4, (500, 3)), rng.uniform(0, 0.3, (500, 3))
    found = BoxTops(low, high).highest(centre, extent)

    def touched(slack: float) -> np.ndarray:
        gap = np.abs(centre[:, None] - (low + high) / 2) - (high - low) / 2 - extent[:, None]
        touch = (gap[:, :, :2] <= slack).all(axis=2)
        return np.where(touch, high[:, 2], -np.inf).max(axis=1)

    assert (found >= touched(0.0)).all()
    assert (found <= touched(0.1)).all()


@pytest.mark.parametrize("solids", [True, False])
def test_no_ground_is_higher_than_highest_says(solids: bool) -> None:
    rng = np.random.default_rng(3)
    ground = Ground(build())
    centre = np.concatenate((rng.uniform(-3, 3, (300, 2)), np.ones((300, 1))), axis=1)
    extent = rng.uniform(0, 0.3, (300, 3))
    bound = ground.highest(centre, extent, solids=solids)
    for _ in range(20):
        points = centre + extent * rng.uniform(-1, 1, centre.shape)
        if solids:
            points[:, 2] = 5.0
            height, _ = ground.heights(points)
        else:
            points[:, 2] = rng.uniform(-0.3, 0.5, len(points))
            depth, geom = ground.depth_in_surfaces(points)
            height = np.where(geom >= 0, points[:, 2] + depth, np.nan)
            assert (geom >= 0).any()
        assert not (height > bound + 1e-9).any()
    assert np.isfinite(bound).any()


def test_swing_clearance_is_that_of_the_lowest_of_all_points() -> None:
    """The pruned search against every sample of the foot in every frame."""
    model = build()
    rng = np.random.default_rng(4)
    nframe = 60
    qpos = np.tile(model.qpos0, (nframe, 1))
    qpos[:, :2] = rng.uniform(-1.5, 1.5, (nframe, 2))
    qpos[:, 2] = rng.uniform(0.3, 1.2, nframe)
    qpos[:, 3:7] = np.array([1.0, 0, 0, 0]) + 0.4 * rng.standard_normal((nframe, 4))
    foot = model.body("foot").id
    ground, geoms = Ground(model), CharacterGeoms.of(model, (foot,))
    poses = poses_of(Motion(model, qpos, 30.0), geoms)
    swings = [Swing(foot, start, start + 12, start, start + 12) for start in range(0, nframe, 12)]
    expected = np.full(nframe, np.inf)
    for i in range(2):
        position, matrix = poses.geom[:, i], poses.turn[:, i]
        xyz, frame = sole_points(geoms, i, position, matrix, sample_spacing(ground))
        clear = xyz[:, 2] - ground.heights(xyz)[0]
        np.fmin.at(expected, frame, clear)
    for swing, (found, where) in zip(
        swings, swing_clearances(swings, ground, geoms, poses), strict=True
    ):
        span = expected[swing.first : swing.last]
        assert found == pytest.approx(span.min(), abs=1e-12)
        assert where == swing.first + span.argmin()


def test_poses_are_those_of_one_frame_at_a_time_whatever_lies_between_the_geoms() -> None:
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><geom type="plane" size="1 1 1"/>
        <body name="a"><freejoint/><geom size=".1"/><geom size=".1" contype="0" conaffinity="0"/>
        <body pos="0 0 1"><joint/><geom size=".1" pos="0 .3 0"/><site name="s"/></body></body>
        </worldbody></mujoco>"""
    )
    rng = np.random.default_rng(6)
    motion = Motion(model, rng.standard_normal((7, model.nq)), 30.0)
    geoms = CharacterGeoms.of(model, ())
    assert geoms.ids.tolist() == [1, 3]
    poses = poses_of(motion, geoms)
    data = mujoco.MjData(model)
    for frame in range(7):
        data.qpos[:] = motion.qpos[frame]
        mujoco.mj_kinematics(model, data)
        np.testing.assert_array_equal(poses.geom[frame], data.geom_xpos[[1, 3]])
        np.testing.assert_array_equal(poses.turn[frame].reshape(2, 9), data.geom_xmat[[1, 3]])
        np.testing.assert_array_equal(poses.site[frame], data.site_xpos)
