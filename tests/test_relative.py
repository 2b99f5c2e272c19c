"""Sites held to other sites, or turned to a point: rows, fits on both solvers, out of reach."""

from __future__ import annotations

import functools
from typing import Any

import mujoco
import numpy as np
import pytest
from made_up import humanoid, loop_quats, loop_sites, mixed, pin, some, walk
from made_up import random_poses as poses

from mjmotion.apps.adaptation import adapt
from mjmotion.body.motion import Motion
from mjmotion.constraints import (
    Constraint,
    LookAt,
    RelativeConstraint,
    SiteConstraint,
    lay_out,
)
from mjmotion.exceptions import ConstraintError, ModelError
from mjmotion.fitting import fit
from mjmotion.ik.hybrid import HybridIK
from mjmotion.ik.numeric import NumericIK
from mjmotion.numerics.rotations import conjugate, exp, log, multiply, to_matrix
from mjmotion.numerics.tangent import ominus, oplus
from mjmotion.scene import Doorway, Scene, doors, flat

HELD = 1e-4  # of a hand that is held to something [m]
ANGLE = 0.01  # of a look-at [degrees]
HIP = (0.02, 0.24, 0.03)  # beside the pelvis, in its frame [m]
FEET = ("left_foot", "right_foot")
MIDDLE = np.arange(30, 60)


@functools.cache
def clip() -> Motion:
    return walk(3.0)


@functools.cache
def feet() -> tuple[SiteConstraint, ...]:
    return tuple(pin(clip().model, clip().qpos, site, contact=True) for site in FEET)


def apart(motion: Motion, held: RelativeConstraint) -> tuple[np.ndarray, np.ndarray]:
    """How far (n,) [m] and how turned (n,) [degrees] a held site is, from MuJoCo itself."""
    model, rows = motion.model, motion.qpos[held.frames]
    sites = loop_sites(model, rows)
    turn = loop_quats(model, rows, held.to)
    here, there = (sites[:, model.site(name).id] for name in (held.site, held.to))
    local = np.zeros((len(rows), 3)) if held.position is None else held.position
    gap = there + np.einsum("nij,nj->ni", to_matrix(turn), local) - here
    wanted = turn if held.quat is None else multiply(turn, held.quat)
    off = log(multiply(wanted, conjugate(loop_quats(model, rows, held.site))))
    return np.linalg.norm(gap, axis=1), np.degrees(np.linalg.norm(off, axis=1))


def aside(motion: Motion, look: LookAt) -> np.ndarray:
    """Angle (n,) [degrees] between a site's axis and the line to its point, from MuJoCo itself."""
    rows = motion.qpos[look.frames]
    axis = to_matrix(loop_quats(motion.model, rows, look.site)) @ look.axis
    line = look.point - loop_sites(motion.model, rows)[:, motion.model.site(look.site).id]
    sine = np.linalg.norm(np.cross(axis, line), axis=1)
    return np.degrees(np.arctan2(sine, np.einsum("ni,ni->n", axis, line)))


def jerk(qpos: np.ndarray) -> float:
    """RMS of the joints' third differences [rad]."""
    rates = ominus(humanoid(), qpos[1:], qpos[:-1])
    return float(np.sqrt(np.mean(np.diff(rates, n=2, axis=0)[:, 6:] ** 2)))


# Rows


def near_relative(model: mujoco.MjModel, qpos: np.ndarray, size: float) -> RelativeConstraint:
    """The left hand where it is to the right one, changed by about ``size`` [m and rad]."""
    rng, n = np.random.default_rng(1), len(qpos)
    sites, turn = loop_sites(model, qpos), loop_quats(model, qpos, "right_hand")
    away = sites[:, model.site("left_hand").id] - sites[:, model.site("right_hand").id]
    local = np.einsum("nji,nj->ni", to_matrix(turn), away) + size * rng.normal(size=(n, 3))
    quat = multiply(conjugate(turn), loop_quats(model, qpos, "left_hand"))
    quat = multiply(quat, exp(size * rng.normal(size=(n, 3))))
    return RelativeConstraint("left_hand", np.arange(n), "right_hand", local, quat)


