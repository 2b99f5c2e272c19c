"""The humanoid's MJCF: structure, sizes, masses, limits, soles and that it lives in a scene."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

PATH = Path(__file__).parents[1] / "models" / "mjcf" / "humanoid.xml"
HEIGHT = 1.75
MASS = 70.0
SIDES = ("left", "right")
LIMB = {"arm": ("shoulder", "elbow", "wrist"), "leg": ("hip", "knee", "ankle", "toes")}
JOINTS = [
    "root",
    "spine",
    "neck",
    "head",
    *(f"{side}_{joint}" for side in SIDES for joint in LIMB["arm"]),
    *(f"{side}_{joint}" for side in SIDES for joint in LIMB["leg"]),
]
PARENTS = {
    "pelvis": "world",
    "torso": "pelvis",
    "neck": "torso",
    "head": "neck",
    **{f"{s}_{b}": p for s in SIDES for b, p in (("upper_arm", "torso"), ("thigh", "pelvis"))},
    **{
        f"{s}_{b}": f"{s}_{p}"
        for s in SIDES
        for b, p in (
            ("forearm", "upper_arm"),
            ("hand", "forearm"),
            ("shank", "thigh"),
            ("foot", "shank"),
            ("toes", "foot"),
        )
    },
}
# De Leva (1996), table 4, males, percent of the body's mass.
DE_LEVA = {
    "pelvis": 11.17,
    "torso": 15.96 + 16.33,
    "upper_arm": 2.71,
    "forearm": 1.62,
    "hand": 0.61,
    "thigh": 14.16,
    "shank": 4.33,
    "foot": 1.37,
}


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(PATH))


def at(model: mujoco.MjModel, qpos: np.ndarray | None = None) -> mujoco.MjData:
    data = mujoco.MjData(model)
    if qpos is not None:
        data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    return data


def turned(model: mujoco.MjModel, joint: str, turn: tuple[float, ...]) -> mujoco.MjData:
    """The pose with one ball joint (or the root) turned by a rotation vector [rad]."""
    dof = np.zeros(model.nv)
    address = model.jnt_dofadr[model.joint(joint).id] + (3 if joint == "root" else 0)
    dof[address : address + 3] = turn
    qpos = model.qpos0.copy()
    mujoco.mj_integratePos(model, qpos, dof, 1.0)
    return at(model, qpos)


def limit(model: mujoco.MjModel, joint: str) -> np.ndarray:
    """Swing and twist limits (3, 2) [rad]: rows x, y, z; columns low, high."""
    numeric = model.numeric(f"limit_{joint}")
    return np.asarray(numeric.data).reshape(3, 2)


def balls(model: mujoco.MjModel) -> list[str]:
    return [
        model.joint(j).name
        for j in range(model.njnt)
        if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_BALL
    ]


def vertices(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> np.ndarray:
    """World positions (n, 3) of a mesh geom's vertices [m]."""
    mesh = model.geom_dataid[geom]
    start = model.mesh_vertadr[mesh]
    local = model.mesh_vert[start : start + model.mesh_vertnum[mesh]]
    return data.geom_xpos[geom] + local @ data.geom_xmat[geom].reshape(3, 3).T


def lowest(model: mujoco.MjModel, data: mujoco.MjData, body: str) -> float:
    """Height of the lowest point of a body's geoms [m]; meshes and spheres, all a foot has."""
    low = np.inf
    for geom in np.flatnonzero(model.geom_bodyid == model.body(body).id):
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
            low = min(low, vertices(model, data, int(geom))[:, 2].min())
        else:
            assert model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE
            low = min(low, data.geom_xpos[geom, 2] - model.geom_size[geom, 0])
    return low


def test_tree_and_dofs(model: mujoco.MjModel) -> None:
    assert [model.joint(j).name for j in range(model.njnt)] == JOINTS
    assert (model.nq, model.nv) == (57, 45)
    free = ("neck", "head", "left_toes", "right_toes")
    not_ik = [d for d in range(model.nv) if model.joint(model.dof_jntid[d]).name in free]
    assert model.nv - len(not_ik) == 37
    names = {
        model.body(b).name: model.body(model.body_parentid[b]).name for b in range(model.nbody)
    }
    assert {k: v for k, v in names.items() if k != "world"} == PARENTS
    assert not model.jnt_pos.any(), "every joint's anchor is its body's origin"


