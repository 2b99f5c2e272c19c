"""Scenes: builders against known answers, composing, saving whole, and bad input."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from PIL import Image
from scipy.interpolate import BSpline

from mjmotion.body.motion import Motion
from mjmotion.exceptions import ModelError, MotionError, SceneError
from mjmotion.scene import (
    BUILDERS,
    Doorway,
    Scene,
    blocks,
    compose,
    doors,
    flat,
    from_heights,
    load_scene,
    save_model,
    slope,
    stairs,
    terrain,
)
from mjmotion.scene.stage import ground_heights
from mjmotion.scene.terrain_scene import control_heights, spline_surface

SHIPPED = ("flat", "terrain", "terrain_doors", "stairs", "slope", "blocks")
ROOT = Path(__file__).parents[1]

CHARACTER = """
<mujoco model="figure">
  <compiler angle="radian"/>
  <default><default class="limb"><geom rgba="0 1 0 1" density="985"/></default></default>
  <asset>
    <texture name="grid" type="2d" builtin="flat" width="8" height="8" rgb1="1 0 0"/>
    <material name="grid" texture="grid"/>
    <texture name="dusk" type="skybox" builtin="flat" width="8" height="8" rgb1="1 0 0"/>
  </asset>
  <custom><numeric name="limit_knee" data="-1 1 -2 2 0 0.123456789012345"/></custom>
  <worldbody>
    <light name="lamp" pos="0 0 3"/>
    <geom name="studio" type="plane" size="1 1 .1"/>
    <body name="pelvis" pos="0 0 .9"><freejoint name="root"/>
      <geom class="limb" name="hip" size=".1" material="grid"/>
      <body name="shank"><joint name="knee" axis="0 1 0" range="0 2.5"/>
        <geom class="limb" name="shin" size=".05" pos="0 0 -.4"/><site name="toe" pos="0 0 -.9"/>
      </body>
    </body>
  </worldbody>
  <keyframe><key name="home" qpos="0 0 .8 1 0 0 0 .5"/></keyframe>
</mujoco>
"""

USER_SCENE = """
<mujoco model="yard">
  <compiler angle="degree" meshdir="parts" texturedir="parts"/>
  <option gravity="0 0 -3.7"/>
  <visual><global offwidth="320" offheight="240"/></visual>
  <default><default class="limb"><geom rgba="0 0 1 1"/></default></default>
  <asset>
    <texture name="grid" type="2d" file="grid.png"/>
    <texture name="sky" type="skybox" builtin="gradient" rgb1="0 0 1" width="16" height="16"/>
    <material name="grid" texture="grid"/>
    <mesh name="rock" file="rock.obj" scale="2 2 2"/>
    <mesh name="wedge" vertex="0 0 0  1 0 0  0 1 0  0 0 1.23456789"/>
    <hfield name="dune" file="dune.png" size="2 3 0.4 0.1"/>
    <hfield name="bump" nrow="2" ncol="3" elevation="0 1 2 3 4 7" size="1 1 .3 .1"/>
  </asset>
  <worldbody>
    <geom name="yard" type="plane" size="0 0 1" material="grid"/>
    <geom name="dune" type="hfield" hfield="dune" pos="5 0 0"/>
    <geom name="bump" type="hfield" hfield="bump" pos="-5 0 0"/>
    <body name="boulder" pos="1 2 0"><geom name="rock" class="limb" type="mesh" mesh="rock"/></body>
    <geom name="wedge" type="mesh" mesh="wedge" euler="0 0 20" pos="3 3 0"/>
    <site name="start" pos="0.5 -1 0" euler="0 0 30"/>
    EXTRA
  </worldbody>
</mujoco>
"""

ROCK = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 0.7071\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.fixture
def yard(tmp_path: Path) -> Path:
    """A user's scene with every kind of asset, from files and inline."""
    parts = tmp_path / "yard" / "parts"
    parts.mkdir(parents=True)
    rng = np.random.default_rng(0)
    Image.fromarray(rng.integers(0, 256, (7, 5), dtype=np.uint8)).save(parts / "dune.png")
    Image.fromarray(rng.integers(0, 256, (4, 4, 3), dtype=np.uint8)).save(parts / "grid.png")
    (parts / "rock.obj").write_text(ROCK)
    path = tmp_path / "yard" / "yard.xml"
    path.write_text(USER_SCENE.replace("EXTRA", ""))
    return path


