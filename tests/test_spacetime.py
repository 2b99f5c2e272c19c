"""The one large optimisation of §7: exact derivatives, known optima, and the fit beside it."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from made_up import humanoid, mixed, pin, random_poses, walk

from mjmotion.body import joint_limits as limits
from mjmotion.body.bones import Bones
from mjmotion.body.character import Character
from mjmotion.body.kinematics import site_positions
from mjmotion.body.motion import Motion
from mjmotion.constraints import Constraint, LookAt, SiteConstraint, lay_out
from mjmotion.constraints.shared_targets import SharedMove, SharedMoves
from mjmotion.exceptions import ConstraintError, FitError
from mjmotion.fitting import fit
from mjmotion.ik.numeric import NumericIK
from mjmotion.ik.solver import default_rigidity
from mjmotion.numerics.rotations import conjugate, exp, log, multiply, rotate
from mjmotion.numerics.tangent import ominus
from mjmotion.paper.conjugate_gradients import swing_twist_jacobian as one_swing_twist_jacobian
from mjmotion.paper.spacetime import Spacetime, objective, solve_spacetime
from mjmotion.paper.spacetime.moves import MovedTargets
from mjmotion.paper.spacetime.problem import Problem
from mjmotion.paper.spacetime.rotating import (
    inverse_right_jacobian,
    right_jacobian,
    swing_twist_jacobian,
)

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "scripts"))

from benchmarks import spacetime as benchmark  # noqa: E402
from benchmarks.speed import select_frames  # noqa: E402

RNG = np.random.default_rng(7)
UP = np.array((0.0, 0.0, 1.0))


@pytest.fixture(scope="module")
def short_walk() -> Motion:
    return walk(0.8)


def pinned(motion: Motion, **shift: object) -> list[SiteConstraint]:
    """Both feet held where they are, or a ``left`` and ``right`` shift away [m]."""
    return [
        pin(motion.model, motion.qpos, f"{side}_foot", shift.get(side, 0.0))
        for side in ("left", "right")
    ]


def two_moves(nframe: int) -> list[SharedMove]:
    """Moves of one foot that fade into each other, and one of the other; all kinds of freedom."""
    fade = np.linspace(0.0, 1.0, nframe)
    every = np.arange(nframe)
    return [
        SharedMove(
            "left_foot", every, 1.0 - fade, np.array((0.1, 0.0, 0.0)), np.eye(3)[:2], UP, 0.3
        ),
        SharedMove(
            "left_foot",
            every,
            fade,
            np.array((0.5, 0.1, 0.0)),
            np.eye(3),
            np.array((0.6, 0.0, 0.8)),
            0.2,
        ),
        SharedMove(
            "right_foot",
            every[1:4],
            np.array(1.0),
            np.array((0.0, 0.0, 0.0)),
            np.array([[1.0, 1.0, 0.0]]),
        ),
    ]


def small_problem(frames_per_knot: float = 2.0) -> Problem:
    """Seven frames of random poses, soft and exact targets, some ranges broken, three moves."""
    model = humanoid()
    qpos = random_poses(model, 7, seed=3, size=0.15)
    constraints = [
        pin(model, qpos, "left_foot", (0.05, -0.03, 0.1)),
        dataclasses.replace(
            pin(model, qpos[:5], "right_foot", (0.0, 0.1, 0.02)), frames=np.arange(1, 6), weight=0.5
        ),
        SiteConstraint("left_hand", np.array([2, 3]), position=np.array((0.5, 0.4, 1.2))),
    ]
    targets = lay_out(constraints, model, 7)
    return Problem(
        Character.of(model), qpos, targets, two_moves(7), default_rigidity(model), frames_per_knot
    )


@pytest.mark.parametrize("size", [1e-5, 0.5, 3.0])
def test_right_jacobian_is_that_of_exp(size: float) -> None:
    vector = size * RNG.normal(size=(20, 3)) / np.sqrt(3.0)
    step = 1e-6
    by_hand = np.stack(
        [
            log(multiply(conjugate(exp(vector - h)), exp(vector + h))) / (2.0 * step)
            for h in step * np.eye(3)
        ],
        axis=-1,
    )
    assert np.allclose(right_jacobian(vector), by_hand, atol=1e-8)
    product = right_jacobian(vector) @ inverse_right_jacobian(vector)
    assert np.allclose(product, np.eye(3), atol=1e-9)


def test_swing_and_twist_change_as_the_reference_says() -> None:
    turns = np.concatenate((RNG.normal(size=(20, 3)), [[0.0, 0.0, 0.7], [0.0, 0.0, 0.0]]))
    quats = exp(turns)
    expected = np.array([one_swing_twist_jacobian(quat) for quat in quats])
    assert np.allclose(swing_twist_jacobian(quats), expected, atol=1e-12)
    lost = swing_twist_jacobian(np.array([0.0, 1.0, 0.0, 0.0]))
    assert not lost.any()


@pytest.mark.parametrize("frames_per_knot", [1.0, 2.5])
def test_jacobian_is_that_of_the_residuals(frames_per_knot: float) -> None:
    problem = small_problem(frames_per_knot)
    point = 1.1 * np.random.default_rng(13).normal(size=problem.nunknown)
    state = problem.state(point)
    broken = (problem.ranges.out(state.angles) != 0.0).any(axis=0)
    assert broken[_columns(problem, "knee")].any() and broken[_columns(problem, "hip")].any()
    assert len(problem.residuals(state, 40.0)) == problem.nresidual
    step = 1e-6
    columns = []
    for index in range(problem.nunknown):
        ends = []
        for sign in (1.0, -1.0):
            moved = point.copy()
            moved[index] += sign * step
            ends.append(problem.residuals(problem.state(moved), 40.0))
        columns.append((ends[0] - ends[1]) / (2.0 * step))
    exact = problem.jacobian(state, 40.0).toarray()
    assert np.abs(exact - np.array(columns).T).max() < 1e-6


def _columns(problem: Problem, joint: str) -> list[int]:
    """Which of a problem's ranges are those of a joint, left or right."""
    model = problem.model
    serving = {model.joint(model.dof_jntid[dof]).name for dof in problem.dofs}
    names = [n for n in Character.of(model).limits.names if n.split(".")[0] in serving]
    assert len(names) == len(problem.ranges.bounds)
    return [index for index, name in enumerate(names) if joint in name]


