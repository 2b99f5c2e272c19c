"""Inverse kinematics: Eq. 7 in closed form, numeric, hybrid, and by conjugate gradients."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from made_up import HIP, SHANK, SOLE, THIGH, humanoid, loop_quats, loop_sites, mixed, pin, some
from made_up import random_poses as poses

from mjmotion.body.character import Character
from mjmotion.body.joint_limits import swing_twist
from mjmotion.body.kinematics import Kinematics
from mjmotion.body.limbs import Limbs, find_limbs
from mjmotion.constraints import SiteConstraint, Targets, lay_out
from mjmotion.ik.hybrid import HybridIK
from mjmotion.ik.numeric import NumericIK, least_deviation
from mjmotion.ik.solver import Deviation, IKSolver, Inequalities, default_rigidity
from mjmotion.numerics.rotations import conjugate, exp, log, multiply
from mjmotion.numerics.tangent import ominus, oplus
from mjmotion.paper.conjugate_gradients import (
    ConjugateGradientIK,
    PenaltyObjective,
    right_jacobian,
    swing_twist_jacobian,
)

ROUNDING = 1e-9  # [m] or [rad]
SAME_POSE = 2e-3  # between solvers that both have converged [rad]
STEPS = 12  # Gauss–Newton steps after which the numeric solver has converged
FEET = ("left_foot", "right_foot")
# A limb without any symmetry: a slanted knee axis, anchors off the origins, turned bodies.
SLANTED = """<mujoco><compiler angle="radian"/><worldbody>
<body name="base" pos="0 0 1" euler=".1 .2 .3"><freejoint/><geom size=".1"/>
 <body name="upper" pos=".02 .1 -.05" euler=".2 -.1 .3"><joint type="ball" pos=".01 .02 -.01"/>
  <geom size=".05"/>
  <body name="lower" pos=".03 -.01 -.4" euler="-.1 .05 .2">
   <joint type="hinge" axis=".1 1 .2" pos="-.01 .02 .03" ref=".1" range="0 2.5"/><geom size=".05"/>
   <body name="end" pos="-.02 .03 -.38" euler=".05 .1 -.2"><joint type="ball" pos=".02 .01 .01"/>
    <geom size=".05"/><site name="end" pos=".1 .02 -.05" euler=".3 .2 .1"/>
 </body></body></body></body></worldbody></mujoco>"""


def slanted() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(SLANTED)


def slanted_poses(model: mujoco.MjModel, count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    qpos = np.tile(model.qpos0, (count, 1))
    for row, step in zip(qpos, 0.4 * rng.normal(size=(count, model.nv)), strict=True):
        mujoco.mj_integratePos(model, row, step, 1.0)
    qpos[:, 11] = rng.uniform(0.5, 1.5, count)
    return qpos


def moved_feet(qpos: np.ndarray, seed: int, size: float = 0.03) -> Targets:
    """Both feet of the humanoid to be elsewhere by about ``size`` [m], turned by thrice that."""
    model, rng = humanoid(), np.random.default_rng(seed)
    constraints = []
    for site in FEET:
        held = pin(model, qpos, site, size * rng.normal(size=(len(qpos), 3)))
        turn = exp(3.0 * size * rng.normal(size=(len(qpos), 3)))
        constraints.append(
            SiteConstraint(site, held.frames, held.position, multiply(some(held.quat), turn))
        )
    return lay_out(constraints, model, len(qpos))


def gaps(model: mujoco.MjModel, qpos: np.ndarray, targets: Targets) -> tuple[float, float]:
    """Largest position [m] and orientation [rad] errors, from MuJoCo frame by frame."""
    sites = loop_sites(model, qpos)[:, targets.sites]
    names = [model.site(site).name for site in targets.sites.tolist()]
    held = targets.position_weight > 0
    place = np.linalg.norm(sites - targets.position, axis=-1) * held
    turn = [
        np.linalg.norm(log(multiply(conjugate(loop_quats(model, qpos, name)), quat)), axis=1)
        for name, quat in zip(names, np.swapaxes(targets.quat, 0, 1), strict=True)
    ]
    return float(place.max()), float((np.array(turn).T * (targets.turn_weight > 0)).max())


# Eq. 7 and the closed-form limb


def test_limbs_are_found_by_their_joints() -> None:
    model = humanoid()
    names = {
        tuple(model.body(b).name for b in (x.base, x.upper, x.lower, x.end))
        for x in find_limbs(model)
    }
    assert names == {
        ("torso", f"{side}_upper_arm", f"{side}_forearm", f"{side}_hand")
        for side in ("left", "right")
    } | {("pelvis", f"{side}_thigh", f"{side}_shank", f"{side}_foot") for side in ("left", "right")}
    assert len(find_limbs(slanted())) == 1
    assert find_limbs(mixed()) == ()


@pytest.mark.parametrize("name", ["left_thigh", "right_upper_arm", "slanted"])
def test_knee_angle_is_equation_7(name: str) -> None:
    """The paper's formula, word by word, from lengths that are measured on MuJoCo's own pose."""
    model = slanted() if name == "slanted" else humanoid()
    limb = next(x for x in find_limbs(model) if name in ("slanted", model.body(x.upper).name))
    limbs, data = Limbs(model, [limb]), mujoco.MjData(model)
    hip, knee, ankle = (int(model.body_jntadr[b]) for b in (limb.upper, limb.lower, limb.end))
    at = model.jnt_qposadr[knee]
    for angle in (0.3, 0.9, 1.6, 2.2):
        data.qpos[:] = model.qpos0
        data.qpos[at] = angle
        mujoco.mj_kinematics(model, data)
        p, axis = data.xanchor[[hip, knee, ankle]], data.xaxis[knee]
        distance = np.linalg.norm(p[2] - p[0])
        mine = limbs.knee_angle(np.full((1, 1), distance**2))[0, 0]
        assert mine + model.qpos0[at] == pytest.approx(angle, abs=1e-9)
        # Eq. 7: φ is the angle between the projections, seen along the axis.
        upper, lower = p[0] - p[1], p[2] - p[1]
        flat = [v - (v @ axis) * axis for v in (upper, lower)]
        l1, l2, r1, r2 = (float(np.linalg.norm(v)) for v in (upper, lower, *flat))
        # s1 and s2 point to either side of the joint; else their product changes sign.
        s = -np.sign((upper @ axis) * (lower @ axis)) * np.sqrt((l1**2 - r1**2) * (l2**2 - r2**2))
        cosine = (l1**2 + l2**2 + 2.0 * s - distance**2) / (2.0 * r1 * r2)
        phi = np.arccos(flat[0] @ flat[1] / (r1 * r2))
        assert np.arccos(cosine) == pytest.approx(phi, abs=1e-7)


@pytest.mark.parametrize("name", ["humanoid", "slanted"])
def test_state_is_mujocos(name: str) -> None:
    model = humanoid() if name == "humanoid" else slanted()
    qpos = poses(model, 5, 1) if name == "humanoid" else slanted_poses(model, 5, 1)
    limbs = Limbs(model, find_limbs(model))
    state, pose = limbs.state(qpos), Kinematics(model, 5).forward(qpos)
    for number, limb in enumerate(limbs.limbs):
        hip, ankle = (pose.xanchor[:, model.body_jntadr[b]] for b in (limb.upper, limb.end))
        np.testing.assert_allclose(state.hip[:, number], hip, atol=ROUNDING)
        base = pose.xmat[:, limb.base]
        local = np.einsum("nji,nj->ni", base, ankle - hip)
        np.testing.assert_allclose(state.ankle[:, number], local, atol=ROUNDING)
        end = multiply(state.base_quat, state.end)[:, number]
        assert np.abs(log(multiply(conjugate(end), pose.xquat[:, limb.end]))).max() < ROUNDING


@pytest.mark.parametrize("name", ["humanoid", "slanted"])
def test_closing_a_limb_meets_its_target(name: str) -> None:
    """The hybrid solver's exact pass puts feet, hands and slanted ends where they have to be."""
    if name == "humanoid":
        model, qpos = humanoid(), poses(humanoid(), 30, 2)
        targets = moved_feet(qpos, 6, 0.02)
    else:
        model, qpos = slanted(), slanted_poses(slanted(), 30, 2)
        shift = 0.02 * np.random.default_rng(4).normal(size=(30, 3))
        targets = lay_out([pin(model, qpos, "end", shift)], model, 30)
    solution = HybridIK(model).prepare(targets).enforce(qpos)
    closed = oplus(model, qpos, solution.displacement)
    assert max(gaps(model, closed, targets)) < 1e-9
    assert (solution.displacement[:, :6] == 0.0).all()
    assert solution.error.max() == pytest.approx(gaps(model, qpos, targets)[0])


