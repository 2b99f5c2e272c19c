"""Constraints, measured: met, missed by a known amount, overridden, mild, free; and whose."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np
import pytest
from made_up import character, loop_sites, of_site, pin, some, walk

from mjmotion.apps.adaptation import adapt
from mjmotion.body.bones import Bones
from mjmotion.body.motion import Motion
from mjmotion.constraints import Constraint, LookAt, RelativeConstraint, SiteConstraint, lay_out
from mjmotion.constraints.shared_targets import with_moves
from mjmotion.constraints.unmet import (
    UNMET,
    UNTURNED,
    Unmet,
    check_free,
    find_unmet,
    relational_residuals,
    residuals,
)
from mjmotion.exceptions import ConstraintError
from mjmotion.fitting import fit
from mjmotion.numerics.rotations import exp, normalized

AXIS = np.array((0.6, 0.0, 0.8))


@pytest.fixture(scope="module")
def motion() -> Motion:
    """At rest: hands, feet and pelvis are all level, x forward."""
    return Motion(character(), np.tile(character().model.qpos0, (20, 1)), 30.0)


def place(motion: Motion, site: str) -> np.ndarray:
    return loop_sites(motion.model, motion.qpos[:1])[0, motion.model.site(site).id]


def wish(motion: Motion, frames: range, shift: float = 0.0, **more: Any) -> SiteConstraint:
    """The left hand, ``shift`` [m] in front of where it is."""
    spot = place(motion, "left_hand") + (shift, 0.0, 0.0)
    return SiteConstraint("left_hand", np.array(frames), spot, **more)


def unmet(motion: Motion, *constraints: Constraint, **more: Any) -> tuple[Unmet, ...]:
    targets = lay_out(constraints, motion.model, motion.nframe)
    return find_unmet(motion, targets, constraints, **more)


def told(found: tuple[Unmet, ...]) -> list[tuple[str, str, int]]:
    return [(one.constraint, one.source, one.index) for one in found]


# Places


def test_what_is_met_is_not_named(motion: Motion) -> None:
    level = wish(motion, range(3, 9), quat=[1, 0, 0, 0])
    assert unmet(motion, level) == () and unmet(motion) == ()


def test_a_position_missed_is_named_with_frames_and_residual(motion: Motion) -> None:
    (missed,) = unmet(motion, wish(motion, range(3, 6), 0.012))
    assert (missed.constraint, missed.frames) == ("position of left_hand", (3, 4, 5))
    assert (missed.index, missed.source) == (0, "user")
    assert missed.residual_mm == pytest.approx(12.0) and missed.residual_deg is None
    assert str(missed) == "position of left_hand at frames 3, 4, 5, off by 12.0 mm"
    assert json.loads(json.dumps(missed.as_dict())) == {
        "constraint": "position of left_hand",
        "frames": [3, 4, 5],
        "residual_mm": missed.residual_mm,
        "residual_deg": None,
        "index": 0,
        "source": "user",
    }


def test_the_worst_of_the_frames_that_are_off(motion: Motion) -> None:
    shift = np.array((0.0, 0.9, 1.1, 30.0, 2.0))[:, None] * (1e-3, 0.0, 0.0)
    held = SiteConstraint("left_hand", np.arange(5, 10), place(motion, "left_hand") + shift)
    (missed,) = unmet(motion, held)
    assert missed.frames == (7, 8, 9) and missed.residual_mm == pytest.approx(30.0)
    (missed,) = unmet(motion, held, tolerance=0.0015)
    assert missed.frames == (8, 9)
    assert unmet(motion, held, tolerance=0.031) == () and UNMET == 1e-3


def test_residuals_are_those_of_each_frame_and_site(motion: Motion) -> None:
    far = dataclasses.replace(wish(motion, range(3, 6), 0.012), weight=0.5)
    hold = pin(motion.model, motion.qpos, "left_foot")
    targets = lay_out([far, hold], motion.model, motion.nframe)
    gap = np.zeros((20, 2))
    gap[3:6, 0] = 0.012
    np.testing.assert_allclose(residuals(motion, targets), gap, atol=1e-12)
    none = lay_out([], motion.model, motion.nframe)
    assert residuals(motion, none).shape == (0, 0)
    assert relational_residuals(motion, targets).shape == (20, 0)


# Orientations


@pytest.mark.parametrize("degrees", [0.4, 0.6, 1.0, 30.0, 90.0, 179.0])
def test_an_orientation_missed_is_named_in_degrees(motion: Motion, degrees: float) -> None:
    half = np.radians(degrees) / 2
    quat = normalized(np.array([np.cos(half), *(np.sin(half) * AXIS)]))
    found = unmet(motion, SiteConstraint("left_hand", np.array([7]), None, quat))
    if degrees < np.degrees(UNTURNED):
        assert found == ()
        return
    (missed,) = found
    assert (missed.constraint, missed.frames) == ("orientation of left_hand", (7,))
    assert missed.residual_mm is None and (missed.index, missed.source) == (0, "user")
    assert missed.residual_deg == pytest.approx(degrees, abs=1e-6)
    assert str(missed) == f"orientation of left_hand at frames 7, off by {degrees:.1f} degrees"


def test_both_of_one_constraint_are_told_apart(motion: Motion) -> None:
    both = wish(motion, range(3, 6), 0.02, quat=exp(0.3 * AXIS))
    place_off, turn_off = unmet(motion, wish(motion, range(12, 14)), both)
    assert (place_off.constraint, turn_off.constraint) == (
        "position of left_hand",
        "orientation of left_hand",
    )
    assert place_off.index == turn_off.index == 1
    assert place_off.residual_mm == pytest.approx(20.0)
    assert turn_off.residual_deg == pytest.approx(np.degrees(0.3), abs=1e-6)


@pytest.mark.parametrize("degrees", [0.2, 5.0, 120.0])
def test_turns_to_another_site_are_measured(motion: Motion, degrees: float) -> None:
    frames, turned = np.arange(2, 4), exp(np.radians(degrees) * AXIS)
    found = unmet(motion, RelativeConstraint("left_hand", frames, "pelvis", None, turned))
    if degrees < 0.5:
        assert found == ()
        return
    (one,) = found
    assert (one.constraint, one.frames) == ("orientation of left_hand to pelvis", (2, 3))
    assert one.residual_mm is None and (one.index, one.source) == (0, "user")
    assert one.residual_deg == pytest.approx(degrees, abs=1e-6)
    mild = RelativeConstraint("left_hand", frames, "pelvis", None, turned, weight=0.5)
    assert unmet(motion, mild) == ()


# Other kinds


def test_a_relative_place_is_measured_in_the_other_s_frame(motion: Motion) -> None:
    away = place(motion, "left_hand") - place(motion, "pelvis")
    frames, step = np.arange(2, 6), np.array((0.0, 0.03, 0.04))
    assert unmet(motion, RelativeConstraint("left_hand", frames, "pelvis", away)) == ()
    off = RelativeConstraint("left_hand", frames, "pelvis", away + step)
    (one,) = unmet(motion, off)
    assert (one.constraint, one.frames) == ("position of left_hand to pelvis", (2, 3, 4, 5))
    assert one.residual_mm == pytest.approx(50.0) and one.residual_deg is None
    both = dataclasses.replace(off, quat=exp(0.2 * AXIS))
    assert [found.constraint for found in unmet(motion, both)] == [
        "position of left_hand to pelvis",
        "orientation of left_hand to pelvis",
    ]
    targets = lay_out([off], motion.model, motion.nframe)
    np.testing.assert_allclose(relational_residuals(motion, targets), np.full((4, 1), 0.05))


@pytest.mark.parametrize("ahead", [4.0, -4.0])
def test_a_look_at_is_off_by_how_far_its_line_passes_from_the_point(
    motion: Motion, ahead: float
) -> None:
    """A point behind is as far as it is away: a line is drawn out forwards only."""
    frames, face = np.arange(2, 6), place(motion, "face")
    assert unmet(motion, LookAt("face", frames, face + (4.0, 0.0, 0.0))) == ()
    (one,) = unmet(motion, LookAt("face", frames, face + (ahead, 0.3, 0.4)))
    assert (one.constraint, one.frames) == ("look-at of face", (2, 3, 4, 5))
    wanted = 500.0 if ahead > 0.0 else 1000.0 * np.sqrt(4.0**2 + 0.5**2)
    assert one.residual_mm == pytest.approx(wanted) and one.residual_deg is None
    assert (one.index, one.source) == (0, "user")


def kinds(motion: Motion, frames: range, shift: float, **more: Any) -> list[Constraint]:
    """One of each kind, its place or point to one side by ``shift`` [m]."""
    at, step = np.array(frames), (0.0, shift, 0.0)
    away = place(motion, "right_hand") - place(motion, "pelvis")
    return [
        SiteConstraint("left_hand", at, place(motion, "left_hand") + step, **more),
        SiteConstraint("head_top", at, None, exp(np.array((0.0, shift, 0.0))), **more),
        RelativeConstraint("right_hand", at, "pelvis", away + step, **more),
        RelativeConstraint(
            "head_top", at, "pelvis", None, exp(np.array((shift, 0.0, 0.0))), **more
        ),
        LookAt("face", at, place(motion, "face") + (4.0, shift, 0.0), **more),
    ]


LABELS = [
    "position of left_hand",
    "orientation of head_top",
    "position of right_hand to pelvis",
    "orientation of head_top to pelvis",
    "look-at of face",
]


def test_every_kind_has_its_place_in_the_list(motion: Motion) -> None:
    off, met = kinds(motion, range(3, 6), 0.1), kinds(motion, range(8, 12), 0.0)
    mixed = [one for pair in zip(met, off, strict=True) for one in pair]
    found = unmet(motion, *mixed)
    assert told(found) == [(label, "user", 2 * i + 1) for i, label in enumerate(LABELS)]
    assert all(one.frames == (3, 4, 5) for one in found)


def test_what_may_give_way_is_not_asked_after(motion: Motion) -> None:
    assert unmet(motion, *kinds(motion, range(3, 6), 0.5, weight=0.99)) == ()


def test_the_later_of_two_counts(motion: Motion) -> None:
    """Of every kind: the earlier is asked after where the later says nothing."""
    early, late = kinds(motion, range(3, 9), 0.5), kinds(motion, range(5, 9), 0.0)
    found = unmet(motion, *early, *late)
    assert told(found) == [(label, "user", i) for i, label in enumerate(LABELS)]
    assert all(one.frames == (3, 4) for one in found)
    found = unmet(motion, *late, *early)
    assert told(found) == [(label, "user", 5 + i) for i, label in enumerate(LABELS)]
    assert all(one.frames == tuple(range(3, 9)) for one in found)
    # One that may give way takes the place of an exact one too.
    mild = kinds(motion, range(5, 9), 0.5, weight=0.5)
    assert all(one.frames == (3, 4) for one in unmet(motion, *early, *mild))


def test_two_of_one_site_are_told_one_by_one(motion: Motion) -> None:
    found = unmet(motion, wish(motion, range(9, 12), 0.02), wish(motion, range(3, 5), 0.05))
    assert [(one.index, one.frames) for one in found] == [(0, (9, 10, 11)), (1, (3, 4))]
    assert [some(one.residual_mm) for one in found] == pytest.approx([20.0, 50.0])


# Whose they are


def test_the_scene_s_own_are_told_apart(motion: Motion) -> None:
    """Each is counted among those of its source, and told in the order of all."""
    met, off, more = (
        pin(motion.model, motion.qpos, site, (0.0, 0.0, height), source="scene")
        for site, height in (("left_foot", 0.0), ("right_foot", 0.0025), ("head_top", 0.004))
    )
    constraints = [
        met,
        off,
        wish(motion, range(3, 5), 0.5),
        wish(motion, range(2)),
        more,
        wish(motion, range(7, 9), 0.2),
    ]
    found = unmet(motion, *constraints)
    assert told(found) == [
        ("position of right_foot", "scene", 1),
        ("position of left_hand", "user", 0),
        ("position of head_top", "scene", 2),
        ("position of left_hand", "user", 2),
    ]
    assert [some(one.residual_mm) for one in found] == pytest.approx([2.5, 500.0, 4.0, 200.0])


def test_how_the_scene_s_feet_stand_is_not_asked_after(motion: Motion) -> None:
    """That has figures of its own; the user's foot of the same frames is."""
    frames, turned = np.arange(20), exp(0.3 * AXIS)
    planned = SiteConstraint("left_foot", frames, None, turned, source="scene")
    assert unmet(motion, planned) == ()
    (one,) = unmet(motion, planned, SiteConstraint("left_foot", frames[4:6], None, turned))
    assert told((one,)) == [("orientation of left_foot", "user", 0)] and one.frames == (4, 5)


