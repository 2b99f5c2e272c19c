"""One frame edited: what changes, what does not, what stays on the ground, and how far it goes."""

from __future__ import annotations

import functools
import subprocess
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import command_line
import mujoco
import numpy as np
import pytest
from made_up import MIXED, NOT_BESIDE_SOURCE, humanoid, loop_quats, loop_sites, mixed, some, walk

from mjmotion.apps.edit import HOLDS, Hold, Span, deformation, edit_frame
from mjmotion.apps.edit.ranges import write_ranges
from mjmotion.body.motion import Motion
from mjmotion.exceptions import ConstraintError, ContactError, FitError, ModelError
from mjmotion.footsteps.contacts import Contact, detect_contacts
from mjmotion.numerics.bspline import basis
from mjmotion.output.reading import read_results
from mjmotion.output.result import Result

FRAME = 45
SINK = (0.0, 0.0, -0.15)
FEET = ("left_heel", "left_toe", "right_heel", "right_toe")


@functools.cache
def the_walk() -> Motion:
    return walk()


@pytest.fixture(scope="module")
def clip() -> Motion:
    return the_walk()


def halved(first: float, count: int = 4) -> tuple[float, ...]:
    """So many levels, each with knots half as far apart, none below a frame a knot."""
    levels = (first / 2**level for level in range(count))
    return tuple(frames_per_knot for frames_per_knot in levels if frames_per_knot >= 1.0)


@functools.cache
def pelvis_sunk(first: int, count: int = 4) -> Result:
    return edit_frame(the_walk(), FRAME, "pelvis", by=SINK, levels=halved(first, count))


@pytest.fixture(scope="module")
def sunk(clip: Motion) -> Result:
    return pelvis_sunk(12)


def changed(edited: Result) -> list[int]:
    """Frames that are not the source's to the bit."""
    before, after = edited.source.qpos, edited.motion.qpos
    return np.flatnonzero((before.view(np.int64) != after.view(np.int64)).any(axis=1)).tolist()


def site(motion: Motion, name: str) -> np.ndarray:
    return loop_sites(motion.model, motion.qpos)[:, motion.model.site(name).id]


# The range


@pytest.mark.parametrize("first", [4, 6, 12])
def test_exactly_the_frames_within_seven_knots_change(clip: Motion, first: int) -> None:
    edited = pelvis_sunk(first)
    knots = Span(FRAME, first, clip.nframe).knots
    assert len(knots) == 7 and knots[3] == FRAME
    # The outermost knots are where the change begins and ends: they stay themselves.
    assert changed(edited) == list(range(knots[0] + 1, knots[-1]))
    assert (edited.source.qpos == clip.qpos).all()


def test_the_range_grows_with_the_knots_and_not_with_the_levels() -> None:
    lengths = [len(changed(pelvis_sunk(first, count))) for first in (4, 6, 12) for count in (1, 4)]
    assert lengths == [23, 23, 35, 35, 71, 71]


def test_default_levels_are_twelve_frames_a_knot_and_halves(clip: Motion, sunk: Result) -> None:
    again = edit_frame(clip, FRAME, "pelvis", by=SINK)
    np.testing.assert_array_equal(again.motion.qpos, sunk.motion.qpos)


@pytest.mark.parametrize("hold", HOLDS)
def test_the_range_is_the_same_whatever_is_held(clip: Motion, hold: Hold) -> None:
    edited = edit_frame(clip, FRAME, "pelvis", by=SINK, levels=halved(6), hold=hold)
    assert changed(edited) == list(range(FRAME - 17, FRAME + 18))


@pytest.mark.parametrize("frame", [0, 3, 88, 90])
def test_near_an_end_the_clip_cuts_the_range(clip: Motion, frame: int) -> None:
    edited = edit_frame(clip, frame, "pelvis", by=(0.0, 0.0, -0.05), levels=halved(4))
    assert changed(edited) == list(range(max(0, frame - 11), min(clip.nframe, frame + 12)))
    assert np.linalg.norm(site(edited.motion, "pelvis")[frame] - site(clip, "pelvis")[frame]) > 0.04