def test_frames_are_aligned_with_the_world_in_the_first_pose(model: mujoco.MjModel) -> None:
    data = at(model)
    identity = np.broadcast_to([1.0, 0.0, 0.0, 0.0], (model.nbody, 4))
    np.testing.assert_allclose(data.xquat, identity, atol=1e-12)
    np.testing.assert_allclose(model.site_quat, np.tile([1.0, 0, 0, 0], (model.nsite, 1)))


def test_heights_and_lengths(model: mujoco.MjModel) -> None:
    data = at(model)
    assert data.site("head_top").xpos[2] == pytest.approx(HEIGHT, abs=1e-3)
    top = max(
        vertices(model, data, g)[:, 2].max()
        for g in range(model.ngeom)
        if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_MESH
    )
    assert top == pytest.approx(HEIGHT, abs=2e-3), "the hair's top is where head_top says"
    for side in SIDES:
        z = {b: data.body(f"{side}_{b}").xpos[2] / HEIGHT for b in ("thigh", "shank", "foot")}
        z |= {
            b: data.body(f"{side}_{b}").xpos[2] / HEIGHT for b in ("upper_arm", "forearm", "hand")
        }
        # Drillis and Contini (1966), fractions of height.
        assert z["thigh"] == pytest.approx(0.530, abs=2e-3)
        assert z["thigh"] - z["shank"] == pytest.approx(0.245, abs=2e-3)
        assert z["shank"] - z["foot"] == pytest.approx(0.246, abs=2e-3)
        assert z["foot"] == pytest.approx(0.039, abs=2e-3)
        assert z["upper_arm"] == pytest.approx(0.818, abs=2e-3)
        assert z["upper_arm"] - z["forearm"] == pytest.approx(0.186, abs=2e-3)
        assert z["forearm"] - z["hand"] == pytest.approx(0.146, abs=2e-3)


def test_breadth_over_the_arms(model: mujoco.MjModel) -> None:
    data = at(model)
    reach = [
        np.abs(vertices(model, data, model.geom(f"{side}_upper_arm").id)[:, 1]).max()
        for side in SIDES
    ]
    assert 0.45 <= sum(reach) <= 0.48


def test_masses_follow_the_table(model: mujoco.MjModel) -> None:
    total = model.body_mass.sum()
    assert total == pytest.approx(MASS, abs=0.1)
    for name, percent in DE_LEVA.items():
        for body in [name] if name in PARENTS else [f"{side}_{name}" for side in SIDES]:
            mass = model.body(body).mass[0]
            if name == "foot":
                mass += model.body(body.replace("foot", "toes")).mass[0]
            assert 100 * mass / total == pytest.approx(percent, abs=0.02)
    head = model.body("head").mass[0] + model.body("neck").mass[0]
    assert 100 * head / total == pytest.approx(6.94, abs=0.02)


def test_inertias_are_those_of_bodies_of_that_size(model: mujoco.MjModel) -> None:
    for body in range(1, model.nbody):
        radii = np.sqrt(model.body_inertia[body] / model.body_mass[body])
        assert (radii > 0.02).all() and (radii < 0.2).all(), model.body(body).name
        a, b, c = np.sort(model.body_inertia[body])
        assert a + b > c, model.body(body).name
    # A standing man's moment about the lateral axis through his centre is about 12 kg m^2.
    data = at(model)
    mass_matrix = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass_matrix)
    centre = data.subtree_com[1] - data.body("pelvis").xpos
    lateral = mass_matrix[4, 4] - MASS * (centre[0] ** 2 + centre[2] ** 2)
    assert 9 < lateral < 15
    assert 0.54 < data.subtree_com[1, 2] / HEIGHT < 0.60


