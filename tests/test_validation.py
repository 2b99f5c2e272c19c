"""Figures on made-up motions whose drift, gaps, depths, clearance and jerk are known exactly."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from mjmotion.body.motion import Motion
from mjmotion.exceptions import ContactError, MotionError
from mjmotion.footsteps.contacts import Contact
from mjmotion.validation import THRESHOLDS, Validation, read_thresholds, validate
from mjmotion.validation.figures import joint_jerk, sole_sites
from mjmotion.validation.ground import Ground
from mjmotion.validation.penetration import character_of, penetration

FPS = 30.0
# A trunk on a foot: the sole is 20 cm by 10 cm and level with z = 0 where the root is at 0.5.
CHARACTER = """
<body name="trunk" pos="0 0 .5"><freejoint name="root"/>
  <geom name="trunk" type="box" size=".1 .1 .1" pos="0 0 .3" contype="0" conaffinity="1"/>
  <body name="foot" pos="0 0 -.4">
    <joint name="ankle" axis="0 1 0" range="-57.29577951308232 57.29577951308232" limited="true"/>
    <geom name="sole" type="box" size=".1 .05 .02" pos="0 0 -.08" contype="0" conaffinity="1"/>
    <site name="foot_heel" pos="-.1 0 -.1"/><site name="foot_toe" pos=".1 0 -.1"/>
  </body>
