"""Rays straight down by formulas are MuJoCo's rays."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mjmotion.body.kinematics import RayCaster
from mjmotion.scene import blocks, terrain
from mjmotion.scene.columns import Columns
from mjmotion.scene.ground import Ground, solid_model

DOWN = np.array((0.0, 0.0, -1.0))
KINDS = ("box", "sphere", "capsule", "cylinder", "ellipsoid", "hfield", "mesh")
ASSETS = """<asset><hfield name="field" nrow="7" ncol="9" size="3 2 .5 .2"/>
<mesh name="tent" vertex="-1 -1 0  1 -1 0  1 1 0  -1 1 0  .1 .2 .9"/></asset>"""


def scene(kinds: tuple[str, ...], turns: str, seed: int, count: int = 40) -> mujoco.MjModel:
    """Return geoms of random sizes, places and turns over a tilted plane."""
    rng = np.random.default_rng(seed)
    parts = ['<geom type="plane" size="0 0 1" pos="0 0 -4" euler="0 10 0"/>']
    for kind in rng.choice(kinds, count):
        quat = {
            "any": rng.normal(size=4),
            "upright": np.array((*rng.normal(size=1), 0.0, 0.0, *rng.normal(size=1))),
            "level": np.array((1.0, 0.0, 0.0, 0.0)),
        }[turns]
        place, size = rng.uniform(-5, 5, 3), rng.uniform(0.05, 0.8, 3)
        what = {"hfield": 'hfield="field"', "mesh": 'mesh="tent"'}.get(kind)
        what = what or f'size="{size[0]} {size[1]} {size[2]}"'
        numbers = [" ".join(map(str, part)) for part in (place, quat)]
        parts.append(f'<geom type="{kind}" {what} pos="{numbers[0]}" quat="{numbers[1]}"/>')
    text = f"<mujoco>{ASSETS}<worldbody>{''.join(parts)}</worldbody></mujoco>"
    model = mujoco.MjModel.from_xml_string(text)
    model.hfield_data[:] = rng.uniform(size=model.hfield_data.shape)
    return solid_model(model)


def check(model: mujoco.MjModel, origins: np.ndarray) -> None:
    """Check that all rays are MuJoCo's."""
    distance, geom, normal = RayCaster(model).cast(origins, DOWN)
    found, of, plumb = Columns(model).cast(origins)
    np.testing.assert_allclose(found, distance, atol=1e-9, rtol=0.0)
    np.testing.assert_array_equal(of, geom)
    np.testing.assert_allclose(plumb, normal, atol=1e-7)
    assert (found >= 0.0).any()


@pytest.mark.parametrize("turns", ["any", "upright", "level"])
@pytest.mark.parametrize("kind", KINDS)
def test_rays_on_to_each_shape_are_mujocos(kind: str, turns: str) -> None:
    # From over, inside and under them: what a ray sees from inside is its way out.
    model = scene((kind,), turns, seed=1, count=5 if kind == "hfield" else 40)
    check(model, np.random.default_rng(2).uniform(-6, 6, (20_000, 3)))


@pytest.mark.parametrize("seed", range(4))
def test_rays_on_to_all_shapes_at_once_are_mujocos(seed: int) -> None:
    model = scene(KINDS, "any", seed, count=150)
    check(model, np.random.default_rng(seed).uniform(-6, 6, (20_000, 3)))


def test_rays_down_edges_of_blocks_are_mujocos_to_the_bit() -> None:
    model = solid_model(blocks().compile())
    origins = np.random.default_rng(3).uniform((-3, -6, -1), (15, 8, 3), (20_000, 3))
    origins[:, :2] = np.round(origins[:, :2] / 0.05) * 0.05
    distance, geom, normal = RayCaster(model).cast(origins, DOWN)
    found, of, plumb = Columns(model).cast(origins)
    assert (found == distance).all() and (of == geom).all() and (plumb == normal).all()


def test_a_ray_down_an_edge_between_two_triangles_meets_them() -> None:
    # MuJoCo's rays pass between the triangles of a heightfield where they meet; none do here.
    model = solid_model(terrain().compile())
    origins = np.random.default_rng(0).uniform((-3, -6, 0), (18, 6, 0), (20_000, 3))
    origins[:, :2] = np.round(origins[:, :2] / 0.05) * 0.05
    origins[:, 2] = 5.0
    found, _, _ = Columns(model).cast(origins)
    beside, _, _ = RayCaster(model).cast(origins + (3e-8, 1e-8, 0.0), DOWN)
    np.testing.assert_allclose(found, beside, atol=1e-6)


def test_nothing_visible_and_no_rays() -> None:
    model = scene(KINDS, "any", seed=5)
    distance, geom, normal = Columns(model).cast(np.empty((0, 3)))
    assert distance.shape == (0,) and geom.shape == (0,) and normal.shape == (0, 3)
    model.geom_rgba[:, 3] = 0.0
    distance, geom, normal = Columns(model).cast(np.zeros((3, 3)))
    assert (distance == -1.0).all() and (geom == -1).all() and (normal == 0.0).all()


@pytest.mark.parametrize("seed", range(3))
def test_walls_are_those_of_rays_on_to_all_geoms(seed: int) -> None:
    model = scene(("box", "cylinder", "mesh"), "any", seed, count=60)
    ground, caster = Ground(model), RayCaster(model)
    rng = np.random.default_rng(seed)
    seen = []
    for _ in range(200):
        origin = np.tile(rng.uniform(-5, 5, 3), (4, 1))
        spans = rng.normal(scale=0.2, size=(4, 3))
        distance, _, _ = caster.cast(origin, spans)
        length = np.linalg.norm(spans, axis=1)
        wall = bool(((distance >= 0.0) & (distance * length < length + 0.015)).any())
        assert ground.blocked(origin, spans, 0.015) == wall
        seen.append(wall)
    assert 0 < sum(seen) < len(seen)