def test_closed_form_and_numeric_legs_are_the_same() -> None:
    """With a root too stiff to move, knees have one angle; swivels are free and may differ."""
    model, qpos = humanoid(), poses(humanoid(), 10, 5, 0.15)
    targets = moved_feet(qpos, 6, 0.01)
    closed = HybridIK(model).prepare(targets).enforce(qpos).displacement
    numeric = NumericIK(model, iterations=STEPS).prepare(targets).enforce(qpos).displacement
    knees = [model.joint(f"{side}_knee").dofadr[0] for side in ("left", "right")]
    np.testing.assert_allclose(closed[:, knees], numeric[:, knees], atol=5e-3)
    assert max(gaps(model, oplus(model, qpos, numeric), targets)) < 1e-6


@pytest.mark.parametrize("name", ["humanoid", "slanted"])
def test_closure_rates_are_finite_differences(name: str) -> None:
    """How a limb follows its base, by moving the base a little and closing the limb again."""
    model = humanoid() if name == "humanoid" else slanted()
    qpos = poses(model, 3, 7) if name == "humanoid" else slanted_poses(model, 3, 7)
    limb = find_limbs(model)[0]
    limbs, step, rng = Limbs(model, [limb]), 1e-6, np.random.default_rng(8)
    state = limbs.state(qpos)
    follow, ankles, _ = limbs.closure(state)
    ankle = state.hip + _turn(state.base_quat, state.ankle)
    end = multiply(state.base_quat, state.end)
    push = np.zeros((3, model.nv))
    push[:, :6] = rng.normal(size=(3, 6))
    moved = oplus(model, qpos, step * push)
    after = limbs.state(moved)
    goal = _turn(conjugate(after.base_quat), ankle - after.hip)
    closed = limbs.close(after, goal, multiply(conjugate(after.base_quat), end))
    # The twist of the base at the ankle, in its own frame, from how a point fixed to it moved.
    carried = after.hip + _turn(after.base_quat, state.ankle)
    velocity = _turn(conjugate(state.base_quat), carried - ankle) / step
    spin = log(multiply(conjugate(state.base_quat), after.base_quat)) / step
    rates = (follow @ velocity[..., None])[..., 0]
    rates[..., 4:] += (ankles @ spin[..., None])[..., 0]
    np.testing.assert_allclose(closed / step, rates, rtol=1e-4, atol=1e-4)