</body>"""
PLANE = '<geom name="floor" type="plane" size="5 5 .1"/>'


def build(
    scene: str = PLANE, assets: str = "", heights: np.ndarray | None = None
) -> mujoco.MjModel:
    xml = f"<mujoco><asset>{assets}</asset><worldbody>{scene}{CHARACTER}</worldbody></mujoco>"
    spec = mujoco.MjSpec.from_string(xml)
    if heights is not None:
        spec.hfields[0].userdata = heights.ravel()
    return spec.compile()


def standing(model: mujoco.MjModel, nframe: int = 40) -> np.ndarray:
    return np.tile(model.qpos0, (nframe, 1))


def check(
    model: mujoco.MjModel,
    qpos: np.ndarray,
    contacts: Sequence[Contact] = (),
    source: np.ndarray | None = None,
    **options: Any,
) -> Validation:
    source = standing(model, len(qpos)) if source is None else source
    return validate(Motion(model, source, FPS), Motion(model, qpos, FPS), contacts, **options)


BOTH = (Contact("foot_heel", 0, 40), Contact("foot_toe", 0, 40))


def test_a_still_stance_breaks_nothing() -> None:
    model = build()
    result = check(model, standing(model), BOTH)
    for name in ("stance_drift_mm", "stance_gap_max_mm", "foot_skate_mm_s", "sole_penetration_mm"):
        assert result.metrics[name] == pytest.approx(0.0, abs=1e-9)
    assert result.metrics["jerk_ratio_rms"] == 1.0
    assert math.isnan(result.metrics["stance_gap_hfield_p95_mm"])
    assert math.isnan(result.metrics["swing_clearance_mm"])
    assert result.broken() == []


def test_drift_is_the_largest_distance_from_the_mean_place() -> None:
    model = build()
    qpos = standing(model)
    qpos[:10, 0] = 0.001 * np.arange(10)  # 0 to 9 mm, mean 4.5
    qpos[10:, 0] = 0.009
    contacts = (Contact("foot_heel", 0, 10), Contact("foot_toe", 10, 40))
    result = check(model, qpos, contacts)
    assert result.metrics["stance_drift_mm"] == pytest.approx(4.5)
    assert [entry["drift_mm"] for entry in result.per_contact] == pytest.approx([4.5, 0.0])
    assert result.worst["stance_drift_mm"].where == "foot_heel"
    assert result.worst["stance_drift_mm"].frame in (0, 9)
    # 9 steps of 1 mm, 29 of none, at 30 fps
    assert result.metrics["foot_skate_mm_s"] == pytest.approx(9 * 30 / 38)
    assert "stance_drift_mm" in result.broken()


@pytest.mark.parametrize("height", [0.003, -0.003])
def test_gap_counts_above_and_below(height: float) -> None:
    model = build()
    qpos = standing(model)
    qpos[17, 2] += height
    result = check(model, qpos, BOTH)
    assert result.metrics["stance_gap_max_mm"] == pytest.approx(3.0)
    assert result.worst["stance_gap_max_mm"].frame == 17
    assert result.worst["stance_gap_max_mm"].where.endswith("over floor")
    assert result.metrics["sole_penetration_mm"] == pytest.approx(max(0.0, -1000 * height))
    assert result.per_frame["gap_mm/foot_toe"][17] == pytest.approx(3.0)
    assert ("stance_gap_max_mm" in result.broken()) and (
        "sole_penetration_mm" not in result.broken()
    )


def test_gap_on_a_heightfield_is_the_95th_percentile() -> None:
    model = build(
        '<geom name="field" type="hfield" hfield="h"/>',
        '<hfield name="h" nrow="11" ncol="11" size="1 1 1 .1"/>',
        np.zeros((11, 11)),
    )
    qpos = standing(model, 101)
    qpos[:, 2] += np.linspace(0, 0.02, 101)
    result = check(model, qpos, (Contact("foot_heel", 0, 101),))
    assert result.metrics["stance_gap_hfield_p95_mm"] == pytest.approx(19.0)
    assert math.isnan(result.metrics["stance_gap_max_mm"])
    assert result.per_contact[0]["ground_kind"] == "hfield"
    assert result.per_contact[0]["gap_mm"] == pytest.approx(20.0)


def test_nothing_under_a_contact_is_an_infinite_gap() -> None:
    model = build('<geom name="block" type="box" size=".05 1 .1" pos="-.1 0 -.1"/>')
    result = check(model, standing(model), BOTH)  # the toe hangs over the edge of the world
    assert result.metrics["stance_gap_max_mm"] == math.inf
    assert result.worst["stance_gap_max_mm"].where == "foot_toe over nothing"
    assert "stance_gap_max_mm" in result.broken()


def test_sole_penetration_of_a_tilted_foot_is_its_lowest_corner() -> None:
    model = build()
    qpos = standing(model)
    qpos[5, 7] = 0.2
    # ankle at 0.1; the toe corner turns about it
    depth = 0.1 * math.sin(0.2) + 0.1 * math.cos(0.2) - 0.1
    result = check(model, qpos, BOTH)
    assert result.metrics["sole_penetration_mm"] == pytest.approx(1000 * depth)
    assert str(result.worst["sole_penetration_mm"]) == "frame 5, foot in floor"
    assert result.per_frame["sole_penetration_mm"][6] == 0.0


def test_sole_penetration_on_a_slope_is_measured_along_its_normal() -> None:
    model = build('<geom name="slope" type="plane" size="5 5 .1" euler="0 -30 0"/>')
    qpos = standing(model)
    angle = math.radians(30)
    # the toe corner (0.1, 0, 0) is under the plane z = x tan 30
    result = check(model, qpos)
    assert result.metrics["sole_penetration_mm"] == pytest.approx(100 * math.sin(angle))


def test_sole_penetration_into_a_step() -> None:
    model = build(PLANE + '<geom name="step" type="box" size=".5 .5 .1" pos="0 0 .1"/>')
    qpos = standing(model)
    qpos[:, 2] += 0.2
    qpos[8, 2] -= 0.006
    result = check(model, qpos, BOTH)
    assert result.metrics["sole_penetration_mm"] == pytest.approx(6.0, abs=1e-3)
    assert str(result.worst["sole_penetration_mm"]) == "frame 8, foot in step"
    assert result.metrics["stance_gap_max_mm"] == pytest.approx(6.0)


def test_a_toe_in_a_riser_is_as_deep_as_the_way_out() -> None:
    model = build(PLANE + '<geom name="step" type="box" size=".5 .5 .1" pos="0.597 0 .1"/>')
    result = check(model, standing(model))
    assert result.metrics["sole_penetration_mm"] == pytest.approx(3.0, abs=1e-3)


@pytest.mark.parametrize("node", [(10, 11), (9, 8), (10, 10)])
def test_one_grid_point_that_pokes_through_the_sole_is_found(node: tuple[int, int]) -> None:
    heights = np.zeros((21, 21))
    heights[node] = 1.0
    model = build(
        '<geom name="field" type="hfield" hfield="h"/>',
        '<hfield name="h" nrow="21" ncol="21" size=".2 .2 .008 .1"/>',
        heights,
    )
    result = check(model, standing(model))
    # every second centimetre a grid point: all of these are under the sole, 8 mm high
    assert result.metrics["sole_penetration_mm"] == pytest.approx(8.0, abs=1e-4)


def test_a_foot_deep_in_a_heightfield() -> None:
    heights = np.full((9, 13), 0.5)
    heights[0, 0], heights[-1, -1] = 0.0, 1.0
    model = build(
        '<geom name="field" type="hfield" hfield="h" pos="0 0 -.5" euler="0 0 40"/>',
        '<hfield name="h" nrow="9" ncol="13" size="2 1 1 .1"/>',
        heights,
    )
    qpos = standing(model)
    qpos[3, 2] -= 0.4  # the field is level with z = 0 where the character stands
    result = check(model, qpos)
    assert result.metrics["sole_penetration_mm"] == pytest.approx(400.0, abs=1e-4)
    assert str(result.worst["sole_penetration_mm"]) == "frame 3, foot in field"
    # the trunk's underside is 0.7 above the sole
    assert result.metrics["obstacle_penetration_mm"] == 0.0


def test_obstacle_penetration_names_body_and_obstacle() -> None:
    wall = '<geom name="wall" type="box" size=".1 1 1" pos=".3 0 1"/>'
    model = build(PLANE + wall)
    qpos = standing(model)
    qpos[:, 0] = 0.05
    qpos[21, 0] = 0.125  # the trunk's face at 0.225, the wall's at 0.2
    result = check(model, qpos)
    assert result.metrics["obstacle_penetration_mm"] == pytest.approx(25.0, abs=1e-3)
    assert str(result.worst["obstacle_penetration_mm"]) == "frame 21, trunk in wall"
    # the sole is in it as well, and counted apart
    assert result.metrics["sole_penetration_mm"] == pytest.approx(25.0, abs=1e-3)
    touching = standing(model)
    touching[:, 0] = 0.1
    assert check(model, touching).broken() == []


def test_obstacle_penetration_into_the_floor() -> None:
    model = build()
    qpos = standing(model)
    qpos[3, 3:7] = [math.cos(math.pi / 4), 0, math.sin(math.pi / 4), 0]  # face down
    qpos[3, 2] = 0.06
    result = check(model, qpos)
    assert result.metrics["obstacle_penetration_mm"] == pytest.approx(40.0)


def walk_over(lift: float, model: mujoco.MjModel) -> np.ndarray:
    """40 frames: 10 on the ground, 20 at ``lift`` with ramps of 2 frames, 10 on the ground."""
    qpos = standing(model)
    ramp = np.concatenate(([1 / 3, 2 / 3], np.ones(16), [2 / 3, 1 / 3]))
    qpos[10:30, 2] += lift * ramp
    return qpos


STEP = tuple(
    Contact(site, *span) for site in ("foot_heel", "foot_toe") for span in ((0, 10), (30, 40))
)


@pytest.mark.parametrize(
    ("adapted", "own", "broken"),
    [(0.030, 0.050, False), (0.009, 0.050, True), (0.004, 0.006, False), (0.002, 0.006, True)],
)
def test_swing_clearance_and_what_is_asked_of_it(adapted: float, own: float, broken: bool) -> None:
    model = build()
    result = check(model, walk_over(adapted, model), STEP, walk_over(own, model))
    assert result.metrics["swing_clearance_mm"] == pytest.approx(1000 * adapted)
    assert result.metrics["source_swing_clearance_mm"] == pytest.approx(1000 * own)
    assert ("swing_clearance_mm" in result.broken()) is broken
    (swing,) = result.per_swing
    assert (swing["start"], swing["end"]) == (10, 30)
    assert 15 <= swing["frame"] < 25


def test_every_swing_is_held_against_its_own_source() -> None:
    model = build()
    high, low = walk_over(0.05, model), walk_over(0.002, model)
    source = np.concatenate((high, low))
    contacts = STEP + tuple(Contact(c.site, c.start + 40, c.end + 40) for c in STEP)
    # the first swing is lower than asked; the second as low as its own source, which is lower
    result = check(model, np.concatenate((walk_over(0.004, model), low)), contacts, source)
    assert result.metrics["swing_clearance_mm"] == pytest.approx(4.0)
    assert result.metrics["source_swing_clearance_mm"] == pytest.approx(50.0)
    assert result.broken() == ["swing_clearance_mm"]
    assert result.broken({"swing_clearance_mm": 3}) == []
    assert [swing["clearance_mm"] for swing in result.per_swing] == pytest.approx([4.0, 2.0])


def test_source_clearance_is_over_the_sources_own_ground() -> None:
    model = build()
    source = walk_over(0.05, model)
    source[:, 2] += 0.8  # the source's flat ground is somewhere else
    result = check(model, walk_over(0.05, model), STEP, source)
    assert result.metrics["source_swing_clearance_mm"] == pytest.approx(50.0)


def test_swing_clearance_over_a_block_and_under_a_lintel() -> None:
    block = '<geom name="block" type="box" size=".02 .3 .02" pos=".05 0 .02"/>'
    lintel = '<geom name="lintel" type="box" size=".3 .3 .05" pos="0 0 1.5"/>'
    model = build(PLANE + block + lintel)
    result = check(model, walk_over(0.055, model), STEP)
    assert result.metrics["swing_clearance_mm"] == pytest.approx(15.0)


def test_a_short_gap_between_contacts_is_no_swing() -> None:
    model = build()
    contacts = (Contact("foot_heel", 0, 20), Contact("foot_heel", 22, 40))
    assert check(model, standing(model), contacts).per_swing == []


def test_jerk_of_a_sine_is_known() -> None:
    model = build()
    period, amplitude = 40, 0.1
    frames = np.arange(2 * period + 3)
    own = standing(model, len(frames))
    own[:, 7] = amplitude * np.sin(2 * np.pi * frames / period)
    adapted = own.copy()
    adapted[:, 7] *= 1.25
    # third difference of a sine: each difference multiplies by 2 fps sin(pi / period)
    rms = amplitude / math.sqrt(2) * (2 * FPS * math.sin(math.pi / period)) ** 3
    jerk = joint_jerk(Motion(model, own, FPS))
    assert jerk.shape == (2 * period, 1)
    assert np.sqrt(np.mean(jerk**2)) == pytest.approx(rms)
    result = check(model, adapted, source=own)
    assert result.metrics["jerk_ratio_rms"] == pytest.approx(1.25, rel=1e-6)
    assert result.metrics["jerk_ratio_p999"] == pytest.approx(1.25, rel=1e-6)
    assert result.per_joint["ankle"] == pytest.approx((1.25 * rms, rms))
    assert result.broken({"jerk_ratio_rms": 1.2}).count("jerk_ratio_rms") == 1
    assert "jerk_ratio_rms" not in result.broken()


def test_one_jolt_shows_in_the_extreme_and_is_located() -> None:
    model = build()
    frames = np.arange(200)
    own = standing(model, 200)
    own[:, 7] = 0.3 * np.sin(frames / 10)
    adapted = own.copy()
    adapted[100, 7] += 0.02
    result = check(model, adapted, source=own)
    assert result.metrics["jerk_ratio_p999"] > 2
    assert result.worst["jerk_ratio_p999"].where == "ankle"
    frame = result.worst["jerk_ratio_p999"].frame
    assert frame is not None and 96 <= frame <= 100


def test_root_travel() -> None:
    model = build()
    own = standing(model)
    own[:, 0] = np.linspace(0, 2, 40)
    adapted = own.copy()
    adapted[:, 0] *= 0.95
    result = check(model, adapted, source=own)
    assert result.metrics["root_travel_ratio"] == pytest.approx(0.95)
    assert result.metrics["root_displacement_ratio"] == pytest.approx(0.95)
    assert result.broken() == ["root_travel_ratio"]
    assert result.broken({"root_travel_ratio": (0.9, 1.1)}) == []


def test_joint_limit() -> None:
    model = build()
    qpos = standing(model)
    qpos[12, 7] = -1.01
    result = check(model, qpos)
    assert result.metrics["joint_limit_rad"] == pytest.approx(0.01)
    assert str(result.worst["joint_limit_rad"]) == "frame 12, ankle"


def test_short_motions_have_figures_too() -> None:
    model = build()
    for nframe in (1, 2, 3):
        result = check(model, standing(model, nframe), (Contact("foot_heel", 0, nframe),))
        assert result.metrics["stance_drift_mm"] == pytest.approx(0.0, abs=1e-9)
        assert math.isnan(result.metrics["jerk_ratio_rms"])
        assert result.broken() == []


def test_what_does_not_belong_together() -> None:
    model = build()
    motion = Motion(model, standing(model), FPS)
    with pytest.raises(MotionError, match="39 frames"):
        validate(Motion(model, standing(model, 39), FPS), motion, ())
    with pytest.raises(MotionError, match="fps"):
        validate(Motion(model, standing(model), 60), motion, ())
    with pytest.raises(ContactError, match="foot_heel"):
        validate(motion, motion, (Contact("foot_hell", 0, 3),))
    with pytest.raises(ContactError, match="frame 3 to 41"):
        validate(motion, motion, (Contact("foot_heel", 3, 41),))


def test_soles_are_found_by_name_without_contacts() -> None:
    model = build()
    assert [model.site(i).name for i in sole_sites(model, ())] == ["foot_heel", "foot_toe"]


# The scene along vertical lines


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
    ground, character = Ground(model), character_of(model, ())
    data = mujoco.MjData(model)
    expected = np.zeros((60, 2))
    position, matrix = np.empty((60, 2, 3)), np.empty((60, 2, 3, 3))
    for frame, i in itertools.product(range(60), range(2)):
        data.qpos[:] = qpos[frame]
        mujoco.mj_kinematics(model, data)
        geom = int(character.geoms[i])
        position[frame, i] = data.geom_xpos[geom]
        matrix[frame, i] = data.geom_xmat[geom].reshape(3, 3)
        for solid in ground.convex:
            gap = mujoco.mj_geomDistance(model, data, geom, solid, 0.0, None)
            expected[frame, i] = max(expected[frame, i], -gap)
    depth, other = penetration(ground, character, position, matrix)
    assert (expected > 0.01).sum() > 20 and (expected == 0).sum() > 20
    np.testing.assert_allclose(depth, expected, atol=1e-8)
    assert ((other >= 0) == (depth > 0)).all()


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


# Thresholds


def test_thresholds_from_texts_mappings_and_files(tmp_path: Path) -> None:
    texts = ["stance_drift_mm=2", "root_travel_ratio=0.9,1.1", "jerk_ratio_rms = none"]
    wanted = THRESHOLDS | {
        "stance_drift_mm": 2.0,
        "root_travel_ratio": (0.9, 1.1),
        "jerk_ratio_rms": None,
    }
    assert read_thresholds(texts) == wanted
    file = tmp_path / "limits.yaml"
    file.write_text(
        "stance_drift_mm: 2\nroot_travel_ratio: [0.9, 1.1]\njerk_ratio_rms: null\n", "utf-8"
    )
    assert read_thresholds(file) == wanted
    file.write_text("joint_limit_rad: 1e-3\n", "utf-8")
    assert read_thresholds(file)["joint_limit_rad"] == 1e-3
    assert read_thresholds({}) == THRESHOLDS


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("stance_drift=2", "Did you mean 'stance_drift_mm'"),
        ("stance_drift_mm", "name=value"),
        ("stance_drift_mm=", "name=value"),
        ("stance_drift_mm=soft", "not a number"),
        ("stance_drift_mm=1,2", "must be a number"),
        ("stance_drift_mm=nan", "not a number"),
        ("root_travel_ratio=1", "two numbers"),
        ("root_travel_ratio=2,1", "above"),
    ],
)
def test_bad_thresholds_say_why(text: str, message: str) -> None:
    with pytest.raises(MotionError, match=message):
        read_thresholds([text])


def test_bad_threshold_files_say_why(tmp_path: Path) -> None:
    with pytest.raises(MotionError, match="cannot be read"):
        read_thresholds(tmp_path / "none.yaml")
    file = tmp_path / "bad.yaml"
    for text, message in (("[1, 2", "not YAML"), ("- 1\n", "map names"), ("a: 1\n", "unknown")):
        file.write_text(text, "utf-8")
        with pytest.raises(MotionError, match=message):
            read_thresholds(file)


def test_thresholds_given_to_validate_stay_with_the_result() -> None:
    model = build()
    qpos = standing(model)
    qpos[:, 2] += 0.003
    result = check(model, qpos, BOTH, thresholds={"stance_gap_max_mm": 4})
    assert result.broken() == []
    assert result.broken({}) == ["stance_gap_max_mm"]
    row = next(row for row in result.summary() if row.figure == "stance_gap_max_mm")
    assert (row.ok, row.unit, row.threshold) == (True, "mm", "≤ 4")


def test_the_humanoid_stands_on_a_floor() -> None:
    spec = mujoco.MjSpec.from_file(
        str(Path(__file__).parents[1] / "models" / "mjcf" / "humanoid.xml")
    )
    spec.worldbody.add_geom(
        name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 0.1], condim=3
    )
    model = spec.compile()
    contacts = tuple(
        Contact(f"{side}_{part}", 0, 10) for side in ("left", "right") for part in ("heel", "toe")
    )
    result = check(model, standing(model, 10), contacts)
    for name in ("stance_gap_max_mm", "sole_penetration_mm", "obstacle_penetration_mm"):
        assert result.metrics[name] < 0.01, name
    assert result.broken() == []
