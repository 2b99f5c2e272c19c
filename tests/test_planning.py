"""Footholds that are free to move, from the plan through the adaptation to the command line."""

from __future__ import annotations

import functools
import json
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from command_line import run
from made_up import MIXED, character, humanoid, loop_sites, missed, some, walk

from mjmotion.apps.adaptation import adapt
from mjmotion.body.character import Character
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.constraints import SiteConstraint
from mjmotion.exceptions import ModelError, MotionError
from mjmotion.fitting import Fit, fit
from mjmotion.footsteps.plan import Plan, shifted
from mjmotion.footsteps.planning import make_plan, with_free_footholds
from mjmotion.ik.solver import default_rigidity
from mjmotion.numerics.tangent import ominus
from mjmotion.output.result import Result
from mjmotion.scene import Scene, flat, load_scene, slope, stairs
from mjmotion.validation import validate

OFF_PLANE = 0.03  # a foothold that is free stays this near the plane it was in [m]
FRAMES = 90


@functools.cache
def scene(name: str) -> Scene:
    if name == "steps":
        return Scene.from_spec(stairs(steps=3, rise=0.12, tread=0.4, distance=0.5), "steps")
    if name == "incline":
        return Scene.from_spec(slope(angle=7.0, distance=0.4, length=2.0), "incline")
    if name == "level":
        return Scene.from_spec(flat(), "level")
    return load_scene(name)


@functools.cache
def clip(name: str) -> Motion:
    return load_clip("walk") if name == "walk" else walk(3.6, 60.0 if name == "fast" else 30.0)


@functools.cache
def planned(where: str, what: str = "walk") -> Plan:
    return make_plan(clip(what), scene(where))


@functools.cache
def adapted(where: str, free: bool, ik: str = "hybrid", what: str = "walk") -> Result:
    return adapt(clip(what), scene(where), free_footholds=free, ik=ik)


def deviation(motion: Motion, source: Motion, weights: np.ndarray) -> float:
    moved = ominus(source.model, motion.qpos, source.qpos)
    return float(np.sum(weights * moved * moved))


# The plan


def test_every_stance_is_one_move() -> None:
    what = planned("terrain")
    moves = what.free_footholds()
    feet = what.source.character.feet
    assert len(moves) == len(what.stances) == len(what.footholds)
    by_foot = [
        [(s, f) for s, f in zip(what.stances, what.footholds, strict=True) if s.foot == foot]
        for foot in range(len(feet))
    ]
    ordered = [(feet[foot].site, *pair) for foot, mine in enumerate(by_foot) for pair in mine]
    for move, (site, stance, foothold) in zip(moves, ordered, strict=True):
        assert move.site == site
        np.testing.assert_array_equal(move.pivot, foothold.position)
        np.testing.assert_allclose(move.directions @ foothold.normal, 0.0, atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(move.directions, axis=1), 1.0)
        np.testing.assert_allclose(some(move.axis), foothold.normal)
        stands = (move.frames >= stance.start) & (move.frames < stance.end)
        assert stands.sum() == stance.end - stance.start
        np.testing.assert_array_equal(move.share[stands], 1.0)
        before = move.frames < stance.start
        assert (np.diff(move.share[before]) >= 0.0).all()
        assert (np.diff(move.share[move.frames >= stance.end]) <= 0.0).all()


def test_shares_of_neighbours_add_up_to_one() -> None:
    """In a swing what one foothold lets go the next one takes up; at the ends one has it all."""
    what = planned("terrain")
    for site in {move.site for move in what.free_footholds()}:
        total = np.zeros(what.source.nframe)
        for move in what.free_footholds():
            if move.site == site:
                total[move.frames] += move.share
        np.testing.assert_allclose(total, 1.0, atol=1e-9)


