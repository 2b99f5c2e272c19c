"""Sites held to other sites, and gazes: rows, fits on both solvers, what is out of reach."""

from __future__ import annotations

import functools
from typing import Any

import mujoco
import numpy as np
import pytest
from made_up import humanoid, loop_quats, loop_sites, mixed, pin, walk
from made_up import random_poses as poses

from mjmotion.apps.adaptation import adapt
from mjmotion.body.joint_limits import limit_excess
from mjmotion.body.motion import Motion
from mjmotion.constraints import (
    Constraint,
    LookAt,
    RelativeConstraint,
    SiteConstraint,
    lay_out,
)
from mjmotion.constraints.unmet import all_missed
from mjmotion.exceptions import ConstraintError, ModelError
from mjmotion.fitting import fit
from mjmotion.ik.hybrid import HybridIK
from mjmotion.ik.numeric import NumericIK
from mjmotion.numerics.rotations import conjugate, exp, log, multiply, to_matrix
from mjmotion.numerics.tangent import ominus, oplus
from mjmotion.scene import Doorway, Scene, doors, flat

HELD = 1e-4  # of a hand that is held to something [m]
ANGLE = 0.01  # of a gaze [degrees]
HIP = np.array((0.02, 0.24, 0.03))  # beside the pelvis, in its frame [m]
FEET = ("left_foot", "right_foot")
MIDDLE = np.arange(30, 60)


@functools.cache
def clip() -> Motion:
    return walk(3.0)


@functools.cache
def feet() -> tuple[SiteConstraint, ...]:
    return tuple(pin(clip().model, clip().qpos, site, contact=True) for site in FEET)


def apart(motion: Motion, link: RelativeConstraint) -> tuple[np.ndarray, np.ndarray]:
    """How far (n,) [m] and how turned (n,) [degrees] a held site is, from MuJoCo itself."""
    model, rows = motion.model, motion.qpos[link.frames]
    sites = loop_sites(model, rows)
    turn = loop_quats(model, rows, link.to)
    here, there = (sites[:, model.site(name).id] for name in (link.site, link.to))
    local = np.zeros((len(rows), 3)) if link.position is None else link.position
    gap = there + np.einsum("nij,nj->ni", to_matrix(turn), local) - here
    wanted = turn if link.quat is None else multiply(turn, link.quat)
    off = log(multiply(wanted, conjugate(loop_quats(model, rows, link.site))))
    return np.linalg.norm(gap, axis=1), np.degrees(np.linalg.norm(off, axis=1))


def aside(motion: Motion, gaze: LookAt) -> np.ndarray:
    """Angle (n,) [degrees] between a site's axis and the line to its point, from MuJoCo itself."""
    rows = motion.qpos[gaze.frames]
    axis = to_matrix(loop_quats(motion.model, rows, gaze.site)) @ gaze.axis
    line = gaze.point - loop_sites(motion.model, rows)[:, motion.model.site(gaze.site).id]
    sine = np.linalg.norm(np.cross(axis, line), axis=1)
    return np.degrees(np.arctan2(sine, np.einsum("ni,ni->n", axis, line)))


def jerk(qpos: np.ndarray) -> float:
    """RMS of the joints' third differences [rad]."""
    rates = ominus(humanoid(), qpos[1:], qpos[:-1])
    return float(np.sqrt(np.mean(np.diff(rates, n=2, axis=0)[:, 6:] ** 2)))


# Rows


def near_link(model: mujoco.MjModel, qpos: np.ndarray, size: float) -> RelativeConstraint:
    """The left hand where it is to the right one, changed by about ``size`` [m and rad]."""
    rng, n = np.random.default_rng(1), len(qpos)
    sites, turn = loop_sites(model, qpos), loop_quats(model, qpos, "right_hand")
    away = sites[:, model.site("left_hand").id] - sites[:, model.site("right_hand").id]
    local = np.einsum("nji,nj->ni", to_matrix(turn), away) + size * rng.normal(size=(n, 3))
    quat = multiply(conjugate(turn), loop_quats(model, qpos, "left_hand"))
    quat = multiply(quat, exp(size * rng.normal(size=(n, 3))))
    return RelativeConstraint("left_hand", np.arange(n), "right_hand", local, quat)


