"""Toes on a hinge at the ball: flat under a heel that rises, as recorded else, never in IK."""

import mujoco
import numpy as np
import pytest
from made_up import some

import mjmotion as mjm
from mjmotion.body.character import Character
from mjmotion.body.feet import STIFFENS, Foot
from mjmotion.body.kinematics import Kinematics, body_dofs, site_id
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.clips.foot_planting import toe_bend
from mjmotion.clips.recorded_feet import RecordedFoot
from mjmotion.footsteps.contacts import Contact, contact_mask
from mjmotion.footsteps.footholds import find_footholds
from mjmotion.footsteps.paths import turned_about_toes, with_toes
from mjmotion.footsteps.plan import Plan, with_ends
from mjmotion.footsteps.planning import make_plan
from mjmotion.footsteps.stances import Stance
from mjmotion.footsteps.toes import ball_over_tip, pitch_between, rolled_no_further
from mjmotion.footsteps.under_toes import TOES_DOWN, TOES_UP, toes_on_ground
from mjmotion.ik.count import parameters
from mjmotion.numerics.rotations import exp, rotate, to_matrix
from mjmotion.scene import Scene, load_scene
from mjmotion.validation import validate

LONG = 0.077  # from the ball to the tip of our adult's toes [m]
FLAT_WITHIN = 1e-3  # toes that lie on the ground are no further off it [m]
ROLLED_WITHIN = 3e-4  # an end of a ball is as far down as it may be [m]
FEET = ("left_foot", "right_foot")
SLOPE = np.deg2rad(8.0)


def humanoid() -> Character:
    return Character.load("humanoid")


def without_toes() -> Character:
    spec = humanoid().spec.copy()
    for side in ("left", "right"):
        spec.delete(spec.body(f"{side}_toes"))
    return Character.load(spec)


def sloping() -> Scene:
    """A plane that rises along the walk."""
    spec = mujoco.MjSpec()
    plane = spec.worldbody.add_geom(name="floor", size=(50.0, 50.0, 0.1))
    plane.type = mujoco.mjtGeom.mjGEOM_PLANE
    plane.quat = exp(np.array((0.0, -SLOPE, 0.0)))
    return Scene.of(spec)


def toe_points(foot: Foot, position: np.ndarray, quat: np.ndarray, bend: np.ndarray) -> np.ndarray:
    """World points (n, k, 3) of the toes' sole [m]."""
    toes = foot.bends[: len(foot.sole)]
    return position[:, None] + rotate(quat[:, None], foot.sole_at(bend)[:, toes])


def rolling(plan: Plan, foot: Foot) -> np.ndarray:
    """Frames in which the ball stands and the heel is well up."""
    path = next(path for path in plan.paths if path.site == foot.site)
    count = plan.source.nframe
    ball = contact_mask(plan.contacts, f"{foot.side}_toe", count)
    heel = contact_mask(plan.contacts, f"{foot.side}_heel", count)
    return np.flatnonzero(ball & ~heel & (path.toes > 0.1))


@pytest.mark.parametrize("slope", [False, True])
def test_toes_stay_flat_while_the_foot_rolls_over_its_ball(slope: bool) -> None:
    plan = make_plan(load_clip("straight"), sloping() if slope else load_scene("flat"))
    normal = rotate(exp(np.array((0.0, -SLOPE * slope, 0.0))), np.array((0.0, 0.0, 1.0)))
    for foot, path in zip(plan.source.character.feet, plan.paths, strict=True):
        frames = rolling(plan, foot)
        assert len(frames) > 5 and path.toes[frames].max() > 0.5
        place = path.position[frames], path.quat[frames]
        points = toe_points(foot, *place, path.toes[frames])
        assert np.abs(points @ normal).max() < FLAT_WITHIN
        stiff = toe_points(foot, *place, np.zeros(len(frames)))
        assert (stiff @ normal).min() < -0.03, "toes that do not bend would be in the ground"