@functools.cache
def shared_fit(where: str, ik: str, free: bool) -> Fit:
    what = planned(where)
    return fit(
        what.source,
        what.constraints(),
        ik=ik,
        first_guess=what.root_shift,
        shared=what.free_footholds() if free else (),
        exact=False,  # as in with_free_footholds, which plans anew from where they went
    )


@pytest.mark.parametrize("ik", ["hybrid", "numeric"])
@pytest.mark.parametrize("where", ["terrain", "stairs"])
def test_free_footholds_change_the_walk_less(where: str, ik: str) -> None:
    """Eq. 4 summed over all frames, from the same first guess; moves paid for too."""
    what, weights = planned(where), default_rigidity(humanoid())
    guess = shifted(what.source, what.root_shift)
    fixed, free = (shared_fit(where, ik, one) for one in (False, True))
    cost = [deviation(one.motion, guess, weights) for one in (fixed, free)]
    moves = what.free_footholds()
    price = sum(m.rigidity * float(v @ v) for m, v in zip(moves, free.moves, strict=True))
    assert cost[1] + price < 0.95 * cost[0]
    assert free.moves.shape == (len(moves), 4) and np.abs(free.moves[:, :2]).max() > 0.02
    for move, value in zip(moves, free.moves, strict=True):
        assert (value[len(move.directions) : 3] == 0.0).all()


@pytest.mark.parametrize("where", ["terrain", "stairs", "blocks", "slope"])
def test_freed_footholds_stay_on_what_they_stood_on(where: str) -> None:
    """They go some way, in their planes: none comes to stand on another step."""
    what = planned(where)
    new = with_free_footholds(what, scene(where))
    assert new.stances == what.stances and len(new.footholds) == len(what.footholds)
    moved = np.array(
        [n.position - o.position for n, o in zip(new.footholds, what.footholds, strict=True)]
    )
    normal = np.array([one.normal for one in what.footholds])
    assert np.abs(np.einsum("ni,ni->n", moved, normal)).max() < OFF_PLANE
    assert 0.02 < np.linalg.norm(moved, axis=1).max() < 0.5
    np.testing.assert_array_equal(what.source.qpos, planned(where).source.qpos)


def test_on_level_ground_nothing_need_move() -> None:
    """The footholds are the clip's own already."""
    what = planned("level", "made up")
    new = with_free_footholds(what, scene("level"))
    for old, one in zip(what.footholds, new.footholds, strict=True):
        np.testing.assert_allclose(one.position, old.position, atol=6e-3)


# The adaptation


@pytest.mark.parametrize("ik", ["hybrid", "numeric"])
@pytest.mark.parametrize("where", ["terrain", "slope"])
def test_figures_hold_with_free_footholds(where: str, ik: str) -> None:
    result = adapted(where, True, ik)
    measured = validate(result.source, result.motion, result.contacts)
    assert missed(measured) == []
    assert measured.metrics["stance_drift_mm"] <= 1.0
    assert measured.metrics["sole_penetration_mm"] <= 5.0
    assert measured.metrics["joint_limit_rad"] <= 1e-4


@pytest.mark.parametrize("where", ["stairs", "blocks", "terrain_doors"])
def test_figures_hold_on_steps_and_through_doors(where: str) -> None:
    result = adapted(where, True)
    measured = validate(result.source, result.motion, result.contacts)
    assert missed(measured) == [] and result.unmet == ()


def test_joints_change_less() -> None:
    """The whole adaptation, without the root, whose way is the ground's."""
    weights = default_rigidity(humanoid())
    weights[:6] = 0.0
    fixed, free = (adapted("terrain", one) for one in (False, True))
    cost = [
        deviation(Motion(humanoid(), one.motion.qpos, 30.0), clip_on(one), weights)
        for one in (fixed, free)
    ]
    assert cost[1] < cost[0]


def clip_on(result: Result) -> Motion:
    return Motion(humanoid(), result.source.qpos, result.source.fps)


