"""The rope: hangs still, swings and bends when it is held, and is held where hands and feet are."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
import pytest

from mjmotion.exceptions import SceneError
from mjmotion.rope.points import RopePoints, nearest_on_rope, rope_points
from mjmotion.scene import Scene, compose, load_scene, rope, save_model

# ---------------------------------------------------------------- the scene


@cache
def scene_model() -> mujoco.MjModel:
    return rope().compile()


def simulated(model: mujoco.MjModel, seconds: float, data: mujoco.MjData | None = None):
    data = mujoco.MjData(model) if data is None else data
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
    return data


def points(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    return rope_points(model).positions(data.qpos)


def test_left_alone_it_hangs_still_and_straight() -> None:
    model = scene_model()
    data = simulated(model, 0.5)
    line = points(model, data)
    assert np.abs(line[:, :2]).max() < 1e-9
    assert line[0, 2] == 4.3 and line[-1, 2] == pytest.approx(0.3, abs=0.005)
    assert np.abs(data.qvel).max() < 0.02


def test_pulled_it_bends_and_let_go_it_swings_and_keeps_its_length() -> None:
    model = rope(edge=0.1).compile()
    data = mujoco.MjData(model)
    body = model.body("rope20").id
    data.xfrc_applied[body, 0] = 30.0
    line = points(model, simulated(model, 0.6, data))
    assert line[20, 0] > 0.5
    steps = np.diff(line, axis=0)
    assert np.linalg.norm(steps, axis=1) == pytest.approx(0.1, abs=1e-3)
    assert steps[10, 0] > 0.0 > steps[-1, 0]  # the pull goes through its middle
    data.xfrc_applied[body, 0] = 0.0
    sides = [points(model, simulated(model, 0.2, data))[-1, 0] for _ in range(12)]
    assert max(sides) > 0.3 and min(sides) < -0.3
    assert not any(warning.number for warning in data.warning)


def test_the_sizes_are_what_was_asked_for() -> None:
    made = rope_points(rope(beam=3.0, length=2.0, radius=0.012, edge=0.1).compile())
    assert made.length == pytest.approx(2.0) and made.radius == 0.012
    assert len(made.rest) == 21 and made.rest[-1, 2] == pytest.approx(1.0)
    shipped, built = load_scene("rope").model, scene_model()
    assert shipped.nq == built.nq == 240
    np.testing.assert_allclose(shipped.body_pos, built.body_pos, atol=1e-6)


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"length": 5.0}, "beam"),
        ({"radius": 0.0}, "radius"),
        ({"edge": 0.001}, "edge"),
        ({"edge": 3.0}, "edge"),
        ({"beam": float("nan")}, "beam"),
    ],
)
def test_bad_ropes(wrong: dict[str, float], named: str) -> None:
    with pytest.raises(SceneError, match=named) as caught:
        rope(**wrong)
    assert "\n" not in str(caught.value)


def test_with_a_character_it_is_one_model_that_plain_mujoco_loads(tmp_path) -> None:
    spec = compose("humanoid", Scene.from_spec(rope(edge=0.2), "rope"))
    model = spec.compile()
    assert (model.jnt_type[0], model.nq) == (mujoco.mjtJoint.mjJNT_FREE, 55 + 60)
    again = mujoco.MjModel.from_xml_path(str(save_model(spec, tmp_path)))
    assert again.nq == model.nq and again.nflex == 1 and again.neq == model.neq
    assert rope_points(again).address.min() == 55


# ---------------------------------------------------------------- its points


def test_places_along_a_rope() -> None:
    along = np.array((0.0, 1.0, 3.0))
    line = RopePoints(np.zeros((2, 3), int), np.zeros((3, 3)), along, 0.01)
    place = np.array(((0.0, 0.0, 3.0), (0.0, 0.0, 2.0), (2.0, 0.0, 2.0)))
    np.testing.assert_allclose(line.at(place, 0.5), (0.0, 0.0, 2.5))
    np.testing.assert_allclose(line.at(place, 2.0), (1.0, 0.0, 2.0))
    np.testing.assert_allclose(line.at(place, 3.0), (2.0, 0.0, 2.0))
    gap, edge = nearest_on_rope(
        np.stack((place, place)), np.array(((1.5, 0.3, 2.0), (0.0, 0.0, 5.0)))
    )
    np.testing.assert_allclose(gap, (0.3, 2.0))
    assert edge.tolist() == [1, 0]