def _turn(quat: np.ndarray, vector: np.ndarray) -> np.ndarray:
    from mjmotion.numerics.rotations import rotate

    return rotate(quat, vector)


def test_swivelling_keeps_the_end_in_place() -> None:
    """The elbow circle: only the knee moves, and by the radius of its circle."""
    model, step = humanoid(), 1e-5
    qpos = poses(model, 4, 9)
    limbs = Limbs(model, find_limbs(model))
    _, _, swivel = limbs.closure(limbs.state(qpos))
    for number, limb in enumerate(limbs.limbs):
        displacement = np.zeros((4, model.nv))
        displacement[:, limbs.dofs[number]] = step * swivel[:, number]
        before, after = (
            Kinematics(model, 4).forward(q) for q in (qpos, oplus(model, qpos, displacement))
        )
        np.testing.assert_allclose(after.xpos[:, limb.end], before.xpos[:, limb.end], atol=1e-9)
        np.testing.assert_allclose(after.xmat[:, limb.end], before.xmat[:, limb.end], atol=1e-9)
        knee = np.linalg.norm(after.xpos[:, limb.lower] - before.xpos[:, limb.lower], axis=1)
        assert (knee > 0.02 * step).all()


def one_foot(position: np.ndarray) -> tuple[mujoco.MjModel, np.ndarray, Targets]:
    """The humanoid at rest, knees a little bent, with its left foot wanted somewhere, level."""
    model = humanoid()
    qpos = model.qpos0[None].copy()
    qpos[:, model.joint("left_knee").qposadr[0]] = 0.2
    constraint = SiteConstraint("left_foot", np.array((0,)), position, np.array((1, 0, 0, 0)))
    return model, qpos, lay_out([constraint], model, 1)


@pytest.mark.parametrize("way", [(0, 0, -1), (0.5, 0, -1), (0.3, 0.4, -1), (1, 0, -0.3)])
def test_out_of_reach_a_leg_stretches_as_far_as_it_goes(way: tuple[float, ...]) -> None:
    """§5.3: towards the target, straight, and what is missing is left."""
    hip, line = np.array((0.0, 0.09, HIP)), np.array(way) / np.linalg.norm(way)
    model, qpos, targets = one_foot(hip + 1.1 * line - (0, 0, SOLE))
    found = oplus(model, qpos, HybridIK(model).prepare(targets).enforce(qpos).displacement)
    ankle = loop_sites(model, found)[0, model.site("left_foot").id] + (0, 0, SOLE)
    np.testing.assert_allclose(ankle, hip + (THIGH + SHANK) * line, atol=1e-9)
    assert found[0, model.joint("left_knee").qposadr[0]] == pytest.approx(0.0, abs=1e-7)
    assert Limbs(model, find_limbs(model)).reach.max() == pytest.approx(THIGH + SHANK)


def test_too_near_a_knee_bends_to_its_limit() -> None:
    model, qpos, targets = one_foot(np.array((0.0, 0.09, HIP - 0.1 - SOLE)))
    found = oplus(model, qpos, HybridIK(model).prepare(targets).enforce(qpos).displacement)
    knee = model.joint("left_knee")
    assert found[0, knee.qposadr[0]] == pytest.approx(model.jnt_range[knee.id, 1])


def test_at_the_edge_of_reach_nothing_jumps() -> None:
    """Targets that go out of reach bit by bit: poses stay finite and near each other."""
    model = humanoid()
    heights = np.linspace(0.0, -0.08, 81) - 0.02
    qpos = np.tile(model.qpos0, (81, 1))
    qpos[:, model.joint("left_knee").qposadr[0]] = 0.2
    position = np.column_stack((np.zeros(81), np.full(81, 0.09), heights + 0.05))
    targets = lay_out([SiteConstraint("left_foot", np.arange(81), position)], model, 81)
    for solver in (HybridIK(model), NumericIK(model)):
        displacement = solver.prepare(targets).solve(qpos).displacement
        assert np.isfinite(displacement).all() and np.abs(displacement).max() < 0.9  # [rad]