@pytest.fixture
def figure(tmp_path: Path) -> Path:
    path = tmp_path / "figure.xml"
    path.write_text(CHARACTER)
    return path


def ray_down(model: mujoco.MjModel, x: float, y: float, z: float = 100.0) -> tuple[float, str]:
    """Height of what a ray straight down from z meets, and the geom's name."""
    return ray(model, (x, y, z), (0, 0, -1), lambda distance: z - distance)


def ray(
    model: mujoco.MjModel,
    origin: ArrayLike,
    direction: ArrayLike,
    value: Callable[[float], float] = lambda distance: distance,
) -> tuple[float, str]:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    geom = np.zeros(1, dtype=np.int32)
    distance = mujoco.mj_ray(
        model, data, np.array(origin, float), np.array(direction, float), None, 1, -1, geom
    )
    assert distance >= 0, "the ray met nothing"
    return value(distance), model.geom(int(geom[0])).name


# ---------------------------------------------------------------- terrain


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    shape=st.tuples(st.integers(4, 9), st.integers(4, 9)),
    points=st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=1, max_size=6),
)
def test_surface_is_scipys_bicubic_spline(
    seed: int, shape: tuple[int, int], points: list[tuple[float, float]]
) -> None:
    control = np.random.default_rng(seed).uniform(0, 2.1, shape)
    row = np.array([p[0] for p in points]) * (shape[0] - 3)
    column = np.array([p[1] for p in points]) * (shape[1] - 3)
    along_y = BSpline(np.arange(shape[0] + 4) - 3, control, 3)(row)
    expected = BSpline(np.arange(shape[1] + 4) - 3, along_y.T, 3)(column).T
    np.testing.assert_allclose(spline_surface(control, column, row), expected, atol=1e-12)


def test_terrain_is_the_spline_over_the_whole_walk() -> None:
    seed, spacing, height = 3, 1.4, 2.1
    x_range, y_range = (-4.0, 20.0), (-8.0, 8.0)
    spec = terrain(seed)
    model = spec.compile()
    control = control_heights(seed, spacing, height, x_range, y_range)
    assert control.min() >= 0 and control.max() <= height
    assert control.shape == (12 + 3, 18 + 3)  # 16 m and 24 m in squares of 1.4 m
    rng = np.random.default_rng(0)
    # Samples of the heightfield lie every 5 cm: there the ray meets the surface itself.
    x = x_range[0] + 0.05 * rng.integers(1, 480, 40)
    y = y_range[0] + 0.05 * rng.integers(1, 320, 40)
    knots_y, knots_x = np.arange(19) - 3, np.arange(25) - 3
    for px, py in zip(x, y, strict=True):
        line = BSpline(knots_y, control, 3)((py - y_range[0]) / spacing)
        expected = BSpline(knots_x, line, 3)((px - x_range[0]) / spacing)
        measured, name = ray_down(model, px, py)
        assert name == "terrain"
        assert measured == pytest.approx(float(expected), abs=1e-5)


def test_terrain_between_samples_is_within_two_millimetres() -> None:
    x_range, y_range = (-4.0, 20.0), (-8.0, 8.0)
    control = control_heights(1, 1.4, 2.1, x_range, y_range)
    points = np.random.default_rng(1).uniform([-3.9, -7.9], [19.9, 7.9], (300, 2))
    exact = np.array(
        [spline_surface(control, [(x + 4) / 1.4], [(y + 8) / 1.4])[0, 0] for x, y in points]
    )
    assert np.abs(ground_heights(terrain(1), points) - exact).max() < 2e-3


def test_terrain_seeds() -> None:
    data = [terrain(seed).compile().hfield_data for seed in (1, 1, 2)]
    np.testing.assert_array_equal(data[0], data[1])
    assert not np.array_equal(data[0], data[2])