def near_gaze(model: mujoco.MjModel, qpos: np.ndarray, size: float) -> LookAt:
    """A slanted axis of the face, to a point 1.5 m along it, changed by about ``size`` [m]."""
    rng, axis = np.random.default_rng(2), np.array((0.8, 0.6, 0.0))
    ahead = to_matrix(loop_quats(model, qpos, "face")) @ axis
    point = loop_sites(model, qpos)[:, model.site("face").id] + 1.5 * ahead
    return LookAt(
        "face", np.arange(len(qpos)), point + size * rng.normal(size=(len(qpos), 3)), axis
    )


@pytest.mark.parametrize("kind", ["link", "gaze", "both"])
def test_one_step_leaves_a_square(kind: str) -> None:
    """Right rows make Gauss–Newton converge in the square: a tenth of the error, a hundredth left.

    A wrong row, or one that forgets that the other site moves too, would leave a tenth.
    """
    model, qpos = humanoid(), poses(humanoid(), 6, 3, 0.05)  # away from limits
    left = []
    for size in (0.03, 0.003):
        constraints: list[RelativeConstraint | LookAt] = []
        if kind != "gaze":
            constraints.append(near_link(model, qpos, size))
        if kind != "link":
            constraints.append(near_gaze(model, qpos, size))
        targets = lay_out(constraints, model, 6)
        step = NumericIK(model, iterations=1).solve(qpos, targets).displacement
        moved = Motion(model, oplus(model, qpos, step), 30.0)
        off = [
            np.concatenate(apart(moved, one))
            if isinstance(one, RelativeConstraint)
            else aside(moved, one)
            for one in constraints
        ]
        left.append(np.concatenate(off).max())
    assert left[0] > 1e-4 and left[1] < 0.02 * left[0]


def test_a_link_moves_both_ends_least() -> None:
    """Two hands that are brought together meet in the middle: each arm gives half."""
    model, qpos = humanoid(), np.tile(humanoid().qpos0, (1, 1))
    for side in ("left", "right"):
        qpos[:, model.joint(f"{side}_elbow").qposadr[0]] = 1.2
    hands = RelativeConstraint("left_hand", np.array((0,)), "right_hand")
    targets = lay_out([hands], model, 1)
    found = NumericIK(model, iterations=20).solve(qpos, targets).displacement
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
        near_link(model, qpos, 0.0),
        near_gaze(model, qpos, 0.0),
        pin(model, qpos, "left_foot"),
    ]
    targets = lay_out(held, model, 5)
    for solution in (solver(model).solve(qpos, targets), solver(model).enforce(qpos, targets)):
        assert np.abs(solution.displacement).max() < 1e-7
        assert solution.error.max() < 1e-9


# Fits

LINKS: dict[str, tuple[str, str, np.ndarray | None, np.ndarray | None]] = {
    "hand on the hip": ("left_hand", "pelvis", HIP, None),
    "hand in hand": ("left_hand", "right_hand", np.array((0.0, 0.02, -0.05)), None),
    "hand on the head": ("right_hand", "head_top", np.array((0.0, -0.02, 0.03)), None),
    "hand turned to the pelvis": ("left_hand", "pelvis", HIP, np.array((0.97, 0.1, -0.15, 0.1))),
    "turned alone": ("head_top", "pelvis", None, np.array((0.97, 0.0, 0.0, 0.24))),
}


@pytest.mark.parametrize("ik", ["hybrid", "numeric"])
@pytest.mark.parametrize("case", sorted(LINKS))
def test_a_site_is_held_to_another(case: str, ik: str) -> None:
    """To a tenth of a millimetre, feet on their places, within limits, and without a jerk."""
    site, to, position, quat = LINKS[case]
    link = RelativeConstraint(site, MIDDLE, to, position, quat)
    result = fit(clip(), [*feet(), link], ik=ik)
    off, turned = apart(result.motion, link)
    if position is not None:
        assert off.max() < HELD and apart(clip(), link)[0].max() > 0.1
    if quat is not None:
        assert turned.max() < ANGLE
    for foot in feet():
        here = loop_sites(clip().model, result.motion.qpos)[:, clip().model.site(foot.site).id]
        assert np.abs(here - foot.position).max() < HELD
    assert result.unmet == () and result.trace.exact_error_percent < 0.01
    assert limit_excess(clip().model, result.motion.qpos).max() < 1e-8
    # What is let go of swings out: the arm is not pulled back to where nobody asked it to be.
    assert jerk(result.motion.qpos) < 1.1 * jerk(clip().qpos)
    assert result.trace.nscalar == sum(c.nscalar for c in feet()) + link.nscalar