# All solvers

SOLVERS = {"numeric": NumericIK, "hybrid": HybridIK, "conjugate gradients": ConjugateGradientIK}


def rough(name: str) -> IKSolver:
    """A solver for what does not depend on how far it goes: one round of conjugate gradients."""
    if name == "conjugate gradients":
        return ConjugateGradientIK(humanoid(), penalties=(1e3,))
    return SOLVERS[name](humanoid())


@pytest.mark.parametrize("name", sorted(SOLVERS))
def test_satisfied_constraints_give_no_displacement(name: str) -> None:
    model, qpos = humanoid(), poses(humanoid(), 5, 10)
    constraints = [pin(model, qpos, site) for site in (*FEET, "left_hand")]
    targets = lay_out(constraints, model, 5)
    solver = SOLVERS[name](model)
    for solution in (solver.prepare(targets).solve(qpos), solver.prepare(targets).enforce(qpos)):
        assert np.abs(solution.displacement).max() < ROUNDING
        assert solution.error.max() < ROUNDING


@pytest.mark.parametrize("name", sorted(SOLVERS))
def test_arguments_stay_and_calls_do_not_remember(name: str) -> None:
    model, qpos = humanoid(), poses(humanoid(), 2, 11)
    targets, other = moved_feet(qpos, 12, 0.01), moved_feet(qpos, 13, 0.02)
    kept, solver = qpos.copy(), rough(name)
    first = solver.prepare(targets).solve(qpos)
    solver.prepare(other).solve(qpos)
    np.testing.assert_array_equal(
        solver.prepare(targets).solve(qpos).displacement, first.displacement
    )
    np.testing.assert_array_equal(qpos, kept)
    assert first.error.max() == pytest.approx(gaps(model, qpos, targets)[0], abs=1e-12)


@pytest.mark.parametrize("name", sorted(SOLVERS))
def test_problems_of_one_solver_are_independent(name: str) -> None:
    """Two are prepared before either is solved: each holds its own targets, none the other's."""
    model, qpos = humanoid(), poses(humanoid(), 1, 11)
    targets, other = moved_feet(qpos, 12, 0.01), moved_feet(qpos, 13, 0.02)
    solver = rough(name)
    one, two = solver.prepare(targets), solver.prepare(other)
    for problem, mine, its in ((two, other, targets), (one, targets, other)):
        alone = rough(name).prepare(mine)
        solved, closed = problem.solve(qpos), problem.enforce(qpos)
        np.testing.assert_array_equal(solved.displacement, alone.solve(qpos).displacement)
        np.testing.assert_array_equal(closed.displacement, alone.enforce(qpos).displacement)
        assert solved.error.max() == pytest.approx(gaps(model, qpos, mine)[0], abs=1e-12)
        moved = oplus(model, qpos, closed.displacement)
        assert 5.0 * gaps(model, moved, mine)[0] < gaps(model, moved, its)[0]


@pytest.mark.parametrize("name", sorted(SOLVERS))
def test_an_array_changed_in_place_between_two_solves_is_seen(name: str) -> None:
    """Nothing is remembered by which array it came in."""
    model, qpos = humanoid(), poses(humanoid(), 1, 11)
    targets, rng = moved_feet(qpos, 12, 0.01), np.random.default_rng(36)
    later = oplus(model, qpos, 0.02 * rng.normal(size=(1, model.nv)))
    problem, given = rough(name).prepare(targets), qpos.copy()
    for call in (problem.solve, problem.enforce):
        given[:] = qpos
        first = call(given)
        given[:] = later
        second = call(given)
        alone = getattr(rough(name).prepare(targets), call.__name__)(later)
        np.testing.assert_array_equal(second.displacement, alone.displacement)
        np.testing.assert_array_equal(second.error, alone.error)
        assert np.abs(second.displacement - first.displacement).max() > 0.01  # [rad]


@pytest.mark.parametrize("name", sorted(SOLVERS))
def test_frames_do_not_know_of_each_other(name: str) -> None:
    qpos = poses(humanoid(), 3, 14)
    targets, solver = moved_feet(qpos, 15, 0.01), rough(name)
    together = solver.prepare(targets).solve(qpos).displacement
    for row in (0, 2):
        alone = solver.prepare(targets.at(np.array([row]))).solve(qpos[[row]]).displacement
        np.testing.assert_allclose(alone[0], together[row], atol=1e-10)


def test_numeric_and_conjugate_gradients_find_the_same_pose() -> None:
    model, qpos = humanoid(), poses(humanoid(), 3, 16, 0.15)
    targets = moved_feet(qpos, 17)
    mine = NumericIK(model, iterations=STEPS).prepare(targets).solve(qpos).displacement
    reference = ConjugateGradientIK(model).prepare(targets).solve(qpos).displacement
    assert np.abs(mine).max() > 0.05  # [rad]: there was something to do
    np.testing.assert_allclose(mine, reference, atol=SAME_POSE)
    assert max(gaps(model, oplus(model, qpos, reference), targets)) < 1e-5
    weights = default_rigidity(model)
    costs = [np.sum(weights * d * d, axis=1) for d in (mine, reference)]
    np.testing.assert_allclose(costs[0], costs[1], rtol=1e-3)