def near_look_at(model: mujoco.MjModel, qpos: np.ndarray, size: float) -> LookAt:
    """A slanted axis of the face, to a point 1.5 m along it, changed by about ``size`` [m]."""
    rng, axis = np.random.default_rng(2), np.array((0.8, 0.6, 0.0))
    ahead = to_matrix(loop_quats(model, qpos, "face")) @ axis
    point = loop_sites(model, qpos)[:, model.site("face").id] + 1.5 * ahead
    return LookAt(
        "face", np.arange(len(qpos)), point + size * rng.normal(size=(len(qpos), 3)), axis
    )


@pytest.mark.parametrize("kind", ["relative", "look-at", "both"])
def test_one_step_leaves_a_square(kind: str) -> None:
    """Right rows make Gauss–Newton converge in the square: a tenth of the error, a hundredth left.

    A wrong row, or one that forgets that the other site moves too, would leave a tenth.
    """
    model, qpos = humanoid(), poses(humanoid(), 6, 3, 0.05)  # away from limits
    left = []
    for size in (0.03, 0.003):
        constraints: list[Constraint] = []
        if kind != "look-at":
            constraints.append(near_relative(model, qpos, size))
        if kind != "relative":
            constraints.append(near_look_at(model, qpos, size))
        targets = lay_out(constraints, model, 6)
        step = NumericIK(model, iterations=1).prepare(targets).solve(qpos).displacement
        moved = Motion(model, oplus(model, qpos, step), 30.0)
        off: list[np.ndarray] = []
        for one in constraints:
            if isinstance(one, RelativeConstraint):
                off += apart(moved, one)
            elif isinstance(one, LookAt):
                off.append(aside(moved, one))
        left.append(max(float(values.max()) for values in off))
    assert left[0] > 1e-4 and left[1] < 0.02 * left[0]


def test_a_relative_place_moves_both_ends_least() -> None:
    """Two hands that are brought together meet in the middle: each arm gives half."""
    model, qpos = humanoid(), np.tile(humanoid().qpos0, (1, 1))
    for side in ("left", "right"):
        qpos[:, model.joint(f"{side}_elbow").qposadr[0]] = 1.2
    hands = RelativeConstraint("left_hand", np.array((0,)), "right_hand")
    targets = lay_out([hands], model, 1)
    found = NumericIK(model, iterations=20).prepare(targets).solve(qpos).displacement
    moved = Motion(model, oplus(model, qpos, found), 30.0)
    assert apart(moved, hands)[0].max() < 1e-6
    ends = loop_sites(model, moved.qpos)[0, [model.site(s).id for s in ("left_hand", "right_hand")]]
    np.testing.assert_allclose(ends[:, 1], 0.0, atol=1e-3)
    both = [model.joint(f"{side}_elbow").dofadr[0] for side in ("left", "right")]
    assert found[0, both[0]] == pytest.approx(found[0, both[1]], abs=1e-3)


@pytest.mark.parametrize("solver", [NumericIK, HybridIK])
def test_what_is_met_asks_for_nothing(solver: type) -> None:
    model, qpos = humanoid(), poses(humanoid(), 5, 4, 0.2)
    held: list[Constraint] = [
        near_relative(model, qpos, 0.0),
        near_look_at(model, qpos, 0.0),
        pin(model, qpos, "left_foot"),
    ]
    targets = lay_out(held, model, 5)
    for solution in (
        solver(model).prepare(targets).solve(qpos),
        solver(model).prepare(targets).enforce(qpos),
    ):
        assert np.abs(solution.displacement).max() < 1e-7
        assert solution.error.max() < 1e-9


# Fits

RELATIVE: dict[str, tuple[str, str, Any, Any]] = {
    "hand on the hip": ("left_hand", "pelvis", HIP, None),
    "hand in hand": ("left_hand", "right_hand", (0.0, 0.02, -0.05), None),
    "hand on the head": ("right_hand", "head_top", (0.0, -0.02, 0.03), None),
    "hand turned to the pelvis": ("left_hand", "pelvis", HIP, (0.97, 0.1, -0.15, 0.1)),
    "turned alone": ("head_top", "pelvis", None, (0.97, 0.0, 0.0, 0.24)),
}


