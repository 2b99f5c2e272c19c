"""The rope: hangs still, swings and bends when it is held, and is held where hands and feet are."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from made_up import MIXED, humanoid

from mjmotion.apps.rope import RopeClimb, RopePoints, climb_rope, measure, rope_points
from mjmotion.apps.rope.climb import plan_climb
from mjmotion.apps.rope.grasps import places_along
from mjmotion.apps.rope.points import nearest_on_rope
from mjmotion.apps.rope.result import marks
from mjmotion.body.motion import Motion
from mjmotion.cli.main import main
from mjmotion.clips.climb import climb_contacts, make_climb
from mjmotion.clips.climb_grip import FEET, find_grips
from mjmotion.clips.climb_plan import Hold
from mjmotion.constraints import load_constraints
from mjmotion.exceptions import ConstraintError, ModelError, RenderError, SceneError
from mjmotion.output.reading import read_results
from mjmotion.paper.rope import make_job
from mjmotion.scene import Scene, compose, load_scene, rope, save_model

# ---------------------------------------------------------------- the scene


@cache
def scene_model() -> mujoco.MjModel:
    return rope().compile()


def simulated(
    model: mujoco.MjModel, seconds: float, data: mujoco.MjData | None = None
) -> mujoco.MjData:
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


def test_with_a_character_it_is_one_model_that_plain_mujoco_loads(tmp_path: Path) -> None:
    character = compose("humanoid", Scene.from_spec(rope(edge=0.2), "rope"), moving=True)
    model = character.model
    assert (model.jnt_type[0], model.nq) == (mujoco.mjtJoint.mjJNT_FREE, 57 + 60)
    again = mujoco.MjModel.from_xml_path(str(save_model(character.spec, tmp_path)))
    assert again.nq == model.nq and again.nflex == 1 and again.neq == model.neq
    assert rope_points(again).address.min() == 57


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


# ---------------------------------------------------------------- grasps and reach


def hold(site: str, start: int, end: int, z: float, x: float = 0.0) -> Hold:
    return Hold(site, start, end, np.array((x, 0.0, z)))


def test_a_hold_takes_the_rope_where_it_hangs() -> None:
    anchor = np.array((0.0, 0.0, 5.0))
    holds = [
        hold("left_hand", 0, 20, 3.0),
        hold("left_foot", 5, 30, 2.0, x=0.3),  # hangs from the hand
        hold("right_hand", 10, 30, 3.6),  # between beam and hand
        hold("left_hand", 25, 30, 4.0),  # between beam and the other hand, its own old hold gone
    ]
    along = places_along(holds, anchor, 4.5)
    np.testing.assert_allclose(along, (2.0, 2.0 + np.hypot(0.3, 1.0), 1.4, 1.0))
    assert places_along(holds[::-1], anchor, 4.5).tolist() == along[::-1].tolist()


def test_a_rope_out_of_reach() -> None:
    anchor = np.array((0.0, 0.0, 3.0))
    with pytest.raises(ConstraintError, match=r"out of reach.*above its beam") as caught:
        places_along([hold("left_hand", 7, 9, 3.2)], anchor, 2.0)
    assert caught.value.frames == (7,)
    with pytest.raises(ConstraintError, match=r"out of reach.*below its end"):
        places_along([hold("left_foot", 0, 9, 0.5)], anchor, 2.0)


def test_a_body_too_small_is_said_with_frames() -> None:
    with pytest.raises(ConstraintError, match="the rope is out of reach") as caught:
        plan_climb("child")
    assert set(caught.value.frames) < set(range(275)) and caught.value.frames


# ---------------------------------------------------------------- the simulation


@cache
def small() -> RopeClimb:
    """The whole climb with a coarse rope."""
    return climb_rope("climber", edge=0.1)


def test_the_figures_of_the_climb() -> None:
    climb = small()
    for figures in (climb.original_figures, climb.figures):
        assert figures.held_mm < 5.0
        assert figures.free_mm > 0.0
        assert figures.drift_mm < 1.0
        assert figures.limit_rad < 1e-9
        assert figures.swing_mm > 20.0 and figures.bend_deg > 3.0
    assert climb.jerk_ratio < 1.3
    assert climb.broken() == [] and climb.unmet == ()
    paper = (11.09, 7.51, 3.57, 1.11)
    reached = [level.max_error_percent for level in climb.trace.levels]
    assert all(ours <= theirs for ours, theirs in zip(reached, paper, strict=False))
    assert climb.trace.exact_error_percent < 0.01
    assert climb.trace.nscalar == 5898


def test_a_held_rope_goes_with_the_hold_and_a_free_one_does_not() -> None:
    climb = small()
    line = rope_points(climb.motion.model)
    points = line.positions(climb.motion.qpos)
    along = places_along(climb.holds, line.rest[0], line.length)
    for one, place in zip(climb.holds, along, strict=True):
        on = line.at(points, float(place))[one.start : one.end]
        assert np.linalg.norm(on - one.point, axis=1).max() < 0.003
        if one.site in FEET:  # feet draw it forward
            before = line.at(points, float(place))[one.start - 6]
            assert before[0] < one.point[0] - 0.02
    edges = np.linalg.norm(np.diff(points, axis=1), axis=2)
    np.testing.assert_allclose(edges, 0.1, rtol=0.01)
    assert np.abs(np.diff(points, axis=0)).max() < 0.06  # no jumps
    # Nothing of the climber was moved by the rope.
    bare = make_climb(humanoid())
    np.testing.assert_array_equal(climb.original.qpos[:, :57], bare.qpos)


def test_figures_see_what_is_wrong() -> None:
    climb = small()
    motion = climb.original
    grips = find_grips(humanoid())
    qpos = motion.qpos.copy()
    qpos[:, 0] += 0.05  # the body moves into the rope and the hands off their holds
    worse = measure(motion.replace(qpos), climb.holds, grips)
    assert worse.held_mm == pytest.approx(50.0, abs=2.0)
    assert worse.drift_mm == pytest.approx(climb.original_figures.drift_mm, abs=1e-6)
    assert len(worse.broken()) >= 1 and "held_mm" in worse.broken()[0]
    qpos = motion.qpos.copy()
    qpos[100, 0] += 0.27  # through the rope in one frame
    through = measure(motion.replace(qpos), climb.holds, grips)
    assert through.free_mm < -5.0 and through.free_frame == 100
    assert through.drift_mm > 200.0
    assert any("frame 100" in line for line in through.broken())


# ---------------------------------------------------------------- the command


def test_the_command_writes_a_folder_that_other_commands_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "rope"
    assert main(["rope", "--out", str(out), "--edge", "0.1", "--no-video"]) == 0
    assert "held points" in capsys.readouterr().out
    report = json.loads((out / "report.json").read_text())
    assert report["scalar_constraints"] == 5898 and report["broken"] == []
    assert report["metrics"]["held_mm"] < 5.0
    results = read_results(out)
    assert results.motion.nframe == 275
    assert results.contacts == climb_contacts()
    again = load_constraints(out / "constraints.json", results.model, 275)
    assert sum(constraint.nscalar for constraint in again) == 5898
    original = mujoco.MjModel.from_xml_path(str(out / "original.xml"))
    assert Motion.load(out / "original.npz", original).nframe == 275
    assert main(["rope", "--out", str(out), "--no-video"]) == 2  # nothing is overwritten
    assert "--force" in capsys.readouterr().err
    assert main(["validate", str(out)]) == 2  # its figures are not about ground
    assert "is a rope climb" in capsys.readouterr().err
    assert json.loads((out / "report.json").read_text()) == report


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--to", "child"], "out of reach"),
        (["--beam", "2.5"], "out of reach"),
        (["--length", "3.0"], "out of reach"),
        (["--to", "nobody"], "nobody"),
        (["--length", "9"], "beam"),
        (["--edge", "7"], "edge"),
        (["--beam", "-1"], "positive"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    options: list[str], named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "rope"
    try:
        code: object = main(["rope", "--out", str(out), "--no-video", *options])
    except SystemExit as error:
        code = error.code
    said = capsys.readouterr().err
    assert code == 2 and named in said and said.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_another_skeleton_cannot_climb(tmp_path: Path) -> None:
    file = tmp_path / "mixed.xml"
    file.write_text(MIXED)
    with pytest.raises(ModelError, match="left_hand"):
        climb_rope(file, edge=0.3)


def test_pictures_of_both(tmp_path: Path) -> None:
    from mjmotion.output.video.side_by_side import render_side_by_side, side_by_side_frames

    climb = small()
    motions, names = (climb.original, climb.motion), ("humanoid", "climber")
    try:
        picture = side_by_side_frames(
            motions, [46], names, grasps=marks(climb), width=480, height=300
        )[0]
    except RenderError as error:
        if "does not start" in str(error) or "apt-get" in str(error):
            pytest.skip(str(error))
        raise
    assert picture.shape == (300, 480, 3)
    left, right = picture[40:260, :238].astype(int), picture[40:260, 242:].astype(int)
    assert np.abs(left[:, :236] - right[:, :236]).mean() > 1.0  # two bodies, not one twice
    short = [Motion(motion.model, motion.qpos[40:43], motion.fps) for motion in motions]
    path = render_side_by_side(tmp_path / "r.mp4", short, names, width=160, height=120)
    assert path.stat().st_size > 500
    with pytest.raises(RenderError, match="same frames"):
        side_by_side_frames((motions[0], short[1]), [0], names, width=160, height=120)
    with pytest.raises(RenderError, match="frames 0 to 274"):
        side_by_side_frames(motions, [275], names, width=160, height=120)


def test_the_job_is_the_papers() -> None:
    job = make_job()
    assert (job.nframe, job.ndof, job.nreduced, job.nscalar) == (275, 37, 13, 5898)
