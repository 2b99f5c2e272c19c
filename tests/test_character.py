"""Characters of other proportions: against closed forms, on any humanoid, and from the shell."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import command_line
import mujoco
import numpy as np
import pytest

from mjmotion.body.assets import find_asset
from mjmotion.body.character import Character
from mjmotion.body.proportions import (
    Proportions,
    find_parts,
    flexible_spine,
    make_character,
)
from mjmotion.body.proportions.proportions import stretch
from mjmotion.body.proportions.shaping import inertia_of, moments, nearest_axes, stretched_shape
from mjmotion.cli.character import FACTORS
from mjmotion.exceptions import ModelError
from mjmotion.numerics.rotations import to_matrix

G1 = Path(__file__).parents[2] / "shared" / "robots" / "unitree_g1" / "g1.xml"
NEEDS_G1 = pytest.mark.skipif(not G1.is_file(), reason="needs ../shared/robots/unitree_g1")

LEG = """
<body name="{s}_a" pos="0 {y}.1 -.05" euler="0 0 30">
  <joint name="{s}_hip_x" axis="1 0 0"/><geom size=".03" mass=".4"/>
  <body name="{s}_b" euler="0 0 -30"><joint name="{s}_hip_y" axis="0 1 0" pos="0 0 .01"/>
    <geom type="capsule" size=".05" fromto="0 0 0 0 0 -.36"/>
    <frame pos="0 0 -.2" euler="0 90 0"><geom name="{s}_pad" type="box" size=".02 .03 .04"/>
      <site name="{s}_front" pos="0 0 .05"/></frame>
    <body name="{s}_c" pos="0 0 -.4"><joint name="{s}_bend" axis="0 1 0" range="0 2"/>
      <geom type="mesh" mesh="bar"/>
      <inertial pos="0 0 -.2" mass="2" fullinertia=".03 .031 .004 .001 .0005 -.0003"/>
      <body name="{s}_d" pos="0 0 -.4"><joint name="{s}_tilt" axis="0 1 0" range="-1 1"/>
        <geom name="{s}_box" type="box" size=".1 .04 .02" pos=".05 0 -.03"/>
        <site name="{s}_sole" pos=".05 0 -.05"/>
      </body></body></body></body>"""
ARM = """
<body name="{s}_e" pos="0 {y}.15 .4"><joint name="{s}_up" type="ball"/>
  <geom type="capsule" size=".04" fromto="0 0 0 0 {y}.3 0"/>
  <body name="{s}_f" pos="0 {y}.3 0"><joint name="{s}_fold" axis="0 0 1"/>
    <geom type="mesh" mesh="bar" euler="{r}90 0 0"/>
    <geom type="ellipsoid" size=".04 .06 .03" pos="0 {y}.1 0" euler="20 30 0"/>
    <body name="{s}_g" pos="0 {y}.28 0"><joint name="{s}_grip" axis="1 0 0"/>
      <geom type="sphere" size=".04" pos="0 {y}.04 0"/><site name="{s}_tip" pos="0 {y}.1 0"/>
    </body></body></body>"""
ROBOT = f"""
<mujoco model="robot"><compiler autolimits="true"/>
<custom><numeric name="limit_l_up" data="-1 1 -1 1 -1 1"/>
  <tuple name="two"><element objtype="joint" objname="l_bend" prm=".5"/>
    <element objtype="joint" objname="r_bend" prm=".5"/></tuple></custom>
<asset><mesh name="bar" vertex="-.03 -.03 0 .03 -.03 0 .03 .03 0 -.03 .03 0
  -.02 -.02 -.3 .02 -.02 -.3 .02 .02 -.3 -.02 .02 -.3"/></asset>
<worldbody><geom name="floor" type="plane" size="5 5 .1"/>
<body name="base" pos="0 0 .9"><freejoint/><geom type="box" size=".08 .12 .08"/>
  <camera name="eye" pos="1 0 .5"/><site name="imu" pos=".02 0 .05"/>
  {LEG.format(s="l", y="")}{LEG.format(s="r", y="-")}
  <body name="trunk" pos="0 0 .1"><joint name="waist" axis="0 0 1"/>
    <geom type="capsule" size=".1" fromto="0 0 .05 0 0 .35"/>
    {ARM.format(s="l", y="", r="")}{ARM.format(s="r", y="-", r="-")}
    <body name="skull" pos="0 0 .5"><joint name="nod" axis="0 1 0"/><geom size=".1" pos="0 0 .1"/>
      <body name="l_ear" pos="0 .1 .1"><joint axis="1 0 0"/><geom size=".01"/></body>
      <body name="r_ear" pos="0 -.1 .1"><joint axis="1 0 0"/><geom size=".01"/></body>
    </body></body></body></worldbody>