# ---------------------------------------------------------------- doors, stairs, slope, blocks


@settings(max_examples=8, deadline=None)
@given(
    x=st.floats(0.5, 6),
    y=st.floats(-2, 2),
    yaw=st.floats(-3.1, 3.1),
    width=st.floats(0.5, 1.5),
    height=st.floats(1.3, 2.3),
)
def test_a_doorway_measures_what_was_asked(
    x: float, y: float, yaw: float, width: float, height: float
) -> None:
    ground = terrain(1, x_range=(-4.0, 10.0), y_range=(-5.0, 5.0))
    model = doors([Doorway(x, y, yaw, width, height)], base=ground).compile()
    floor = float(ground_heights(ground, [(x, y)])[0])
    lintel, name = ray(model, (x, y, floor + 0.01), (0, 0, 1))
    assert name == "door1_lintel"
    assert lintel + 0.01 == pytest.approx(height, abs=1e-9)
    across = np.array([-np.sin(yaw), np.cos(yaw), 0])
    middle = np.array([x, y, floor + height - 0.02])
    for sign, side in ((1, "left"), (-1, "right")):
        distance, name = ray(model, middle, sign * across)
        assert name == f"door1_{side}_post"
        assert distance == pytest.approx(width / 2, abs=1e-9)
    for side in ("left", "right"):
        post = model.geom(f"door1_{side}_post")
        bottom = post.pos[2] - post.size[2]
        assert bottom < ground_heights(ground, [post.pos[:2]])[0] - 0.2


def test_stairs_heights_by_ray() -> None:
    model = stairs(steps=4, rise=0.15, tread=0.4, landing=1.0, width=6.0, distance=2.0).compile()
    tops = [0.15, 0.30, 0.45, 0.60, 0.45, 0.30, 0.15]
    edges = np.cumsum([2.0, 0.4, 0.4, 0.4, 1.0, 0.4, 0.4, 0.4])
    for top, low, high in zip(tops, edges[:-1], edges[1:], strict=True):
        for x in (low + 1e-4, (low + high) / 2, high - 1e-4):
            for y in (-2.99, 0.0, 2.99):
                assert ray_down(model, x, y)[0] == pytest.approx(top, abs=1e-9)
    for x in (1.99, edges[-1] + 0.01):
        assert ray_down(model, x, 0.0)[0] == pytest.approx(0.0, abs=1e-9)


def test_slope_heights_by_ray_and_by_collision() -> None:
    model = slope(angle=8.0, length=3.0, plateau=1.0, width=8.0, distance=1.5).compile()
    steep = np.tan(np.radians(8.0))
    x = np.linspace(0.0, 10.0, 101)
    expected = np.clip(np.minimum(x - 1.5, 8.5 - x), 0.0, 3.0) * steep
    measured = [ray_down(model, px, 1.0)[0] for px in x]
    np.testing.assert_allclose(measured, expected, atol=1e-6)
    # The edges themselves, from side to side: no ray may fall through a joint.
    for px in (1.5, 4.5, 5.5, 8.5):
        for py in np.linspace(-3.99, 3.99, 41):
            top = np.clip(min(px - 1.5, 8.5 - px), 0.0, 3.0) * steep
            assert ray_down(model, px, py)[0] == pytest.approx(top, abs=1e-6)
    # A ball that rests on the ramp touches it.
    spec = slope(angle=8.0, length=3.0, plateau=1.0, width=8.0, distance=1.5)
    up = 0.05 * np.array([-np.sin(np.radians(8.0)), 0.0, np.cos(np.radians(8.0))])
    body = spec.worldbody.add_body(pos=np.array([3.0, 0.3, 1.5 * steep]) + up)
    body.add_geom(name="ball", size=[0.05, 0, 0])
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    gap = mujoco.mj_geomDistance(
        model, data, model.geom("ramp_up").id, model.geom("ball").id, 1.0, None
    )
    assert gap == pytest.approx(0.0, abs=1e-5)