def test_hybrid_and_numeric_find_the_same_pose() -> None:
    """Solved again and again from where they came to, both meet the targets with poses of the same
    cost; one round of the hybrid is one Gauss–Newton step, so small targets agree in pose too."""
    model, qpos = humanoid(), poses(humanoid(), 8, 18, 0.15)
    targets = moved_feet(qpos, 19, 0.004)
    one = HybridIK(model).prepare(targets).solve(qpos).displacement
    other = NumericIK(model, iterations=STEPS).prepare(targets).solve(qpos).displacement
    np.testing.assert_allclose(one, other, atol=5e-3)
    moved = qpos
    far = moved_feet(qpos, 20, 0.03)
    for _ in range(4):
        moved = oplus(model, moved, HybridIK(model).prepare(far).solve(moved).displacement)
    assert max(gaps(model, moved, far)) < 1e-4


def test_the_displacement_is_the_least() -> None:
    """Any other pose near by that meets the targets costs more (Eq. 4)."""
    model, qpos = humanoid(), poses(humanoid(), 4, 21, 0.15)
    targets, weights = moved_feet(qpos, 22), default_rigidity(model)
    best = NumericIK(model, iterations=STEPS).prepare(targets).solve(qpos).displacement
    cost = np.sum(weights * best * best, axis=1)
    rng = np.random.default_rng(23)
    closer = NumericIK(model, np.ones(model.nv), iterations=STEPS)
    for _ in range(20):
        nudged = oplus(model, qpos, best + 0.05 * rng.normal(size=best.shape))
        back = (
            closer.prepare(targets).solve(nudged).displacement
        )  # onto the targets again, by any way
        other = ominus(model, oplus(model, nudged, back), qpos)
        # Neck, head and wrists serve nothing and only add cost; the test is about the others.
        idle = best == 0.0
        other[idle] = 0.0
        assert max(gaps(model, oplus(model, qpos, other), targets)) < 1e-5
        assert (np.sum(weights * other * other, axis=1) > cost).all()


@pytest.mark.parametrize("name", ["numeric", "hybrid"])
def test_rigid_joints_move_less(name: str) -> None:
    model, qpos = humanoid(), poses(humanoid(), 5, 24, 0.15)
    targets, weights = moved_feet(qpos, 25, 0.01), default_rigidity(model)
    root, knees = slice(0, 6), [model.joint(f"{s}_knee").dofadr[0] for s in ("left", "right")]
    solver = SOLVERS[name]
    usual = solver(model, weights).prepare(targets).solve(qpos).displacement
    stiff, soft = weights.copy(), weights.copy()
    stiff[root] *= 1e6
    soft[root] *= 1e-3
    assert (
        np.abs(solver(model, stiff).prepare(targets).solve(qpos).displacement[:, root]).max() < 1e-4
    )
    free = solver(model, soft).prepare(targets).solve(qpos).displacement
    norm = np.linalg.norm
    assert (norm(free[:, root], axis=1) > norm(usual[:, root], axis=1)).all()
    assert norm(free[:, knees]) < norm(usual[:, knees])


def test_default_rigidity() -> None:
    model = humanoid()
    weights = default_rigidity(model)
    assert weights.shape == (model.nv,) and (weights > 0).all()
    at = {
        name: weights[model.joint(name).dofadr[0]] for name in ("spine", "left_knee", "left_wrist")
    }
    assert at["spine"] > at["left_knee"] > at["left_wrist"]
    assert weights[:6].min() > at["spine"]


@pytest.mark.parametrize("name", ["numeric", "conjugate gradients"])
def test_a_wish_gives_way(name: str) -> None:
    """The lighter a target, the more of it is left."""
    model, qpos = humanoid(), poses(humanoid(), 2, 26, 0.15)
    left = []
    for weight in (0.02, 0.2, 0.6, 1.0):
        wish = pin(model, qpos, "head_top", (0.0, 0.0, -0.1), weight=weight)
        targets = lay_out([wish], model, 2)
        solver = NumericIK(model, iterations=STEPS) if name == "numeric" else SOLVERS[name](model)
        found = oplus(model, qpos, solver.prepare(targets).solve(qpos).displacement)
        left.append(gaps(model, found, targets)[0])
    assert left[0] > left[1] > left[2] > left[3] and left[0] < 0.1
    assert left[3] < 1e-4


def test_wishes_weigh_the_same_in_both_solvers() -> None:
    model, qpos = humanoid(), poses(humanoid(), 2, 26, 0.15)
    targets = lay_out([pin(model, qpos, "head_top", (0, 0, -0.1), weight=0.3)], model, 2)
    mine = NumericIK(model, iterations=STEPS).prepare(targets).solve(qpos).displacement
    reference = ConjugateGradientIK(model).prepare(targets).solve(qpos).displacement
    np.testing.assert_allclose(mine, reference, atol=5 * SAME_POSE)


