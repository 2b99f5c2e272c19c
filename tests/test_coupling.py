"""Joints that share one set of degrees of freedom: a flexible spine, hinges, bad tuples."""

from __future__ import annotations

import functools

import mujoco
import numpy as np
import pytest
from made_up import humanoid, loop_quats, loop_sites, pin, some
from made_up import random_poses as poses

from mjmotion.body.assets import find_asset
from mjmotion.body.character import Character
from mjmotion.body.motion import Motion
from mjmotion.constraints import SiteConstraint, lay_out
from mjmotion.exceptions import ModelError
from mjmotion.fitting import fit
from mjmotion.ik import parameters
from mjmotion.ik.hybrid import HybridIK
from mjmotion.ik.numeric import NumericIK
from mjmotion.ik.solver import default_rigidity
from mjmotion.numerics.rotations import conjugate, exp, log, multiply
from mjmotion.numerics.tangent import ominus, oplus

EXACT = 0.01  # [% of height]
SHARE = 1e-9  # how exactly a joint has its share [rad]
SPINE = ("spine_lower", "spine_middle", "spine_upper")
HANDS, FEET = ("left_hand", "right_hand"), ("left_foot", "right_foot")
# A finger of three hinges on a free root: shares 1, 2 and 0.5, the second with a narrow range.
FINGER = """<mujoco><compiler angle="radian"/><worldbody>
<body name="palm" pos="0 0 1"><freejoint name="root"/><geom size=".1"/>
 <body name="a" pos=".1 0 0"><joint name="one" axis="0 1 0" range="-1 1"/><geom size=".02"/>
  <body name="b" pos=".1 0 0"><joint name="two" axis="0 1 0" range="-.4 1"/><geom size=".02"/>
   <body name="c" pos=".1 0 0"><joint name="three" axis="0 1 0" range="-3 3"/><geom size=".02"/>
    <joint name="side" axis="0 0 1" range="-1 1"/>
    <site name="tip" pos=".1 0 0"/></body></body></body></body></worldbody>
<custom>{}</custom></mujoco>"""
ELEMENT = '<element objtype="joint" objname="{}" prm="{}"/>'


def tied(*pairs: tuple[str, float], name: str = "couple_x") -> str:
    elements = "".join(ELEMENT.format(*pair) for pair in pairs)
    return f'<tuple name="{name}">{elements}</tuple>'


@functools.cache
def finger() -> mujoco.MjModel:
    text = tied(("one", 1.0), ("two", 2.0), ("three", 0.5))
    return mujoco.MjModel.from_xml_string(FINGER.format(text))


@functools.cache
def flexible() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(find_asset("model", "humanoid_flexible")))


@functools.cache
def with_tuple(*pairs: tuple[str, float]) -> mujoco.MjModel:
    """The rigid humanoid with a tuple of one's own."""
    text = find_asset("model", "humanoid").read_text("utf-8")
    return mujoco.MjModel.from_xml_string(text.replace("</custom>", tied(*pairs) + "</custom>"))


def turn_of(model: mujoco.MjModel, qpos: np.ndarray, joint: str) -> np.ndarray:
    at = model.joint(joint).qposadr[0]
    if model.joint(joint).type[0] == mujoco.mjtJoint.mjJNT_HINGE:
        return qpos[:, at : at + 1]
    return log(qpos[:, at : at + 4])


def unequal(model: mujoco.MjModel, qpos: np.ndarray) -> float:
    """How far any coupled joint is from its share of its group's turn [rad], worst frame."""
    worst = 0.0
    for group in Character.of(model).coupling.groups:
        shared = Character.of(model).coupling.shared_turn(group, qpos)
        for joint, share in zip(group.joints, group.shares, strict=True):
            off = turn_of(model, qpos, model.joint(joint).name) - share * shared
            worst = max(worst, float(np.abs(off).max()))
    return worst


def shares_of(model: mujoco.MjModel) -> dict[str, float]:
    (group,) = Character.of(model).coupling.groups
    return {model.joint(j).name: s for j, s in zip(group.joints, group.shares, strict=True)}