def test_left_and_right_are_mirror_images(model: mujoco.MjModel) -> None:
    rng = np.random.default_rng(0)
    turn = {j: rng.uniform(-0.6, 0.6, 3) for j in ("shoulder", "wrist", "hip", "ankle")}
    hinge = {"elbow": 0.7, "knee": 0.9, "toes": 0.4}
    poses = {}
    for side, flip in (("left", [1, 1, 1]), ("right", [-1, 1, -1])):
        dof = np.zeros(model.nv)
        for joint, vector in turn.items():
            address = model.jnt_dofadr[model.joint(f"{side}_{joint}").id]
            dof[address : address + 3] = vector * flip
        for joint, angle in hinge.items():
            dof[model.jnt_dofadr[model.joint(f"{side}_{joint}").id]] = angle
        qpos = model.qpos0.copy()
        mujoco.mj_integratePos(model, qpos, dof, 1.0)
        poses[side] = at(model, qpos)
    mirror = np.array([1.0, -1.0, 1.0])
    for body in (b.removeprefix("left_") for b in PARENTS if b.startswith("left_")):
        left, right = (poses[s].body(f"{s}_{body}") for s in SIDES)
        np.testing.assert_allclose(left.xpos * mirror, right.xpos, atol=1e-9)
        np.testing.assert_allclose(left.xipos * mirror, right.xipos, atol=1e-9)
    for site in ("heel", "toe", "foot", "hand"):
        left, right = (poses[s].site(f"{s}_{site}").xpos for s in SIDES)
        np.testing.assert_allclose(left * mirror, right, atol=1e-9)
    for geom in ("foot_sole", "foot_upper", "toes_sole", "toes_cap", "palm", "thigh"):
        left, right = (vertices(model, poses[s], model.geom(f"{s}_{geom}").id) for s in SIDES)
        assert len(left) == len(right)
        gap = np.linalg.norm((left * mirror)[:, None] - right[None], axis=2).min(1)
        assert gap.max() < 1e-3, geom
    for joint in turn:
        left, right = (limit(model, f"{s}_{joint}") for s in SIDES)
        np.testing.assert_allclose(left[1], right[1])
        np.testing.assert_allclose(left[[0, 2]], -right[[0, 2]][:, ::-1])


def test_sole_sites_are_its_ends_on_the_ground(model: mujoco.MjModel) -> None:
    data = at(model)
    for side in SIDES:
        parts = [vertices(model, data, model.geom(f"{side}_{x}_sole").id) for x in ("foot", "toes")]
        sole = np.concatenate(parts)
        ground = sole[sole[:, 2] < 1e-4]
        assert len(ground) >= 12 and sole[:, 2].min() == pytest.approx(0, abs=1e-5)
        heel, toe, foot = (data.site(f"{side}_{s}").xpos for s in ("heel", "toe", "foot"))
        np.testing.assert_allclose(heel, ground[ground[:, 0].argmin()], atol=1e-4)
        for index in (ground[:, 0].argmin(), ground[:, 0].argmax()):
            others = np.delete(ground[:, 0], index)
            assert np.abs(others - ground[index, 0]).min() > 1e-3, "the end is one point, no edge"
        np.testing.assert_allclose(foot, data.body(f"{side}_foot").xpos * [1, 1, 0], atol=1e-9)
        assert np.ptp(ground[:, 0]) == pytest.approx(0.255, abs=0.005)
        # The toe site is the ball: on the hinge, where the rigid part of the sole ends.
        np.testing.assert_allclose(toe, data.joint(f"{side}_toes").xanchor, atol=1e-9)
        assert parts[0][:, 0].max() == pytest.approx(toe[0], abs=1e-4)
        assert toe[0] - heel[0] == pytest.approx(0.70 * 0.255, abs=0.002)
        width = np.ptp(ground[ground[:, 0] > foot[0] + 0.05][:, 1])
        assert width == pytest.approx(0.095, abs=0.004)
        assert np.ptp(ground[ground[:, 0] < foot[0]][:, 1]) < 0.75 * width, "heel narrower"


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize(
    ("site", "sign", "degrees"), [("heel", -1, range(0, 31, 3)), ("toe", 1, range(0, 61, 4))]
)
def test_nothing_goes_under_the_ground_when_the_foot_pitches(
    model: mujoco.MjModel, side: str, site: str, sign: int, degrees: range
) -> None:
    """Pitch the whole figure about the site: heel with the toes up, toe with the heel up."""
    start = at(model).site(f"{side}_{site}").xpos.copy()
    for degree in degrees:
        data = turned(model, "root", (0.0, sign * np.deg2rad(degree), 0.0))
        shift = data.site(f"{side}_{site}").xpos - start
        assert lowest(model, data, f"{side}_foot") - shift[2] > -0.003, degree