@pytest.mark.parametrize("ik", ["hybrid", "numeric"])
@pytest.mark.parametrize("case", sorted(RELATIVE))
def test_a_site_is_held_to_another(case: str, ik: str) -> None:
    """To a tenth of a millimetre, feet on their places, within limits, and without a jerk."""
    site, to, position, quat = RELATIVE[case]
    held = RelativeConstraint(site, MIDDLE, to, position, quat)
    constraints: list[Constraint] = [*feet(), held]
    result = fit(clip(), constraints, ik=ik)
    off, turned = apart(result.motion, held)
    if position is not None:
        assert off.max() < HELD and apart(clip(), held)[0].max() > 0.1
    if quat is not None:
        assert turned.max() < ANGLE
    for foot in feet():
        here = loop_sites(clip().model, result.motion.qpos)[:, clip().model.site(foot.site).id]
        assert np.abs(here - foot.position).max() < HELD
    assert result.unmet == () and result.trace.exact_error_percent < 0.01
    assert clip().character.limits.excess(result.motion.qpos).max() < 1e-8
    # What is let go of swings out: the arm is not pulled back to where nobody asked it to be.
    assert jerk(result.motion.qpos) < 1.1 * jerk(clip().qpos)
    assert result.trace.nscalar == sum(one.nscalar for one in constraints)


LOOK_ATS: dict[str, tuple[Any, Any]] = {
    "to the side": ((3.0, 2.0, 1.4), (1.0, 0.0, 0.0)),
    "up along another axis": ((1.5, 0.3, 3.0), (0.0, 0.0, 1.0)),
    "near": ((1.6, 0.4, 1.2), (1.0, 0.0, 0.0)),
}


@pytest.mark.parametrize("ik", ["hybrid", "numeric"])
@pytest.mark.parametrize("case", sorted(LOOK_ATS))
def test_a_site_faces_a_point(case: str, ik: str) -> None:
    look = LookAt("face", MIDDLE, *LOOK_ATS[case])
    result = fit(clip(), [*feet(), look], ik=ik)
    assert aside(clip(), look).max() > 15.0 and aside(result.motion, look).max() < ANGLE
    assert result.unmet == () and jerk(result.motion.qpos) < 1.2 * jerk(clip().qpos)
    assert clip().character.limits.excess(result.motion.qpos).max() < 1e-8
    assert look.nscalar == 2 * len(MIDDLE)


def test_a_look_at_alone_is_refined_to_the_last_level() -> None:
    """No position is ever off, and still the first level is not the last."""
    look = LookAt("face", MIDDLE, np.array((0.0, 2.0, 1.5)))
    result = fit(clip(), [look])
    assert [level.frames_per_knot for level in result.trace.levels][:4] == [16, 8, 4, 2]
    assert aside(result.motion, look).max() < ANGLE
    rates = ominus(humanoid(), result.motion.qpos[1:], result.motion.qpos[:-1])
    assert np.abs(np.diff(rates, n=2, axis=0)[:, 6:]).max() < 0.06  # [rad] a frame³


def test_a_look_at_follows_a_point_that_moves() -> None:
    s = np.linspace(0.0, np.pi, len(MIDDLE))
    point = np.column_stack((np.full_like(s, 4.0), 2.0 * np.cos(s), 1.5 + 0.5 * np.sin(s)))
    look = LookAt("face", MIDDLE, point)
    result = fit(clip(), [*feet(), look])
    assert aside(result.motion, look).max() < ANGLE


def test_a_point_right_behind() -> None:
    """Exactly opposite: any way round is as good, and one of them is taken."""
    model = humanoid()
    motion = Motion(model, np.tile(model.qpos0, (20, 1)), 30.0)
    face = loop_sites(model, motion.qpos)[0, model.site("face").id]
    look = LookAt("face", np.arange(20), face - (3.0, 0.0, 0.0))
    assert aside(motion, look).min() == pytest.approx(180.0)
    assert aside(fit(motion, [look]).motion, look).max() < ANGLE