def test_other_rates() -> None:
    result = adapted("incline", True, "hybrid", "fast")
    measured = validate(result.source, result.motion, result.contacts)
    assert result.motion.fps == 60.0 and measured.metrics["stance_drift_mm"] <= 1.0
    assert measured.metrics["sole_penetration_mm"] <= 5.0 and result.unmet == ()


def test_a_character_without_feet() -> None:
    character = Character.load(mujoco.MjSpec.from_string(MIXED))
    qpos = np.tile(character.model.qpos0, (20, 1))
    with pytest.raises(MotionError, match="heel"):
        adapt(Motion(character, qpos, 30.0), scene("level"), free_footholds=True)


def test_free_targets_out_of_reach_move_as_a_whole() -> None:
    """A rail 4 m behind that the hand may be anywhere along: it is held in one place, in reach."""
    motion, held = clip("made up"), np.arange(40, 52)
    rail = SiteConstraint("right_hand", held, np.array((-4.0, -0.35, 0.9)), free=("x",))
    result = adapt(motion, scene("level"), constraints=[rail])
    model = result.motion.model
    hand = loop_sites(model, result.motion.qpos)[held, model.site("right_hand").id]
    assert result.unmet == () and np.ptp(hand, axis=0).max() < 1e-4
    np.testing.assert_allclose(hand[:, 1:], np.tile((-0.35, 0.9), (len(held), 1)), atol=1e-4)
    body = result.motion.qpos[held, 0]
    assert np.abs(hand[:, 0] - body).max() < 0.8


def test_what_a_free_target_cannot_do_is_measured_from_where_it_was_asked() -> None:
    """Free along x, but a metre out to the side: what is missing is told, by frame; feet stay."""
    motion, held = clip("made up"), np.arange(40, 52)
    wide = SiteConstraint("right_hand", held, np.array((1.0, -2.0, 1.0)), free=("x",))
    result = adapt(motion, scene("level"), constraints=[wide], ik="numeric")
    (missed,) = [one for one in result.unmet if "hand" in one.constraint]
    assert missed.constraint == "position of right_hand" and missed.frames == tuple(held)
    hand = loop_sites(result.motion.model, result.motion.qpos)
    hand = hand[held, result.motion.model.site("right_hand").id]
    off = 1000.0 * np.linalg.norm(hand[:, 1:] - (-2.0, 1.0), axis=1)
    assert off.min() > 500.0 and missed.residual_mm >= off.max() - 1e-6


def test_unknown_sites_are_named() -> None:
    wish = SiteConstraint("right_hnd", np.arange(3), np.array((0, 0, 1)), free=("x",))
    with pytest.raises(ModelError, match="Did you mean 'right_hand'"):
        adapt(clip("made up"), scene("level"), constraints=[wish])


# The command line


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("clip") / "short.npz"
    whole = load_clip("walk")
    whole.replace(whole.qpos[:FRAMES]).save(path)
    return path


def written(folder: Path, text: str) -> Path:
    path = folder / "constraints.yaml"
    path.write_text(text, "utf-8")
    return path