def test_the_range_of_a_whole_ball() -> None:
    """MuJoCo's own limit of a ball is on the angle that it turns in all."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><compiler angle="radian"/><worldbody><body name="root"><freejoint/>
        <geom size=".1"/><body><joint name="ball" type="ball" range="0 0.5" limited="true"/>
        <geom size=".1"/><site name="end" pos="0 0 -.4"/></body></body></worldbody></mujoco>"""
    )
    motion = Motion(model, np.tile(model.qpos0, (3, 1)), 30.0)
    quat = exp(np.tile((0.6, 0.3, -0.2), (3, 1)))
    targets = lay_out([SiteConstraint("end", np.arange(3), quat=quat)], model, 3)
    problem = Problem(motion.character, motion.qpos, targets, [], default_rigidity(model), 1.0)
    point = 0.8 * np.random.default_rng(2).normal(size=problem.nunknown)
    state = problem.state(point)
    assert np.allclose(
        problem.ranges.out(state.angles), Character.of(model).limits.excess(state.qpos)
    )
    assert problem.ranges.out(state.angles).any()
    along = np.random.default_rng(3).normal(size=problem.nunknown)
    ends = [problem.residuals(problem.state(point + h * along), 1.0) for h in (1e-6, -1e-6)]
    away = problem.jacobian(state, 1.0) @ along - (ends[0] - ends[1]) / 2e-6
    assert np.abs(away).max() < 1e-7


def test_merit_is_the_sum_of_squares_and_holds_the_objective() -> None:
    problem = small_problem()
    state = problem.state(0.1 * RNG.normal(size=problem.nunknown))
    residuals = problem.residuals(state, 25.0)
    assert problem.merit(state, 25.0) == pytest.approx(float(residuals @ residuals))
    motion = Motion(problem.model, state.qpos, 30.0)
    told = objective(motion, problem.guess, None, state.moves, problem.moved.moves)
    assert problem.objective(state) == pytest.approx(told)