class Ceiling:
    """Keep the top of the head under a height [m]."""

    def __init__(self, model: mujoco.MjModel, height: float) -> None:
        self.model, self.height = model, height
        self.asked: list[np.ndarray] = []
        self._kinematics: dict[int, Kinematics] = {}

    def __call__(self, qpos: np.ndarray, frames: np.ndarray) -> Inequalities:
        self.asked.append(np.array(frames))
        site, count = self.model.site("head_top"), len(qpos)
        if count not in self._kinematics:
            self._kinematics[count] = Kinematics(self.model, count)
        pose = self._kinematics[count].forward(qpos)
        top = pose.site_xpos[:, site.id]
        rows = pose.rows(
            np.arange(count),
            top,
            np.full(count, site.bodyid[0]),
            np.tile((0.0, 0.0, -1.0), (count, 1)),
        )
        needed = top[:, 2] - self.height
        low = needed > 0.0
        return Inequalities(np.flatnonzero(low), rows[low], needed[low], -needed[low])


@pytest.mark.parametrize("name", sorted(SOLVERS))
def test_inequalities_are_pushed_out(name: str) -> None:
    """A head under a ceiling that only some frames touch, feet on their places all the while."""
    model = humanoid()
    qpos = np.tile(model.qpos0, (3, 1))
    for side in ("left", "right"):
        qpos[:, model.joint(f"{side}_knee").qposadr[0]] = 0.5
    qpos[:, 2] = (0.88, 0.80, 0.70)
    tops = loop_sites(model, qpos)[:, model.site("head_top").id, 2]
    ceiling = Ceiling(model, float(tops[1]) - 0.02)
    targets = lay_out([pin(model, qpos, site) for site in FEET], model, 3)
    solver, moved = SOLVERS[name](model), qpos
    for _ in range(1 if name == "conjugate gradients" else 4):
        moved = oplus(model, moved, solver.prepare(targets, ceiling).solve(moved).displacement)
    after = loop_sites(model, moved)[:, model.site("head_top").id, 2]
    assert after[:2].max() < ceiling.height + 2e-3
    np.testing.assert_allclose(moved[2], qpos[2], atol=ROUNDING)
    assert max(gaps(model, moved, targets)) < 2e-3
    assert all(set(frames) <= {0, 1, 2} for frames in ceiling.asked)


@pytest.mark.parametrize("name", ["numeric", "conjugate gradients"])
def test_limits_are_kept(name: str) -> None:
    """A foot that only a knee beyond its range would bring there, and a hand behind the back."""
    model = humanoid()
    qpos = np.tile(model.qpos0, (2, 1))
    stiff = default_rigidity(model)
    stiff[:6] *= 1e4
    constraints = [
        SiteConstraint(
            "left_foot", np.array((0,)), np.array((-0.1, 0.09, 0.75)), np.array((1, 0, 0, 0))
        ),
        SiteConstraint("right_hand", np.array((1,)), np.array((-0.6, 0.2, 1.2))),
    ]
    targets = lay_out(constraints, model, 2)
    solver = (
        NumericIK(model, stiff, iterations=8)
        if name == "numeric"
        else (ConjugateGradientIK(model, stiff))
    )
    moved = oplus(model, qpos, solver.prepare(targets).solve(qpos).displacement)
    assert Character.of(model).limits.excess(moved).max() < (
        1e-9 if name == "numeric" else 1e-3
    )  # [rad]
    before = np.linalg.norm(loop_sites(model, qpos)[0, targets.sites[0]] - (-0.1, 0.09, 0.75))
    assert (
        np.linalg.norm(loop_sites(model, moved)[0, targets.sites[0]] - (-0.1, 0.09, 0.75)) < before
    )


def test_numeric_solves_any_tree() -> None:
    """Slides, hinges and balls off their bodies' origins, in a model with no limbs at all."""
    model, qpos = mixed(), poses(mixed(), 20, 27)
    rng = np.random.default_rng(28)
    tip = pin(model, qpos, "tip", 0.05 * rng.normal(size=(20, 3)))
    constraints = [
        SiteConstraint("tip", tip.frames, tip.position),
        pin(model, qpos, "other", 0.02),
    ]
    targets = lay_out(constraints, model, 20)
    for solver in (NumericIK(model, iterations=STEPS), HybridIK(model)):
        moved = qpos
        for _ in range(6):
            moved = oplus(model, moved, solver.prepare(targets).solve(moved).displacement)
        assert max(gaps(model, moved, targets)) < 1e-5
    exact = oplus(model, qpos, NumericIK(model).prepare(targets).enforce(qpos).displacement)
    assert max(gaps(model, exact, targets)) < 2e-3  # six steps, with the root nearly still