def test_the_root_follows_the_spline_of_one_data_point(sunk: Result) -> None:
    """The root goes where level one takes it: 1/3, 4/3, 1/3 of the change at three knots."""
    sink = sunk.motion.qpos[:, 2] - sunk.source.qpos[:, 2]
    away = np.abs(np.arange(sunk.source.nframe) - FRAME) / 12.0
    bump = np.zeros(len(sink))
    for knot, share in ((-1, 1 / 3), (0, 4 / 3), (1, 1 / 3)):
        distance = np.abs((np.arange(len(sink)) - FRAME) / 12.0 - knot)
        whole = np.floor(distance).astype(int)
        pieces = basis(distance - whole)
        bump += share * np.where(whole == 0, pieces[:, 1], np.where(whole == 1, pieces[:, 0], 0.0))
    assert bump[FRAME] == pytest.approx(1.0)
    assert (bump[away >= 3.0] == 0.0).all()
    np.testing.assert_allclose(sink, -0.15 * bump, atol=2e-3)


def test_deformation_is_largest_at_the_frame_and_fades(sunk: Result) -> None:
    size = deformation(sunk)
    assert abs(int(size.argmax()) - FRAME) < 12 and size[FRAME] > 0.15 - 1e-6
    assert (size[[FRAME - 36, FRAME + 36]] == 0.0).all()
    assert size[[FRAME - 30, FRAME + 30]].max() < 0.03


# The pose


def test_the_pelvis_sinks_over_knees_that_bend_and_feet_that_stay(sunk: Result) -> None:
    before, after = sunk.source, sunk.motion
    np.testing.assert_allclose(
        site(after, "pelvis")[FRAME] - site(before, "pelvis")[FRAME], SINK, atol=1e-6
    )
    stands = [c.site for c in sunk.contacts if c.start <= FRAME < c.end]
    assert stands
    for name in stands:
        assert np.linalg.norm(site(after, name)[FRAME] - site(before, name)[FRAME]) < 1e-6
        knee = after.model.joint(f"{name.split('_')[0]}_knee").qposadr[0]
        assert after.qpos[FRAME, knee] > before.qpos[FRAME, knee] + 0.3
    assert not sunk.unmet
    assert after.character.limits.excess(after.qpos).max() < 1e-9


def test_nothing_that_stands_slides_anywhere_in_the_range(sunk: Result) -> None:
    checked = 0
    for contact in sunk.contacts:
        frames = slice(contact.start, contact.end)
        gap = site(sunk.motion, contact.site)[frames] - site(sunk.source, contact.site)[frames]
        # A heel that rises less than half a millimetre with its ankle still stands.
        most = 5e-4 if contact.site.endswith("heel") else 1e-6
        assert np.linalg.norm(gap, axis=1).max() < most, contact
        checked += contact.start < FRAME + 36 and contact.end > FRAME - 36
    assert checked >= 8


def test_feet_in_the_air_keep_their_way_too(sunk: Result) -> None:
    for name in ("left_foot", "right_foot"):
        lower = site(sunk.motion, name)[:, 2] - site(sunk.source, name)[:, 2]
        assert lower.min() > -1e-6, name


def test_free_feet_slide_and_that_is_what_holding_is_for(clip: Motion) -> None:
    free = edit_frame(clip, FRAME, "pelvis", by=SINK, hold="frame")
    slid = max(
        np.linalg.norm(site(free.motion, name) - site(free.source, name), axis=1).max()
        for name in FEET
    )
    assert slid > 0.02


def test_contacts_hold_what_stands_and_let_the_other_foot_sink(clip: Motion) -> None:
    edited = edit_frame(clip, FRAME, "pelvis", by=SINK, hold="contacts")
    for contact in edited.contacts:
        frames = slice(contact.start, contact.end)
        gap = site(edited.motion, contact.site)[frames] - site(edited.source, contact.site)[frames]
        assert np.linalg.norm(gap, axis=1).max() < 5e-4, contact
    lower = [
        (site(edited.motion, name) - site(edited.source, name))[:, 2].min()
        for name in ("left_foot", "right_foot")
    ]
    assert min(lower) < -0.02


def test_two_sites_at_once_bend_the_body_forward(clip: Motion) -> None:
    by = np.array([SINK, (0.32, 0.0, -0.29)])
    edited = edit_frame(clip, FRAME, ["pelvis", "head_top"], by=by, levels=halved(6))
    for name, wanted in zip(("pelvis", "head_top"), by, strict=True):
        gap = site(edited.motion, name)[FRAME] - site(edited.source, name)[FRAME]
        np.testing.assert_allclose(gap, wanted, atol=1e-6)
    there = site(clip, "pelvis")[FRAME] + SINK
    again = edit_frame(clip, FRAME, "pelvis", to=there, levels=halved(6))
    np.testing.assert_allclose(site(again.motion, "pelvis")[FRAME], there, atol=1e-6)