def test_a_fit_says_whose_it_could_not_meet() -> None:
    """The same index from the fit and from an application that adds its own plan."""
    motion = walk(1.5)
    feet = [
        pin(motion.model, motion.qpos, f"{side}_foot", source="scene") for side in ("left", "right")
    ]
    frames, head = np.arange(20, 25), place(motion, "head_top")
    hand = loop_sites(motion.model, motion.qpos)[2, motion.model.site("right_hand").id]
    near = SiteConstraint("right_hand", np.array([2]), hand)
    far = SiteConstraint("left_hand", frames, head + (0.3, 0.0, 1.2))
    result = fit(motion, [*feet, near, far])
    (one,) = [one for one in result.unmet if one.source == "user"]
    assert told((one,)) == [("position of left_hand", "user", 1)] and one.frames == tuple(frames)
    again = find_unmet(result.motion, result.targets, [*feet, near, far])
    assert again == result.unmet
    adapted = adapt(motion, "flat", constraints=[near, far])
    (one,) = [one for one in adapted.unmet if one.source == "user"]
    assert told((one,)) == [("position of left_hand", "user", 1)] and one.frames == tuple(frames)
    # Against what was asked for, not against what was brought within reach.
    sites = loop_sites(adapted.motion.model, adapted.motion.qpos[frames])
    gap = sites[:, adapted.motion.model.site("left_hand").id] - some(far.position)
    assert one.residual_mm == pytest.approx(1000.0 * np.linalg.norm(gap, axis=1).max(), rel=1e-6)