def test_relative_places_in_a_model_without_limbs() -> None:
    model = mixed()
    motion = Motion(model, np.tile(poses(model, 1, 5, 0.1), (20, 1)), 30.0)
    held = RelativeConstraint("tip", np.arange(20), "other", np.array((0.05, 0.0, -0.1)))
    for ik in ("hybrid", "numeric"):
        assert apart(fit(motion, [held], ik=ik).motion, held)[0].max() < 1e-3


@pytest.mark.parametrize("fps", [24.0, 60.0])
def test_other_rates(fps: float) -> None:
    motion = walk(2.0, fps)
    frames = np.arange(round(0.6 * fps), round(1.4 * fps))
    held = RelativeConstraint("left_hand", frames, "pelvis", np.array(HIP))
    look = LookAt("face", frames, np.array((4.0, 2.0, 1.5)))
    result = fit(motion, [*(pin(motion.model, motion.qpos, s) for s in FEET), held, look])
    assert apart(result.motion, held)[0].max() < HELD and aside(result.motion, look).max() < ANGLE
    assert jerk(result.motion.qpos) < 1.1 * jerk(motion.qpos) and result.unmet == ()


def test_a_wish_gives_way() -> None:
    """The lighter, the more is left, of either kind; and neither is asked after."""
    model, qpos = humanoid(), poses(humanoid(), 3, 6, 0.1)
    left: dict[str, list[float]] = {"relative": [], "look-at": []}
    for weight in (0.05, 0.3, 1.0):
        held = RelativeConstraint("left_hand", np.arange(3), "pelvis", np.array(HIP), weight=weight)
        look = LookAt("face", np.arange(3), np.array((2.0, 1.0, 1.0)), weight=weight)
        for name, one in (("relative", held), ("look-at", look)):
            targets = lay_out([one], model, 3)
            found = NumericIK(model, iterations=12).prepare(targets).solve(qpos).displacement
            moved = Motion(model, oplus(model, qpos, found), 30.0)
            left[name].append(
                (apart(moved, held)[0] if name == "relative" else aside(moved, look)).max()
            )
    mild = RelativeConstraint("left_hand", MIDDLE, "pelvis", np.array((0, 0, 3)), weight=0.05)
    aloof = LookAt("left_foot", MIDDLE, np.array((1.0, 9.0, 0.0)), weight=0.05)
    assert fit(clip(), [mild, aloof]).unmet == ()
    for values in left.values():
        assert values[0] > values[1] > values[2] and values[2] < 1e-4


def test_the_later_of_two_holds() -> None:
    """Of the same two sites, or of one axis of a site; its other axes look where they look."""
    early, late = np.arange(0, 10), np.arange(5, 15)
    targets = lay_out(
        [
            RelativeConstraint("left_hand", early, "pelvis", np.array((0, 0, 1))),
            RelativeConstraint("left_hand", late, "pelvis", np.array((0, 0, 2)), weight=0.5),
            RelativeConstraint("left_hand", late, "right_hand", np.array((0, 0, 3))),
            LookAt("face", early, np.array((1, 0, 0))),
            LookAt("face", late, np.array((2, 0, 0)), weight=0.7),
            LookAt("face", late, np.array((3, 0, 0)), axis=np.array((0, 0, 1))),
        ],
        humanoid(),
        20,
    )
    assert len(targets.relative) == 2 and len(targets.look_at) == 3 and len(targets.sites) == 0
    np.testing.assert_array_equal(targets.relative[0].position[:, 2], [1] * 5 + [2] * 10)
    np.testing.assert_array_equal(targets.relative[0].position_weight, [1.0] * 5 + [0.5] * 10)
    np.testing.assert_array_equal(targets.relative[0].turn_weight, 0.0)
    np.testing.assert_array_equal(targets.relative[1].position_weight, [0.0] * 5 + [1.0] * 10)
    np.testing.assert_array_equal(targets.look_at[0].weight, [1.0] * 5 + [0.0] * 10)
    np.testing.assert_array_equal(targets.look_at[1].weight, [0.0] * 5 + [0.7] * 10)
    np.testing.assert_array_equal(targets.look_at[2].weight, [0.0] * 5 + [1.0] * 10)
    none = [-1] * 5
    np.testing.assert_array_equal(targets.relative[0].position_index, [0] * 5 + [1] * 10)
    np.testing.assert_array_equal(targets.relative[0].turn_index, -1)
    np.testing.assert_array_equal(targets.relative[1].position_index, none + [2] * 10)
    np.testing.assert_array_equal(targets.look_at[0].index, [3] * 5 + [-1] * 10)
    np.testing.assert_array_equal(targets.look_at[1].index, none + [4] * 10)
    np.testing.assert_array_equal(targets.look_at[2].index, none + [5] * 10)
    np.testing.assert_array_equal(targets.held, True)
    few = targets.at(np.array((0, 14)))
    assert few.relative[0].position[:, 2].tolist() == [1, 2] and few.look_at[1].point[1, 0] == 2.0
    assert few.relative[0].position_index.tolist() == [0, 1] and few.look_at[1].index[1] == 4
    every = targets.over_all_frames(20)
    assert every.relative[0].position_index.tolist() == [0] * 5 + [1] * 10 + [-1] * 5
    assert every.look_at[0].index.tolist() == [3] * 5 + [-1] * 15
    assert not targets.columns(np.zeros(0, dtype=bool)).relative


