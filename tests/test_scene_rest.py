"""Scenes in which something can move: they stand still, and so they compose with a character."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from PIL import Image

from mjmotion.body.character import Character
from mjmotion.exceptions import SceneError
from mjmotion.footsteps.contacts import contact_sites
from mjmotion.footsteps.obstacles import convex_obstacles
from mjmotion.scene import Scene, compose, load_scene, save_model

FAULTS = Path(__file__).parents[2] / "shared" / "faults"
NEEDS_FAULTS = pytest.mark.skipif(not FAULTS.is_dir(), reason="needs ../shared/faults")
HUMANOID = Path(__file__).parents[1] / "models" / "mjcf" / "humanoid.xml"

FLOOR = '<geom name="floor" type="plane" size="0 0 .1"/>'
LEAF = '<geom name="leaf" type="box" size=".02 .4 1" pos="0 .4 0" mass="1"/>'
BALL = '<geom name="ball" size=".1" pos=".3 .1 0" mass="1"/>'

# What of a world moves, and a pose of it other than its rest pose.
MOVING = {
    "free": (f'<body name="b" pos="2 0 .3" euler="0 0 20"><freejoint/>{BALL}</body>',
             "3 1 .5 .6 0 .8 0"),
    "free in a frame": (f'<frame pos="1 2 3" euler="10 20 30"><body name="b" pos="0 .5 0" '
                        f'axisangle="0 1 0 40"><freejoint/>{BALL}</body></frame>',
                        "3 1 .5 .6 0 .8 0"),
    "free with its own frame aligned": (
        f'<body name="b" pos="2 0 .3"><freejoint align="true"/>{BALL}'
        '<geom name="rod" type="capsule" size=".02" fromto="0 0 0 .3 .4 .5"/></body>',
        "3 1 .5 .6 0 .8 0"),
    "hinge": (f'<body name="b" pos="1 0 1" euler="0 0 15"><joint name="h" axis="0 0 1" '
              f'pos="0 -.1 0" ref="20"/>{LEAF}</body>', "1.2"),
    "chain": (f'<body name="a" pos="1 0 1"><joint type="slide" axis="1 0 0"/>{BALL}'
              '<frame euler="0 90 0"><body name="b" zaxis="1 0 1"><joint type="ball"/>'
              f'{LEAF}<body name="c" pos="0 0 .5"><joint axis="1 1 0"/><geom name="tip" size=".1"/>'
              '</body></body></frame></body>', ".4 .5 .5 .5 .5 -.7"),
    "mocap": (f'<body name="b" mocap="true" pos="1 1 1" euler="5 0 0">{LEAF}</body>', ""),
}  # fmt: skip


def world(inside: str, pose: str = "", before: str = "", after: str = "") -> Scene:
    """A scene with a floor, what is to be in it, and perhaps a keyframe ``there``."""
    key = f'<keyframe><key name="there" {pose}/></keyframe>' if pose else ""
    xml = f"<mujoco>{before}<worldbody>{FLOOR}{inside}</worldbody>{after}{key}</mujoco>"
    return Scene.from_spec(mujoco.MjSpec.from_string(xml), "made up")


def geom_poses(model: mujoco.MjModel, key: str | None) -> dict[str, np.ndarray]:
    """Position and rotation of every named geom in the world: name to (12,)."""
    data = mujoco.MjData(model)
    if key is not None:
        mujoco.mj_resetDataKeyframe(model, data, model.key(key).id)
    mujoco.mj_kinematics(model, data)
    return {
        model.geom(i).name: np.concatenate((data.geom_xpos[i], data.geom_xmat[i]))
        for i in range(model.ngeom)
    }


@pytest.mark.parametrize("name", MOVING)
@pytest.mark.parametrize("keyframe", [None, "there"])
def test_what_moves_stands_where_its_pose_has_it(name: str, keyframe: str | None) -> None:
    inside, qpos = MOVING[name]
    pose = f'qpos="{qpos}"' if qpos else 'mpos="2 0 1" mquat=".6 .8 0 0"'
    scene = world(inside, pose)
    before = scene.spec.to_xml()
    rest = scene.at_rest(keyframe)
    assert rest.model.njnt == 0 and rest.model.nmocap == 0 and rest.model.nkey == 0
    wanted, found = geom_poses(scene.model, keyframe), geom_poses(rest.model, None)
    assert wanted.keys() == found.keys()
    for geom, place in wanted.items():
        np.testing.assert_allclose(found[geom], place, atol=1e-9, err_msg=geom)
    if keyframe is not None:  # the two poses differ, or this would show nothing
        still = geom_poses(scene.model, None)
        assert max(np.abs(still[geom] - wanted[geom]).max() for geom in wanted) > 0.1
    assert scene.spec.to_xml() == before
    solid = {rest.model.geom(int(geom)).name for geom in convex_obstacles(rest.model)}
    assert solid == wanted.keys() - {"floor"}


def test_what_does_not_move_is_the_same_scene() -> None:
    scene = load_scene("stairs")
    assert scene.at_rest() is scene


def test_all_that_needs_joints_goes_with_them() -> None:
    scene = world(
        f'<body name="b" pos="1 0 1"><joint name="h"/>{LEAF}<site name="s"/></body>',
        'qpos="1"',
        after='<actuator><motor name="m" joint="h"/></actuator>'
        '<sensor><jointpos joint="h"/><framepos objtype="site" objname="s"/></sensor>'
        '<tendon><fixed name="t"><joint joint="h" coef="1"/></fixed></tendon>'
        '<equality><joint joint1="h"/></equality>'
        '<custom><tuple name="u"><element objtype="body" objname="b" prm="0"/></tuple>'
        '<numeric name="limit_h" data="0 1 0 1 0 1"/></custom>',
    )
    model = compose("humanoid", scene).model
    assert (model.nu, model.nsensor, model.ntendon, model.neq, model.ntuple) == (0, 0, 0, 0, 0)
    names = [model.numeric(i).name for i in range(model.nnumeric)]
    assert "limit_h" not in names and "limit_left_hip" in names


def test_an_unknown_keyframe_is_told_with_those_that_there_are() -> None:
    with pytest.raises(SceneError, match=r"keyframe 'ther'\. Did you mean 'there'") as caught:
        world(MOVING["hinge"][0], 'qpos="1"').at_rest("ther")
    assert "\n" not in str(caught.value)
    with pytest.raises(SceneError, match=r"\(none\)"):
        load_scene("flat").at_rest("home")


def test_what_collides_by_pairs_alone_is_solid() -> None:
    scene = world(
        '<geom name="step" type="box" size=".2 .2 .1" pos="1 0 .1" contype="0" conaffinity="0"/>'
        '<geom name="picture" size=".1" pos="2 0 1" contype="0" conaffinity="0"/>'
        f'<body pos="0 0 3"><freejoint/>{BALL}</body>',
        after='<contact><pair geom1="ball" geom2="step"/></contact>',
    )
    rest = scene.at_rest().model
    assert {rest.geom(int(geom)).name for geom in convex_obstacles(rest)} == {"step", "ball"}


# ---------------------------------------------------------------- flexes

BOX = np.stack(np.meshgrid((-1, 1), (-1, 1), (-1, 1)), axis=-1).reshape(-1, 3)

FLEXES = {
    "cloth": ('type="grid" dim="2" count="5 3 1" spacing=".1 .2 .1" euler="90 0 0" radius=".01"',
              (0.2, 0.01, 0.2)),
    "soft": ('type="grid" dim="3" count="3 3 3" spacing=".1 .1 .1" radius=".01"', None),
    "rope": ('type="grid" dim="1" count="5 1 1" spacing=".1 .1 .1" radius=".02"',
             (0.22, 0.02, 0.02)),
}  # fmt: skip


@pytest.mark.parametrize("kind", FLEXES)
def test_flexes_become_geoms_of_their_shape(kind: str) -> None:
    form, half = FLEXES[kind]
    inside = f'<flexcomp name="thing" {form} pos="2 1 1" mass="1" rgba="1 0 0 1">'
    if kind == "cloth":
        inside += '<pin id="0 2"/>'
    scene = world(inside + '<edge equality="true"/></flexcomp>')
    model = scene.at_rest().model
    assert model.nflex == 0 and model.njnt == 0
    assert model.nbody <= 3  # the points are gone, but for a body that holds them all
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for geom in range(1, model.ngeom):
        assert model.geom(geom).name.startswith("thing")
        assert model.geom_contype[geom] and model.geom_rgba[geom].tolist() == [1, 0, 0, 1]
        turn = data.geom_xmat[geom].reshape(3, 3)
        corners = model.geom_aabb[geom, :3] + model.geom_aabb[geom, 3:] * BOX
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
            corners = model.mesh_vert
        points = data.geom_xpos[geom] + corners @ turn.T
        low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
    np.testing.assert_allclose((low + high) / 2, (2, 1, 1), atol=1e-6)
    if half is not None:
        np.testing.assert_allclose((high - low) / 2, half, atol=1e-6)
    else:  # its corners are moved out along the mean of three faces, its sides by the radius
        assert (abs((high - low) / 2 - 0.11) < 0.006).all()


def test_a_flat_cloth_is_an_obstacle() -> None:
    model = world(f'<flexcomp name="c" {FLEXES["cloth"][0]} pos="2 0 1" mass="1"/>').at_rest().model
    assert model.geom("c").id in convex_obstacles(model)


# ---------------------------------------------------------------- names

# Elements that a scene may have under names of the humanoid's own.
SAME = (
    '<body name="pelvis" pos="3 2 1"><freejoint name="root"/>'
    '<geom name="{geom}" size=".1" material="{material}"/><site name="left_heel"/>'
    '<camera name="eye" mode="targetbody" target="pelvis" pos="0 0 5"/>'
    '<light name="lamp" mode="targetbody" target="pelvis"/></body>'
)


def test_equal_names_of_any_kind_are_the_scenes_to_change(tmp_path: Path) -> None:
    spec = mujoco.MjSpec.from_file(str(HUMANOID))
    body = next(one for one in spec.bodies if one.name == "pelvis")
    body.add_camera(name="eye")
    body.add_light(name="lamp")
    spec.add_numeric(name="number", data=[1.0], size=1)
    spec.add_material(name="skin_of_all", rgba=(0, 1, 0, 1))
    geom = next(one for one in spec.geoms if one.name)
    geom.material = "skin_of_all"
    scene = world(
        SAME.format(geom=geom.name, material="skin_of_all"),
        before='<asset><material name="skin_of_all" rgba="1 0 0 1"/></asset>',
        after='<custom><numeric name="number" data="2"/></custom>',
    )
    alone = spec.copy().compile()
    character = compose(spec, scene)
    model = character.model
    assert [model.joint(i).name for i in range(model.njnt)] == [
        alone.joint(i).name for i in range(alone.njnt)
    ]
    assert model.geom(geom.name).matid == model.material("skin_of_all").id
    assert model.material("skin_of_all").rgba.tolist() == [0, 1, 0, 1]
    assert model.geom(f"scene_{geom.name}").matid == model.material("scene_skin_of_all").id
    theirs = model.body("scene_pelvis")
    np.testing.assert_allclose(theirs.pos, (3, 2, 1))
    assert model.cam("scene_eye").targetbodyid == theirs.id
    assert model.light("scene_lamp").targetbodyid == theirs.id
    assert model.site("scene_left_heel").bodyid == theirs.id
    assert model.numeric("number").data == 1 and model.numeric("scene_number").data == 2
    saved = mujoco.MjModel.from_xml_path(str(save_model(character.spec, tmp_path)))
    assert saved.body("scene_pelvis").id == theirs.id and saved.nq == model.nq


def test_a_figure_of_the_same_make_stands_by() -> None:
    """A scene with another humanoid in it: it is an obstacle, and its feet are nobody's."""
    spec = mujoco.MjSpec.from_file(str(HUMANOID))
    spec.worldbody.add_geom(name="ground", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0, 0, 0.1))
    scene = Scene.from_spec(spec, "company")
    character = compose("humanoid", scene)
    assert len(character.feet) == 2 and character.model.njnt == scene.model.njnt
    assert len(convex_obstacles(character.model)) > 10
    # Each finds the character's own alone.
    alone = Character.load("humanoid")
    assert len(character.limbs) == len(alone.limbs)
    assert len(character.parts.trunk) == len(alone.parts.trunk)
    assert contact_sites(character.model) == contact_sites(alone.model)