def test_a_lifted_foot_no_longer_stands_and_stands_again_later(clip: Motion) -> None:
    frame = 30
    stands = {c.site: c for c in detect_contacts(clip) if c.start <= frame < c.end}
    side = next(iter(stands)).split("_")[0]
    edited = edit_frame(clip, frame, f"{side}_foot", by=(0.0, 0.0, 0.1), levels=halved(4))
    np.testing.assert_allclose(
        site(edited.motion, f"{side}_foot")[frame],
        site(clip, f"{side}_foot")[frame] + (0, 0, 0.1),
        atol=1e-5,
    )
    assert not [c for c in edited.contacts if c.site.startswith(side) and c.start <= frame < c.end]
    assert any(c.site.startswith(side) and c.start > frame for c in edited.contacts)


@pytest.mark.parametrize("by", [(0.0, 0.0, 0.5), (0.0, 0.0, -0.9)])
def test_a_drag_out_of_reach_goes_as_far_as_the_feet_let_it(clip: Motion, by: tuple) -> None:
    edited = edit_frame(clip, FRAME, "pelvis", by=by, levels=halved(6))
    moved = site(edited.motion, "pelvis")[FRAME] - site(edited.source, "pelvis")[FRAME]
    assert 0.0 < moved @ by / (np.linalg.norm(by) ** 2) < 0.9
    (missed,) = [one for one in edited.unmet if one.constraint == "position of pelvis"]
    assert missed.frames == (FRAME,)
    assert missed.residual_mm == pytest.approx(1000 * np.linalg.norm(by - moved), rel=1e-3)
    for contact in edited.contacts:
        if contact.start <= FRAME < contact.end:
            gap = site(edited.motion, contact.site) - site(edited.source, contact.site)
            assert np.linalg.norm(gap[FRAME]) < 2e-3, contact
    assert edited.motion.character.limits.excess(edited.motion.qpos).max() < 1e-9


def test_levels_refine(clip: Motion) -> None:
    """Where feet are held while they stand alone; closing those held throughout needs no spline."""
    edited = edit_frame(clip, FRAME, "pelvis", by=SINK, levels=halved(12), hold="contacts")
    trace = some(edited.trace)
    errors = [level.max_error_percent for level in trace.levels]
    assert [level.frames_per_knot for level in trace.levels][:4] == [12.0, 6.0, 3.0, 1.5]
    assert errors[3] < errors[2] < errors[1] < errors[0]
    assert trace.first_error_percent == pytest.approx(100 * 0.15 / 1.75, rel=0.02)
    assert trace.exact_error_percent < 0.01  # a tenth of a millimetre is what counts as met


def test_jerk_stays_as_it_was(sunk: Result) -> None:
    from mjmotion.validation.figures import joint_jerk

    rms = [np.sqrt(np.mean(joint_jerk(m) ** 2)) for m in (sunk.source, sunk.motion)]
    assert rms[1] < 1.1 * rms[0]


def test_the_argument_stays(clip: Motion) -> None:
    before = clip.qpos.copy()
    edit_frame(clip, FRAME, "left_hand", by=(0.1, 0.0, 0.2), levels=halved(4))
    assert (clip.qpos == before).all()


