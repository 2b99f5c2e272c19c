"""Algorithm 1 on a small walk whose feet have to follow bumpy ground, and on a robot."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from made_up import humanoid, loop_quats, loop_sites, mixed, pin, some, walk

from mjmotion.body.bones import Bones
from mjmotion.body.character import Character
from mjmotion.body.motion import Motion
from mjmotion.constraints import SiteConstraint, Targets, lay_out
from mjmotion.constraints.unmet import residuals
from mjmotion.exceptions import ConstraintError, FitError, ModelError
from mjmotion.fitting import Fit, default_levels, fit
from mjmotion.fitting.algorithm import PASSES
from mjmotion.ik import make_solver
from mjmotion.ik.hybrid import HybridIK
from mjmotion.ik.numeric import NumericIK
from mjmotion.ik.solver import Clearance, Deviation, IKProblem, Solution, default_rigidity
from mjmotion.numerics.bspline import fit_level
from mjmotion.numerics.rotations import conjugate, log, multiply
from mjmotion.numerics.tangent import ominus, oplus
from mjmotion.paper.conjugate_gradients import ConjugateGradientIK

PAPER = (14.31, 9.24, 3.48, 1.06)  # maximum errors of its terrain job, level by level [% of height]
EXACT = 0.01  # after the exact pass [% of height]
FEET = ("left_foot", "right_foot")
G1 = Path(__file__).parents[2] / "shared" / "robots" / "unitree_g1" / "g1.xml"


@functools.cache
def clip() -> Motion:
    return walk(3.0)


def on_bumps(
    motion: Motion, height: float = 0.05, sites: tuple[str, ...] = FEET
) -> list[SiteConstraint]:
    """Both feet posed in every frame, on ground that goes up and down along the walk."""
    constraints = []
    for site in sites:
        own = pin(motion.model, motion.qpos, site, contact=True)
        bump = height * np.sin(3.0 * some(own.position)[:, 0])[:, None] * (0, 0, 1)
        constraints.append(
            SiteConstraint(site, own.frames, some(own.position) + bump, own.quat, contact=True)
        )
    return constraints


@functools.cache
def fitted(ik: str, exact: bool) -> Fit:
    return fit(clip(), on_bumps(clip()), ik=ik, exact=exact)


def worst(result: Fit, constraints: Sequence[SiteConstraint]) -> float:
    """Largest position error of a result by MuJoCo itself [m]."""
    motion, far = result.motion, []
    sites = loop_sites(motion.model, motion.qpos)
    for constraint in constraints:
        here = sites[constraint.frames, motion.model.site(constraint.site).id]
        far.append(float(np.linalg.norm(here - constraint.position, axis=1).max()))
    return max(far)


@pytest.mark.parametrize(
    ("fps", "wanted"),
    [
        (30.0, (16, 8, 4, 2)),
        (60.0, (32, 16, 8, 4, 2)),
        (120.0, (64, 32, 16, 8, 4, 2)),
        (24.0, (16, 8, 4, 2)),
        (2.0, (2,)),
    ],
)
def test_default_levels(fps: float, wanted: tuple[float, ...]) -> None:
    assert default_levels(fps) == wanted


@pytest.mark.parametrize("ik", ["hybrid", "numeric"])
def test_every_level_leaves_less(ik: str) -> None:
    """Level by level, and never more than the paper's own job left."""
    result = fitted(ik, False)
    errors = [level.max_error_percent for level in result.trace.levels]
    assert [level.frames_per_knot for level in result.trace.levels] == [16, 8, 4, 2]
    assert [level.level for level in result.trace.levels] == [1, 2, 3, 4]
    assert result.trace.first_error_percent > errors[0]
    assert all(b < a for a, b in itertools.pairwise(errors)), errors
    assert all(mine <= paper for mine, paper in zip(errors, PAPER, strict=True)), errors
    assert result.trace.nscalar == 2 * 6 * clip().nframe
    # The last level's error is the motion's own.
    percent = 100.0 * worst(result, on_bumps(clip())) / 1.75
    assert errors[-1] == pytest.approx(percent, rel=0.05)
    assert result.trace.fit_seconds >= sum(level.seconds for level in result.trace.levels) > 0.0