def test_blocks_are_level_at_the_start_and_seeded() -> None:
    one, again, other = (blocks(seed).compile() for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.geom_size, again.geom_size)
    assert not np.array_equal(one.geom_size, other.geom_size)
    angles = np.linspace(0, 2 * np.pi, 24)
    near = [ray_down(one, 0.79 * np.cos(a), 0.79 * np.sin(a))[0] for a in angles]
    np.testing.assert_allclose(near, 0.07, atol=1e-12)
    rng = np.random.default_rng(0)
    tops = [ray_down(one, *rng.uniform([-2, -4.8], [13.9, 6.9])) for _ in range(200)]
    assert {name.split("_")[0] for _, name in tops} == {"block"}
    heights = np.array([top for top, _ in tops])
    assert heights.min() >= 0.014 - 1e-9 and heights.max() <= 0.14 + 1e-9
    assert np.ptp(heights) > 0.1


# ---------------------------------------------------------------- heights


def test_heights_from_an_array_stand_where_they_should() -> None:
    rows, columns = np.mgrid[0:21, 0:31]
    heights = 0.02 * columns - 0.01 * rows + 3.0
    model = from_heights(heights, cell=0.1, start=(0.5, 1.0)).compile()
    # The start is the origin: columns run along +x and rows along +y from (-0.5, -1).
    for row, column in ((1, 1), (10, 5), (19, 29), (3, 17)):
        measured, _ = ray_down(model, -0.5 + 0.1 * column, -1.0 + 0.1 * row)
        assert measured == pytest.approx(heights[row, column], abs=1e-5)
    assert model.site("start").pos[2] == pytest.approx(heights[10, 5], abs=1e-5)


def test_heights_from_npy_and_image_agree(tmp_path: Path) -> None:
    grey = np.random.default_rng(0).integers(0, 256, (12, 16), dtype=np.uint8)
    Image.fromarray(grey).save(tmp_path / "grey.png")
    Image.fromarray(grey.astype(np.uint16) * 257).save(tmp_path / "grey16.png")
    np.save(tmp_path / "grey.npy", np.flipud(grey) / 255.0 * 0.5)
    models = [
        from_heights(tmp_path / name, height=0.5, cell=0.2).compile()
        for name in ("grey.png", "grey16.png", "grey.npy")
    ]
    for model in models[1:]:
        np.testing.assert_allclose(model.hfield_data, models[0].hfield_data, atol=1e-6)
        np.testing.assert_allclose(model.hfield_size, models[0].hfield_size, atol=1e-9)
    assert models[0].hfield_size[0, 2] == pytest.approx(0.5 * np.ptp(grey.astype(float)) / 255)


def test_level_heights_are_level() -> None:
    model = from_heights(np.full((5, 6), 1.25)).compile()
    assert ray_down(model, 0.05, 0.03)[0] == pytest.approx(1.25, abs=1e-5)