def test_free_footholds_on_the_command_line(short: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    # The clip ends in the middle of a step: nothing holds its last foothold back.
    path = ("--threshold", "root_travel_ratio=0.9,1.1")
    done = run(
        "adapt", short, "--scene", "stairs", "--free-footholds", "--out", out, "--no-video", *path
    )
    assert done.returncode == 0, done.stderr
    report = json.loads((out / "report.json").read_text("utf-8"))
    assert report["metrics"]["stance_drift_mm"] <= 1.0 and not report["unmet"]
    free = np.load(out / "motion.npz")["qpos"]
    fixed = adapt(Motion.load(short, character()), scene("stairs"), tolerance=1e-4)
    assert np.abs(free[:, :3] - fixed.motion.qpos[:, :3]).max() > 1e-3


GOOD = """
- {site: left_hand, frames: [20, 40], to: pelvis, position: [0.02, 0.26, 0.03]}
- {site: face, frames: [10, 60], look_at: [4, 2, 1.5]}
- {site: right_hand, frames: [50, 60], position: [0.9, -0.35, 0.9], free: [x, y, z, yaw]}
"""


def test_every_kind_of_constraint_on_the_command_line(short: Path, tmp_path: Path) -> None:
    wishes, out = written(tmp_path, GOOD), tmp_path / "out"
    done = run(
        "adapt", short, "--scene", "flat", "--constraints", wishes, "--out", out, "--no-video"
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    report = json.loads((out / "report.json").read_text("utf-8"))
    assert not report["unmet"]


NOT_MET = """
- {site: left_hand, frames: [20, 30], to: pelvis, position: [3, 0, 0]}
- {site: left_foot, frames: [20, 30], look_at: [1, 50, 0]}
"""
NOT_IN_ONE_PIECE = """
- {site: right_hand, frames: [50, 60], position: [0.9, -0.35, 3.5], free: [x]}
"""


def test_what_is_not_met_is_exit_1_with_frames_and_residuals(short: Path, tmp_path: Path) -> None:
    wishes, out = written(tmp_path, NOT_MET), tmp_path / "out"
    done = run(
        "adapt", short, "--scene", "flat", "--constraints", wishes, "--out", out, "--no-video"
    )
    assert done.returncode == 1 and "Traceback" not in done.stderr
    frames = "20, 21, 22, 23, 24, … (10 frames)"
    for name, unit in (
        ("position of left_hand to pelvis", "mm"),
        ("look-at of left_foot", "m"),  # tens of metres: no one wants those in millimetres
    ):
        line = next(x for x in done.stderr.splitlines() if f"not met: {name} at" in x)
        assert "your constraint" in line and frames in line
        assert re.search(rf"off by \d+\.\d {unit}$", line)
    report = json.loads((out / "report.json").read_text("utf-8"))
    own = {one["constraint"] for one in report["unmet"] if one["source"] == "user"}
    assert own == {"position of left_hand to pelvis", "look-at of left_foot"}


def test_what_cannot_be_held_in_one_piece_is_exit_2(short: Path, tmp_path: Path) -> None:
    wishes, out = written(tmp_path, NOT_IN_ONE_PIECE), tmp_path / "out"
    done = run(
        "adapt", short, "--scene", "flat", "--constraints", wishes, "--out", out, "--no-video"
    )
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert "'right_hand' is free in x" in done.stderr
    assert "50, 51, 52, 53, 54, … (10 frames)" in done.stderr and " mm" in done.stderr
    assert not out.exists()


BAD = {
    "free word": (
        "- {site: left_hand, frames: 3, position: [0, 0, 1], free: [w]}",
        "entry 0.*none of x, y, z, yaw",
    ),
    "to nothing": (
        "- {site: left_hand, frames: 3, to: pelviss, position: [0, 0, 1]}",
        "entry 0.*Did you mean 'pelvis'",
    ),
    "no point": ("- {site: face, frames: 3, look_at: [1, 2]}", "entry 0.*3 numbers"),
    "late frames": ("- {site: face, frames: [80, 95], look_at: [1, 2, 3]}", "0 to 90"),
    "one body": (
        "- {site: left_heel, frames: 3, to: left_toe, position: [0, 0, 1]}",
        "on one body",
    ),
}


@pytest.mark.parametrize("case", sorted(BAD))
def test_bad_constraints_are_one_line_and_exit_2(case: str, short: Path, tmp_path: Path) -> None:
    text, message = BAD[case]
    wishes, out = written(tmp_path, text), tmp_path / "out"
    done = run(
        "adapt", short, "--scene", "flat", "--constraints", wishes, "--out", out, "--no-video"
    )
    assert done.returncode == 2 and not out.exists()
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("mjmotion")
    assert re.search(message, lines[0]), lines[0]