GAZES = {
    "to the side": (np.array((3.0, 2.0, 1.4)), np.array((1.0, 0.0, 0.0))),
    "up along another axis": (np.array((1.5, 0.3, 3.0)), np.array((0.0, 0.0, 1.0))),
    "near": (np.array((1.6, 0.4, 1.2)), np.array((1.0, 0.0, 0.0))),
}


@pytest.mark.parametrize("ik", ["hybrid", "numeric"])
@pytest.mark.parametrize("case", sorted(GAZES))
def test_a_site_faces_a_point(case: str, ik: str) -> None:
    gaze = LookAt("face", MIDDLE, *GAZES[case])
    result = fit(clip(), [*feet(), gaze], ik=ik)
    assert aside(clip(), gaze).max() > 15.0 and aside(result.motion, gaze).max() < ANGLE
    assert result.unmet == () and jerk(result.motion.qpos) < 1.2 * jerk(clip().qpos)
    assert limit_excess(clip().model, result.motion.qpos).max() < 1e-8
    assert gaze.nscalar == 2 * len(MIDDLE)


def test_a_gaze_alone_is_refined_to_the_last_level() -> None:
    """No position is ever off, and still the first level is not the last."""
    gaze = LookAt("face", MIDDLE, np.array((0.0, 2.0, 1.5)))
    result = fit(clip(), [gaze])
    assert [level.frames_per_knot for level in result.trace.levels][:4] == [16, 8, 4, 2]
    assert aside(result.motion, gaze).max() < ANGLE
    rates = ominus(humanoid(), result.motion.qpos[1:], result.motion.qpos[:-1])
    assert np.abs(np.diff(rates, n=2, axis=0)[:, 6:]).max() < 0.06  # [rad] a frame³


def test_a_gaze_follows_a_point_that_moves() -> None:
    s = np.linspace(0.0, np.pi, len(MIDDLE))
    point = np.column_stack((np.full_like(s, 4.0), 2.0 * np.cos(s), 1.5 + 0.5 * np.sin(s)))
    gaze = LookAt("face", MIDDLE, point)
    result = fit(clip(), [*feet(), gaze])
    assert aside(result.motion, gaze).max() < ANGLE


def test_a_point_right_behind() -> None:
    """Exactly opposite: any way round is as good, and one of them is taken."""
    model = humanoid()
    motion = Motion(model, np.tile(model.qpos0, (20, 1)), 30.0)
    face = loop_sites(model, motion.qpos)[0, model.site("face").id]
    gaze = LookAt("face", np.arange(20), face - (3.0, 0.0, 0.0))
    assert aside(motion, gaze).min() == pytest.approx(180.0)
    assert aside(fit(motion, [gaze]).motion, gaze).max() < ANGLE


def test_links_in_a_model_without_limbs() -> None:
    model = mixed()
    motion = Motion(model, np.tile(poses(model, 1, 5, 0.1), (20, 1)), 30.0)
    link = RelativeConstraint("tip", np.arange(20), "other", np.array((0.05, 0.0, -0.1)))
    for ik in ("hybrid", "numeric"):
        assert apart(fit(motion, [link], ik=ik).motion, link)[0].max() < 1e-3


@pytest.mark.parametrize("fps", [24.0, 60.0])
def test_other_rates(fps: float) -> None:
    motion = walk(2.0, fps)
    held = np.arange(round(0.6 * fps), round(1.4 * fps))
    link = RelativeConstraint("left_hand", held, "pelvis", HIP)
    gaze = LookAt("face", held, np.array((4.0, 2.0, 1.5)))
    result = fit(motion, [*(pin(motion.model, motion.qpos, s) for s in FEET), link, gaze])
    assert apart(result.motion, link)[0].max() < HELD and aside(result.motion, gaze).max() < ANGLE
    assert jerk(result.motion.qpos) < 1.1 * jerk(motion.qpos) and result.unmet == ()