def test_a_convex_mesh_is_placed_and_another_is_sampled(tmp_path: Path) -> None:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=2, radius=2.0)
    ball.export(tmp_path / "ball.stl")
    model = from_heights(tmp_path / "ball.stl", start=(2.0, 2.0)).compile()
    assert model.ngeom == 1 and model.geom_type[0] == mujoco.mjtGeom.mjGEOM_MESH
    assert ray_down(model, 0.0, 0.0)[0] == pytest.approx(2.0, abs=1e-3)

    x, y = np.meshgrid(np.linspace(0, 4, 41), np.linspace(0, 2, 21))
    z = 0.3 * np.sin(2 * x) * np.cos(y)
    index = np.arange(x.size).reshape(x.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    # The same sheet in centimetres with y up, as many tools export.
    points = 100 * np.stack([x, z, -y], axis=-1).reshape(-1, 3)
    trimesh.Trimesh(points, faces, process=False).export(tmp_path / "sheet.ply")
    model = from_heights(
        tmp_path / "sheet.ply", scale=0.01, up="y", cell=0.1, start=(1.0, 1.0)
    ).compile()
    assert model.geom_type.tolist() == [mujoco.mjtGeom.mjGEOM_HFIELD]
    for row, column in ((3, 4), (10, 20), (18, 33)):
        measured, _ = ray_down(model, x[row, column] - 1.0, y[row, column] - 1.0)
        assert measured == pytest.approx(z[row, column], abs=2e-3)


def test_a_level_sheet_and_a_pile_of_boxes(tmp_path: Path) -> None:
    import trimesh

    corners = [[0, 0, 0.5], [4, 0, 0.5], [4, 2, 0.5], [0, 2, 0.5]]
    trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]]).export(tmp_path / "sheet.obj")
    model = from_heights(tmp_path / "sheet.obj").compile()
    assert ray_down(model, 1.0, 0.3)[0] == pytest.approx(0.5, abs=1e-5)

    low, high = trimesh.creation.box((4, 4, 1)), trimesh.creation.box((2, 2, 3))
    trimesh.util.concatenate([low, high]).export(tmp_path / "pile.glb")
    model = from_heights(tmp_path / "pile.glb", start=(2.0, 2.0)).compile()
    assert ray_down(model, 0.5, -0.5)[0] == pytest.approx(1.5, abs=1e-5)
    assert ray_down(model, 1.5, -0.5)[0] == pytest.approx(0.5, abs=1e-5)


# ---------------------------------------------------------------- shipped scenes


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_scenes(name: str) -> None:
    scene = load_scene(name)
    assert scene.name == name
    assert scene.model.nq == 0
    np.testing.assert_allclose(scene.start_pos[:2], 0.0, atol=1e-12)
    assert scene.start_yaw == pytest.approx(0.0)
    top, _ = ray_down(scene.model, 0.0, 0.0)
    assert top == pytest.approx(scene.start_pos[2], abs=1e-6)
    assert scene.model.nlight >= 1
    assert scene.model.vis.global_.offwidth >= 1280 and scene.model.vis.global_.offheight >= 720


def test_shipped_scenes_are_what_the_script_makes(tmp_path: Path) -> None:
    import runpy

    script = runpy.run_path(str(ROOT / "scripts" / "make_scenes.py"))
    script["write_scenes"](tmp_path)
    made = {path.name for path in tmp_path.iterdir()}
    assert made == {path.name for path in (ROOT / "scenes").iterdir()}
    for name in made:
        assert (tmp_path / name).read_bytes() == (ROOT / "scenes" / name).read_bytes(), name


def test_shipped_terrain_is_the_same_with_doors() -> None:
    one, other = load_scene("terrain").model, load_scene("terrain_doors").model
    np.testing.assert_array_equal(one.hfield_data, other.hfield_data)
    assert sum("lintel" in other.geom(i).name for i in range(other.ngeom)) == 3


# ---------------------------------------------------------------- compose


@pytest.mark.parametrize("name", SHIPPED)
def test_compose_humanoid(name: str) -> None:
    scene = load_scene(name)
    model = compose("humanoid", scene).model
    alone = mujoco.MjModel.from_xml_path(str(ROOT / "models" / "mjcf" / "humanoid.xml"))
    assert model.nq == alone.nq and model.nv == alone.nv and model.nbody == alone.nbody
    for kind, count in (
        ("joint", alone.njnt),
        ("body", alone.nbody),
        ("site", alone.nsite),
        ("numeric", alone.nnumeric),
    ):
        for i in range(count):
            getattr(model, kind)(getattr(alone, kind)(i).name)  # raises KeyError if it is gone
    assert model.joint(0).name == alone.joint(0).name
    np.testing.assert_array_equal(model.jnt_range, alone.jnt_range)
    np.testing.assert_allclose(model.body_mass, alone.body_mass)
    before = scene.spec.to_xml()
    compose("humanoid", scene)
    assert scene.spec.to_xml() == before