<contact><exclude body1="l_c" body2="r_c"/></contact>
<equality><connect body1="l_d" body2="trunk" anchor=".1 0 0" active="false"/></equality>
<tendon><spatial name="cord" range=".1 1.2"><site site="imu"/><site site="l_sole"/></spatial>
</tendon>
<sensor><jointpos joint="l_bend"/><framepos objtype="site" objname="l_tip"/></sensor>
<actuator><motor joint="l_bend"/></actuator>
<keyframe><key name="squat"
  qpos="1 2 .7 1 0 0 0 {"0 -.8 1.6 -.8 " * 2}0 {"1 0 0 0 0 0 " * 2}0 0 0"/></keyframe></mujoco>"""


def robot() -> mujoco.MjSpec:
    return mujoco.MjSpec.from_string(ROBOT)


def posed(model: mujoco.MjModel, seed: int, scale: float = 1.0) -> mujoco.MjData:
    """A random pose; the root's place is scaled, joint angles are the same for any body."""
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    step = 0.4 * rng.normal(size=model.nv)
    mujoco.mj_integratePos(model, data.qpos, step, 1.0)
    data.qpos[:3] = scale * step[:3]
    mujoco.mj_forward(model, data)
    return data


SOURCES = [
    pytest.param("humanoid", id="humanoid"),
    pytest.param(robot(), id="robot"),
    pytest.param(G1, id="G1", marks=NEEDS_G1),
]


@pytest.mark.parametrize("source", SOURCES)
def test_a_size_scales_lengths_masses_and_inertias(source: str | Path | mujoco.MjSpec) -> None:
    s = 1.7
    before = Character.load(source).model
    after = make_character(source, Proportions(size=s)).model
    mine = before.body_rootid == before.body_rootid[before.jnt_bodyid[0]]
    np.testing.assert_allclose(after.body_mass[mine], s**3 * before.body_mass[mine], rtol=1e-6)
    # Principal axes may swap where two moments are all but equal.
    inertias = (np.sort(model.body_inertia[mine], axis=1) for model in (before, after))
    np.testing.assert_allclose(s**5 * next(inertias), next(inertias), rtol=2e-5, atol=1e-12)
    one, two = posed(before, 1), posed(after, 1, s)
    for name in ("xpos", "xipos", "site_xpos", "xanchor"):
        np.testing.assert_allclose(getattr(two, name), s * getattr(one, name), atol=1e-6)
    geoms = np.flatnonzero(mine[before.geom_bodyid])
    np.testing.assert_allclose(two.geom_xpos[geoms], s * one.geom_xpos[geoms], atol=1e-6)
    np.testing.assert_allclose(after.geom_rbound[geoms], s * before.geom_rbound[geoms], rtol=1e-5)
    # The whole: kinetic energy of a spin, which knows every mass and inertia, goes with s⁵.
    np.testing.assert_allclose(spin(after, two), s**5 * spin(before, one), rtol=1e-5)