def standing(model: mujoco.MjModel, nframe: int = 31) -> Motion:
    """At rest with knees and elbows a little bent, a second at 30 fps."""
    qpos = np.tile(model.qpos0, (nframe, 1))
    for joint, angle in (("knee", 0.3), ("elbow", 0.5)):
        for side in ("left", "right"):
            qpos[:, model.joint(f"{side}_{joint}").qposadr[0]] = angle
    return Motion(model, qpos, 30.0)


def reaching(motion: Motion, reach: tuple[float, float, float]) -> list[SiteConstraint]:
    """Both hands away from where they are for half the time, feet where they are."""
    held = [pin(motion.model, motion.qpos, site) for site in FEET]
    for site in HANDS:
        own = loop_sites(motion.model, motion.qpos)[8:24, motion.model.site(site).id]
        held.append(SiteConstraint(site, np.arange(8, 24), own + reach))
    return held


def worst(result: Motion, constraints: list[SiteConstraint]) -> float:
    """Largest position error by MuJoCo itself [m]."""
    sites = loop_sites(result.model, result.qpos)
    return max(
        float(
            np.linalg.norm(sites[c.frames, result.model.site(c.site).id] - c.position, axis=1).max()
        )
        for c in constraints
    )


# Reading


def test_the_flexible_spine_is_read() -> None:
    (group,) = Character.of(flexible()).coupling.groups
    assert group.name == "spine"
    assert tuple(flexible().joint(joint).name for joint in group.joints) == SPINE
    assert sum(group.shares) == pytest.approx(1.0, abs=1e-5) and min(group.shares) > 0.1
    found = Character.of(flexible()).coupling
    assert len(found.leader) == 6 and found
    leader = flexible().joint(SPINE[0]).dofadr[0] + np.arange(3)
    np.testing.assert_array_equal(found.leader, [*leader, *leader])
    ratios = np.repeat(group.shares[1:], 3) / group.shares[0]
    np.testing.assert_allclose(found.ratio, ratios, rtol=1e-9)
    assert not Character.of(humanoid()).coupling and Character.of(humanoid()).coupling.groups == ()


def test_tuples_of_other_names_are_not_ours() -> None:
    text = tied(("one", -3.0), name="something")
    assert Character.of(mujoco.MjModel.from_xml_string(FINGER.format(text))).coupling.groups == ()


BAD_TUPLES = {
    "one joint": (tied(("one", 1.0)), "two joints or more"),
    "a body": (
        '<tuple name="couple_x"><element objtype="joint" objname="one" prm="1"/>'
        '<element objtype="body" objname="a" prm="1"/></tuple>',
        "nothing else",
    ),
    "free root": (tied(("root", 1.0), ("one", 1.0)), "one kind"),
    "no share": (tied(("one", 1.0), ("two", 0.0)), "positive share"),
    "negative share": (tied(("one", 1.0), ("two", -1.0)), "positive share"),
    "twice": (tied(("one", 1.0), ("one", 2.0)), "coupled already"),
    "two tuples": (
        tied(("one", 1.0), ("two", 1.0)) + tied(("two", 1.0), ("three", 1.0), name="couple_y"),
        "'couple_y'.*coupled already",
    ),
}


@pytest.mark.parametrize("case", sorted(BAD_TUPLES))
def test_bad_tuples(case: str) -> None:
    text, message = BAD_TUPLES[case]
    model = mujoco.MjModel.from_xml_string(FINGER.format(text))
    with pytest.raises(ModelError, match=message) as caught:
        _ = Character.of(model).coupling
    assert "\n" not in str(caught.value)


def test_a_ball_and_a_hinge_and_ranges_that_exclude_each_other() -> None:
    with pytest.raises(ModelError, match="one kind"):
        _ = Character.of(with_tuple(("spine", 1.0), ("left_knee", 1.0))).coupling
    text = FINGER.format(tied(("one", 1.0), ("two", 1.0)))
    text = text.replace('range="-1 1"/><geom', 'range="-1 -.6"/><geom')
    with pytest.raises(ModelError, match="no turn that the ranges"):
        _ = Character.of(mujoco.MjModel.from_xml_string(text)).coupling


# Shares