def test_compose_a_users_scene(
    yard: Path,
    figure: Path,
    capfd: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    recwarn: pytest.WarningsRecorder,
) -> None:
    monkeypatch.chdir(tmp_path)
    scene = load_scene(yard)
    assert scene.start_yaw == pytest.approx(np.radians(30))
    np.testing.assert_allclose(scene.start_pos, [0.5, -1, 0])
    model = compose(figure, scene).model
    assert [model.joint(i).name for i in range(model.njnt)] == ["root", "knee"]
    names = {model.geom(i).name for i in range(model.ngeom)}
    assert names == {"yard", "dune", "bump", "rock", "wedge", "hip", "shin"}  # no studio floor
    assert model.opt.gravity[2] == -3.7
    assert [model.light(i).name for i in range(model.nlight)] == ["sun"]
    assert model.vis.global_.offwidth >= 1280 and model.vis.global_.offheight >= 720
    # Both have a texture, a material and a class of the same names: each keeps its own.
    assert model.geom("hip").rgba.tolist() == [0, 1, 0, 1]
    assert model.geom("rock").rgba.tolist() == [0, 0, 1, 1]
    assert model.geom("hip").matid != model.geom("yard").matid
    skies = [
        i for i in range(model.ntex) if model.tex_type[i] == mujoco.mjtTexture.mjTEXTURE_SKYBOX
    ]
    assert [model.tex(i).name for i in skies] == ["sky"]
    assert model.numeric("limit_knee").data[5] == 0.123456789012345
    np.testing.assert_allclose(model.key("home").qpos, [0, 0, 0.8, 1, 0, 0, 0, 0.5])
    assert capfd.readouterr() == ("", "")
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()
    assert not recwarn.list


CRATE = (
    '<body name="crate" pos="2 0 1"><freejoint name="crate"/>'
    '<geom name="box" type="box" size=".2 .2 .2"/></body><site name'
)


def test_a_scene_that_moves_stands_still_beside_a_character(yard: Path, figure: Path) -> None:
    yard.write_text(yard.read_text().replace("<site name", CRATE))
    character = compose(figure, load_scene(yard))
    model = character.model
    assert [model.joint(i).name for i in range(model.njnt)] == ["root", "knee"]
    assert model.body_weldid[model.body("crate").id] == 0
    np.testing.assert_allclose(model.body("crate").pos, [2, 0, 1])
    Motion(character, model.qpos0[None], 30.0)


def test_a_scene_that_is_to_move_keeps_the_root_first(yard: Path, figure: Path) -> None:
    yard.write_text(yard.read_text().replace("<site name", CRATE))
    character = compose(figure, load_scene(yard), moving=True)
    model = character.model
    assert [model.joint(i).name for i in range(model.njnt)] == ["root", "knee", "crate"]
    with pytest.raises(ModelError, match="only free one"):  # whose motion would it be?
        Motion(character, model.qpos0[None], 30.0)
    np.testing.assert_allclose(model.qpos0[:7], [0, 0, 0.9, 1, 0, 0, 0])
    np.testing.assert_allclose(model.qpos0[8:11], [2, 0, 1])


# ---------------------------------------------------------------- saving


def assert_same(one: mujoco.MjModel, other: mujoco.MjModel, but: str = "-") -> None:
    """Every array of the two models is equal, but for the paths of asset files."""
    for name in dir(one):
        if name.startswith("_") or "path" in name or name in ("nbuffer", but):
            continue
        value = getattr(one, name)
        if isinstance(value, (int, float, np.ndarray)):
            np.testing.assert_array_equal(value, getattr(other, name), err_msg=name)