# What cannot be met


@pytest.mark.parametrize("ik", ["hybrid", "numeric"])
def test_out_of_reach_is_named_by_frame(ik: str) -> None:
    """A hand 3 m from its own pelvis, and a foot that is to face where it must not turn."""
    far = RelativeConstraint("left_hand", MIDDLE, "pelvis", np.array((3.0, 0.0, 0.0)))
    look = LookAt("left_foot", MIDDLE, np.array((1.0, 9.0, 0.0)))
    result = fit(clip(), [*feet(), far, look], ik=ik)
    names = {one.constraint: one for one in result.unmet}
    hand, foot = names["position of left_hand to pelvis"], names["look-at of left_foot"]
    off = 1000.0 * apart(result.motion, far)[0]
    assert hand.frames == tuple(MIDDLE) and hand.residual_mm == pytest.approx(off.max(), rel=1e-6)
    assert off.min() > 1000.0
    # A look-at's residual is how far its line passes from the point.
    turned = aside(result.motion, look)
    place = loop_sites(clip().model, result.motion.qpos[MIDDLE])[:, clip().model.site(FEET[0]).id]
    length = 1000.0 * np.linalg.norm(look.point - place, axis=1)
    past = length * np.sin(np.radians(np.minimum(turned, 90.0)))
    assert foot.residual_mm == pytest.approx(past.max(), rel=1e-3)
    assert set(foot.frames) == set(MIDDLE[past > 1.0]) != set()
    assert (hand.index, hand.source) == (2, "user") and (foot.index, foot.source) == (3, "user")


def test_a_turn_out_of_reach_is_named_in_degrees() -> None:
    """The head turned half round to the pelvis: the neck and the spine do what they can."""
    turned = RelativeConstraint("head_top", MIDDLE, "pelvis", None, exp(np.array((0, 0, 3.1))))
    result = fit(clip(), [turned], ik="numeric")
    (missed,) = result.unmet
    assert missed.constraint == "orientation of head_top to pelvis"
    assert (missed.index, missed.source) == (0, "user")
    degrees = apart(result.motion, turned)[1]
    assert missed.residual_deg == pytest.approx(degrees.max(), abs=1e-3) and degrees.min() > 5.0
    assert missed.frames == tuple(MIDDLE) and missed.residual_mm is None
    within = RelativeConstraint("head_top", MIDDLE, "pelvis", None, exp(np.array((0, 0, 0.8))))
    assert fit(clip(), [within], ik="numeric").unmet == ()