def test_a_wish_gives_way() -> None:
    """The lighter, the more is left, of a link and of a gaze; and neither is asked after."""
    model, qpos = humanoid(), poses(humanoid(), 3, 6, 0.1)
    left: dict[str, list[float]] = {"link": [], "gaze": []}
    for weight in (0.05, 0.3, 1.0):
        link = RelativeConstraint("left_hand", np.arange(3), "pelvis", HIP, weight=weight)
        gaze = LookAt("face", np.arange(3), np.array((2.0, 1.0, 1.0)), weight=weight)
        for name, one in (("link", link), ("gaze", gaze)):
            targets = lay_out([one], model, 3)
            found = NumericIK(model, iterations=12).solve(qpos, targets).displacement
            moved = Motion(model, oplus(model, qpos, found), 30.0)
            left[name].append(
                (apart(moved, link)[0] if name == "link" else aside(moved, gaze)).max()
            )
        mild = fit(
            clip(),
            [RelativeConstraint("left_hand", MIDDLE, "pelvis", np.array((0, 0, 3)), weight=0.05)],
        )
        assert mild.unmet == ()
    for values in left.values():
        assert values[0] > values[1] > values[2] and values[2] < 1e-4


def test_the_later_of_two_holds() -> None:
    """Of links of the same two sites, and of gazes of the same axis; two axes are two gazes."""
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
    assert len(targets.links) == 2 and len(targets.gazes) == 3 and len(targets.sites) == 0
    np.testing.assert_array_equal(targets.links[0].position[:, 2], [1] * 5 + [2] * 10)
    np.testing.assert_array_equal(targets.links[0].position_weight, [1.0] * 5 + [0.5] * 10)
    np.testing.assert_array_equal(targets.links[0].turn_weight, 0.0)
    np.testing.assert_array_equal(targets.links[1].position_weight, [0.0] * 5 + [1.0] * 10)
    np.testing.assert_array_equal(targets.gazes[0].weight, [1.0] * 5 + [0.0] * 10)
    np.testing.assert_array_equal(targets.gazes[1].weight, [0.0] * 5 + [0.7] * 10)
    np.testing.assert_array_equal(targets.gazes[2].weight, [0.0] * 5 + [1.0] * 10)
    np.testing.assert_array_equal(targets.held, True)
    few = targets.at(np.array((0, 14)))
    assert few.links[0].position[:, 2].tolist() == [1, 2] and few.gazes[1].point[1, 0] == 2.0
    assert not targets.columns(np.zeros(0, dtype=bool)).links


# What cannot be met


@pytest.mark.parametrize("ik", ["hybrid", "numeric"])
def test_out_of_reach_is_named_by_frame(ik: str) -> None:
    """A hand 3 m from its own pelvis, and a foot that is to face where it must not turn."""
    far = RelativeConstraint("left_hand", MIDDLE, "pelvis", np.array((3.0, 0.0, 0.0)))
    gaze = LookAt("left_foot", MIDDLE, np.array((1.0, 9.0, 0.0)))
    result = fit(clip(), [*feet(), far, gaze], ik=ik)
    names = {one.constraint: one for one in result.unmet}
    hand, look = names["position of left_hand to pelvis"], names["gaze of left_foot"]
    off = 1000.0 * apart(result.motion, far)[0]
    assert hand.frames == tuple(MIDDLE) and hand.residual_mm == pytest.approx(off.max(), rel=1e-6)
    assert off.min() > 1000.0
    # A gaze's residual is how far its line passes from the point.
    turned = aside(result.motion, gaze)
    place = loop_sites(clip().model, result.motion.qpos[MIDDLE])[:, clip().model.site(FEET[0]).id]
    length = 1000.0 * np.linalg.norm(gaze.point - place, axis=1)
    past = length * np.sin(np.radians(np.minimum(turned, 90.0)))
    assert look.residual_mm == pytest.approx(past.max(), rel=1e-3)
    assert set(look.frames) == set(MIDDLE[past > 1.0]) != set()
    missed = all_missed(result.unmet, result.motion, [far, gaze])
    assert all(
        one.own for one in missed if one.constraint in names and "foot" not in one.constraint
    )


