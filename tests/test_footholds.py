"""Footholds on grounds whose right answer is known; feet and stances from contacts."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from made_up import character, humanoid, loop_sites, mixed, walk

from mjmotion.body.character import Character
from mjmotion.body.kinematics import Kinematics
from mjmotion.body.motion import Motion
from mjmotion.exceptions import ContactError, ModelError, SceneError
from mjmotion.footsteps.contacts import Contact, detect_contacts
from mjmotion.footsteps.footholds import Foothold, find_footholds
from mjmotion.footsteps.stances import Stance, find_stances
from mjmotion.numerics.rotations import rotate, yaw_quat
from mjmotion.scene import Scene
from mjmotion.scene.ground import Ground

PLACE = 0.002  # [m]
TURN = 0.005  # [rad]
SOLE = (-0.058, 0.197)  # from heel to the tip of the toes [m]
BALL = 0.12  # where the toes bend [m]


def scene(body: str, assets: str = "") -> Ground:
    xml = f"<mujoco><asset>{assets}</asset><worldbody>{body}</worldbody></mujoco>"
    return Scene.from_spec(mujoco.MjSpec.from_string(xml)).ground


PLANE = '<geom type="plane" size="9 9 .1" pos="0 0 {height}"/>'


def stance(x: float, y: float = 0.0, yaw: float = 0.0, foot: int = 0) -> Stance:
    """A foot flat on level ground with the posed site at (x, y)."""
    return Stance(foot, (0, 10), (0, 12), np.array((x, y, 0.0)), yaw_quat(np.asarray(yaw)))


def put(ground: Ground, *stances: Stance, start: float = 0.0) -> tuple[Foothold, ...]:
    return find_footholds(stances, character().feet, ground, start)


def test_feet_of_the_humanoid() -> None:
    feet = character().feet
    assert [foot.side for foot in feet] == ["left", "right"]
    for foot in feet:
        assert humanoid().body(foot.body).name == f"{foot.side}_foot"
        assert foot.site == f"{foot.side}_foot"
        np.testing.assert_allclose(foot.heel, (SOLE[0], 0, 0), atol=1e-9)
        np.testing.assert_allclose(foot.toe, (BALL, 0, 0), atol=1e-9)
        np.testing.assert_allclose(foot.front, (SOLE[1], 0, 0), atol=1e-6)
        assert np.abs(foot.sole[:, 2]).max() < 1e-3
        # The sole's outline reaches from heel to toe and a hand's breadth across.
        assert foot.sole[:, 0].min() == pytest.approx(SOLE[0], abs=0.01)
        assert foot.sole[:, 0].max() == pytest.approx(SOLE[1], abs=0.01)
        assert 0.06 < np.ptp(foot.sole[:, 1]) < 0.13


def test_models_without_feet() -> None:
    with pytest.raises(ModelError, match="no feet"):
        _ = Character.of(mixed()).feet
    half = '<mujoco><worldbody><body><freejoint/><geom size=".1"/><site name="a_heel"/></body>'
    with pytest.raises(ModelError, match="a_toe"):
        _ = Character.of(mujoco.MjModel.from_xml_string(half + "</worldbody></mujoco>")).feet


@pytest.mark.parametrize("height", [0.0, 0.3, -0.8])
@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.5])
def test_level_ground(height: float, yaw: float) -> None:
    (hold,) = put(scene(PLANE.format(height=height)), stance(1.0, -0.4, yaw), start=height)
    np.testing.assert_allclose(hold.position, (1.0, -0.4, height), atol=PLACE)
    np.testing.assert_allclose(
        rotate(hold.quat, np.eye(3)[0]), (np.cos(yaw), np.sin(yaw), 0), atol=TURN
    )
    np.testing.assert_allclose(hold.normal, (0, 0, 1), atol=TURN)
    assert hold.moved == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("angle", [5.0, 15.0])
@pytest.mark.parametrize("yaw", [0.0, 90.0, 30.0, 180.0])
def test_slopes_tilt_the_foot(angle: float, yaw: float) -> None:
    """Up along +x: the sole lies on the plane, and keeps its heading."""
    tilt = np.radians(angle)
    ground = scene(f'<geom type="plane" size="9 9 .1" euler="0 {-angle} 0"/>')
    (hold,) = put(ground, stance(0.5, 0.2, np.radians(yaw)), start=0.5 * np.tan(tilt))
    up = np.array((-np.sin(tilt), 0.0, np.cos(tilt)))
    np.testing.assert_allclose(hold.normal, up, atol=TURN)
    np.testing.assert_allclose(rotate(hold.quat, np.eye(3)[2]), up, atol=TURN)
    assert abs(up @ hold.position) < PLACE  # on the plane through the origin
    along = rotate(hold.quat, np.eye(3)[0])
    assert np.arctan2(along[1], along[0]) == pytest.approx(np.radians(yaw), abs=0.02)
    assert hold.moved < 0.01


def box(low: float, high: float, top: float, name: str = "box") -> str:
    """A box over x from low to high, wide in y, from the floor up to a height."""
    half = 0.5 * (high - low)
    return (
        f'<geom name="{name}" type="box" size="{half} 2 {0.5 * top}"'
        f' pos="{low + half} 0 {0.5 * top}"/>'
    )


def sole_points(hold: Foothold, index: int = 0) -> np.ndarray:
    foot = character().feet[index]
    return hold.position + rotate(hold.quat, foot.sole)


STEP = PLANE.format(height=0.0) + box(1.0, 3.0, 0.15)


@pytest.mark.parametrize("x", [0.82, 0.88, 0.93, 0.98, 1.02, 1.05])
def test_a_foot_that_straddles_a_step_moves_off_it_the_short_way(x: float) -> None:
    """It ends up level, wholly on one side, and no farther off than it has to be."""
    (hold,) = put(scene(STEP), stance(x))
    sole = sole_points(hold)
    assert np.ptp(sole[:, 2]) < PLACE
    if hold.position[2] > 0.1:
        assert hold.position[2] == pytest.approx(0.15, abs=PLACE)
        assert sole[:, 0].min() > 1.0 - PLACE  # nothing hangs over
        needed = 1.0 - (x + SOLE[0])
    else:
        assert hold.position[2] == pytest.approx(0.0, abs=PLACE)
        assert sole[:, 0].max() < 1.0 + PLACE  # nothing in the riser
        needed = x + SOLE[1] - 1.0
    shortest = min(1.0 - (x + SOLE[0]), x + SOLE[1] - 1.0)
    assert needed - 0.01 < hold.moved < max(shortest, 0.0) + 0.11


@pytest.mark.parametrize("x", [0.55, 0.7, 1.2, 1.8])
def test_feet_clear_of_an_edge_stay(x: float) -> None:
    (hold,) = put(scene(STEP), stance(x))
    assert hold.moved < 1e-9
    assert hold.position[2] == pytest.approx(0.15 if x > 1.0 else 0.0, abs=PLACE)


def test_a_foot_that_hangs_over_a_ledge_moves_back() -> None:
    """Nothing but a platform: toes over its end are drawn in, a foot off it comes back on."""
    ground = scene(box(0.0, 1.0, 0.4))
    for x in (0.9, 0.97, 1.03):
        (hold,) = put(ground, stance(x), start=0.4)
        sole = sole_points(hold)
        assert sole[:, 0].max() < 1.0 + PLACE and 0.01 < hold.moved < 0.34
        np.testing.assert_allclose(sole[:, 2], 0.4, atol=PLACE)


def test_nothing_to_stand_on() -> None:
    with pytest.raises(SceneError, match=r"no ground.*x=5\.00, y=0\.00.*frames 0") as caught:
        put(scene(box(0.0, 1.0, 0.4)), stance(0.5), stance(5.0), start=0.4)
    assert caught.value.frames == tuple(range(12))
    assert "\n" not in str(caught.value)


def test_walls_are_no_ground() -> None:
    """A foot beside a wall keeps out of it."""
    wall = '<geom type="box" size=".1 2 1" pos="1.1 0 1"/>'
    (hold,) = put(scene(PLANE.format(height=0.0) + wall), stance(0.9))
    assert sole_points(hold)[:, 0].max() < 1.0 + PLACE
    assert hold.position[2] == pytest.approx(0.0, abs=PLACE)


def test_heights_are_followed_from_stance_to_stance() -> None:
    """Up the stair under a bridge, not on to the bridge that is 1.6 m over the floor."""
    bridge = '<geom type="box" size="2 2 .05" pos="2 0 1.65"/>'
    stair = box(0.5, 1.0, 0.15, "one") + box(1.0, 1.5, 0.3, "two") + box(1.5, 4.0, 0.45, "three")
    holds = put(
        scene(PLANE.format(height=0.0) + stair + bridge),
        *(stance(x, foot=i % 2) for i, x in enumerate((0.2, 0.7, 1.2, 1.9))),
    )
    np.testing.assert_allclose([h.position[2] for h in holds], (0.0, 0.15, 0.3, 0.45), atol=PLACE)


def test_ghosts_and_moving_bodies_are_no_ground() -> None:
    picture = '<geom type="box" size="1 1 .2" pos="0 0 .2" contype="0" conaffinity="0"/>'
    moving = '<body pos="0 0 .5"><freejoint/><geom type="box" size="1 1 .1"/></body>'
    (hold,) = put(scene(PLANE.format(height=0.0) + picture + moving), stance(0.0))
    np.testing.assert_allclose(hold.position, 0.0, atol=PLACE)


def test_rough_ground_holds_the_sole_up() -> None:
    """A gentle heightfield: no part of the sole sinks more than 5 mm into it."""
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.linspace(-2, 2, 161), np.linspace(-2, 2, 161))
    heights = 0.05 * np.sin(2.0 * x + 0.3) * np.cos(1.7 * y) + 0.1
    spec = mujoco.MjSpec.from_string(
        '<mujoco><asset><hfield name="h" nrow="161" ncol="161" size="2 2 .1 .1"/></asset>'
        '<worldbody><geom type="hfield" hfield="h"/></worldbody></mujoco>'
    )
    spec.hfields[0].userdata = heights.ravel()
    low = float(heights.min())
    ground = Scene.from_spec(spec).ground
    points = rng.uniform(-1.2, 1.2, (6, 2))
    truth, _ = ground.under(np.column_stack((points, np.full(6, 0.5))))
    assert np.ptp(truth) > 0.01 and np.isfinite(truth).all() and low < 0.1
    for (px, py), z in zip(points, truth, strict=True):
        (hold,) = put(ground, stance(px, py, 0.4), start=float(z))
        sole = sole_points(hold)
        under, _ = ground.under(sole)
        assert (sole[:, 2] - under).min() > -0.005  # [m]
        assert abs(hold.position[2] - z) < 0.03 and hold.moved < 0.34


def test_stances_of_a_walk() -> None:
    motion = walk(3.6)
    contacts = detect_contacts(motion)
    pose = Kinematics(motion.model, motion.nframe).forward(motion.qpos)
    feet = motion.character.feet
    stances = find_stances(motion, pose, feet, contacts)
    assert [s.start for s in stances] == sorted(s.start for s in stances)
    sites = loop_sites(motion.model, motion.qpos)
    for one in stances:
        if one.end - one.start < 10:
            continue  # cut by the clip's ends, while a foot lifts off
        middle = (one.start + one.end) // 2
        foot = sites[middle, motion.model.site(feet[one.foot].site).id]
        np.testing.assert_allclose(one.source_pos, foot, atol=PLACE)
        np.testing.assert_allclose(one.source_quat, (1, 0, 0, 0), atol=TURN)
        spans = {(c.start, c.end) for c in contacts if c.site.startswith(feet[one.foot].side)}
        assert one.heel in spans and one.toe in spans
        assert one.start == min(one.heel[0], one.toe[0]) and one.end == max(one.heel[1], one.toe[1])


def test_stances_join_heel_and_toe() -> None:
    model = humanoid()
    motion = Motion(model, np.tile(model.qpos0, (40, 1)), 30.0)
    pose = Kinematics(model, 40).forward(motion.qpos)
    contacts = (
        Contact("left_heel", 0, 10),
        Contact("left_toe", 5, 18),
        Contact("left_toe", 25, 40),
    )
    first, second = find_stances(motion, pose, Character.of(model).feet, contacts)
    assert (first.heel, first.toe, first.start, first.end) == ((0, 10), (5, 18), 0, 18)
    assert (second.heel, second.toe, second.start, second.end) == ((0, 0), (25, 40), 25, 40)
    np.testing.assert_allclose(second.source_pos, (0.0, 0.09, 0.0), atol=PLACE)
    with pytest.raises(ContactError, match="left_hand"):
        find_stances(motion, pose, Character.of(model).feet, (Contact("left_hand", 0, 9),))
