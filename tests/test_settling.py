"""Soles on rough ground: plates that settle, and walks on bumps, small boxes and rods."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from made_up import character

from mjmotion.apps.adaptation import adapt
from mjmotion.footsteps.settling import (
    EDGE_STEP,
    INSIDE_STEP,
    SINK,
    SINK_STANDING,
    HeightMap,
    Tread,
    settle,
    settled,
)
from mjmotion.numerics.rotations import exp, rotate, yaw_quat
from mjmotion.scene import Scene
from mjmotion.scene.builders import flat
from mjmotion.scene.ground import Ground
from mjmotion.scene.heights import add_heightfield
from mjmotion.scene.stage import add_start, new_scene
from mjmotion.validation import validate

CELL, BUMP = 0.08, 0.05  # [m]


def bumps(seed: int, relief: float = BUMP) -> mujoco.MjSpec:
    spec = new_scene("bumps")
    heights = np.random.default_rng(seed).uniform(0.0, relief, (60, 100))
    add_heightfield(spec, "bumps", heights, (-2.0, 6.0), (-2.4, 2.4))
    add_start(spec)
    return spec


def rods() -> mujoco.MjSpec:
    """Thin rods across the way, nearer to each other than a foot is long."""
    spec = flat()
    for number, x in enumerate(np.arange(0.1, 5.0, 0.31)):
        spec.worldbody.add_geom(
            name=f"rod{number}",
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=(0.015, 0.0, 0.0),
            fromto=(x, -1.5, 0.015, x + 0.2, 1.5, 0.015),
        )
    return spec


def crates(seed: int) -> mujoco.MjSpec:
    rng, spec = np.random.default_rng(seed), flat()
    for number in range(250):
        size = (*rng.uniform(0.02, 0.15, 2), 0.5 * rng.uniform(0.01, 0.05))
        spec.worldbody.add_geom(
            name=f"crate{number}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=size,
            pos=(rng.uniform(-1.0, 6.0), rng.uniform(-1.2, 1.2), size[2]),
            quat=yaw_quat(np.asarray(rng.uniform(0.0, np.pi))),
        )
    return spec


def ground(spec: mujoco.MjSpec) -> Ground:
    return Scene.from_spec(spec).ground


def tread() -> Tread:
    return Tread.of(character().feet[0])


def test_a_tread_leaves_no_hole_in_its_sole() -> None:
    points = tread().points
    rng = np.random.default_rng(1)
    sole = tread().foot.sole[:, :2]
    inside = (rng.dirichlet(np.ones(len(sole)), 200)) @ sole
    apart = np.linalg.norm(inside[:, None] - points[None, :, :2], axis=2).min(axis=1)
    assert apart.max() < np.hypot(EDGE_STEP, INSIDE_STEP)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_plate_rests_as_low_as_a_linear_programme_says(seed: int) -> None:
    from scipy.optimize import linprog

    sole = tread()
    rng = np.random.default_rng(seed)
    heights = rng.uniform(0.0, BUMP, (4, len(sole.points)))
    points = np.broadcast_to(sole.points, (4, *sole.points.shape))
    plates = settled(sole, np.zeros((4, 3)), np.array((1.0, 0, 0, 0)), heights, points)
    toes = sole.toes * np.tan(0.3)
    at = np.column_stack((sole.points[:, :2], np.ones(len(sole.points))))
    for number, height in enumerate(heights):
        best = linprog(
            (*sole.load, 1.0), -at, -(height - sole.sink - toes), bounds=[(None, None)] * 3
        )
        normal = plates.normal[number]
        middle = np.append(sole.load, 0.0) - plates.position[number]
        lowest = -(middle[:2] @ normal[:2]) / normal[2] + plates.position[number, 2]
        assert lowest == pytest.approx(best.fun, abs=1e-4)


def test_a_foot_rests_on_three_posts() -> None:
    """On two posts under its ball and one under its heel: in the plane of their tops."""
    spec = flat()
    tops = {(-0.04, 0.0): 0.02, (0.1, 0.03): 0.035, (0.1, -0.03): 0.015}
    for (x, y), top in tops.items():
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=(0.004, 0, 0), fromto=(x, y, -0.1, x, y, top)
        )
    sole = tread()
    plates = settle(sole, ground(spec), np.zeros(3), np.array((1.0, 0.0, 0.0, 0.0)))
    for (x, y), top in tops.items():
        over = np.array((x, y, top + 0.004)) - plates.position[0]
        assert over @ plates.normal[0] == pytest.approx(SINK, abs=0.002)
    assert sole.rises(ground(spec), plates.position[0], plates.quat[0], 0.0) < SINK + 1e-3


def test_on_a_slope_a_foot_lies_as_the_slope_does() -> None:
    spec = mujoco.MjSpec()
    tilt = exp(np.array((0.1, -0.2, 0.0)))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=(5, 5, 0.1), quat=tilt)
    plates = settle(tread(), ground(spec), np.zeros(3), yaw_quat(np.asarray(0.7)))
    np.testing.assert_allclose(plates.normal[0], rotate(tilt, np.eye(3)[2]), atol=SINK / 0.06)
    assert plates.gap[0] <= SINK_STANDING / np.cos(0.25) + 1e-6


def test_a_map_of_heights_is_exact_on_a_slope() -> None:
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=(5, 5, 0.1), quat=exp(np.array((0.1, -0.2, 0.0)))
    )
    place = ground(spec)
    points = np.random.default_rng(3).uniform(-0.3, 0.3, (50, 3)) * (1, 1, 0)
    heights, _ = place.under(points)
    np.testing.assert_allclose(HeightMap(place, np.zeros(3), 0.3).at(points), heights, atol=1e-9)


@pytest.mark.parametrize(
    "spec", [bumps(4), bumps(5), rods(), crates(6)], ids=("bumps", "more bumps", "rods", "crates")
)
def test_walks_on_rough_ground_neither_sink_in_nor_float(spec: mujoco.MjSpec) -> None:
    result = adapt("straight", Scene.from_spec(spec))
    figures = validate(result.source, result.motion, result.contacts)
    assert figures.metrics["sole_penetration_mm"] <= 5.0
    broken = figures.broken()
    assert "stance_gap_hfield_p95_mm" not in broken and "stance_gap_max_mm" not in broken
    assert figures.metrics["contact_kept_percent"] >= 90.0