@pytest.mark.parametrize("ik", ["hybrid", "numeric"])
def test_the_exact_pass_is_exact(ik: str) -> None:
    result, constraints = fitted(ik, True), on_bumps(clip())
    assert result.trace.exact_error_percent < EXACT
    assert worst(result, constraints) < 1e-4 and result.unmet == ()
    motion = result.motion
    for constraint in constraints:
        quat = loop_quats(motion.model, motion.qpos, constraint.site)
        assert np.abs(log(multiply(conjugate(quat), some(constraint.quat)))).max() < 1e-3
    assert motion.character.limits.excess(motion.qpos).max() < 1e-9


def test_the_exact_pass_brings_no_jerk() -> None:
    """Third differences of the joints [rad] with the pass, beside those without it."""
    jerks = []
    for exact in (False, True):
        qpos = fitted("hybrid", exact).motion.qpos
        rates = ominus(humanoid(), qpos[1:], qpos[:-1])
        jerks.append(np.sqrt(np.mean(np.diff(rates, n=2, axis=0)[:, 6:] ** 2)))
    assert jerks[1] < 1.2 * jerks[0]


def test_hybrid_and_numeric_agree() -> None:
    one, other = fitted("hybrid", True).motion.qpos, fitted("numeric", True).motion.qpos
    apart = ominus(humanoid(), one, other)
    assert np.abs(apart[:, :3]).max() < 0.005  # [m]
    assert np.abs(apart).max() < 0.05  # [rad]
    moved = ominus(humanoid(), one, clip().qpos)
    assert np.abs(apart).mean() < 0.2 * np.abs(moved).mean()


def test_algorithm_1_word_by_word() -> None:
    motion, constraints = clip(), on_bumps(clip(), 0.03)
    solver = NumericIK(motion.model)
    targets, qpos = lay_out(constraints, motion.model, motion.nframe), motion.qpos
    for frames_per_knot in (12, 6):
        displacement = solver.prepare(targets).solve(qpos[targets.frames]).displacement
        submap = np.zeros((motion.nframe, motion.model.nv))
        # Line 8 may be done more than once at the same knots, each time to what is left.
        for _ in range(PASSES):
            left = displacement - submap[targets.frames]
            submap += fit_level(targets.frames, left, motion.nframe, frames_per_knot)
        qpos = oplus(motion.model, qpos, submap)
    assert motion.character.limits.excess(qpos).max() == 0.0
    result = fit(motion, constraints, levels=(12, 6), ik="numeric", first_guess=False, exact=False)
    np.testing.assert_allclose(result.motion.qpos, qpos, atol=1e-12)


def test_a_motion_that_fits_stays() -> None:
    motion = clip()
    for ik in ("hybrid", "numeric"):
        result = fit(motion, [pin(motion.model, motion.qpos, site) for site in FEET], ik=ik)
        np.testing.assert_allclose(result.motion.qpos, motion.qpos, atol=1e-9)
        assert result.trace.exact_error_percent < 1e-9


@pytest.mark.parametrize("ik", ["hybrid", "numeric"])
def test_frames_outside_the_support_do_not_move_at_all(ik: str) -> None:
    """Knots of 4 frames: a constraint on frame 45 moves nothing 16 frames and more from it."""
    motion = clip()
    point = loop_sites(motion.model, motion.qpos)[45, motion.model.site("left_hand").id]
    wish = SiteConstraint("left_hand", np.array((45,)), point + (0.05, 0.0, 0.03))
    result = fit(motion, [wish], levels=(4, 2), ik=ik)
    away = np.abs(np.arange(motion.nframe) - 45) >= 16
    moved = np.abs(ominus(motion.model, result.motion.qpos, motion.qpos)).max(axis=1)
    assert (moved[away] == 0.0).all()
    np.testing.assert_allclose(result.motion.qpos[away], motion.qpos[away], rtol=0, atol=1e-15)
    assert moved[45] > 0.02 and moved[44] > 0.0 and worst(result, [wish]) < 1e-4
    # It fades: the farther from the constraint, the less.
    assert (np.diff(moved[45:61]) <= 1e-3).all()


def test_refinement_stops_at_the_tolerance() -> None:
    motion, constraints = clip(), on_bumps(clip())
    all_levels = fitted("hybrid", False).trace.levels
    loose = fit(motion, constraints, tolerance=0.05, exact=False)
    assert len(loose.trace.levels) < len(all_levels)
    assert worst(loose, constraints) <= 0.05
    tight = fit(motion, constraints, tolerance=1e-9, exact=False)
    assert len(tight.trace.levels) == len(all_levels)