# ---------------------------------------------------------------- saving

SETTINGS = (
    *('angle="radian"', 'eulerseq="zyx"', 'balanceinertia="true"', 'boundmass="0.1"'),
    *('boundinertia="0.1"', 'settotalmass="3"', 'inertiafromgeom="true"'),
    *('inertiafromgeom="false"', 'inertiagrouprange="0 1"', 'alignfree="true"'),
    *('fusestatic="true"', 'discardvisual="true"', 'strippath="true"'),
)


@pytest.mark.parametrize("setting", SETTINGS)
def test_a_scene_of_other_settings_can_be_saved(
    setting: str, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "scene.xml"
    path.write_text(
        f"<mujoco><compiler {setting}/><worldbody>{FLOOR}"
        '<body name="b" pos="1 0 0" euler=".1 .2 .3"><joint name="h"/>'
        f'<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>{LEAF}</body></worldbody></mujoco>'
    )
    character = compose("humanoid", load_scene(path))
    saved = mujoco.MjModel.from_xml_path(str(save_model(character.spec, tmp_path / "out")))
    for name in ("body_pos", "body_quat", "geom_pos", "geom_size", "body_mass", "jnt_range"):
        np.testing.assert_array_equal(getattr(saved, name), getattr(character.model, name))
    assert capfd.readouterr() == ("", "")
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


def test_faces_of_cube_textures_are_found_from_anywhere(tmp_path: Path) -> None:
    sides = ("right", "left", "up", "down", "front", "back")
    (tmp_path / "look").mkdir()
    for number, side in enumerate(sides):
        pixels = np.full((4, 4, 3), 40 * number, dtype=np.uint8)
        Image.fromarray(pixels).save(tmp_path / "look" / f"{side}.png")
    files = " ".join(f'file{side}="{side}.png"' for side in sides)
    path = tmp_path / "scene.xml"
    path.write_text(
        '<mujoco><compiler texturedir="look"/>'
        f'<asset><texture name="die" type="cube" {files}/><material name="die" texture="die"/>'
        f"</asset><worldbody>{FLOOR}<body><freejoint/>"
        '<geom type="box" size=".1 .1 .1" material="die"/></body></worldbody></mujoco>'
    )
    character = compose("humanoid", load_scene(path))
    saved = mujoco.MjModel.from_xml_path(str(save_model(character.spec, tmp_path / "out")))
    np.testing.assert_array_equal(saved.tex_data, character.model.tex_data)


# ---------------------------------------------------------------- what used to fail


@NEEDS_FAULTS
@pytest.mark.parametrize(
    ("file", "body", "place"),
    [
        ("scene_free_box.xml", "box", (2, 0, 0.3)),
        ("scene_same_names.xml", "scene_pelvis", (3, 2, 1)),
    ],
)
def test_scenes_that_were_refused(file: str, body: str, place: tuple[float, ...]) -> None:
    model = compose("humanoid", load_scene(FAULTS / file)).model
    assert model.njnt == compose("humanoid", "flat").model.njnt
    np.testing.assert_allclose(model.body(body).pos, place)
    assert model.body_weldid[model.body(body).id] == 0