def test_on_a_body_that_changes_it_is_measured_on_the_body_of_each_frame(motion: Motion) -> None:
    model, held = motion.model, wish(motion, range(3, 6))
    grow = np.ones(20)
    grow[5] = 1.1
    bones = Bones(
        *(grow[:, None, None] * field for field in (model.body_pos, model.jnt_pos, model.site_pos))
    )
    (one,) = unmet(motion, held, bones=bones)
    assert one.frames == (5,) and some(one.residual_mm) > 10.0


# What is free to move


def free(motion: Motion, **more: Any) -> SiteConstraint:
    options: dict[str, Any] = {"shift": 0.4, "free": ("x", "yaw"), **more}
    return wish(motion, range(3, 6), options.pop("shift"), **options)


def test_what_is_free_is_measured_where_it_went(motion: Motion) -> None:
    """In place and in turn: but for the yaw that it took, orientations are what they were."""

    def after(constraint: SiteConstraint, yaw: float) -> tuple[Unmet, ...]:
        held = of_site(with_moves([constraint], np.array(((-0.4, 0.0, 0.0, yaw),)))[0])
        targets = lay_out([held], motion.model, motion.nframe)
        return find_unmet(motion, targets, [constraint])

    yawed = free(motion, quat=exp(np.array((0.0, 0.0, 1.2))))
    assert after(yawed, -1.2) == ()
    (one,) = after(free(motion, quat=exp(np.array((0.1, 0.0, 0.0)))), 0.0)
    assert one.constraint == "orientation of left_hand" and one.frames == (3, 4, 5)
    assert one.residual_deg == pytest.approx(np.degrees(0.1), abs=1e-6)
    # All frames turn together: one that is turned on its own is told.
    apart = exp(np.array(((0, 0, 0), (0, 0, 0.3), (0, 0, 0.0))))
    (one,) = after(free(motion, quat=apart), -0.1)
    assert one.frames == (3, 4, 5)
    assert one.residual_deg == pytest.approx(np.degrees(0.2), abs=1e-6)
    # Without yaw among what is free nothing turns, and no other direction moves.
    fixed = free(motion, quat=exp(np.array((0.0, 0.0, 1.2))), free=("x",))
    (one,) = after(fixed, -1.2)
    assert one.residual_deg == pytest.approx(np.degrees(1.2), abs=1e-6)
    (one,) = after(free(motion, shift=0.5), 0.0)
    assert one.residual_mm == pytest.approx(100.0)