def test_the_first_guess_is_the_contacts_shift() -> None:
    """Ground that is higher everywhere lifts the root, and no knee bends (§4.5)."""
    motion = clip()
    lifted = [pin(motion.model, motion.qpos, s, (0.3, 0.1, 0.2), contact=True) for s in FEET]
    result = fit(motion, lifted)
    shift = ominus(motion.model, result.motion.qpos, motion.qpos)
    np.testing.assert_allclose(
        shift[:, :3], np.tile((0.3, 0.1, 0.2), (motion.nframe, 1)), atol=5e-3
    )
    assert np.abs(shift[:, 3:]).max() < 0.03  # [rad]
    plain = fit(motion, lifted, first_guess=False)
    assert plain.trace.first_error_percent > 10.0 > result.trace.first_error_percent
    given = fit(motion, lifted, first_guess=np.tile((0.3, 0.1, 0.2), (motion.nframe, 1)))
    assert given.trace.first_error_percent < 1e-9


def test_what_cannot_be_met_is_reported() -> None:
    """A hand at twice an arm's length, with the body too stiff to come along."""
    motion = clip()
    head = loop_sites(motion.model, motion.qpos)[:, motion.model.site("head_top").id]
    frames = np.arange(40, 45)
    far = SiteConstraint("left_hand", frames, head[frames] + (0.0, 0.0, 1.2))
    hold = [pin(motion.model, motion.qpos, site) for site in FEET]
    result = fit(motion, [*hold, far])
    (unmet,) = [u for u in result.unmet if "left_hand" in u.constraint]
    assert unmet.frames == tuple(range(40, 45))
    assert unmet.residual_mm == pytest.approx(1000.0 * worst(result, [far]), rel=1e-6)
    assert some(unmet.residual_mm) > 100.0
    targets = lay_out([far], motion.model, motion.nframe)
    assert 1000.0 * residuals(result.motion, targets).max() == pytest.approx(unmet.residual_mm)
    # A wish of less weight is no constraint that could be broken.
    wish = SiteConstraint("left_hand", frames, far.position, weight=0.2)
    assert not any("left_hand" in u.constraint for u in fit(motion, [*hold, wish]).unmet)


@pytest.mark.parametrize("ik", ["hybrid", "numeric"])
def test_targets_at_the_limit_of_an_ankle(ik: str) -> None:
    """Feet that pitch more than their ankles bend: both solvers keep the limits, and say where that
    leaves a target unmet; the numeric one, whose body gives, meets them all."""
    motion = clip()
    constraints = []
    for site in FEET:
        own = pin(motion.model, motion.qpos, site)
        pitch = -0.45 * np.sin(np.pi * own.frames / motion.nframe) ** 2  # toes up [rad]
        turn = np.column_stack((np.cos(pitch / 2), 0 * pitch, np.sin(pitch / 2), 0 * pitch))
        constraints.append(SiteConstraint(site, own.frames, own.position, turn))
    result = fit(motion, constraints, ik=ik)
    assert motion.character.limits.excess(result.motion.qpos).max() < 1e-9
    assert 1000.0 * worst(result, constraints) == pytest.approx(
        max([u.residual_mm or 0.0 for u in result.unmet], default=0.0), abs=1.0
    )
    if ik == "numeric":
        assert worst(result, constraints) < 1e-3  # [m]


def test_rigid_joints_stay() -> None:
    motion, stiff, soft = clip(), default_rigidity(humanoid()), default_rigidity(humanoid())
    root = slice(0, 6)
    stiff[root] *= 1e4
    soft[root] *= 0.1
    for ik in ("hybrid", "numeric"):
        moved = []
        for rigidity in (stiff, None, soft):
            constraints = on_bumps(motion, 0.02)
            solver = make_solver(motion.character, ik, rigidity)
            result = fit(motion, constraints, ik=solver, first_guess=False)
            assert worst(result, constraints) < 1e-4
            moved.append(np.abs(ominus(motion.model, result.motion.qpos, motion.qpos)))
        roots = [one[:, root].max() for one in moved]
        assert roots[0] < 1e-3 and roots[0] < roots[1] < roots[2]
        assert moved[0][:, 6:].max() > moved[2][:, 6:].max() > 0.02