def test_joints_of_every_kind() -> None:
    """Hinges off their axis, slides, and a site that is turned on its body."""
    model = mixed()
    qpos = random_poses(model, 3, seed=5)
    targets = lay_out([pin(model, qpos, "tip", (0.02, 0.01, 0.0))], model, 3)
    problem = Problem(Character.of(model), qpos, targets, [], default_rigidity(model), 1.0)
    assert "other" not in {model.joint(model.dof_jntid[dof]).name for dof in problem.dofs}
    point = 0.2 * RNG.normal(size=problem.nunknown)
    exact = problem.jacobian(problem.state(point), 1.0)
    along = RNG.normal(size=problem.nunknown)
    ends = [problem.residuals(problem.state(point + h * along), 1.0) for h in (1e-6, -1e-6)]
    assert np.abs(exact @ along - (ends[0] - ends[1]) / 2e-6).max() < 1e-7


def test_moved_targets_are_those_of_the_fit() -> None:
    model, moves = humanoid(), two_moves(7)
    qpos = random_poses(model, 7, seed=4)
    targets = lay_out([pin(model, qpos, f"{s}_foot") for s in ("left", "right")], model, 7)
    values = 0.3 * RNG.normal(size=(3, 4))
    mine, _ = MovedTargets(moves, targets, model)(values)
    theirs = SharedMoves(moves, targets, model).moved(values)
    assert np.allclose(mine.position, theirs.position, atol=1e-12)
    assert np.allclose(mine.matrix, theirs.matrix, atol=1e-12)


def test_a_move_of_nothing_is_told() -> None:
    model = humanoid()
    qpos = random_poses(model, 3, seed=4)
    constraints = [pin(model, qpos, "left_foot")]
    move = SharedMove("right_foot", np.arange(3), np.array(1.0), np.zeros(3), np.eye(3))
    with pytest.raises(ConstraintError, match="right_foot"):
        solve_spacetime(Motion(model, qpos, 30.0), constraints, shared=[move])


def test_one_knot_a_frame_is_frame_by_frame_ik(short_walk: Motion) -> None:
    """Nothing joins the frames then: each has the least displacement that many steps of IK find."""
    constraints = pinned(short_walk, left=(0.03, 0.02, 0.05), right=(-0.02, 0.0, 0.03))
    found = solve_spacetime(
        short_walk, constraints, first_guess=False, frames_per_knot=1.0, tolerance=1e-9
    )
    model = short_walk.model
    targets = lay_out(constraints, model, short_walk.nframe)
    ik = NumericIK(model, iterations=60).prepare(targets).solve(short_walk.qpos)
    away = ominus(model, found.motion.qpos, short_walk.qpos)
    assert np.abs(away).max() > 0.05
    assert np.abs(away - ik.displacement).max() < 1e-3
    cost = float(np.sum(default_rigidity(model) * ik.displacement**2))
    assert found.objective == pytest.approx(cost, rel=1e-3)
    assert found.max_error < 1e-5
    assert found.converged


def test_free_footholds_go_back_to_where_nothing_is_asked(short_walk: Motion) -> None:
    """Targets that were moved and turned as a whole: the moves undo that, and no joint turns."""
    shift, yaw = np.array((0.1, -0.05, 0.0)), 0.2
    asked, moves = [], []
    for constraint in pinned(short_walk):
        assert constraint.position is not None and constraint.quat is not None
        pivot = constraint.position[0]
        turn = np.broadcast_to(exp(yaw * UP), constraint.quat.shape)
        asked.append(
            dataclasses.replace(
                constraint,
                position=pivot + rotate(turn, constraint.position - pivot) + shift,
                quat=multiply(turn, constraint.quat),
            )
        )
        moves.append(
            SharedMove(
                constraint.site, constraint.frames, np.array(1.0), pivot, np.eye(3)[:2], UP, 1e-6
            )
        )
    found = solve_spacetime(
        short_walk, asked, shared=moves, first_guess=False, frames_per_knot=1.0, tolerance=1e-9
    )
    # Turned about the pivot first, then moved: undoing both takes a shift of its own.
    assert np.allclose(found.moves[:, 3], -yaw, atol=1e-3)
    assert np.abs(ominus(short_walk.model, found.motion.qpos, short_walk.qpos)).max() < 2e-3
    assert found.objective < 1e-3
    fixed = solve_spacetime(short_walk, asked, first_guess=False, frames_per_knot=1.0)
    assert fixed.objective > 100.0 * found.objective