@pytest.mark.parametrize("name", ["flexible", "finger"])
def test_couple_gives_every_joint_its_share(name: str) -> None:
    """The turn that fits what there was best; poses that have their shares stay as they are."""
    model = flexible() if name == "flexible" else finger()
    qpos = poses(model, 20, 1, 0.1)
    before = qpos.copy()
    coupled = Character.of(model).coupling.couple(qpos)
    assert unequal(model, qpos) > 0.01 and unequal(model, coupled) < SHARE
    np.testing.assert_array_equal(qpos, before)
    np.testing.assert_allclose(Character.of(model).coupling.couple(coupled), coupled, atol=1e-12)
    (group,) = Character.of(model).coupling.groups
    joints = [model.joint(joint).name for joint in group.joints]
    others = np.ones(model.nq, dtype=bool)
    for joint in joints:
        at = model.joint(joint).qposadr[0]
        others[at : at + len(model.joint(joint).qpos0)] = False
    np.testing.assert_array_equal(coupled[:, others], qpos[:, others])
    shares = np.array(group.shares)
    turns = np.stack([turn_of(model, qpos, joint) for joint in joints], axis=1)
    best = np.linalg.lstsq(shares[:, None], turns.swapaxes(0, 1).reshape(len(shares), -1))[0]
    np.testing.assert_allclose(
        Character.of(model).coupling.shared_turn(group, coupled).ravel(), best.ravel(), atol=1e-9
    )


def test_a_range_bounds_the_whole_group() -> None:
    """The second hinge stops at -0.4, so the others stop at half and a quarter of that."""
    model = finger()
    qpos = np.tile(model.qpos0, (2, 1))
    qpos[0, 7:10] = (-0.9, -1.8, -0.45)
    qpos[1, 7:10] = (0.9, 1.8, 0.45)
    coupled = Character.of(model).coupling.couple(qpos)
    np.testing.assert_allclose(coupled[0, 7:10], (-0.2, -0.4, -0.1), atol=1e-12)
    np.testing.assert_allclose(coupled[1, 7:10], (0.5, 1.0, 0.25), atol=1e-12)


def test_a_spine_bends_as_far_as_its_joints_go() -> None:
    """Bent too far forwards and backwards: all go back together, to where the first joint stops."""
    model, shares = flexible(), shares_of(flexible())
    qpos = np.tile(model.qpos0, (2, 1))
    for row, angle in enumerate((2.4, -1.5)):
        for joint, share in shares.items():
            at = model.joint(joint).qposadr[0]
            qpos[row, at : at + 4] = exp(np.array((0.0, share * angle, 0.0)))
    coupled = Character.of(model).coupling.couple(qpos)
    boxes = {joint: model.numeric(f"limit_{joint}").data[2:4] for joint in SPINE}
    back = max(boxes[joint][0] / share for joint, share in shares.items())
    front = min(boxes[joint][1] / share for joint, share in shares.items())
    for joint, share in shares.items():
        wanted = [(0.0, share * front, 0.0), (0.0, share * back, 0.0)]
        np.testing.assert_allclose(turn_of(model, coupled, joint), wanted, atol=1e-5)
    assert Character.of(model).limits.excess(coupled).max() < 1e-8


@pytest.mark.parametrize("name", ["flexible", "finger"])
def test_gather_and_spread_are_finite_differences(name: str) -> None:
    """A small turn of the leader, all shares put right: the site moves as gathered rows say."""
    model = flexible() if name == "flexible" else finger()
    site = "left_hand" if name == "flexible" else "tip"
    qpos = np.tile(model.qpos0, (3, 1)) if name == "flexible" else poses(model, 3, 2, 0.05)
    if name == "flexible":
        qpos = Character.of(model).coupling.couple(poses(model, 3, 2, 0.05))
        for joint in SPINE:  # at a bent spine shares are first order only: begin at a straight one
            at = model.joint(joint).qposadr[0]
            qpos[:, at : at + 4] = (1.0, 0.0, 0.0, 0.0)
    qpos, found, step = (
        Character.of(model).coupling.couple(qpos),
        Character.of(model).coupling,
        1e-6,
    )
    data, jacp, jacr = mujoco.MjData(model), np.empty((3, model.nv)), np.empty((3, model.nv))
    for row in qpos:
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacSite(model, data, jacp, jacr, model.site(site).id)
        rows = found.gather(np.concatenate((jacp, jacr)))
        assert (rows[:, found.follower] == 0.0).all()
        for dof in sorted(set(found.leader.tolist())):
            unit = np.zeros((1, model.nv))
            unit[0, dof] = step
            spread = found.spread(unit)
            moved = Character.of(model).coupling.couple(oplus(model, row[None], spread))
            # What couple makes of it is what spread said, to first order.
            np.testing.assert_allclose(ominus(model, moved, row[None]), spread, atol=1e-9)
            place = loop_sites(model, np.stack((row, moved[0])))[:, model.site(site).id]
            quat = loop_quats(model, np.stack((row, moved[0])), site)
            turn = log(multiply(quat[1], conjugate(quat[0])))
            slope = np.concatenate((place[1] - place[0], turn)) / step
            np.testing.assert_allclose(slope, rows[:, dof], atol=2e-5)