def test_arguments_and_progress() -> None:
    motion, constraints = walk(1.0), on_bumps(walk(1.0), 0.02)
    kept, points = motion.qpos.copy(), some(constraints[0].position).copy()
    calls: list[tuple[str, int, int]] = []
    result = fit(motion, constraints, progress=lambda *step: calls.append(step))
    np.testing.assert_array_equal(motion.qpos, kept)
    np.testing.assert_array_equal(some(constraints[0].position), points)
    assert result.motion is not motion and result.motion.fps == motion.fps
    assert [done for _, done, _ in calls] == list(range(1, len(calls) + 1))
    assert calls[0] == ("fit", 1, 5) and {stage for stage, _, _ in calls} == {"fit"}


def test_twice_is_the_same() -> None:
    again = fit(clip(), on_bumps(clip()))
    np.testing.assert_array_equal(again.motion.qpos, fitted("hybrid", True).motion.qpos)


def test_no_constraints_and_one_frame() -> None:
    motion = walk(0.5)
    np.testing.assert_allclose(fit(motion, []).motion.qpos, motion.qpos, atol=1e-15)
    one = Motion(motion.model, motion.qpos[:1], 30.0)
    result = fit(one, [pin(one.model, one.qpos, "left_foot", (0.0, 0.0, 0.05))])
    assert result.trace.exact_error_percent < EXACT


def test_any_tree_with_a_free_root() -> None:
    """Hinges, slides and balls without any limb: hybrid and numeric both serve."""
    model = mixed()
    motion = Motion(model, np.tile(model.qpos0, (40, 1)), 30.0)
    wave = 0.05 * np.sin(np.arange(40) / 6.0)[:, None] * (1.0, 0.5, 0.2)
    tip = pin(model, motion.qpos, "tip", wave)
    constraints = [SiteConstraint("tip", tip.frames, tip.position)]
    for ik in ("hybrid", "numeric"):
        assert worst(fit(motion, constraints, ik=ik), constraints) < 1e-4


def test_conjugate_gradients_through_the_fit() -> None:
    """The paper's solver in the paper's algorithm, on four frames with feet on a rise."""
    motion = Motion(humanoid(), clip().qpos[20:24], 30.0)
    constraints = on_bumps(motion, 0.03)
    options: dict[str, Any] = {"levels": (4, 2), "first_guess": False, "exact": False}
    slow = fit(motion, constraints, ik=ConjugateGradientIK(motion.model), **options)
    quick = fit(motion, constraints, ik=NumericIK(motion.model, iterations=8), **options)
    apart = ominus(motion.model, slow.motion.qpos, quick.motion.qpos)
    moved = ominus(motion.model, slow.motion.qpos, motion.qpos)
    assert np.abs(apart).max() < 1e-3 < 0.03 < np.abs(moved).max()  # [rad]
    errors = [level.max_error_percent for level in slow.trace.levels]
    assert errors[1] < errors[0]


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "no levels": ({"levels": ()}, "levels is empty"),
    "zero": ({"levels": (16, 0)}, "positive"),
    "nan": ({"levels": (float("nan"),)}, "positive"),
    "fine to coarse": ({"levels": (2, 4)}, "coarse to fine"),
    "levels of words": ({"levels": ("coarse", "fine")}, "frames a knot of each level"),
    "levels of one number": ({"levels": 4}, "frames a knot of each level"),
    "solver": ({"ik": "hybird"}, "Did you mean 'hybrid'"),
    "no solver": ({"ik": fit_level}, "without prepare"),
}


@pytest.mark.parametrize("case", sorted(BAD))
def test_bad_settings(case: str) -> None:
    options, message = BAD[case]
    with pytest.raises(FitError, match=message):
        fit(walk(0.2), [], **options)


BAD_SOLVERS: dict[str, tuple[dict[str, Any], str]] = {
    "unknown": ({"ik": "numerc"}, "Did you mean 'numeric'"),
    "three rigidities": ({"rigidity": np.ones(3)}, "45 positive numbers"),
    "no rigidity": ({"rigidity": np.zeros(45)}, "45 positive numbers"),
    "one without rigidity": ({"rigidity": [1.0] * 44 + [0.0]}, "45 positive numbers"),
    "other bones": (
        {"ik": NumericIK(humanoid()), "bones": Bones.of(humanoid())},
        "NumericIK was not made for a body that changes",
    ),
}