def test_saved_model_is_the_same_from_anywhere(
    yard: Path, figure: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(yard.parent)
    character = compose(figure, load_scene("yard.xml"))
    model = character.model
    path = save_model(character.spec, tmp_path / "out")
    assert {file.name for file in (tmp_path / "out").iterdir()} == {
        "model.xml", "dune.bin", "bump.bin", "rock.obj", "scene_grid.png"
    }  # fmt: skip
    moved = (tmp_path / "out").rename(tmp_path / "moved")
    for file in (yard.parent / "parts").iterdir():
        file.unlink()
    monkeypatch.chdir("/")
    loaded = mujoco.MjModel.from_xml_path(str(moved / path.name))
    assert model.nhfield == 2 and model.nmesh == 2
    assert_same(model, loaded)


@pytest.mark.parametrize("name", SHIPPED)
def test_saved_humanoid_on_shipped_scenes(name: str, tmp_path: Path) -> None:
    character = compose("humanoid", load_scene(name))
    path = save_model(character.spec, tmp_path)
    assert_same(character.model, mujoco.MjModel.from_xml_path(str(path)))


def test_same_file_name_for_different_assets(tmp_path: Path) -> None:
    texts = {}
    for name, top in (("a", "0.5"), ("b", "1.5")):
        folder = tmp_path / name / "meshes"
        folder.mkdir(parents=True)
        (folder / "part.obj").write_text(ROCK.replace("0.7071", top))
        texts[name] = (
            '<mujoco><compiler meshdir="meshes"/>'
            '<asset><mesh name="part" file="part.obj"/></asset>'
            f'<worldbody><body name="{name}">{"<freejoint/>" if name == "a" else ""}'
            f'<geom name="g{name}" type="mesh" mesh="part"/></body></worldbody></mujoco>'
        )
        (tmp_path / name / "m.xml").write_text(texts[name])
    character = compose(tmp_path / "a" / "m.xml", load_scene(tmp_path / "b" / "m.xml"))
    model = character.model
    assert np.ptp(model.mesh_vert[:4], axis=0).max() != np.ptp(model.mesh_vert[4:], axis=0).max()
    assert_same(
        model, mujoco.MjModel.from_xml_path(str(save_model(character.spec, tmp_path / "out")))
    )


def test_textures_held_in_memory(tmp_path: Path) -> None:
    spec = flat()
    pixels = np.random.default_rng(0).integers(0, 256, (6, 4, 3), dtype=np.uint8)
    spec.add_texture(
        name="paint", type=mujoco.mjtTexture.mjTEXTURE_2D, width=4, height=6, nchannel=3,
        data=list(pixels.tobytes()),
    )  # fmt: skip
    cube = np.random.default_rng(1).integers(0, 256, (24, 4, 3), dtype=np.uint8)
    spec.add_texture(
        name="box", type=mujoco.mjtTexture.mjTEXTURE_CUBE, width=4, height=24, nchannel=3,
        data=list(cube.tobytes()),
    )  # fmt: skip
    loaded = mujoco.MjModel.from_xml_path(str(save_model(spec, tmp_path)))
    # A file says that its colours are linear; those in memory say nothing, which means the same.
    assert_same(spec.compile(), loaded, but="tex_colorspace")


def test_two_models_in_one_folder_keep_their_own_heights(tmp_path: Path) -> None:
    first = save_model(terrain(1), tmp_path, "one.xml")
    second = save_model(terrain(2), tmp_path, "two.xml")
    again = save_model(terrain(1), tmp_path, "three.xml")
    assert len(list(tmp_path.glob("*.bin"))) == 2
    data = [mujoco.MjModel.from_xml_path(str(path)).hfield_data for path in (first, second, again)]
    np.testing.assert_array_equal(data[0], terrain(1).compile().hfield_data)
    np.testing.assert_array_equal(data[1], terrain(2).compile().hfield_data)
    np.testing.assert_array_equal(data[0], data[2])


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(MotionError, match="cannot write") as caught:
        save_model(flat(), tmp_path / "file" / "out")
    assert "\n" not in str(caught.value)


# ---------------------------------------------------------------- bad input

BAD_SCENES = {
    "missing.xml": (None, "does not exist"),
    "empty.xml": ("", "empty.xml. is empty"),
    "cut.xml": ("<mujoco><worldbody><geom", "well-formed"),
    "notes.txt": ("hello", "not an MJCF"),
    "word.xml": ('<mujoco><worldbody><geom type="blob"/></worldbody></mujoco>', "blob"),
    "size.xml": ('<mujoco><worldbody><geom type="sphere"/></worldbody></mujoco>', "size"),
    "mesh.xml": (
        '<mujoco><asset><mesh name="a" file="gone.obj"/></asset><worldbody>'
        '<geom type="mesh" mesh="a"/></worldbody></mujoco>',
        "gone.obj",
    ),
    "up.xml": (
        '<mujoco><worldbody><site name="start" euler="0 90 0"/></worldbody></mujoco>',
        "straight up",
    ),
}


@pytest.mark.parametrize("name", BAD_SCENES)
def test_bad_scene_files(name: str, tmp_path: Path) -> None:
    text, message = BAD_SCENES[name]
    path = tmp_path / name
    if text is not None:
        path.write_text(text)
    with pytest.raises(SceneError, match=message) as caught:
        load_scene(path)
    assert "\n" not in str(caught.value)
    assert name in str(caught.value)


def test_unknown_scene_name_suggests_one() -> None:
    with pytest.raises(SceneError, match=re.escape("Did you mean 'terrain_doors'?")):
        load_scene("terain_door")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<mujoco", "cannot be read: it is not well-formed"),
        (
            '<mujoco><worldbody><body><freejoint/><geom type="mesh"/></body></worldbody></mujoco>',
            "does not compile",
        ),
        ('<mujoco><worldbody><body><geom size=".1"/></body></worldbody></mujoco>', "root"),
    ],
)
def test_bad_characters(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "bad.xml").write_text(text)
    with pytest.raises(ModelError, match=message):
        compose(tmp_path / "bad.xml", Scene.from_spec(flat()))


