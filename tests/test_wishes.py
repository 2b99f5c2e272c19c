"""The user's own constraints, measured: met, missed by a known amount, overridden, or mild."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mjmotion.body.motion import Motion
from mjmotion.constraints import Constraint, LookAt, RelativeConstraint, SiteConstraint
from mjmotion.constraints.unmet import Missed, all_missed, unmet_wishes
from mjmotion.fitting import Unmet
from mjmotion.numerics.rotations import exp, normalized
from mjmotion.output.results import load_model

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def motion() -> Motion:
    model = load_model(ROOT / "models" / "mjcf" / "humanoid.xml")
    return Motion(model, np.tile(model.qpos0, (20, 1)), 30.0)


def hand_of(motion: Motion) -> np.ndarray:
    import mujoco

    data = mujoco.MjData(motion.model)
    data.qpos[:] = motion.qpos[0]
    mujoco.mj_kinematics(motion.model, data)
    return np.array(data.site("left_hand").xpos)


def wish(
    frames: range, shift: float = 0.0, motion: Motion | None = None, **more: Any
) -> SiteConstraint:
    assert motion is not None
    return SiteConstraint(
        "left_hand", np.array(frames), hand_of(motion) + [shift, 0.0, 0.0], **more
    )


def test_what_is_met_is_not_named(motion: Motion) -> None:
    level = wish(range(3, 9), motion=motion, quat=[1, 0, 0, 0])
    assert unmet_wishes(motion, [level]) == ()
    assert unmet_wishes(motion, []) == ()


def test_a_position_missed_is_named_with_frames_and_residual(motion: Motion) -> None:
    (missed,) = unmet_wishes(motion, [wish(range(3, 6), 0.012, motion)])
    assert (missed.constraint, missed.frames, missed.own) == (
        "position of left_hand",
        (3, 4, 5),
        True,
    )
    assert missed.residual_mm == pytest.approx(12.0) and missed.residual_deg is None
    assert str(missed) == "position of left_hand at frames 3, 4, 5, off by 12.0 mm"
    assert json.loads(json.dumps(missed.as_dict()))["frames"] == [3, 4, 5]


@pytest.mark.parametrize("degrees", [1.0, 30.0, 90.0, 179.0])
def test_an_orientation_missed_is_named_in_degrees(motion: Motion, degrees: float) -> None:
    half = np.radians(degrees) / 2
    quat = normalized(np.array([np.cos(half), *(np.sin(half) * np.array([0.6, 0.0, 0.8]))]))
    turned = SiteConstraint("left_hand", np.array([7]), None, quat)
    (missed,) = unmet_wishes(motion, [turned])
    assert (missed.constraint, missed.frames) == ("orientation of left_hand", (7,))
    assert missed.residual_mm is None
    assert missed.residual_deg == pytest.approx(degrees, abs=1e-6)


def test_a_wish_that_may_give_way_is_not_asked_after(motion: Motion) -> None:
    assert unmet_wishes(motion, [wish(range(3, 6), 0.5, motion, weight=0.5)]) == ()


def test_the_later_of_two_counts(motion: Motion) -> None:
    far, here = wish(range(3, 9), 0.5, motion), wish(range(5, 9), 0.0, motion)
    (missed,) = unmet_wishes(motion, [far, here])
    assert missed.frames == (3, 4)


def test_the_scene_s_own_targets_are_told_apart(motion: Motion) -> None:
    unmet = (
        Unmet("position of left_hand", (3, 4), 500.0),
        Unmet("position of left_foot", (8,), 2.5),
    )
    missed = all_missed(unmet, motion, [wish(range(3, 5), 0.5, motion)])
    assert [(one.constraint, one.own) for one in missed] == [
        ("position of left_hand", True),
        ("position of left_foot", False),
    ]
    assert missed[1] == Missed("position of left_foot", (8,), 2.5)


def test_what_the_fit_measured_is_the_user_s_where_the_user_asked(motion: Motion) -> None:
    """Places in another site's frame, gazes, and what is free to move: told by name and frame."""
    frames = np.arange(3, 6)
    wishes: list[Constraint] = [
        RelativeConstraint("left_hand", frames, "pelvis", np.array((0, 0, 2))),
        LookAt("face", frames, np.array((0, 0, 9))),
        SiteConstraint("right_hand", frames, np.array((0, 0, 9)), free=("x",)),
    ]
    unmet = (
        Unmet("position of left_hand to pelvis", (3, 4, 5), 800.0),
        Unmet("gaze of face", (4,), 20.0),
        Unmet("position of right_hand", (5,), 3.0),
        Unmet("position of left_foot", (4,), 2.0),
        Unmet("position of right_hand", (9,), 2.0),
    )
    missed = all_missed(unmet, motion, wishes)
    assert [(one.constraint, one.frames, one.own) for one in missed] == [
        (one.constraint, one.frames, own)
        for one, own in zip(unmet, (True, True, True, False, False), strict=True)
    ]


@pytest.mark.parametrize("degrees", [0.2, 5.0, 120.0])
def test_turns_to_another_site_are_measured(motion: Motion, degrees: float) -> None:
    """At rest the hands and the pelvis are all level."""
    turned = exp(np.radians(degrees) * np.array((0.6, 0.0, 0.8)))
    link = RelativeConstraint("left_hand", np.arange(2, 4), "pelvis", np.array((0, 0, 5)), turned)
    missed = unmet_wishes(motion, [link])
    if degrees < 0.5:
        assert missed == ()
        return
    (one,) = missed
    assert (one.constraint, one.frames) == ("orientation of left_hand to pelvis", (2, 3))
    assert one.residual_deg == pytest.approx(degrees, abs=1e-6) and one.own
    mild = RelativeConstraint("left_hand", np.arange(2, 4), "pelvis", None, turned, weight=0.5)
    assert unmet_wishes(motion, [mild]) == ()


def test_orientations_of_what_is_free_are_measured_but_for_the_yaw_it_took(motion: Motion) -> None:
    frames = np.arange(3, 6)
    away: dict[str, Any] = {"position": (5.0, 5.0, 5.0), "free": ("x", "yaw")}
    yawed = SiteConstraint("left_hand", frames, quat=exp(np.array((0, 0, 1.2))), **away)
    assert unmet_wishes(motion, [yawed]) == ()
    tilted = SiteConstraint("left_hand", frames, quat=exp(np.array((0.1, 0, 0))), **away)
    (one,) = unmet_wishes(motion, [tilted])
    assert one.constraint == "orientation of left_hand" and one.frames == (3, 4, 5)
    assert one.residual_deg == pytest.approx(np.degrees(0.1), abs=1e-6)
    # All frames turn together: one that is turned on its own is told.
    apart = exp(np.array(((0, 0, 0), (0, 0, 0.3), (0, 0, 0.0))))
    (one,) = unmet_wishes(motion, [SiteConstraint("left_hand", frames, quat=apart, **away)])
    assert one.residual_deg == pytest.approx(np.degrees(0.2), abs=0.1)
    fixed = SiteConstraint(
        "left_hand", frames, np.array((5, 5, 5)), exp(np.array((0, 0, 1.2))), free=("x",)
    )
    (one,) = unmet_wishes(motion, [fixed])
    assert one.residual_deg == pytest.approx(np.degrees(1.2), abs=1e-6)