def test_hybrid_takes_sites_on_no_limb_too() -> None:
    model, qpos = humanoid(), poses(humanoid(), 4, 29, 0.15)
    constraints = [pin(model, qpos, "left_foot", 0.01), pin(model, qpos, "face", (0.02, 0, -0.02))]
    targets = lay_out(constraints, model, 4)
    moved = qpos
    for _ in range(4):
        moved = oplus(model, moved, HybridIK(model).prepare(targets).solve(moved).displacement)
    assert max(gaps(model, moved, targets)) < 1e-3


def test_position_or_orientation_alone() -> None:
    """What a constraint does not name stays free: cheaper than holding both."""
    model, qpos = humanoid(), poses(humanoid(), 4, 30, 0.15)
    both = pin(model, qpos, "left_foot", (0.0, 0.0, 0.05))
    place = SiteConstraint("left_foot", both.frames, both.position)
    turned = multiply(np.asarray(both.quat), exp(np.array((0.0, 0.1, 0.1))))
    turn = SiteConstraint("left_foot", both.frames, None, turned)
    for solver in (NumericIK(model, iterations=STEPS), HybridIK(model)):
        for constraint in (place, turn):
            targets, moved = lay_out([constraint], model, 4), qpos
            for _ in range(4):
                moved = oplus(model, moved, solver.prepare(targets).solve(moved).displacement)
            assert max(gaps(model, moved, targets)) < 1e-4
    weights = default_rigidity(model)
    costs = [
        np.sum(
            weights * NumericIK(model).prepare(lay_out([c], model, 4)).solve(qpos).displacement ** 2
        )
        for c in (place, both)
    ]
    assert costs[0] < costs[1]


def test_least_deviation_is_a_least_norm_solution() -> None:
    rng = np.random.default_rng(31)
    jacobian, error = rng.normal(size=(3, 4, 9)), rng.normal(size=(3, 4))
    freedom, previous = rng.uniform(0.5, 2.0, (3, 9)), rng.normal(size=(3, 9))
    found, _ = least_deviation(jacobian, error, np.zeros((3, 4)), freedom, previous)
    for row in range(3):
        wanted = error[row] + jacobian[row] @ previous[row]
        root = np.sqrt(freedom[row])
        pseudo = root * (np.linalg.pinv(jacobian[row] * root) @ wanted)
        np.testing.assert_allclose(found[row], pseudo, atol=1e-6)


@pytest.mark.parametrize("name", ["numeric", "hybrid"])
def test_a_body_at_its_limit_is_left_there(name: str) -> None:
    """Hands so far in front that the body would bend further than its spine goes."""
    model = humanoid()
    qpos = np.tile(model.qpos0, (3, 1))
    for side in ("left", "right"):
        qpos[:, model.joint(f"{side}_elbow").qposadr[0]] = 0.3
    at = model.joint("spine").qposadr[0]
    qpos[:, at : at + 4] = exp(np.array((0.0, 1.25, 0.0)))  # of 1.309 that it can
    hands = [pin(model, qpos, f"{side}_hand", (0.3, 0.0, -0.3)) for side in ("left", "right")]
    targets = lay_out([SiteConstraint(h.site, h.frames, h.position) for h in hands], model, 3)
    moved = oplus(model, qpos, SOLVERS[name](model).prepare(targets).solve(qpos).displacement)
    columns = [
        i for i, part in enumerate(Character.of(model).limits.names) if part.startswith("spine")
    ]
    assert Character.of(model).limits.excess(moved)[:, columns].max() < 1e-4
    free = HybridIK(model)
    for _ in range(8):
        moved = oplus(model, moved, free.prepare(targets).solve(moved).displacement)
    assert gaps(model, moved, targets)[0] < 1e-3
    assert Character.of(model).limits.excess(moved)[:, columns].max() < 1e-3


def toes_down(model: mujoco.MjModel, nframe: int) -> tuple[np.ndarray, Targets]:
    """Feet where they are, heels raised further than ankles bend: the shanks have to lean."""
    qpos = np.tile(model.qpos0, (nframe, 1))
    for side in ("left", "right"):
        qpos[:, model.joint(f"{side}_knee").qposadr[0]] = 0.2
    feet = [pin(model, qpos, site) for site in FEET]
    turn = exp(np.array((0.0, 1.2, 0.0)))
    raised = [
        SiteConstraint(f.site, f.frames, f.position, multiply(turn, some(f.quat))) for f in feet
    ]
    return qpos, lay_out(raised, model, nframe)


def test_joints_at_their_edges_are_held_from_level_to_level() -> None:
    """With a deviation to keep least, what would leave its range is held, and the body gives."""
    model = humanoid()
    guess, targets = toes_down(model, 2)
    problem, limits = HybridIK(model).prepare(targets), Character.of(model).limits
    over: dict[str, list[float]] = {"held": [], "loose": []}
    for name, excess in over.items():
        moved, last = guess, None
        for _ in range(8):
            so_far = Deviation(ominus(model, moved, guess), np.ones(2, dtype=bool))
            last = problem.solve(moved, last, so_far if name == "held" else None)
            moved = oplus(model, moved, last.displacement)
            excess.append(float(limits.excess(moved).max()))
        assert gaps(model, moved, targets)[0] < 0.02
    assert over["loose"][-1] > 0.1 and over["held"][-1] < 1e-3