def test_a_turn_out_of_reach_is_named_in_degrees() -> None:
    """The head turned half round to the pelvis: the neck and the spine do what they can."""
    turned = RelativeConstraint("head_top", MIDDLE, "pelvis", None, exp(np.array((0, 0, 3.1))))
    result = fit(clip(), [turned], ik="numeric")
    (missed,) = all_missed(result.unmet, result.motion, [turned])
    assert missed.constraint == "orientation of head_top to pelvis" and missed.own
    degrees = apart(result.motion, turned)[1]
    assert missed.residual_deg == pytest.approx(degrees.max(), abs=1e-3) and degrees.min() > 5.0
    assert missed.frames == tuple(MIDDLE) and missed.residual_mm is None
    within = RelativeConstraint("head_top", MIDDLE, "pelvis", None, exp(np.array((0, 0, 0.8))))
    result = fit(clip(), [within], ik="numeric")
    assert all_missed(result.unmet, result.motion, [within]) == ()


def test_all_kinds_past_an_obstacle() -> None:
    """Through a doorway, a hand on the hip, one on a rail that is free, eyes to the side."""
    motion = walk(3.6)
    scene = Scene.from_spec(doors((Doorway(x=0.9, height=1.66, width=1.2),), base=flat()))
    plain = adapt(motion, scene)
    held, rail = np.arange(20, 60), np.arange(62, 74)
    model = plain.motion.model
    spot = loop_sites(model, plain.motion.qpos)[68, model.site("right_hand").id]
    constraints = (
        RelativeConstraint("left_hand", held, "pelvis", HIP),
        LookAt("face", np.arange(15, 75), np.array((5.0, 2.5, 1.5))),
        SiteConstraint("right_hand", rail, spot + (0.05, -0.1, 0.1), free=("x", "z")),
    )
    result = adapt(motion, scene, constraints=constraints)
    assert result.unmet == ()
    assert apart(result.motion, constraints[0])[0].max() < HELD
    assert aside(result.motion, constraints[1]).max() < 0.1
    sites = loop_sites(result.motion.model, result.motion.qpos)
    hand = sites[rail, model.site("right_hand").id]
    assert np.ptp(hand, axis=0).max() < HELD
    np.testing.assert_allclose(hand[:, 1], spot[1] - 0.1, atol=HELD)
    assert jerk(result.motion.qpos) < 1.3 * jerk(plain.motion.qpos)
    errors = [level.max_error_percent for level in result.trace.levels]
    assert errors[3] < 0.2 * errors[0]
    for contact in result.contacts:
        points = sites[contact.start : contact.end, model.site(contact.site).id]
        assert np.ptp(points, axis=0).max() < 2e-3


# Bad input


BAD_LINKS: dict[str, tuple[dict[str, Any], str]] = {
    "no frames": ({"frames": []}, "no frames"),
    "a frame twice": ({"frames": [1, 1]}, "twice"),
    "wants nothing": ({"position": None}, "wants nothing"),
    "to itself": ({"to": "left_hand"}, "two sites"),
    "weight": ({"weight": 0.0}, "weight"),
    "rows": ({"position": np.zeros((3, 3))}, "2 rows"),
    "not finite": ({"position": (0, np.nan, 0)}, "not finite"),
    "zero quat": ({"quat": np.zeros(4)}, "zero"),
}


@pytest.mark.parametrize("case", sorted(BAD_LINKS))
def test_bad_links(case: str) -> None:
    options, message = BAD_LINKS[case]
    good: dict[str, Any] = {"frames": [1, 2], "to": "pelvis", "position": (0, 0, 1)}
    with pytest.raises(ConstraintError, match=message):
        RelativeConstraint("left_hand", **{**good, **options})


BAD_GAZES: dict[str, tuple[dict[str, Any], str]] = {
    "no frames": ({"frames": []}, "no frames"),
    "a frame twice": ({"frames": [1, 1]}, "twice"),
    "weight": ({"weight": 2.0}, "weight"),
    "a point of two": ({"point": (0, 1)}, "point must be 3 numbers"),
    "a point nowhere": ({"point": (0, 1, np.inf)}, "not finite"),
    "no axis": ({"axis": (0, 0, 0)}, "no length"),
    "an axis a frame": ({"axis": np.ones((2, 3))}, "axis must be"),
}


@pytest.mark.parametrize("case", sorted(BAD_GAZES))
def test_bad_gazes(case: str) -> None:
    options, message = BAD_GAZES[case]
    good: dict[str, Any] = {"frames": [1, 2], "point": (0, 0, 1)}
    with pytest.raises(ConstraintError, match=message):
        LookAt("face", **{**good, **options})


def test_sites_that_cannot_be_held() -> None:
    model = humanoid()
    for link, kind, message in (
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
            lay_out([link], model, 20)