def test_rigidities_are_what_the_whole_group_costs() -> None:
    model, found = finger(), Character.of(finger()).coupling
    weights = np.random.default_rng(3).uniform(0.5, 2.0, model.nv)
    displacement = found.spread(np.random.default_rng(4).normal(size=(1, model.nv)))[0]
    leads = np.ones(model.nv, dtype=bool)
    leads[found.follower] = False
    whole = np.sum(weights * displacement**2)
    assert np.sum((found.rigidity(weights) * displacement**2)[leads]) == pytest.approx(whole)


# Solvers


@pytest.mark.parametrize("solver", [NumericIK, HybridIK])
def test_solvers_move_the_spine_as_one(solver: type) -> None:
    model = flexible()
    qpos = Character.of(model).coupling.couple(poses(model, 6, 5, 0.1))
    targets = lay_out([pin(model, qpos, site, (0.03, 0.02, -0.02)) for site in HANDS], model, 6)
    displacement = solver(model).prepare(targets).solve(qpos).displacement
    whole = [
        displacement[:, model.joint(joint).dofadr[0] + np.arange(3)] / share
        for joint, share in shares_of(model).items()
    ]
    assert np.abs(whole[0]).max() > 5e-3
    for turn in whole[1:]:  # one turn for all: alike to first order, in the joints' own frames
        np.testing.assert_allclose(turn, whole[0], atol=0.05 * np.abs(whole[0]).max())


def test_numeric_ik_finds_the_least_turn_of_all() -> None:
    """A row of hinges in the plane: its one degree of freedom and the root share a displacement."""
    model = finger()
    qpos, found = (
        Character.of(model).coupling.couple(np.tile(model.qpos0, (1, 1))),
        Character.of(finger()).coupling,
    )
    weights = np.full(model.nv, 1.0)
    weights[:6] = 1e6
    shift = (0.0, 0.0, -0.05)
    tip = pin(model, qpos, "tip", shift)
    targets = lay_out([SiteConstraint("tip", tip.frames, tip.position, weight=0.9)], model, 1)
    solution = NumericIK(model, weights, iterations=20).prepare(targets).solve(qpos)
    angle = solution.displacement[0, 6:9]
    np.testing.assert_allclose(angle, angle[0] * np.array((1.0, 2.0, 0.5)), atol=1e-9)
    # The wish's own minimum over the one angle: cost of the joints and of what is left, softly.
    soft = 0.05 * (1.0 / 0.9 - 1.0)

    w = np.linspace(-0.5, 0.5, 2001)
    tried = np.tile(qpos, (len(w), 1))
    tried[:, 7:10] = w[:, None] * (1.0, 2.0, 0.5)
    gap = loop_sites(model, tried)[:, model.site("tip").id] - some(tip.position)[0]
    cost = np.sum(gap * gap, axis=1) / soft + w * w * (1.0 + 4.0 + 0.25)
    best = w[np.argmin(cost)]
    assert angle[0] == pytest.approx(best, abs=5e-4) and found.rigidity(weights)[6] == 5.25


@pytest.mark.parametrize("ik", ["hybrid", "numeric"])
def test_a_fit_keeps_the_shares(ik: str) -> None:
    motion = standing(flexible())
    constraints = reaching(motion, (0.2, 0.05, -0.1))
    result = fit(motion, constraints, ik=ik)
    assert unequal(flexible(), result.motion.qpos) < SHARE
    assert Character.of(flexible()).limits.excess(result.motion.qpos).max() < 1e-8
    assert result.trace.exact_error_percent < EXACT and worst(result.motion, constraints) < 1e-4
    assert np.abs(turn_of(flexible(), result.motion.qpos, SPINE[1])).max() > 0.01