def test_a_stiff_move_gives_as_much_as_its_rigidity_lets_it(short_walk: Motion) -> None:
    """One move of one frame: its best place is where both costs rise alike."""
    still = short_walk.replace(short_walk.qpos[:1])
    constraints = pinned(still, left=(0.1, 0.0, 0.0))
    pivot = np.zeros(3)
    costs = {}
    for rigidity in (1.0, 30.0):
        move = SharedMove(
            "left_foot",
            np.arange(1),
            np.array(1.0),
            pivot,
            np.array([[1.0, 0.0, 0.0]]),
            None,
            rigidity,
        )
        found = solve_spacetime(
            still,
            constraints,
            shared=[move],
            first_guess=False,
            frames_per_knot=1.0,
            tolerance=1e-10,
        )
        best = float(found.moves[0, 0])

        def cost(place: float, rigidity: float = rigidity) -> float:
            moved = pinned(still, left=(0.1 + place, 0.0, 0.0))
            alone = solve_spacetime(
                still, moved, first_guess=False, frames_per_knot=1.0, tolerance=1e-10
            )
            return alone.objective + rigidity * place**2

        around = [cost(best + step) for step in (-0.01, 0.0, 0.01)]
        assert found.objective == pytest.approx(around[1], rel=1e-3)
        assert around[1] < min(around[0], around[2])
        costs[rigidity] = best
    assert -0.1 < costs[1.0] < costs[30.0] < 0.0


@pytest.fixture(scope="module")
def raised(short_walk: Motion) -> list[SiteConstraint]:
    return pinned(short_walk, left=(0.02, 0.0, 0.06), right=(0.0, 0.03, 0.02))


def test_two_frames_a_knot_need_the_exact_pass(
    short_walk: Motion, raised: list[SiteConstraint]
) -> None:
    found = solve_spacetime(short_walk, raised)
    assert found.left > found.max_error
    assert found.max_error < 1e-4
    bare = solve_spacetime(short_walk, raised, exact=False)
    assert bare.max_error == bare.left == pytest.approx(found.left)


def test_nothing_is_less_than_the_least(short_walk: Motion, raised: list[SiteConstraint]) -> None:
    """The fit meets the same constraints and deviates more, but hardly."""
    least = solve_spacetime(short_walk, raised, frames_per_knot=1.0, tolerance=1e-8)
    for ik in ("hybrid", "numeric"):
        result = fit(short_walk, raised, ik=ik)
        cost = objective(result.motion, least.guess)
        assert least.objective < 1.002 * cost
        assert cost < 1.15 * least.objective


def test_joint_limits_are_held(short_walk: Motion) -> None:
    """The feet are asked to turn further than ankle and hip can."""
    model = short_walk.model
    asked = pinned(short_walk)
    quat = asked[0].quat
    assert quat is not None
    turned = multiply(quat, np.broadcast_to(exp(np.array((0.0, 1.3, 0.0))), quat.shape))
    asked[0] = dataclasses.replace(asked[0], quat=turned)
    found = solve_spacetime(short_walk, asked, first_guess=False, frames_per_knot=1.0)
    assert Character.of(model).limits.excess(found.motion.qpos).max() < 2e-3
    # Held, not merely never met: with no more than a little room the ankle is at its limit.
    low, high = Character.of(model).limits.boxes[model.joint("left_ankle").id].T
    at = model.joint("left_ankle").qposadr[0]
    angles = limits.swing_twist(found.motion.qpos[:, at : at + 4])
    assert min(np.abs(angles - low).min(), np.abs(angles - high).min()) < 2e-3