def spin(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Kinetic energy of joint rates, the root at rest in place."""
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    rates = np.sin(np.arange(model.nv) + 1.0)
    rates[:3] = 0.0
    armature = rates @ (model.dof_armature * rates)
    return float(rates @ full @ rates - armature)


@pytest.mark.parametrize("source", SOURCES)
def test_parts_grow_by_their_factors_and_soles_stay_down(
    source: str | Path | mujoco.MjSpec,
) -> None:
    factors = Proportions(legs=1.25, torso=0.8, arms=0.85)
    before = Character.load(source).model
    after = make_character(source, factors).model
    old, new = find_parts(before), find_parts(after)
    for limbs, others, factor in ((old.legs, new.legs, 1.25), (old.arms, new.arms, 0.85)):
        for limb, other in zip(limbs, others, strict=True):
            bones = np.linalg.norm(np.diff(limb.points, axis=0), axis=1)
            grown = np.linalg.norm(np.diff(other.points, axis=0), axis=1)
            np.testing.assert_allclose(grown, factor * bones, rtol=1e-6)
            assert limb.bodies == other.bodies
    trunk = np.linalg.norm(np.diff(new.spine, axis=0)) / np.linalg.norm(np.diff(old.spine, axis=0))
    assert trunk == pytest.approx(0.8)
    one, two = mujoco.MjData(before), mujoco.MjData(after)
    for model, data in ((before, one), (after, two)):
        mujoco.mj_kinematics(model, data)
    feet = [i for i in range(before.nsite) if before.site(i).name.endswith(("_toe", "_sole"))]
    np.testing.assert_allclose(two.site_xpos[feet, 2], one.site_xpos[feet, 2], atol=1e-6)


def test_the_parts_of_a_robot_are_told_by_its_shape() -> None:
    model = robot().compile()
    parts = find_parts(model)

    def names(bodies: tuple[int, ...]) -> str:
        return " ".join(model.body(b).name for b in bodies)

    assert [names(leg.upper) for leg in parts.legs] == ["l_a l_b", "r_a r_b"]
    assert [names(leg.lower) for leg in parts.legs] == ["l_c", "r_c"]
    assert [names(leg.end) for leg in parts.legs] == ["l_d", "r_d"]
    assert [names(arm.bodies) for arm in parts.arms] == ["l_e l_f l_g", "r_e r_f r_g"]
    assert names(parts.trunk) == "base trunk"
    assert names(parts.head) == "skull l_ear r_ear"
    assert parts.hip_height == pytest.approx(0.85, abs=0.01)


@NEEDS_G1
def test_the_parts_of_a_real_robot() -> None:
    model = mujoco.MjModel.from_xml_path(str(G1))
    parts = find_parts(model)
    assert [model.body(leg.lower[0]).name for leg in parts.legs] == [
        "left_knee_link",
        "right_knee_link",
    ]
    assert [model.body(arm.lower[0]).name for arm in parts.arms] == [
        "left_elbow_link",
        "right_elbow_link",
    ]
    assert model.body(parts.legs[0].end[0]).name == "left_ankle_pitch_link"
    assert parts.head == () and len(parts.head_geoms) == 2  # its head is part of the torso


def test_lengths_times_widths_squared_make_masses() -> None:
    before = Character.load("humanoid").model
    after = make_character("humanoid", Proportions(legs=1.3, width=0.9, head=1.2)).model
    for body, factor in (
        ("left_thigh", 1.3 * 0.81),
        ("torso", 0.81),
        ("left_hand", 1.0),
        ("head", 1.2**3),
    ):
        assert after.body(body).mass[0] == pytest.approx(factor * before.body(body).mass[0])
    assert after.body("left_shank").ipos[2] == pytest.approx(
        1.3 * before.body("left_shank").ipos[2]
    )


def test_an_inertia_is_that_of_the_stretched_points() -> None:
    rng = np.random.default_rng(4)
    points, weights = rng.normal(size=(50, 3)), rng.uniform(0.1, 1.0, 50)
    points -= weights @ points / weights.sum()
    inertia = inertia_of(np.einsum("n,ni,nj->ij", weights, points, points))
    bent = stretch(rng.normal(size=3), 1.4, 0.7)
    moved = points @ bent.T
    expected = inertia_of(np.einsum("n,ni,nj->ij", weights, moved, moved))
    np.testing.assert_allclose(inertia_of(bent @ moments(inertia) @ bent.T), expected, atol=1e-9)
    # And that is what a character's bodies get: a full inertia about axes of their own.
    before, after = robot().compile(), make_character(robot(), Proportions(legs=1.5)).model
    body = before.body("l_c").id
    full = []
    for model in (before, after):
        turn = to_matrix(model.body_iquat[body])
        full.append(turn @ np.diag(model.body_inertia[body]) @ turn.T)
    along = find_parts(before).legs[0].points
    grown = stretch(along[2] - along[1], 1.5, 1.0)
    np.testing.assert_allclose(
        full[1], inertia_of(1.5 * grown @ moments(full[0]) @ grown.T), rtol=1e-6, atol=1e-9
    )


@pytest.mark.parametrize(
    "kind",
    [mujoco.mjtGeom.mjGEOM_ELLIPSOID, mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CAPSULE],
)
def test_a_shape_stretched_along_its_axes_is_exact(kind: int) -> None:
    size = np.array((0.1, 0.2, 0.3))
    stretched, turn = stretched_shape(kind, size, np.diag((1.5, 1.5, 2.0)))
    expected = (0.15, 0.4, 0.3) if kind == mujoco.mjtGeom.mjGEOM_CAPSULE else (0.15, 0.3, 0.6)
    np.testing.assert_allclose(stretched, expected)
    np.testing.assert_allclose(turn, np.eye(3), atol=1e-12)


def test_an_ellipsoid_stays_one_under_any_map() -> None:
    rng = np.random.default_rng(0)
    size, bent = np.array((0.1, 0.2, 0.3)), stretch(rng.normal(size=3), 1.6, 0.8)
    stretched, turn = stretched_shape(mujoco.mjtGeom.mjGEOM_ELLIPSOID, size, bent)
    ball = rng.normal(size=(100, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    local = (ball * size) @ bent.T @ turn / stretched
    np.testing.assert_allclose(np.linalg.norm(local, axis=1), 1.0, atol=1e-9)
    assert np.linalg.det(turn) == pytest.approx(1.0)


def test_principal_axes_stay_near_the_old_ones() -> None:
    turn = to_matrix(np.array((0.9, 0.3, -0.2, 0.24)) / np.linalg.norm((0.9, 0.3, -0.2, 0.24)))
    inertia = turn @ np.diag((3.0, 1.0, 2.0)) @ turn.T
    tilt = to_matrix(np.array((np.cos(0.05), 0.0, np.sin(0.05), 0.0)))
    np.testing.assert_allclose(nearest_axes(inertia, turn @ tilt), turn, atol=1e-6)


def test_what_refers_to_parts_stays_valid() -> None:
    before = robot().compile()
    after = make_character(robot(), Proportions(legs=1.5, arms=0.5, torso=1.2)).model
    assert after.nexclude == before.nexclude and after.ntuple == before.ntuple
    assert after.nsensor == before.nsensor and after.nu == before.nu
    np.testing.assert_array_equal(after.jnt_range, before.jnt_range)
    np.testing.assert_array_equal(
        Character.of(after).limits.boxes[before.joint("l_up").id][:, 1], 1.0
    )
    # The tendon's bounds go with its length, the connection's anchor with its foot.
    ratio = after.tendon_length0 / before.tendon_length0
    np.testing.assert_allclose(after.tendon_range[0] / before.tendon_range[0], ratio[0])
    assert ratio[0] > 1.3
    np.testing.assert_allclose(after.eq_data[0, :3], before.eq_data[0, :3])
    # Both bars of a mesh, stretched differently, and the meshes of arms and legs apart.
    assert after.nmesh > before.nmesh


def test_a_keyframe_stays_on_the_ground() -> None:
    models = robot().compile(), make_character(robot(), Proportions(legs=1.4, feet=1.3)).model
    lowest = []
    for model in models:
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        mujoco.mj_kinematics(model, data)
        box = model.geom("l_box").id
        turn, size = data.geom_xmat[box].reshape(3, 3), model.geom_size[box]
        lowest.append(data.geom_xpos[box, 2] - np.abs(turn[2]) @ size)
        np.testing.assert_allclose(data.qpos[:2], (1, 2))
    assert lowest[1] == pytest.approx(lowest[0], abs=1e-6)


def test_a_head_without_a_body_grows_above_the_neck() -> None:
    start, stop = ROBOT.index('<body name="skull"'), ROBOT.index("</worldbody>")
    ball = '<geom name="ball" size=".1" pos="0 0 .6"/>'
    text = ROBOT[:start] + ball + "</body></body>" + ROBOT[stop:]
    text = text[: text.index("<keyframe>")] + "</mujoco>"
    spec = mujoco.MjSpec.from_string(text)
    parts = find_parts(spec.compile())
    assert parts.head == () and len(parts.head_geoms) == 1
    model = make_character(spec, Proportions(head=2.0, torso=0.5)).model
    head = model.geom("ball")
    assert head.size[0] == pytest.approx(0.2)
    # Its foot, 0.5 over the trunk, comes down with the trunk; it stands on that.
    assert head.pos[2] == pytest.approx(0.25 + 0.2, abs=1e-6)


def test_the_source_is_not_changed() -> None:
    spec = robot()
    before = spec.to_xml()
    make_character(spec, Proportions(legs=2.0))
    flexible_spine(humanoid := Character.load("humanoid").spec)
    assert spec.to_xml() == before
    assert humanoid.joint("spine") is not None


@pytest.mark.parametrize("factor", [0.0, -1.0, float("nan"), float("inf"), 0.05, 20.0])
def test_a_factor_that_makes_no_body_is_refused(factor: float) -> None:
    with pytest.raises(ModelError, match="proportion legs"):
        Proportions(legs=factor)


def test_factors_that_make_a_part_vanish_together_are_refused() -> None:
    with pytest.raises(ModelError, match=r"arms 0\.3 times size 0\.2 makes that part vanish"):
        Proportions(arms=0.3, size=0.2)


def test_models_that_are_no_humanoids_are_refused() -> None:
    box = "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"
    with pytest.raises(ModelError, match="no limbs found"):
        make_character(mujoco.MjSpec.from_string(box), Proportions(legs=2.0))
    fixed = box.replace("<freejoint/>", "")
    with pytest.raises(ModelError, match="free"):
        make_character(mujoco.MjSpec.from_string(fixed), Proportions(legs=2.0))
    legs = "".join(LEG.format(s=s, y=y) for s, y in (("l", ""), ("r", "-")))
    biped = f"""<mujoco><asset><mesh name="bar" vertex="-.03 -.03 0 .03 -.03 0 0 .03 0 0 0 -.3"/>
      </asset><worldbody><body pos="0 0 .9"><freejoint/><geom size=".1"/>{legs}</body></worldbody>
      </mujoco>"""
    assert make_character(mujoco.MjSpec.from_string(biped), Proportions(legs=2.0)).model
    with pytest.raises(ModelError, match="no arms to scale"):
        make_character(mujoco.MjSpec.from_string(biped), Proportions(arms=2.0))
    with pytest.raises(ModelError, match="unknown model"):
        make_character("humanoidd", Proportions())


def test_the_shipped_characters_are_what_the_script_makes() -> None:
    sys.path.insert(0, str(Path(__file__).parents[1] / "scripts"))
    try:
        import make_characters as script
    finally:
        sys.path.pop(0)
    made = {
        "climber": make_character("humanoid", script.CLIMBER),
        "child": make_character("humanoid", script.child()),
        "humanoid_flexible": flexible_spine("humanoid", script.SPINE),
    }
    for name, character in made.items():
        shipped = mujoco.MjModel.from_xml_path(str(find_asset("model", name)))
        model = character.spec.compile()
        for field in (
            "body_pos",
            "body_mass",
            "body_inertia",
            "site_pos",
            "jnt_range",
            "geom_size",
        ):
            np.testing.assert_allclose(
                getattr(shipped, field),
                getattr(model, field),
                rtol=1e-5,
                atol=1e-5,
                err_msg=f"{name} {field}",
            )


def test_the_child_has_a_childs_measures() -> None:
    model = mujoco.MjModel.from_xml_path(str(find_asset("model", "child")))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    assert data.site("head_top").xpos[2] == pytest.approx(1.16, abs=0.01)
    assert 20.0 < model.body_mass.sum() < 23.0  # its mass is not set, and comes out right
    foot = Character.of(model).feet[0]
    assert foot.front[0] - foot.heel[0] == pytest.approx(0.178, abs=0.002)


def flexible() -> tuple[mujoco.MjModel, mujoco.MjModel]:
    return Character.load("humanoid").model, flexible_spine("humanoid", (0.5, 0.3, 0.2)).model


def test_a_flexible_spine_is_the_rigid_one_at_rest() -> None:
    rigid, bent = flexible()
    whole: list[tuple[np.ndarray, ...]] = []
    for model, names in ((rigid, ["torso"]), (bent, ["lower_back", "middle_back", "chest"])):
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        bodies = [model.body(name).id for name in names]
        mass = model.body_mass[bodies]
        com = mass @ data.xipos[bodies] / mass.sum()
        arm = data.xipos[bodies] - com
        turn = data.ximat[bodies].reshape(-1, 3, 3)
        own = np.einsum("nij,nj,nkj->nik", turn, model.body_inertia[bodies], turn)
        steiner = inertia_of(np.einsum("n,ni,nj->nij", mass, arm, arm))
        whole.append((mass.sum(), com, (own + steiner).sum(axis=0)))
        for site in ("head_top", "left_hand", "right_toe"):
            whole[-1] += (data.site(site).xpos.copy(),)
    for one, other in zip(*whole, strict=True):
        np.testing.assert_allclose(other, one, atol=1e-9)


def test_a_flexible_spine_says_its_shares() -> None:
    rigid, bent = flexible()
    (group,) = Character.of(bent).coupling.groups
    assert group.name == "spine" and group.shares == (0.5, 0.3, 0.2)
    names = [bent.joint(i).name for i in range(bent.njnt)]
    old = [rigid.joint(i).name for i in range(rigid.njnt)]
    spine = old.index("spine")
    assert names == [
        *old[:spine],
        "spine_lower",
        "spine_middle",
        "spine_upper",
        *old[spine + 1 :],
    ]
    box = Character.of(rigid).limits.boxes[rigid.joint("spine").id]
    np.testing.assert_allclose(
        Character.of(bent).limits.boxes[bent.joint("spine_middle").id], 0.3 * box
    )
    assert bent.body(bent.body("neck").parentid[0]).name == "chest"
    assert bent.body(bent.body("right_upper_arm").parentid[0]).name == "chest"


def test_a_flexible_spine_keeps_what_refers_to_the_rest() -> None:
    spec = Character.load("humanoid").spec
    spec.add_exclude(name="apart", bodyname1="head", bodyname2="left_hand")
    spec.add_sensor(
        name="elbow",
        type=mujoco.mjtSensor.mjSENS_JOINTPOS,
        objtype=mujoco.mjtObj.mjOBJ_JOINT,
        objname="left_elbow",
    )
    model = flexible_spine(spec).model
    assert model.nexclude == 1 and model.nsensor == 1
    assert model.sensor_objid[0] == model.joint("left_elbow").id
    # And one of other proportions can be made from it, its parts told as before.
    tall = make_character(flexible_spine("humanoid"), Proportions(torso=1.5)).model
    assert len(find_parts(tall).trunk) == 4
    assert tall.body("middle_back").pos[2] == pytest.approx(1.5 * model.body("middle_back").pos[2])


@pytest.mark.parametrize("shares", [(0.5, 0.5), (0.5, 0.6, 0.2), (1.2, -0.1, -0.1)])
def test_shares_that_make_no_spine_are_refused(shares: tuple[float, ...]) -> None:
    with pytest.raises(ModelError, match="shares"):
        flexible_spine("humanoid", shares)


def test_a_spine_that_is_no_ball_is_refused() -> None:
    with pytest.raises(ModelError, match="no ball joint 'spine'"):
        flexible_spine(robot())


def run(*words: object) -> subprocess.CompletedProcess[str]:
    return command_line.run("character", *words)


def test_the_command_offers_every_proportion() -> None:
    assert set(FACTORS) == set(Proportions.__dataclass_fields__)


def test_the_command_writes_a_model_that_mujoco_loads(tmp_path: Path) -> None:
    out = tmp_path / "tall.xml"
    done = run("--legs", 1.25, "--torso", 0.8, "--flexible-spine", "--out", out)
    assert done.returncode == 0, done.stderr
    assert "51 DOFs" in done.stdout
    model = mujoco.MjModel.from_xml_path(str(out))
    assert model.body("left_shank").pos[2] == pytest.approx(-1.25 * 0.4288)
    again = run("--out", out)
    assert again.returncode == 2 and "--force" in again.stderr
    assert run("--size", 0.5, "--from", out, "--out", out, "--force").returncode == 0
    half = mujoco.MjModel.from_xml_path(str(out))
    assert half.body_mass.sum() == pytest.approx(model.body_mass.sum() / 8, rel=1e-4)


@NEEDS_G1
def test_the_command_writes_a_robot_with_its_meshes(tmp_path: Path) -> None:
    done = run("--from", G1, "--legs", 1.2, "--out", tmp_path / "g1.xml")
    assert done.returncode == 0, done.stderr
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "g1.xml"))
    assert model.nmesh == mujoco.MjModel.from_xml_path(str(G1)).nmesh


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--legs", "0"], "proportion legs is 0.0"),
        (["--arms", "x"], "'x' is not a number"),
        (["--legs", "0.01"], "vanish"),
        (["--from", "nobody"], "unknown model 'nobody'"),
    ],
)
def test_the_command_refuses_bad_input(tmp_path: Path, words: list[str], line: str) -> None:
    done = run(*words, "--out", tmp_path / "out.xml")
    assert done.returncode == 2
    assert line in done.stderr and done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())