@pytest.mark.parametrize("ik", ["hybrid", "numeric"])
def test_a_spine_at_its_limit_leaves_the_rest_to_others(ik: str) -> None:
    """Hands so far out that the spine stops: the joints below and above it do what is left."""
    motion = standing(flexible())
    constraints = reaching(motion, (0.3, 0.1, -0.3))
    result = fit(motion, constraints, ik=ik)
    assert unequal(flexible(), result.motion.qpos) < SHARE
    assert Character.of(flexible()).limits.excess(result.motion.qpos).max() < 1e-8
    assert worst(result.motion, constraints) < 1e-3 and result.unmet == ()
    front = flexible().numeric(f"limit_{SPINE[0]}").data[3]
    bent = turn_of(flexible(), result.motion.qpos, SPINE[0])[:, 1].max()
    assert bent == pytest.approx(front, rel=0.02)  # it went to the edge of its range


def test_a_motion_that_lacks_its_shares_is_given_them() -> None:
    motion = standing(flexible())
    bent = motion.qpos.copy()
    at = flexible().joint(SPINE[2]).qposadr[0]
    bent[:, at : at + 4] = exp(np.array((0.0, 0.3, 0.0)))
    constraints = [pin(flexible(), motion.qpos, site) for site in FEET]
    result = fit(Motion(flexible(), bent, 30.0), constraints, first_guess=False)
    share = np.array([*shares_of(flexible()).values()])
    expected = 0.3 * share[0] * share[2] / (share @ share)  # least squares of (0, 0, 0.3)
    assert unequal(flexible(), result.motion.qpos) < SHARE
    np.testing.assert_allclose(
        turn_of(flexible(), result.motion.qpos, SPINE[0])[:, 1], expected, atol=0.01
    )


TIED = {
    "leader carries limbs": (("spine", 0.6), ("neck", 0.4)),
    "follower carries limbs": (("neck", 0.4), ("spine", 0.6)),
    "both knees": (("left_knee", 1.0), ("right_knee", 1.0)),
}


@pytest.mark.parametrize("case", sorted(TIED))
def test_joints_coupled_anywhere(case: str) -> None:
    """What hybrid IK cannot close in form it leaves to the numeric solver."""
    model = with_tuple(*TIED[case])
    motion = standing(model)
    constraints = reaching(motion, (0.25, 0.0, -0.1))
    for ik in ("hybrid", "numeric"):
        result = fit(motion, constraints, ik=ik)
        assert unequal(model, result.motion.qpos) < SHARE
        assert result.trace.exact_error_percent < EXACT and result.unmet == ()
        moved = ominus(model, result.motion.qpos, motion.qpos)
        for joint, _ in TIED[case]:
            start = model.joint(joint).dofadr[0]
            assert np.abs(moved[:, start : start + 3]).max() > 1e-4


def test_which_joint_leads_does_not_matter() -> None:
    motions = []
    for pairs in (TIED["leader carries limbs"], TIED["follower carries limbs"]):
        motion = standing(with_tuple(*pairs))
        motions.append(fit(motion, reaching(motion, (0.25, 0.0, -0.1)), ik="numeric").motion.qpos)
    np.testing.assert_allclose(motions[0], motions[1], atol=1e-6)


def test_followers_are_no_parameters() -> None:
    """A spine of three segments has the numbers of the rigid one: 20 (8) and 37 (13), Table 1."""
    for model in (humanoid(), flexible()):
        assert parameters(Character.of(model), FEET) == (20, 8)
        assert parameters(Character.of(model), (*FEET, *HANDS)) == (37, 13)
    for case in ("leader carries limbs", "follower carries limbs"):
        assert parameters(Character.of(with_tuple(*TIED[case])), (*FEET, *HANDS)) == (37, 13)
    assert parameters(Character.of(finger()), ["tip"])[0] == 8
    assert default_rigidity(flexible()).shape == (flexible().nv,)
