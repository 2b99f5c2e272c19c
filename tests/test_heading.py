"""A walk sets off along the start's x-axis, and says if it met nothing of the scene."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from command_line import run

from mjmotion import Motion, adapt, load_clip
from mjmotion.apps.adaptation import NEVER_MET
from mjmotion.exceptions import FitError
from mjmotion.footsteps.heading import heading, never_met, set_off
from mjmotion.footsteps.planning import make_plan
from mjmotion.numerics.rotations import multiply, rotate, yaw_quat
from mjmotion.output.reading import read_results
from mjmotion.scene import Scene, from_heights, load_scene

FAULTS = Path(__file__).parents[2] / "shared" / "faults"
NEEDS_FAULTS = pytest.mark.skipif(not FAULTS.is_dir(), reason="needs ../shared/faults")
RECORDINGS = Path(__file__).parents[2] / "shared" / "mocap" / "bvh"


@cache
def straight() -> Motion:
    """A walk of 4 m along +x."""
    return load_clip("straight")


def turned(degrees: float, about: tuple[float, float] = (0.0, 0.0)) -> Motion:
    """The walk turned about a point of the ground."""
    qpos = np.array(straight().qpos)
    turn = yaw_quat(np.full(len(qpos), math.radians(degrees)))
    middle = np.array((*about, 0.0))
    qpos[:, :3] = rotate(turn, qpos[:, :3] - middle) + middle
    qpos[:, 3:7] = multiply(turn, qpos[:, 3:7])
    return straight().replace(qpos)


def backwards() -> Motion:
    """The walk played backwards: it goes along -x, looking along +x."""
    return straight().replace(np.array(straight().qpos[::-1]))


@pytest.mark.parametrize("degrees", [10.0, -45.0, 90.0, 180.0, -135.0])
def test_a_walk_is_turned_to_set_off_along_x(degrees: float) -> None:
    clip = turned(degrees, about=(1.0, -2.0))
    before = np.array(clip.qpos)
    found = set_off(clip)
    assert heading(found) == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(found.qpos[0, :3], clip.qpos[0, :3], atol=1e-12)
    # The same walk: as far from its first place, as high, and turned as a whole.
    away = found.qpos[:, :3] - found.qpos[0, :3]
    mine = straight().qpos[:, :3] - straight().qpos[0, :3]
    way = heading(straight())
    assert way is not None
    back = rotate(yaw_quat(np.full(len(mine), -way)), mine)
    np.testing.assert_allclose(away, back, atol=1e-9)
    np.testing.assert_array_equal(found.qpos[:, 7:], clip.qpos[:, 7:])
    np.testing.assert_array_equal(clip.qpos, before)


def test_a_walk_along_x_stays_to_the_bit() -> None:
    for name in ("walk", "straight", "turn_left", "stop", "sneak"):
        clip = load_clip(name)
        assert set_off(clip) is clip, name


@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="the recordings of shared/mocap are not here")
def test_a_recording_is_turned_already() -> None:
    for name in ("02_01", "16_13"):
        clip = load_clip(RECORDINGS / f"{name}.bvh")
        assert set_off(clip) is clip, name


def test_one_that_goes_nowhere_stays() -> None:
    still = straight().replace(np.repeat(turned(90.0).qpos[:1], 40, axis=0))
    assert heading(still) is None and set_off(still) is still


def test_who_walks_backwards_still_does() -> None:
    found = set_off(backwards())
    assert found.qpos[-1, 0] - found.qpos[0, 0] > 3.5
    looks = rotate(found.qpos[:, 3:7], np.array((1.0, 0.0, 0.0)))
    assert looks[:, 0].max() < -0.9


def test_adapting_turns_or_keeps() -> None:
    clip, levels = turned(90.0), (8.0, 2.0)
    there = adapt(clip, "flat", levels=levels).source.qpos
    kept = adapt(clip, "flat", levels=levels, heading="keep").source.qpos
    np.testing.assert_allclose(kept, clip.qpos, atol=1e-12)
    assert there[-1, 0] > 3.5 and abs(there[-1, 1]) < 0.3
    assert kept[-1, 1] > 3.5
    with pytest.raises(FitError, match="heading 'away'"):
        adapt(clip, "flat", heading="away")


BOX = '<geom name="box" type="box" size=".2 .2 .2" pos="{}" {}/>'
SCENES = {
    "nothing to meet": ("", False),
    "a box beside": (BOX.format("2 .6 .2", ""), False),
    "a box far aside": (BOX.format("2 3 .2", ""), True),
    "a box behind": (BOX.format("-2 0 .2", ""), True),
    "a picture far aside": (BOX.format("2 3 .2", 'contype="0" conaffinity="0"'), False),
    "a plate under the floor": (BOX.format("2 3 -.2", ""), False),
    "one of two beside": (BOX.format("2 .6 .2", "") + BOX.format("9 9 .2", "").replace(
        '"box" t', '"other" t'), False),
    "a box turned towards": (
        '<geom type="box" size="1.2 .1 .2" pos="2 1.4 .2" euler="0 0 90"/>', False),
    "a box turned away": (
        '<geom type="box" size="1.2 .1 .2" pos="2 1.4 .2"/>', True),
    "a free box far aside": (
        f'<body><freejoint/>{BOX.format("2 3 .2", "")}</body>', True),
}  # fmt: skip


@pytest.mark.parametrize("name", SCENES)
def test_what_was_never_met(name: str) -> None:
    inside, wanted = SCENES[name]
    floor = '<geom name="floor" type="plane" size="0 0 .1"/>'
    xml = f"<mujoco><worldbody>{floor}{inside}</worldbody></mujoco>"
    scene = Scene.from_spec(mujoco.MjSpec.from_string(xml)).at_rest()
    plan = make_plan(straight(), scene)
    path = plan.source.qpos[:, :3] + plan.root_shift
    assert never_met(path, plan.footholds, scene.model) is wanted


def test_a_heightfield_is_met_where_a_foot_stands_higher() -> None:
    heights = np.zeros((21, 121))
    heights[:, 75:] = 0.2 * np.sin(np.linspace(0.0, 3.0, 46)) ** 2  # ahead of the start
    scene = Scene.from_spec(from_heights(heights, cell=0.1, start=(6.0, 1.0)))
    for clip, wanted in ((straight(), False), (turned(180.0), True)):
        plan = make_plan(clip, scene)
        assert never_met(plan.source.qpos[:, :3], plan.footholds, scene.model) is wanted


def test_it_is_told_on_stderr_and_in_the_report(tmp_path: Path) -> None:
    turned(180.0).save(tmp_path / "away.npz")
    words = ("adapt", tmp_path / "away.npz", "--scene", "stairs", "--no-video", "--levels", "8,2")
    done = run(*words, "--heading", "keep", "--out", tmp_path / "kept")
    assert done.returncode == 0 and f"note: {NEVER_MET}" in done.stderr
    assert NEVER_MET in (tmp_path / "kept" / "report.html").read_text("utf-8")
    assert read_results(tmp_path / "kept").notes == (NEVER_MET,)
    done = run(*words, "--out", tmp_path / "turned")
    notes = read_results(tmp_path / "turned").notes
    assert NEVER_MET not in done.stderr and NEVER_MET not in notes
    # It climbs the stairs, and what that changes is told instead.
    assert notes and "steps have another length" in notes[0]
    assert all(f"note: {note}" in done.stderr for note in notes)


@NEEDS_FAULTS
def test_a_recording_walked_backwards_climbs_the_stairs() -> None:
    clip = load_clip(FAULTS / "walk_backwards.bvh")
    plan = make_plan(set_off(clip), load_scene("stairs"))
    assert max(one.position[2] for one in plan.footholds) > 0.2


@NEEDS_FAULTS
def test_a_walk_there_and_back_has_no_displacement() -> None:
    clip = load_clip(FAULTS / "there_and_back.bvh")
    metrics = adapt(clip, "flat", levels=(8.0, 2.0)).validate().metrics
    assert math.isnan(metrics["root_displacement_ratio"])
    assert metrics["root_travel_ratio"] == pytest.approx(1.0, abs=0.03)