@pytest.mark.parametrize("ik", ["hybrid", "numeric"])
def test_a_fit_moves_what_is_free_before_it_measures(motion: Motion, ik: str) -> None:
    """A hand and a yaw half a metre off: met, for the fit's targets went to the motion."""
    yawed = free(motion, shift=0.5, quat=exp(np.array((0.0, 0.0, 0.4))))
    result = fit(motion, [yawed], ik=ik)
    assert result.unmet == ()
    assert result.moves[0, 0] == pytest.approx(-0.5, abs=0.02)
    assert result.moves[0, 3] == pytest.approx(-0.4, abs=0.02)
    asked = find_unmet(result.motion, lay_out([yawed], motion.model, 20), [yawed])
    assert [one.constraint for one in asked] == [
        "position of left_hand",
        "orientation of left_hand",
    ]


def test_what_is_free_and_cannot_be_met_in_one_piece_is_refused(motion: Motion) -> None:
    hold, spot = wish(motion, range(3, 6)), free(motion)
    constraints: list[Constraint] = [hold, spot]
    label = "position of left_hand"
    missed = Unmet(label, (4, 5), 12.0, index=1)
    with pytest.raises(
        ConstraintError, match=r"'left_hand' is free in x, yaw .* 12\.0 mm"
    ) as caught:
        check_free([missed], constraints)
    assert list(caught.value.frames) == [4, 5] and "frames 4, 5" in str(caught.value)
    assert "\n" not in str(caught.value)
    # Others may be out of reach: what is held where it is, the scene's own, or a mere turn.
    check_free((), constraints)
    check_free([dataclasses.replace(missed, index=0)], constraints)
    check_free([dataclasses.replace(missed, source="scene")], constraints)
    turn = Unmet("orientation of left_hand", (4,), None, 3.0, index=1)
    check_free([turn], constraints)
    other = RelativeConstraint("left_hand", np.arange(3), "pelvis")
    check_free([dataclasses.replace(missed, index=0)], [other, spot])