BAD_BUILDS = [
    (lambda: terrain(spacing=0.0), "spacing"),
    (lambda: terrain(cell=-1.0), "cell"),
    (lambda: terrain(height=float("nan")), "height"),
    (lambda: terrain(x_range=(3.0, 1.0)), "x_range"),
    (lambda: terrain(x_range=(1.0, 9.0)), "no ground"),
    (lambda: terrain(-1), "seed"),
    (lambda: doors([Doorway(1.0, width=0.0)]), "door1"),
    (lambda: doors([Doorway(500.0)]), "no ground"),
    (lambda: doors([]), "doorway"),
    (lambda: stairs(rise=0.0), "rise"),
    (lambda: stairs(steps=0), "steps"),
    (lambda: slope(angle=75.0), "angle"),
    (lambda: slope(length=-1.0), "length"),
    (lambda: blocks(size=0.0), "size"),
    (lambda: blocks(size=100.0), "no block"),
    (lambda: blocks(size=0.01), "too many"),
    (lambda: from_heights(np.zeros(5)), "shape"),
    (lambda: from_heights(np.zeros((3, 1))), "shape"),
    (lambda: from_heights(np.array([[0.0, 1.0], [np.nan, 0.0]])), "row 1, column 0"),
    (lambda: from_heights(np.zeros((3, 3)), cell=0.0), "cell"),
    (lambda: from_heights(np.zeros((3, 3)), start=(9.0, 0.0)), "beside"),
    (lambda: from_heights("no_such.npy"), "no_such.npy"),
    (lambda: from_heights("no_such.png"), "no_such.png"),
    (lambda: from_heights(np.zeros((3, 3)), up="x"), "up"),
]


@pytest.mark.parametrize(("build", "message"), BAD_BUILDS)
def test_bad_builder_arguments(build: Callable[[], object], message: str) -> None:
    with pytest.raises(SceneError, match=message) as caught:
        build()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["bad.npy", "bad.png", "bad.obj", "bad.stl", "bad.xyzzy"])
def test_damaged_height_files(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(b"\x00\x01 not what it says \xff")
    with pytest.raises(SceneError, match=re.escape(name)) as caught:
        from_heights(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_registry_names_every_builder() -> None:
    assert set(BUILDERS) == {
        "flat",
        "terrain",
        "doors",
        "stairs",
        "slope",
        "blocks",
        "heights",
        "rope",
    }
    for name, build in BUILDERS.items():
        spec = build(np.zeros((4, 4))) if name == "heights" else build()
        assert Scene.from_spec(spec, name).start_yaw == 0.0