def test_the_fitted_motion_has_them_flat_too() -> None:
    result = mjm.adapt("straight", "flat")
    model, data = result.motion.model, mujoco.MjData(result.motion.model)
    for foot in result.motion.character.feet:
        ball = contact_mask(result.contacts, f"{foot.side}_toe", result.motion.nframe)
        body = model.body(f"{foot.side}_toes").id
        for frame in np.flatnonzero(ball):
            data.qpos[:] = result.motion.qpos[frame]
            mujoco.mj_kinematics(model, data)
            up = data.xmat[body].reshape(3, 3)[2]
            ahead = data.xpos[body] + data.xmat[body].reshape(3, 3) @ (LONG, 0.0, 0.0)
            assert abs(data.xpos[body][2]) < FLAT_WITHIN and abs(ahead[2]) < FLAT_WITHIN, frame
            assert up[2] > 0.999


def test_they_stay_within_their_range_and_the_foot_goes_on_over_their_tip() -> None:
    (foot, _) = humanoid().feet
    assert foot.toes is not None
    high = foot.toes.high
    lying = np.array((0.0, high - STIFFENS, high + 2.0))
    raised = ball_over_tip(foot, lying, np.zeros(3))
    np.testing.assert_allclose(raised[:2], 0.0, atol=1e-12)
    away = LONG * (1.0 - np.cos(2.0)), 0.0, LONG * np.sin(2.0)
    np.testing.assert_allclose(raised[2], away, atol=1e-4)
    np.testing.assert_allclose(foot.toes.settled(lying), (0.0, high - STIFFENS, high), atol=1e-4)
    within = np.linspace(foot.toes.low, high - 0.01, 50)
    np.testing.assert_allclose(foot.toes.settled(foot.toes.wanted(within)), within, atol=1e-12)
    # A path turned further than that keeps its tip, and its toes are bent as far as they go.
    plan = make_plan(load_clip("straight"), load_scene("flat"))
    frames = rolling(plan, foot)
    path = plan.paths[0]
    further = exp(np.tile((0.0, 0.8, 0.0), (len(path.quat), 1)))
    quat = np.array([_multiplied(q, t) for q, t in zip(path.quat, further, strict=True)])
    turned = turned_about_toes(path, foot, quat)
    bends = [foot.toes.settled(one.toes) for one in (path, turned)]
    assert high - 0.01 < bends[1].max() <= high
    tips = [
        one.position + rotate(one.quat, foot.toes.turned(foot.front[None], bend)[:, 0])
        for one, bend in zip((path, turned), bends, strict=True)
    ]
    np.testing.assert_allclose(tips[1][frames], tips[0][frames], atol=1e-9)
    bent = with_toes(plan.source, [turned])
    assert bent.character.limits.excess(bent.qpos).max() < 1e-9


@pytest.mark.parametrize("roll", [-0.3, 0.3])
def test_a_ball_that_stands_is_not_rolled_on_to_one_end(roll: float) -> None:
    """An ankle that asks for a roll gets it in the air alone: a ball is a line, not a point."""
    foot, count = humanoid().feet[0], 3
    assert foot.toes is not None
    still = np.tile((1.0, 0.0, 0.0, 0.0), (count, 1))
    turned = exp(np.tile((roll, 0.2, 0.1), (count, 1)))
    stance, room = np.array((True, True, False)), np.array((0.0, 0.005, 1.0))
    quat, left = rolled_no_further(foot, (still, turned), np.zeros(count), stance, room)
    ends = rotate(quat[:, None], (foot.sole[-2:] - foot.toe)[None])[..., 2]
    flat = (foot.sole[-2:] - foot.toe)[:, 2]
    np.testing.assert_allclose((flat - ends).max(axis=1)[:2], room[:2], atol=ROLLED_WITHIN)
    np.testing.assert_array_equal(quat[2], turned[2])
    np.testing.assert_allclose(left[:2], 0.0, atol=ROLLED_WITHIN)
    np.testing.assert_allclose(pitch_between(still, quat), pitch_between(still, turned), atol=0.03)