def test_any_tree_with_a_free_root_can_be_edited(tmp_path: Path) -> None:
    path = tmp_path / "mixed.xml"
    path.write_text(MIXED, "utf-8")
    motion = Motion(path, np.tile(mixed().qpos0, (40, 1)), 30.0)
    held = (Contact("tip", 0, 40),)
    edited = edit_frame(motion, 20, "other", by=(0.02, 0.0, 0.03), levels=halved(4), contacts=held)
    assert changed(edited) == list(range(9, 32))
    gap = site(edited.motion, "other")[20] - site(motion, "other")[20]
    np.testing.assert_allclose(gap, (0.02, 0.0, 0.03), atol=1e-4)
    assert np.linalg.norm(site(edited.motion, "tip") - site(motion, "tip"), axis=1).max() < 1e-3
    turned = loop_quats(edited.motion.model, edited.motion.qpos, "tip")
    assert np.isfinite(turned).all()


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"frame": 91}, FitError, "0 to 90"),
        ({"frame": -1}, FitError, "0 to 90"),
        ({"levels": (0,)}, FitError, r"levels \[0.0\] must be positive"),
        ({"levels": (2.5, 1.0)}, FitError, r"\[2.5, 1.0\] .* begin with a whole number"),
        ({"levels": (4, 0.5)}, FitError, "none may be below 1"),
        ({"levels": (4, 8)}, FitError, "coarse to fine"),
        ({"levels": ()}, FitError, "levels is empty"),
        ({"levels": 4}, FitError, "levels 4 must be frames a knot of each level"),
        ({"hold": "fest"}, FitError, "feet"),
        ({"site": "plevis"}, ModelError, "pelvis"),
        ({"site": []}, ConstraintError, "none"),
        ({"site": ["pelvis", "pelvis"]}, ConstraintError, "different"),
        ({"by": None}, ConstraintError, "either"),
        ({"to": (0.0, 0.0, 1.0)}, ConstraintError, "either"),
        ({"by": (0.0, 1.0)}, ConstraintError, "3 numbers"),
        ({"by": (0.0, 0.0, float("nan"))}, ConstraintError, "finite"),
        ({"contacts": [Contact("left_heel", 0, 999)]}, ContactError, "999"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_bad_edits(clip: Motion, change: dict, error: type[Exception], words: str) -> None:
    settings = {"frame": FRAME, "site": "pelvis", "by": SINK, **change}
    frame, name = settings.pop("frame"), settings.pop("site")
    with pytest.raises(error, match=words):
        edit_frame(clip, frame, name, **settings)


# The plot and the command


def test_the_plot_shows_every_first_level(tmp_path: Path) -> None:
    edits = {first: pelvis_sunk(first) for first in (4, 12)}
    path = write_ranges(tmp_path / "edit.svg", edits, FRAME)
    text = path.read_text("utf-8")
    assert text.lstrip().startswith("<?xml") and text.count('id="axes_') == 2


def run(*words: object) -> subprocess.CompletedProcess[str]:
    return command_line.run("edit-frame", *words)


@pytest.fixture(scope="module")
def file(clip: Motion, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("clip") / "walk.npz"
    clip.save(path)
    return path


def test_the_command_writes_a_result_with_a_plot(file: Path, tmp_path: Path) -> None:
    words = ("--frame", FRAME, "--site", "pelvis", "--by", 0, 0, -0.1, "--levels", "6,3,1.5")
    # An edit is a change of posture: further back than the clip is what it may be asked for.
    aside = ("--no-video", *NOT_BESIDE_SOURCE)
    done = run(file, *words, "--out", tmp_path / "out", *aside)
    assert done.returncode == 0, done.stderr
    assert f"35 frames change, {FRAME - 17} to {FRAME + 17}" in done.stdout
    results = read_results(tmp_path / "out")
    assert (tmp_path / "out" / "edit.png").stat().st_size > 10_000
    moved = np.flatnonzero((results.motion.qpos != results.source.qpos).any(axis=1))
    assert (moved[0], moved[-1]) == (FRAME - 17, FRAME + 17)
    # A result can be edited again: it brings its own model and contacts.
    hand = ("--site", "left_hand", "--by", 0, 0.1, 0.1)
    pelvis = ("--site", "pelvis", "--by", 0, 0, -0.05)
    again = ("--frame", 20, *hand, *pelvis, "--levels", "12,6,3,1.5")
    done = run(tmp_path / "out", *again, "--out", tmp_path / "again", *aside)
    assert done.returncode == 0, done.stderr
    second = read_results(tmp_path / "again")
    assert (second.source.qpos == results.motion.qpos).all()
    assert second.model.ngeom == results.model.ngeom


def measured(*figures: tuple[float, float]) -> Callable[..., Any]:
    """A stand-in for validate: drift and swing clearance of the source, then of what is edited."""
    names, turn = ("stance_drift_mm", "swing_clearance_mm"), iter(figures)

    def validate(*_: object, **__: object) -> Any:
        values = dict(zip(names, next(turn), strict=True))
        broken = [names[0]] * (values[names[0]] > 1.0) + [names[1]] * (values[names[1]] < 10.0)
        return SimpleNamespace(metrics=values, broken=lambda: broken)

    return validate


@pytest.mark.parametrize(
    ("before", "after", "given", "off"),
    [
        ((7.0, 20.0), (7.0, 20.0), [], {"stance_drift_mm"}),
        ((7.0, 20.0), (7.1, 20.0), [], set()),  # the edit made it worse: judged, and broken
        ((7.0, 20.0), (7.0, 20.0), ["stance_drift_mm=2"], set()),  # the user's word holds
        ((0.5, 4.0), (0.5, 4.0), [], {"swing_clearance_mm"}),
        ((0.5, 4.0), (0.5, 3.0), [], set()),
        ((0.5, 20.0), (7.0, 20.0), [], set()),
    ],
)
def test_only_what_the_clip_breaks_by_itself_is_not_judged(
    before: tuple[float, float],
    after: tuple[float, float],
    given: list[str],
    off: set[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from mjmotion import validation
    from mjmotion.cli import edit_frame as command

    monkeypatch.setattr(validation, "validate", measured(before, after))
    edited: Any = SimpleNamespace(source=None, motion=None, contacts=())
    left = command._not_the_edit_s(edited, validation.THRESHOLDS, given)
    assert set(left) == off and all(value is None for value in left.values())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--site", "pelvis", "--by", 0, 0, -0.1, "--frame", 400), "0 to 90"),
        (("--site", "plevis", "--by", 0, 0, -0.1, "--frame", 4), "pelvis"),
        (("--site", "pelvis", "--frame", 4), "--by"),
        (
            ("--site", "pelvis", "--by", 0, 0, 1, "--to", 0, 0, 1, "--frame", 4),
            "--site is given 1 times, --by or --to 2",
        ),
        (("--site", "pelvis", "--by", 0, 0, "x", "--frame", 4), "'x'"),
        (("--site", "pelvis", "--by", 0, 0, 1, "--frame", -4), "-4"),
        (("--site", "pelvis", "--by", 0, 0, 1, "--frame", 4, "--levels", 0), "'0'"),
    ],
)
def test_bad_words(file: Path, tmp_path: Path, words: tuple, said: str) -> None:
    done = run(file, *words, "--out", tmp_path / "deep" / "out", "--no-video")
    assert done.returncode == 2, done.stderr
    assert len(done.stderr.splitlines()) == 1 and said in done.stderr, done.stderr
    assert not list(tmp_path.iterdir())


def test_the_humanoid_has_what_is_dragged() -> None:
    names = {humanoid().site(i).name for i in range(humanoid().nsite)}
    sides = {f"{side}_{part}" for side in ("left", "right") for part in ("hand", "elbow", "knee")}
    assert {"pelvis", "head_top", "right_foot"} | sides <= names


def swivelled(motion: Motion, name: str, chain: tuple[str, str], angle: float) -> np.ndarray:
    """Where a limb's elbow or knee is when it is turned about the line through its ends (3,)."""
    data = mujoco.MjData(motion.model)
    data.qpos[:] = motion.qpos[FRAME]
    mujoco.mj_kinematics(motion.model, data)
    first, last = (data.body(body).xpos for body in chain)
    middle = data.site(name).xpos
    axis = (last - first) / np.linalg.norm(last - first)
    arm = middle - first
    turned = arm * np.cos(angle) + np.cross(axis, arm) * np.sin(angle)
    return np.asarray(first + turned + axis * (axis @ arm) * (1.0 - np.cos(angle)))


@pytest.mark.parametrize(
    ("name", "chain"),
    [
        ("left_elbow", ("left_upper_arm", "left_hand")),
        ("right_knee", ("right_thigh", "right_foot")),
    ],
)
def test_an_elbow_and_a_knee_go_where_they_are_dragged(
    clip: Motion, name: str, chain: tuple[str, str]
) -> None:
    to = swivelled(clip, name, chain, 0.6)
    assert np.linalg.norm(to - site(clip, name)[FRAME]) > 0.02
    edited = edit_frame(clip, FRAME, name, to=to)
    np.testing.assert_allclose(site(edited.motion, name)[FRAME], to, atol=1e-3)
    for contact in edited.contacts:
        slip = site(edited.motion, contact.site) - site(edited.source, contact.site)
        frames = slice(contact.start, contact.end)
        assert np.linalg.norm(slip[frames], axis=1).max() < 1e-3, contact
    assert edited.motion.character.limits.excess(edited.motion.qpos).max() < 1e-9