def test_limits_are_named_for_every_ball_and_contain_the_first_pose(model: mujoco.MjModel) -> None:
    names = {f"limit_{joint}" for joint in balls(model)}
    assert {model.numeric(n).name for n in range(model.nnumeric)} == names
    assert len(names) == 11
    for joint in balls(model):
        low, high = limit(model, joint).T
        assert (low < 0).all() and (high > 0).all(), joint
    for joint in ("elbow", "knee"):
        for side in SIDES:
            low, high = model.joint(f"{side}_{joint}").range
            assert low == 0 and 2.4 < high < 2.8
    assert model.jnt_limited[1:].all()


def test_total_range_contains_the_swing_and_twist_box(model: mujoco.MjModel) -> None:
    for joint in balls(model):
        box = np.abs(limit(model, joint)).max(axis=1)
        swing = min(np.hypot(box[0], box[1]), np.pi)
        corner = 2 * np.arccos(np.cos(swing / 2) * np.cos(box[2] / 2))
        low, high = model.joint(joint).range
        assert low == 0
        assert high >= min(corner, np.pi) - 1e-6
        assert high <= corner + 0.02, "no looser than it must be"


@pytest.mark.parametrize(
    ("joint", "site", "axis", "sign", "moved", "way"),
    [
        # What the larger limit of each joint does, by where it takes a site.
        ("left_hip", "left_foot", 1, -1, 0, 1),  # flexion: foot forward
        ("left_hip", "left_foot", 0, 1, 1, 1),  # abduction: foot outward
        ("right_hip", "right_foot", 0, -1, 1, -1),
        ("left_hip", "left_toe", 2, 1, 1, 1),  # outward turn
        ("left_shoulder", "left_hand", 1, -1, 0, 1),
        ("left_shoulder", "left_hand", 0, 1, 1, 1),
        ("right_shoulder", "right_hand", 0, -1, 1, -1),
        ("spine", "head_top", 1, 1, 0, 1),  # flexion: head forward
        ("left_ankle", "left_toe", 1, 1, 2, -1),  # plantar flexion: toe down
    ],
)
def test_signs_of_the_limits(
    model: mujoco.MjModel, joint: str, site: str, axis: int, sign: int, moved: int, way: int
) -> None:
    turn = np.zeros(3)
    turn[axis] = 0.3 * sign
    step = turned(model, joint, tuple(turn)).site(site).xpos - at(model).site(site).xpos
    assert step[moved] * way > 0.01
    low, high = limit(model, joint)[axis]
    larger = high if sign > 0 else -low
    assert larger >= max(-low, high)


def test_hinges_flex_for_positive_angles(model: mujoco.MjModel) -> None:
    for side in SIDES:
        for joint, site, way in (("knee", "foot", -1), ("elbow", "hand", 1)):
            qpos = model.qpos0.copy()
            qpos[model.jnt_qposadr[model.joint(f"{side}_{joint}").id]] = 0.5
            moved = (
                at(model, qpos).site(f"{side}_{site}").xpos - at(model).site(f"{side}_{site}").xpos
            )
            assert moved[0] * way > 0.05


def test_colliding_geoms_are_named_and_visual_ones_do_not_collide(model: mujoco.MjModel) -> None:
    for geom in range(model.ngeom):
        name, group = model.geom(geom).name, model.geom_group[geom]
        assert model.geom_contype[geom] == 0
        if model.geom_conaffinity[geom]:
            assert name and group == 0
        else:
            assert group == 2
    bodies = set(model.geom_bodyid[model.geom_conaffinity == 1])
    assert bodies == set(range(1, model.nbody)), "every body can meet an obstacle"


def test_drops_onto_a_floor_without_exploding(model: mujoco.MjModel) -> None:
    spec = mujoco.MjSpec.from_file(str(PATH))
    spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 0.1])
    composed = spec.compile()
    data = mujoco.MjData(composed)
    data.qpos[2] += 0.02
    touched = set()
    for _ in range(500):
        mujoco.mj_step(composed, data)
        touched |= {composed.geom(g).name for g in data.contact.geom.ravel()}
        pairs = composed.geom_bodyid[data.contact.geom]
        assert (pairs.min(axis=1, initial=0) == 0).all(), "no contact of the body with itself"
    assert {"floor", "left_foot_sole", "right_foot_sole"} <= touched
    assert np.isfinite(data.qpos).all() and np.abs(data.qvel).max() < 50
    assert 0 < data.body("pelvis").xpos[2] < 0.93
    assert not data.warning.number.any()