def test_what_serves_nothing_stays(short_walk: Motion, raised: list[SiteConstraint]) -> None:
    before = np.array(short_walk.qpos)
    found = solve_spacetime(short_walk, raised, first_guess=False)
    away = ominus(short_walk.model, found.motion.qpos, short_walk.qpos)
    arm = short_walk.model.joint("left_elbow").dofadr[0]
    assert not away[:, arm].any()
    assert np.array_equal(short_walk.qpos, before)


def test_bodies_that_change(short_walk: Motion, raised: list[SiteConstraint]) -> None:
    model = short_walk.model
    plain = Bones.of(model)
    grow = np.linspace(1.0, 1.1, short_walk.nframe)[:, None, None]
    bones = Bones(
        grow * plain.body_pos, *(np.repeat(x[None], len(grow), axis=0) for x in _rest(plain))
    )
    found = solve_spacetime(short_walk, raised, frames_per_knot=1.0, bones=bones)
    assert found.max_error < 2e-4
    sites = np.array([model.site(c.site).id for c in raised])
    there = site_positions(model, found.motion.qpos, sites, bones)
    for column, constraint in enumerate(raised):
        assert constraint.position is not None
        assert np.abs(there[:, column] - constraint.position).max() < 2e-4


def _rest(bones: Bones) -> list[np.ndarray]:
    return [getattr(bones, field.name) for field in dataclasses.fields(bones)[1:]]


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"frames_per_knot": 0.0}, "frames a knot"),
        ({"frames_per_knot": float("nan")}, "frames a knot"),
        ({"penalties": ()}, "penalties"),
        ({"penalties": (1.0, -1.0)}, "penalties"),
        ({"rigidity": np.ones(3)}, "rigidity"),
        ({"tolerance": 0.0}, "tolerance"),
    ],
)
def test_settings_that_make_no_sense(
    short_walk: Motion, raised: list[SiteConstraint], more: dict[str, object], words: str
) -> None:
    with pytest.raises(FitError, match=words) as told:
        solve_spacetime(short_walk, raised, **more)  # type: ignore[arg-type]
    assert "\n" not in str(told.value)


def test_constraints_that_it_cannot_take(short_walk: Motion) -> None:
    look: Constraint = LookAt("left_hand", np.arange(3), point=np.array((1.0, 0.0, 1.0)))
    with pytest.raises(FitError, match="LookAt"):
        solve_spacetime(short_walk, [look])
    with pytest.raises(FitError, match="no constraints"):
        solve_spacetime(short_walk, [])
    beyond = SiteConstraint("left_foot", np.array([short_walk.nframe]), np.zeros(3))
    with pytest.raises(ConstraintError, match="left_foot"):
        solve_spacetime(short_walk, [beyond])


def test_the_benchmark_tells_what_was_found() -> None:
    count = 30
    fixed, free = (_first(job, count) for job in benchmark.make_jobs())
    said: list[str] = []
    found = benchmark.run([fixed, free], said.append, repeats=1)
    assert len(said) == len(found)
    value = {figure.name: figure.value for figure in found}
    assert len(value) == len(found)
    for job in (fixed, free):
        result = job.fit("hybrid")
        best: Spacetime = job.solve(1.0, benchmark.TIGHT)
        assert value[f"{job.name}: least objective"] == pytest.approx(best.objective)
        over = 100.0 * (job.objective(result) / best.objective - 1.0)
        assert over > -0.1
        assert value[f"{job.name}: objective of fit, hybrid, over the least by"] == pytest.approx(
            over, abs=1e-3
        )
    assert value["free: least objective"] < value["fixed: least objective"]
    aimed = [figure.name for figure in found if figure.target]
    assert "fit, hybrid: free footholds over fixed" in aimed
    assert "free: spacetime, the quicker, over fit, hybrid" in aimed


def _first(job: benchmark.FreeJob, count: int) -> benchmark.FreeJob:
    """The first frames of a job."""
    short = select_frames(job.job, np.arange(count))
    moves = []
    for move in job.moves:
        kept = move.frames < count
        if kept.any() and move.share[kept].max() > 0.0:
            moves.append(
                dataclasses.replace(move, frames=move.frames[kept], share=move.share[kept])
            )
    return benchmark.FreeJob(job.name, short, tuple(moves))
