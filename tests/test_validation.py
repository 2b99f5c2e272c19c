"""Figures on made-up motions whose drift, gaps, depths, clearance and jerk are known exactly."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np
import pytest
from made_up import some

from mjmotion.body.motion import Motion
from mjmotion.exceptions import ContactError, MotionError
from mjmotion.footsteps.contacts import Contact
from mjmotion.validation import Validation, validate
from mjmotion.validation.figures import joint_jerk, sole_sites

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
    thresholds: Mapping[str, object] | None = None,
) -> Validation:
    source = standing(model, len(qpos)) if source is None else source
    before, motion = Motion(model, source, FPS), Motion(model, qpos, FPS)
    return validate(before, motion, contacts, thresholds=thresholds)


BOTH = (Contact("foot_heel", 0, 40), Contact("foot_toe", 0, 40))


def test_a_still_stance_breaks_nothing() -> None:
    model = build()
    result = check(model, standing(model), BOTH)
    for name in ("stance_drift_mm", "stance_gap_max_mm", "foot_skate_mm_s", "sole_penetration_mm"):
        assert result.metrics[name] == pytest.approx(0.0, abs=1e-9)
    assert math.isnan(result.metrics["stance_gap_hfield_p95_mm"])
    assert math.isnan(result.metrics["swing_clearance_mm"])
    assert result.broken() == []


@pytest.mark.parametrize("moved", [False, True])
def test_a_ratio_to_nothing_is_none(moved: bool) -> None:
    """Over a source that stands still nothing can be said, whether the motion moves or not."""
    model = build()
    qpos = standing(model)
    if moved:
        qpos[:, 0] += 0.3 * np.sin(np.linspace(0.0, 3.0, len(qpos)))
        qpos[:, 7:] += 0.1 * np.sin(np.linspace(0.0, 9.0, len(qpos)))[:, None]
    result = check(model, qpos, BOTH, source=standing(model))
    ratios = [name for name in result.metrics if "_ratio" in name]
    assert len(ratios) >= 7
    for name in ratios:
        assert math.isnan(result.metrics[name]), name
        assert name not in result.broken()
    (line,) = [one for one in result.table().splitlines() if one.startswith("root displacement")]
    assert "–" in line


def test_a_walk_there_and_back_has_a_path_and_no_displacement() -> None:
    model = build()
    there = standing(model)
    there[:, 0] = np.sin(np.linspace(0.0, np.pi, len(there)))
    near = there.copy()
    near[:, 0] *= 1.02
    near[-1, 0] = 0.004
    result = check(model, near, BOTH, source=there)
    assert result.metrics["root_travel_ratio"] == pytest.approx(1.02, abs=0.01)
    assert math.isnan(result.metrics["root_displacement_ratio"])


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
    assert check(model, touching).broken({"contact_kept_percent": None}) == []


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
    Contact(site, start, end)
    for site in ("foot_heel", "foot_toe")
    for start, end in ((0, 10), (30, 40))
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
    # A source that is lifted by 2 mm alone stands, says the figure of contacts.
    kept: dict[str, object] = {"contact_kept_percent": None}
    assert result.broken(kept) == ["swing_clearance_mm"]
    assert result.broken(kept | {"swing_clearance_mm": 3}) == []
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
    assert result.metrics["raw_jerk_ratio_rms"] == pytest.approx(1.25, rel=1e-6)
    # the low-pass mirrors both ends, which a sine goes through slope first
    assert result.per_joint["ankle"] == pytest.approx((1.25 * rms, rms), rel=5e-3)
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
    assert 96 <= some(result.worst["jerk_ratio_p999"].frame) <= 100


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
        contacts = [Contact(site, 0, nframe) for site in ("foot_heel", "foot_toe")]
        result = check(model, standing(model, nframe), contacts)
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