def test_all_kinds_past_an_obstacle() -> None:
    """Through a doorway, a hand on the hip, one on a rail that is free, eyes to the side."""
    motion = walk(3.6)
    scene = Scene.from_spec(doors((Doorway(x=0.9, height=1.66, width=1.2),), base=flat()))
    plain = adapt(motion, scene)
    held, rail = np.arange(20, 60), np.arange(62, 74)
    model = plain.motion.model
    spot = loop_sites(model, plain.motion.qpos)[68, model.site("right_hand").id]
    hip = RelativeConstraint("left_hand", held, "pelvis", np.array(HIP))
    look = LookAt("face", np.arange(15, 75), np.array((5.0, 2.5, 1.5)))
    grip = SiteConstraint("right_hand", rail, spot + (0.05, -0.1, 0.1), free=("x", "z"))
    result = adapt(motion, scene, constraints=[hip, look, grip])
    assert result.unmet == ()
    assert apart(result.motion, hip)[0].max() < HELD
    assert aside(result.motion, look).max() < 0.1
    sites = loop_sites(result.motion.model, result.motion.qpos)
    hand = sites[rail, model.site("right_hand").id]
    assert np.ptp(hand, axis=0).max() < HELD
    np.testing.assert_allclose(hand[:, 1], spot[1] - 0.1, atol=HELD)
    assert jerk(result.motion.qpos) < 1.3 * jerk(plain.motion.qpos)
    errors = [level.max_error_percent for level in some(result.trace).levels]
    assert errors[3] < 0.2 * errors[0]
    for contact in result.contacts:
        points = sites[contact.start : contact.end, model.site(contact.site).id]
        assert np.ptp(points, axis=0).max() < 2e-3


# Bad input


BAD_RELATIVE: dict[str, tuple[dict[str, Any], str]] = {
    "no frames": ({"frames": []}, "no frames"),
    "a frame twice": ({"frames": [1, 1]}, "twice"),
    "wants nothing": ({"position": None}, "wants nothing"),
    "to itself": ({"to": "left_hand"}, "two sites"),
    "weight": ({"weight": 0.0}, "weight"),
    "rows": ({"position": np.zeros((3, 3))}, "2 rows"),
    "not finite": ({"position": (0, np.nan, 0)}, "not finite"),
    "zero quat": ({"quat": np.zeros(4)}, "zero"),
}


@pytest.mark.parametrize("case", sorted(BAD_RELATIVE))
def test_bad_relative_constraints(case: str) -> None:
    options, message = BAD_RELATIVE[case]
    good: dict[str, Any] = {"frames": [1, 2], "to": "pelvis", "position": (0, 0, 1)}
    with pytest.raises(ConstraintError, match=message):
        RelativeConstraint("left_hand", **{**good, **options})


BAD_LOOK_ATS: dict[str, tuple[dict[str, Any], str]] = {
    "no frames": ({"frames": []}, "no frames"),
    "a frame twice": ({"frames": [1, 1]}, "twice"),
    "weight": ({"weight": 2.0}, "weight"),
    "a point of two": ({"point": (0, 1)}, "point must be 3 numbers"),
    "a point nowhere": ({"point": (0, 1, np.inf)}, "not finite"),
    "no axis": ({"axis": (0, 0, 0)}, "no length"),
    "an axis a frame": ({"axis": np.ones((2, 3))}, "axis must be"),
}


@pytest.mark.parametrize("case", sorted(BAD_LOOK_ATS))
def test_bad_look_ats(case: str) -> None:
    options, message = BAD_LOOK_ATS[case]
    good: dict[str, Any] = {"frames": [1, 2], "point": (0, 0, 1)}
    with pytest.raises(ConstraintError, match=message):
        LookAt("face", **{**good, **options})


def test_sites_that_cannot_be_held() -> None:
    model = humanoid()
    for held, kind, message in (
        (
            RelativeConstraint("left_heel", np.array((1,)), "left_toe"),
            ConstraintError,
            "on one body",
        ),
        (
            RelativeConstraint("left_hand", np.array((1,)), "pelviss"),
            ModelError,
            "Did you mean 'pelvis'",
        ),
        (
            RelativeConstraint("left_hnd", np.array((1,)), "pelvis"),
            ModelError,
            "Did you mean 'left_hand'",
        ),
        (LookAt("fac", np.array((1,)), np.array((0, 0, 0))), ModelError, "Did you mean 'face'"),
        (
            LookAt("face", np.array((19, 20)), np.array((0, 0, 0))),
            ConstraintError,
            "names frames 20",
        ),
    ):
        with pytest.raises(kind, match=message):
            lay_out([held], model, 20)