def at_the_edge() -> tuple[np.ndarray, np.ndarray, Targets]:
    """A guess, poses some levels on with ankles at the edge of their range, and their targets."""
    model = humanoid()
    guess, targets = toes_down(model, 2)
    problem, moved, last = HybridIK(model).prepare(targets), guess, None
    for _ in range(3):
        deviation = Deviation(ominus(model, moved, guess), np.ones(2, dtype=bool))
        last = problem.solve(moved, last, deviation)
        moved = oplus(model, moved, last.displacement)
    return guess, moved, targets


def test_edges_are_handed_on_in_the_solution_and_nowhere_else() -> None:
    """A level that is not given the one before begins anew, whatever its problem has solved."""
    guess, moved, targets = at_the_edge()
    deviation = Deviation(ominus(humanoid(), moved, guess), np.ones(2, dtype=bool))
    problem = HybridIK(humanoid()).prepare(targets)
    first = problem.solve(moved, deviation=deviation)
    handed_on = problem.solve(moved, first, deviation).displacement
    again = problem.solve(moved, deviation=deviation).displacement
    np.testing.assert_array_equal(again, first.displacement)
    assert np.abs(handed_on - again).max() > 1e-3  # [rad]


@pytest.mark.parametrize("counts", [(False, False), (True, False)])
def test_frames_whose_deviation_does_not_count_hold_no_edges(counts: tuple[bool, bool]) -> None:
    """They are solved as without one, the others as if all counted."""
    guess, moved, targets = at_the_edge()
    problem, mask = HybridIK(humanoid()).prepare(targets), np.array(counts)
    so_far = ominus(humanoid(), moved, guess)
    whole = Deviation(so_far, np.ones(2, dtype=bool))
    some_of_it = Deviation(so_far * mask[:, None], mask)
    plain = problem.solve(moved).displacement
    first, one = problem.solve(moved, None, whole), problem.solve(moved, None, some_of_it)
    held = problem.solve(moved, first, whole).displacement
    assert np.abs(held - first.displacement).max() > 1e-3  # [rad]: something is held
    found = problem.solve(moved, one, some_of_it).displacement
    np.testing.assert_allclose(found, np.where(mask[:, None], held, plain), atol=1e-12)


def test_frames_that_inequalities_ask_are_told() -> None:
    model = humanoid()
    qpos = np.tile(model.qpos0, (3, 1))
    qpos[:, 2] = (0.93, 0.80, 0.93)
    tops = loop_sites(model, qpos)[:, model.site("head_top").id, 2]
    targets = lay_out([pin(model, qpos, site) for site in FEET], model, 3)
    for solver in (NumericIK(model), HybridIK(model)):
        found = solver.prepare(targets, Ceiling(model, float(tops[1]) + 0.05)).solve(qpos)
        np.testing.assert_array_equal(found.pushed, [True, False, True])
        assert not some(solver.prepare(targets).solve(qpos).pushed).any()


# The reference's own derivatives


@pytest.mark.parametrize("size", [0.0, 1e-7, 1e-2, 0.5, 2.0, 3.1])
def test_derivatives_of_rotations(size: float) -> None:
    rng, h = np.random.default_rng(32), 1e-6
    v = rng.normal(size=3)
    v *= size / np.linalg.norm(v)
    quat = exp(v)
    slope = [log(multiply(conjugate(quat), exp(v + h * e))) / h for e in np.eye(3)]
    np.testing.assert_allclose(right_jacobian(v), np.transpose(slope), atol=1e-5)
    angles = [
        (swing_twist(multiply(quat, exp(h * e))) - swing_twist(multiply(quat, exp(-h * e))))
        / (2 * h)
        for e in np.eye(3)
    ]
    np.testing.assert_allclose(swing_twist_jacobian(quat), np.transpose(angles), atol=1e-6)


@pytest.mark.parametrize("name", ["humanoid", "mixed"])
def test_gradient_of_equation_6(name: str) -> None:
    """Positions, orientations, a ceiling and broken limits, against central differences."""
    ceiling: Ceiling | None
    if name == "humanoid":
        model, qpos = humanoid(), poses(humanoid(), 1, 33)
        targets, ceiling = moved_feet(qpos, 34), Ceiling(humanoid(), 1.2)
    else:
        model, qpos, ceiling = mixed(), poses(mixed(), 1, 33), None
        targets = lay_out([pin(model, qpos, "tip", 0.1, weight=0.4)], model, 1)
    objective = PenaltyObjective(
        Character.of(model), qpos[0], targets, default_rigidity(model), ceiling
    )
    x, h = 0.5 * np.random.default_rng(35).normal(size=model.nv), 1e-6
    value, gradient = objective(x, 100.0)
    slope = [
        (objective(x + h * e, 100.0)[0] - objective(x - h * e, 100.0)[0]) / (2 * h)
        for e in np.eye(model.nv)
    ]
    np.testing.assert_allclose(gradient, slope, atol=1e-6 * max(1.0, value))