@pytest.mark.parametrize("case", sorted(BAD_SOLVERS))
def test_bad_solvers(case: str) -> None:
    options, message = BAD_SOLVERS[case]
    with pytest.raises(FitError, match=message):
        make_solver(clip().character, **options)


def test_a_solver_is_made_or_returned_as_it_is() -> None:
    own, rigidity = NumericIK(clip().model), np.full(45, 2.0)
    assert make_solver(clip().character, own) is own
    for ik, kind in (("hybrid", HybridIK), ("numeric", NumericIK)):
        made = make_solver(clip().character, ik, rigidity)
        assert type(made) is kind
        np.testing.assert_array_equal(made.rigidity, rigidity)


def test_a_solver_of_one_s_own_needs_two_methods() -> None:
    """Whatever has prepare, solve and enforce serves, unless targets are free to move."""

    class Problem:
        def __init__(self, problem: IKProblem) -> None:
            self._problem = problem

        def solve(
            self,
            qpos: np.ndarray,
            last: Solution | None = None,
            deviation: Deviation | None = None,
        ) -> Solution:
            assert deviation is None
            return self._problem.solve(qpos, last)

        def enforce(self, qpos: np.ndarray) -> Solution:
            return self._problem.enforce(qpos)

    class Own:
        def prepare(self, targets: Targets, clearance: Clearance | None = None) -> IKProblem:
            return Problem(HybridIK(humanoid()).prepare(targets, clearance))

    motion = walk(1.0)
    mine = fit(motion, on_bumps(motion, 0.02), ik=Own())
    np.testing.assert_array_equal(
        mine.motion.qpos, fit(motion, on_bumps(motion, 0.02), ik="hybrid").motion.qpos
    )
    spot = SiteConstraint("left_hand", np.arange(3), np.array((1.0, 0, 1)), free=("x",))
    with pytest.raises(FitError, match=r"Own has no sensitivity\(\).*'hybrid'"):
        fit(motion, [spot], ik=Own())


def test_bad_constraints() -> None:
    with pytest.raises(ConstraintError, match="left_foot"):
        fit(walk(0.2), [SiteConstraint("left_foot", np.array((900,)), np.array((0, 0, 0)))])
    with pytest.raises(ModelError, match="left_fot"):
        fit(walk(0.2), [SiteConstraint("left_fot", np.array((0,)), np.array((0, 0, 0)))])


@pytest.mark.skipif(not G1.is_file(), reason="the robot of ../shared/robots is not here")
def test_a_robot_of_29_hinges() -> None:
    """Nothing knows the humanoid: the robot steps in place on a moving floor."""
    model = mujoco.MjModel.from_xml_path(str(G1))
    qpos = np.tile(model.qpos0, (60, 1))
    for side in ("left", "right"):
        for name, angle in (("hip_pitch", -0.4), ("knee", 0.8), ("ankle_pitch", -0.4)):
            qpos[:, model.joint(f"{side}_{name}_joint").qposadr[0]] = angle
    motion = Motion(model, qpos, 30.0)
    phase = np.arange(60)[:, None] / 60.0
    constraints = []
    for site, sign in (("left_foot", 1.0), ("right_foot", -1.0)):
        lift = 0.06 * np.maximum(0.0, sign * np.sin(4.0 * np.pi * phase)) ** 2
        floor = 0.04 * np.sin(2.0 * np.pi * phase)
        shift = (lift + floor) * (0, 0, 1) + 0.05 * phase * (1, 0.3, 0)
        constraints.append(pin(model, qpos, site, shift, contact=True))
    assert (model.jnt_type[1:] == mujoco.mjtJoint.mjJNT_HINGE).all() and model.njnt == 30
    result = fit(motion, constraints, ik="numeric")
    errors = [level.max_error_percent for level in result.trace.levels]
    assert errors[3] < errors[0]
    assert worst(result, constraints) < 1e-3 and result.unmet == ()
    for constraint in constraints:
        quat = loop_quats(model, result.motion.qpos, constraint.site)
        assert np.abs(log(multiply(conjugate(quat), some(constraint.quat)))).max() < 0.01  # [rad]
    assert Character.of(model).limits.excess(result.motion.qpos).max() < 1e-9