def _multiplied(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    result = np.empty(4)
    mujoco.mju_mulQuat(result, first, second)
    return result


def recorded(bend: np.ndarray, toes: bool = True) -> RecordedFoot:
    """A foot that stands still for half the time, then is carried along at 1 m/s, 0.3 m up."""
    count, fps = len(bend), 60.0
    ankle = np.zeros((count, 3))
    half = count // 2
    ankle[half:, 0], ankle[:, 2] = np.arange(count - half) / fps, 0.0682
    ankle[half:, 2] += 0.3
    ball = ankle + (0.12, 0.0, -0.0682)
    still = np.tile(np.eye(3), (count, 1, 1))
    turned = to_matrix(exp(np.outer(bend, (0.0, -1.0, 0.0))))
    axis = np.tile((0.0, 1.0, 0.0), (count, 1))
    return RecordedFoot.recorded(ankle, ball, still, turned if toes else None, axis, None, fps)


def test_a_recording_with_a_toe_joint_gives_its_bend_and_one_without_gives_none() -> None:
    time = np.arange(240) / 60.0
    # At rest the recorded joint is bent by 0.2 as the foot stands flat: that is no bend.
    wanted = np.where(time < 2.0, 0.0, 0.3 * np.sin(np.pi * (time - 2.0)) ** 2)
    foot = recorded(wanted + 0.2)
    np.testing.assert_allclose(foot.bend, wanted, atol=0.02)
    assert (recorded(wanted, toes=False).bend == 0.0).all()
    (own, _) = humanoid().feet
    assert own.toes is not None
    ankle = np.array((0.0, 0.0, -0.0682))
    bend = toe_bend(foot, own.toes, ankle + own.toe, ankle + own.front, 60.0)
    np.testing.assert_allclose(bend[130:], wanted[130:], atol=0.02)


@pytest.mark.parametrize("name", ["walk", "sneak"])
def test_built_in_gaits_bend_them_and_keep_them_out_of_the_ground(name: str) -> None:
    motion = load_clip(name)
    pose = Kinematics(motion.model, motion.nframe).forward(motion.qpos)
    for foot in motion.character.feet:
        bend = foot.bend(pose)
        assert foot.toes is not None and np.rad2deg(bend.max()) > 30.0
        np.testing.assert_allclose(bend, motion.qpos[:, foot.toes.address], atol=1e-9)
        site = site_id(motion.model, foot.site)
        turn = pose.site_xmat[:, site]
        points = pose.site_xpos[:, site, None] + np.einsum("nij,nkj->nki", turn, foot.sole_at(bend))
        assert points[..., 2].min() > -FLAT_WITHIN


def test_ik_does_not_find_them() -> None:
    character = humanoid()
    assert parameters(character, FEET) == (20, 8)
    assert parameters(character, (*FEET, "left_hand", "right_hand")) == (37, 13)
    model = character.model
    for side in ("left", "right"):
        dof = int(model.joint(f"{side}_toes").dofadr[0])
        for site in ("heel", "toe", "foot"):
            body = int(model.site(f"{side}_{site}").bodyid[0])
            assert not body_dofs(model, body)[dof]


def test_a_body_without_them_rolls_over_its_toe_site() -> None:
    character = without_toes()
    walk = load_clip("straight")
    hinges = {some(foot.toes).address for foot in walk.character.feet}
    keep = [i for i in range(walk.model.nq) if i not in hinges]
    stiff = Motion(character, walk.qpos[:, keep], walk.fps)
    plan = make_plan(stiff, load_scene("flat"))
    for foot, path in zip(character.feet, plan.paths, strict=True):
        assert foot.toes is None and foot.bodies == (foot.body,) and not foot.bends.any()
        assert (foot.front == foot.toe).all() and (path.toes == 0.0).all()
        ball = path.position + rotate(path.quat, foot.toe)
        frames = np.flatnonzero(contact_mask(plan.contacts, f"{foot.side}_toe", stiff.nframe))
        assert len(frames) and np.abs(ball[frames, 2]).max() < 1e-9


def test_toes_follow_ground_that_rises_a_little_ahead() -> None:
    (foot, _) = humanoid().feet
    box = '<geom type="box" size="1 1 .5" pos="{x} 0 {z}" euler="0 {tilt} 0"/>'
    rise = 10.0
    # A ramp that begins under the ball, its top's lower edge at z = 0.
    turn = np.deg2rad(rise)
    corner = np.array((-np.cos(turn) - 0.5 * np.sin(turn), -np.sin(turn) + 0.5 * np.cos(turn)))
    ramp = box.format(x=0.12 - corner[0], z=-corner[1], tilt=-rise)
    floor = '<mujoco><worldbody><geom type="plane" size="9 9 .1"/>{}</worldbody></mujoco>'
    here = np.zeros(3), np.array((1.0, 0.0, 0.0, 0.0))

    def bend(geoms: str) -> float:
        scene = Scene.of(mujoco.MjSpec.from_string(floor.format(geoms)))
        return toes_on_ground(foot, scene.ground, *here)

    assert bend("") == 0.0
    assert bend(ramp) == pytest.approx(turn, abs=0.02)
    wall = '<geom type="box" size="1 1 .1" pos="1.15 0 .1"/>'
    assert bend(wall) == TOES_UP
    assert TOES_DOWN < TOES_UP
    # Ground that toes follow is good ground: a foot that has them stays where it is.
    stance = Stance(0, (0, 9), (0, 9), *here)
    for geoms, stays in (("", True), (ramp, True), (wall, False)):
        scene = Scene.of(mujoco.MjSpec.from_string(floor.format(geoms)))
        (stands,) = find_footholds((stance,), (foot,), scene.ground, 0.0)
        assert (stands.moved == 0.0) == stays


def test_a_stance_ends_as_its_ball_leaves_the_ground() -> None:
    feet, place = humanoid().feet, (np.zeros(3), np.array((1.0, 0.0, 0.0, 0.0)))
    stances = (Stance(0, (0, 10), (3, 20), *place), Stance(1, (12, 30), (14, 40), *place))
    left = (Contact("left_toe", 3, 8), Contact("left_toe", 9, 16), Contact("right_toe", 14, 40))
    first, second = with_ends(stances, feet, left)
    assert first.toe == (3, 16) and first.heel == (0, 10)
    assert second is stances[1]


def test_the_figures_see_them() -> None:
    """Toes bent into the ground under a foot that stands: no deeper and no less than they are."""
    standing = load_clip("straight").replace(np.tile(humanoid().model.qpos0, (40, 1)))
    result = mjm.adapt(standing, "flat")
    assert result.validate().metrics["sole_penetration_mm"] < 0.1
    (foot, _) = result.motion.character.feet
    assert foot.toes is not None
    bent = result.motion.replace(foot.toes.put(result.motion.qpos, np.full(40, -0.4)))
    figures = validate(result.source, bent, result.contacts).metrics
    assert figures["sole_penetration_mm"] == pytest.approx(1e3 * LONG * np.sin(0.4), abs=0.5)
    assert figures["obstacle_penetration_mm"] == 0.0


def test_pitch_is_how_far_the_heel_is_up() -> None:
    turn = exp(np.array(((0.0, 0.3, 0.0), (0.0, -0.2, 0.0))))
    flat = np.tile((1.0, 0.0, 0.0, 0.0), (2, 1))
    np.testing.assert_allclose(pitch_between(flat, turn), (0.3, -0.2), atol=1e-12)
