"""Targets that move as a whole (§7): their effect, their elimination, the footholds they find."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest
from made_up import humanoid, loop_quats, loop_sites, mixed, of_site, pin, some
from made_up import random_poses as poses

from mjmotion.body.assets import find_asset
from mjmotion.body.character import Character
from mjmotion.body.motion import Motion
from mjmotion.constraints import (
    Constraint,
    LookAt,
    RelativeConstraint,
    SiteConstraint,
    Targets,
    lay_out,
)
from mjmotion.constraints.shared_targets import (
    RIGIDITY,
    Sensitivity,
    SharedMove,
    SharedMoves,
    free_moves,
    with_moves,
)
from mjmotion.exceptions import ConstraintError, ModelError
from mjmotion.fitting import Fit, fit
from mjmotion.ik.hybrid import HybridIK
from mjmotion.ik.numeric import NumericIK
from mjmotion.ik.solver import Deviation, default_rigidity
from mjmotion.numerics.rotations import conjugate, exp, log, multiply, to_matrix, yaw_quat
from mjmotion.numerics.tangent import ominus, oplus

FEET = ("left_foot", "right_foot")
PLANE, UP = np.eye(3)[:2], np.array((0.0, 0.0, 1.0))
SLIDE = 1e-4  # of a shared foothold over its contact [m]
SMALL = 0.002  # errors of targets in which costs are all but quadratic [m or rad]
NFRAME = 40


@functools.cache
def flexible() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(find_asset("model", "humanoid_flexible")))


def change(targets: Targets, delta: np.ndarray) -> Targets:
    """Targets moved and turned by (n, s, 6) in world axes."""
    quat = multiply(exp(delta[..., 3:]), targets.quat)
    position = targets.position + delta[..., :3]
    return dataclasses.replace(targets, position=position, quat=quat, matrix=to_matrix(quat))


# What a move does to targets


def feet_of(model: mujoco.MjModel, nframe: int, seed: int) -> Targets:
    qpos = poses(model, nframe, seed, 0.1)
    return lay_out([pin(model, qpos, site) for site in FEET], model, nframe)


def four_moves() -> list[SharedMove]:
    """Two of one foot that overlap, two of the other at the same frames; some with few freedoms."""
    rng = np.random.default_rng(1)
    return [
        SharedMove(FEET[0], np.arange(8), np.linspace(0.2, 1, 8), np.zeros(3), PLANE, UP),
        SharedMove(
            FEET[0],
            np.arange(5, 12)[::-1],
            np.linspace(0.3, 1, 7),
            np.array((1.0, 0.0, 0.0)),
            rng.normal(size=(3, 3)),
            np.array((0.0, 0.2, 1.0)),
            rigidity=0.5,
        ),
        SharedMove(
            FEET[1], np.arange(3, 9), np.array(0.7), np.array((0.3, 0.2, 0)), PLANE[:1], UP, 2.0
        ),
        SharedMove(FEET[1], np.arange(3, 9), np.array(1.0), np.zeros(3), PLANE[1:], None, 2.0),
    ]


def some_values(moves: list[SharedMove], seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Values (nmove, 4) of moves that are not small, and which of them are free."""
    free = np.array(
        [[i < len(m.directions) for i in range(3)] + [m.axis is not None] for m in moves]
    )
    return 0.2 * np.random.default_rng(seed).normal(size=free.shape) * free, free


def test_a_move_is_what_it_says() -> None:
    """x' = pivot + R(share yaw)(x - pivot) + share Σ u direction, target by target."""
    model, targets = humanoid(), feet_of(humanoid(), 6, 2)
    share, pivot, axis = (
        np.linspace(0.0, 1.0, 4),
        np.array((0.3, -0.2, 0.1)),
        np.array((0.6, 0, 0.8)),
    )
    directions = np.array(((2.0, 0.0, 0.0), (0.0, 3.0, 4.0)))
    move = SharedMove(FEET[1], np.array((2, 1, 4, 5)), share, pivot, directions, 5.0 * axis)
    moved = SharedMoves([move], targets, model).moved(np.array(((0.1, -0.2, 9.0, 0.7),)))
    for frame, part in zip(move.frames, share, strict=True):
        turn = exp(part * 0.7 * axis)
        step = part * (0.1 * np.array((1.0, 0, 0)) - 0.2 * np.array((0, 0.6, 0.8)))
        wanted = pivot + to_matrix(turn) @ (targets.position[frame, 1] - pivot) + step
        np.testing.assert_allclose(moved.position[frame, 1], wanted, atol=1e-12)
        np.testing.assert_allclose(
            moved.matrix[frame, 1], to_matrix(turn) @ targets.matrix[frame, 1], atol=1e-12
        )
    np.testing.assert_array_equal(moved.position[:, 0], targets.position[:, 0])
    np.testing.assert_array_equal(moved.position[[0, 3]], targets.position[[0, 3]])


def test_a_share_that_fades_to_nothing_moves_nothing_there() -> None:
    targets = feet_of(humanoid(), 5, 3)
    share = np.array((0.0, 0.5, 1.0, 0.5, 0.0))
    moves = SharedMoves(
        [SharedMove(FEET[0], np.arange(5), share, np.zeros(3), PLANE)], targets, humanoid()
    )
    step = moves.moved(np.array(((0.4, 0.0, 0.0, 0.0),))).position - targets.position
    np.testing.assert_allclose(step[:, 0, 0], 0.4 * share, atol=1e-12)
    np.testing.assert_array_equal(moves.touched, share > 0.0)


def dense_step(
    moves: list[SharedMove], laid: SharedMoves, values: np.ndarray, seen: Sensitivity
) -> np.ndarray:
    """All frames and all moves as one quadratic, its Jacobian by central differences of targets."""
    nmove, h = len(moves), 1e-6
    effect = np.zeros((*seen.gradient.shape, 4 * nmove))
    for unknown in range(4 * nmove):
        unit = np.zeros(4 * nmove)
        unit[unknown] = h
        up, down = (laid.moved(values + sign * unit.reshape(nmove, 4)) for sign in (1, -1))
        effect[..., :3, unknown] = (up.position - down.position) / (2 * h)
        effect[..., 3:, unknown] = log(multiply(up.quat, conjugate(down.quat))) / (2 * h)
    rigidity = np.repeat([move.rigidity for move in moves], 4)
    matrix = np.einsum("nsik,nsitj,ntjl->kl", effect, seen.hessian, effect) + np.diag(rigidity)
    right = np.einsum("nsik,nsi->k", effect, seen.gradient) + rigidity * values.ravel()
    free = some_values(moves, 0)[1].ravel()
    step = np.zeros(4 * nmove)
    step[free] = np.linalg.solve(matrix[np.ix_(free, free)], -right[free])
    return step.reshape(nmove, 4)


@pytest.mark.parametrize("seed", [4, 5, 6])
def test_elimination_is_one_dense_system(seed: int) -> None:
    """Moves that share frames and sites, away from zero: the sparse step is the dense one."""
    model, rng, moves = humanoid(), np.random.default_rng(seed), four_moves()
    laid = SharedMoves(moves, feet_of(model, 12, seed), model)
    values, _ = some_values(moves, seed)
    root = rng.normal(size=(12, 12, 12))
    hessian = (root @ root.swapaxes(1, 2)).reshape(12, 2, 6, 2, 6)
    seen = Sensitivity(0.02 * rng.normal(size=(12, 2, 6)), hessian)
    step = laid.step(values, laid.moved(values), np.arange(12), seen) - values
    wanted = dense_step(moves, laid, values, seen)
    assert np.abs(wanted).max() > 0.01
    np.testing.assert_allclose(step, wanted, atol=1e-8)


def test_elimination_is_the_optimum_over_poses_and_moves_at_once() -> None:
    """Least |d|² with J d = e + E u and ρ|u|²: the KKT system of all unknowns, poses among them."""
    model, rng, moves = humanoid(), np.random.default_rng(7), four_moves()[:1]
    moves = [dataclasses.replace(moves[0], rigidity=0.3)]
    nframe, ndof = 12, 20
    laid = SharedMoves(moves, feet_of(model, nframe, 7), model)
    jacobian, error = rng.normal(size=(nframe, 12, ndof)), 0.01 * rng.normal(size=(nframe, 12))
    inverse = np.asarray(np.linalg.inv(jacobian @ jacobian.swapaxes(1, 2)), dtype=np.float64)
    gradient = (inverse @ error[..., None])[..., 0].reshape(nframe, 2, 6)
    seen = Sensitivity(gradient, inverse.reshape(nframe, 2, 6, 2, 6))
    zero = np.zeros((1, 4))
    u = laid.step(zero, laid.moved(zero), np.arange(nframe), seen)[0]
    h = 1e-6
    effect = np.zeros((nframe, 12, 3))
    for column, unknown in enumerate((0, 1, 3)):
        unit = np.zeros((1, 4))
        unit[0, unknown] = h
        up, down = laid.moved(unit), laid.moved(-unit)
        effect[..., column] = np.concatenate(
            ((up.position - down.position), log(multiply(up.quat, conjugate(down.quat)))), axis=2
        ).reshape(nframe, 12) / (2 * h)
    size, rows = nframe * ndof, nframe * 12
    kkt = np.zeros((size + 3 + rows, size + 3 + rows))
    kkt[:size, :size] = np.eye(size)
    kkt[size : size + 3, size : size + 3] = 0.3 * np.eye(3)
    for frame in range(nframe):
        at = size + 3 + 12 * frame
        kkt[at : at + 12, ndof * frame : ndof * (frame + 1)] = jacobian[frame]
        kkt[at : at + 12, size : size + 3] = -effect[frame]
    kkt += np.tril(kkt, -1).T
    right = np.concatenate((np.zeros(size + 3), error.ravel()))
    np.testing.assert_allclose(
        u[[0, 1, 3]], np.linalg.solve(kkt, right)[size : size + 3], atol=1e-8
    )


def test_blocks_grow_with_contacts_not_with_their_square() -> None:
    """A move meets those that share its frames: its neighbours in time, however long the walk."""
    model, sizes = humanoid(), []
    for steps in (10, 20, 40):
        nframe = 6 * steps
        targets = feet_of(model, nframe, 8)
        moves = [
            SharedMove(
                FEET[step % 2],
                np.arange(max(0, 6 * step - 4), min(nframe, 6 * step + 10)),
                np.array(1.0),
                np.zeros(3),
                PLANE,
            )
            for step in range(steps)
        ]
        laid = SharedMoves(moves, targets, model)
        sizes.append(len(laid._blocks))
    assert sizes[2] - sizes[1] == 2 * (sizes[1] - sizes[0]) < 2 * 10 * 6


def test_a_step_does_not_leap() -> None:
    model, move = humanoid(), four_moves()[:1]
    laid = SharedMoves(move, feet_of(model, 12, 9), model)
    pull = Sensitivity(np.full((12, 2, 6), 50.0), np.zeros((12, 2, 6, 2, 6)))
    zero = np.zeros((1, 4))
    step = laid.step(zero, laid.moved(zero), np.arange(12), pull)
    assert np.isfinite(step).all() and np.abs(step).max() == pytest.approx(0.5)


@pytest.mark.parametrize("spacing", [1, 2, 3])
def test_frames_that_are_asked_miss_no_move(spacing: int) -> None:
    """Even of a move at every other frame of many, some of its own frames are asked."""
    model, nframe = humanoid(), 300
    targets = feet_of(model, nframe, 10)
    for first in range(spacing):
        move = SharedMove(
            FEET[0], np.arange(first, nframe, spacing), np.array(1.0), np.zeros(3), PLANE
        )
        rows = SharedMoves([move], targets, model).some_rows(6)
        asked = np.isin(move.frames, rows).sum()
        assert asked >= 6 and len(rows) <= nframe and (np.diff(rows) > 0).all()


BAD_MOVES: dict[str, tuple[dict[str, Any], str]] = {
    "no frames": ({"frames": []}, "frames, each once"),
    "a frame twice": ({"frames": [1, 2, 1]}, "frames, each once"),
    "shares of another length": ({"share": np.ones(4)}, r"share \(n,\)"),
    "a share above one": ({"share": 1.2}, "shares must be"),
    "a share below zero": ({"share": [1.0, -0.1, 0.5]}, "shares must be"),
    "a share that is no number": ({"share": np.nan}, "shares must be"),
    "a pivot of two": ({"pivot": np.zeros(2)}, r"pivot \(3,\)"),
    "a pivot nowhere": ({"pivot": (0, np.inf, 0)}, "pivot not finite"),
    "nothing free": ({"directions": np.empty((0, 3))}, "directions, or an axis"),
    "four directions": ({"directions": np.ones((4, 3))}, "one to three"),
    "a direction of two": ({"directions": np.ones((1, 2))}, r"directions \(k, 3\)"),
    "no direction": ({"directions": np.zeros((1, 3))}, "length 0"),
    "an endless direction": ({"directions": np.full((1, 3), np.inf)}, "length 0"),
    "an axis of no length": ({"axis": np.zeros(3)}, "length 0"),
    "an axis of four": ({"axis": np.ones(4)}, r"axis \(3,\)"),
    "words": ({"pivot": "here"}, r"pivot \(3,\)"),
    "no rigidity": ({"rigidity": 0.0}, "rigidity"),
    "a rigidity that is no number": ({"rigidity": np.nan}, "rigidity"),
    "an endless rigidity": ({"rigidity": np.inf}, "rigidity"),
}


@pytest.mark.parametrize("case", sorted(BAD_MOVES))
def test_bad_moves(case: str) -> None:
    options, message = BAD_MOVES[case]
    good: dict[str, Any] = {
        "frames": [1, 2, 3],
        "share": 1.0,
        "pivot": np.zeros(3),
        "directions": PLANE,
    }
    with pytest.raises(ConstraintError, match=message) as caught:
        SharedMove("left_foot", **{**good, **options})
    assert "left_foot" in str(caught.value) and "\n" not in str(caught.value)


def test_moves_of_what_is_not_held() -> None:
    """Frames that nothing constrains, a site that nothing names, one held at other frames only."""
    model, qpos = humanoid(), poses(humanoid(), 10, 11)
    left, right = (pin(model, qpos, site) for site in FEET)
    early = SiteConstraint(FEET[0], np.arange(4), some(left.position)[:4])
    targets = lay_out([early, right], model, 10)
    for site, frames in ((FEET[0], (7, 8)), (FEET[1], (20, 21)), ("left_hand", (1, 2))):
        move = SharedMove(site, np.array(frames), np.array(1.0), np.zeros(3), PLANE)
        with pytest.raises(ConstraintError, match=f"'{site}'.*no constraint holds that site"):
            SharedMoves([move], targets, model)
    with pytest.raises(ModelError, match="no_such"):
        SharedMoves([SharedMove("no_such", [1], 1.0, np.zeros(3), PLANE)], targets, model)  # type: ignore[arg-type]


# What frames answer


def near_targets(
    model: mujoco.MjModel, qpos: np.ndarray, sites: tuple[str, ...], kind: str
) -> Targets:
    """Sites to be elsewhere by about SMALL, with all kinds of other wishes at some frames."""
    rng, n = np.random.default_rng(12), len(qpos)
    constraints: list[Constraint] = []
    for site in sites:
        own = pin(model, qpos, site, SMALL * rng.normal(size=(n, 3)))
        quat = multiply(exp(SMALL * rng.normal(size=(n, 3))), some(own.quat))
        constraints.append(
            SiteConstraint(
                site,
                own.frames,
                None if kind == "turn" else own.position,
                None if kind == "place" else quat,
            )
        )
    if kind == "all":
        sites_at = loop_sites(model, qpos)
        pelvis, hand, face = (model.site(s).id for s in ("pelvis", "left_hand", "face"))
        turn = to_matrix(loop_quats(model, qpos, "pelvis"))
        local = np.einsum("nji,nj->ni", turn, sites_at[:, hand] - sites_at[:, pelvis])
        ahead = sites_at[:, face] + 2.0 * to_matrix(loop_quats(model, qpos, "face"))[:, :, 0]
        constraints += [
            RelativeConstraint("left_hand", [0, 2], "pelvis", local[[0, 2]] + SMALL),  # type: ignore[arg-type]
            LookAt("face", [0, 3], ahead[[0, 3]] + SMALL),  # type: ignore[arg-type]
            SiteConstraint("head_top", [1], sites_at[1, model.site("head_top").id] + SMALL),  # type: ignore[arg-type]
        ]
    return lay_out(constraints, model, n)


def least_cost(model: mujoco.MjModel, qpos: np.ndarray, targets: Targets) -> np.ndarray:
    """Eq. 4 halved, of the least displacement that meets the targets (n,), by many steps."""
    found = NumericIK(model, iterations=15).prepare(targets).solve(qpos).displacement
    return 0.5 * np.sum(default_rigidity(model) * found * found, axis=1)


CASES: dict[str, tuple[Callable[[], mujoco.MjModel], tuple[str, ...], str]] = {
    "feet": (humanoid, FEET, "both"),
    "feet and a hand": (humanoid, (*FEET, "left_hand"), "both"),
    "places alone": (humanoid, FEET, "place"),
    "turns alone": (humanoid, FEET[:1], "turn"),
    "a foot and the head": (humanoid, ("left_foot", "head_top"), "both"),
    "relative targets and look-ats at some frames": (humanoid, FEET, "all"),
    "flexible spine": (flexible, ("left_foot", "left_hand", "right_hand"), "both"),
    "no limbs": (mixed, ("tip",), "place"),
}


@pytest.mark.parametrize("solver", [NumericIK, HybridIK])
@pytest.mark.parametrize("case", sorted(CASES))
def test_sensitivity_is_the_cost_s_own_slope_and_bend(case: str, solver: type) -> None:
    """Central differences of the least deviation's cost, for targets moved a little."""
    make, sites, kind = CASES[case]
    model, rng, h = make(), np.random.default_rng(13), 1e-4
    qpos = Character.of(model).coupling.couple(poses(model, 4, 14, 0.1))
    targets = near_targets(model, qpos, sites, kind)
    held = np.stack((targets.position_weight, targets.turn_weight), axis=-1).repeat(3, -1) > 0
    seen = solver(model).prepare(targets).sensitivity(qpos)
    for _ in range(3):
        delta = rng.normal(size=held.shape) * held
        delta /= np.linalg.norm(delta, axis=(1, 2), keepdims=True)
        up, down = (least_cost(model, qpos, change(targets, s * h * delta)) for s in (1, -1))
        slope = np.einsum("nsi,nsi->n", seen.gradient, delta)
        scale = np.linalg.norm(seen.gradient, axis=(1, 2))
        assert np.abs(slope - (up - down) / (2 * h)).max() < 0.03 * scale.max()
        far = [least_cost(model, qpos, change(targets, s * SMALL * delta)) for s in (1, 0, -1)]
        bend = (far[0] - 2 * far[1] + far[2]) / SMALL**2
        mine = np.einsum("nsi,nsitj,ntj->n", delta, seen.hessian, delta)
        np.testing.assert_allclose(mine, bend, rtol=0.1, atol=1e-3)
    assert (seen.gradient[~held] == 0.0).all()


@pytest.mark.parametrize("solver", [NumericIK, HybridIK])
@pytest.mark.parametrize(
    "case", ["feet", "relative targets and look-ats at some frames", "flexible spine"]
)
def test_sensitivity_counts_what_there_is_already(case: str, solver: type) -> None:
    """Half way to the targets, with that half as the deviation: the whole way's own slope."""
    make, sites, kind = CASES[case]
    model = make()
    qpos = Character.of(model).coupling.couple(poses(model, 4, 14, 0.1))
    targets = near_targets(model, qpos, sites, kind)
    whole = NumericIK(model, iterations=15)
    half = 0.5 * whole.prepare(targets).solve(qpos).displacement
    problem, moved = solver(model).prepare(targets), oplus(model, qpos, half)
    mine = problem.sensitivity(moved, Deviation(half, np.ones(4, dtype=bool)))
    wanted = NumericIK(model).prepare(targets).sensitivity(qpos)
    scale = np.abs(wanted.gradient).max()
    assert np.abs(mine.gradient - wanted.gradient).max() < 0.05 * scale
    nothing = problem.sensitivity(qpos, Deviation(np.zeros_like(half), np.zeros(4, dtype=bool)))
    np.testing.assert_allclose(nothing.gradient, wanted.gradient, atol=0.03 * scale)


def test_what_is_deviated_already_is_kept_least() -> None:
    """Solving in two halves with the first as deviation ends where one solve ends."""
    model, qpos = humanoid(), poses(humanoid(), 4, 15, 0.1)
    rng = np.random.default_rng(16)
    targets = near_targets(model, qpos, FEET, "both")
    for solver in (NumericIK(model), HybridIK(model)):
        once = NumericIK(model, iterations=15).prepare(targets).solve(qpos).displacement
        astray = oplus(model, qpos, 0.002 * rng.normal(size=(4, model.nv)) * (once != 0.0))
        for _ in range(3):
            deviation = Deviation(ominus(model, astray, qpos), np.ones(4, dtype=bool))
            step = solver.prepare(targets).solve(astray, deviation=deviation).displacement
            astray = oplus(model, astray, step)
        np.testing.assert_allclose(ominus(model, astray, qpos), once, atol=3e-4)


# Footholds


@functools.cache
def sliding(power: float, seed: int = 0) -> tuple[Motion, np.ndarray, np.ndarray]:
    """A clip that stands on both feet while the left one slides and turns; where, and its yaw."""
    model = humanoid()
    qpos = np.tile(model.qpos0, (NFRAME, 1))
    for side in ("left", "right"):
        for joint, angle in (("hip", -0.3), ("ankle", -0.3)):
            at = model.joint(f"{side}_{joint}").qposadr[0]
            qpos[:, at], qpos[:, at + 2] = np.cos(angle / 2), np.sin(angle / 2)
        qpos[:, model.joint(f"{side}_knee").qposadr[0]] = 0.6
    qpos[:, 2] -= 0.04
    left, right = (pin(model, qpos, site) for site in FEET)
    s = np.linspace(0.0, 1.0, NFRAME) ** power
    drift, yaw = np.outer(s, (0.06, -0.03, 0.0)), 0.3 * s
    quat = multiply(yaw_quat(yaw), some(left.quat))
    slid = SiteConstraint(FEET[0], left.frames, some(left.position) + drift, quat)
    found = fit(Motion(model, qpos, 30.0), [right, slid], levels=(8, 4, 2, 2), first_guess=False)
    return found.motion, some(left.position) + drift, yaw


def free_foot(
    motion: Motion, free: tuple[str, ...], away: tuple[float, float] = (0.02, 0.05)
) -> list[SiteConstraint]:
    """The right foot where it is, the left on one spot some way off the middle of its slide."""
    left, right = (pin(motion.model, motion.qpos, site) for site in FEET)
    spot = some(left.position)[0] + (*away, 0.0)
    return [right, SiteConstraint(FEET[0], left.frames, spot, some(left.quat)[0], free=free)]


def cost_of(result: Fit, motion: Motion) -> float:
    moved = ominus(motion.model, result.motion.qpos, motion.qpos)
    return float(np.sum(default_rigidity(motion.model) * moved * moved))


@pytest.mark.parametrize("ik", ["hybrid", "numeric"])
@pytest.mark.parametrize("power", [1.0, 3.0])
def test_a_free_foothold_comes_to_the_mean_place(power: float, ik: str) -> None:
    """Every frame has the same foot, so the least sum of squares is at the mean, not the middle."""
    motion, track, yaw = sliding(power)
    result = fit(motion, free_foot(motion, ("x", "y", "yaw")), ik=ik, first_guess=False)
    foot = loop_sites(motion.model, result.motion.qpos)[:, motion.model.site(FEET[0]).id]
    assert np.linalg.norm(foot - foot.mean(axis=0), axis=1).max() < SLIDE
    np.testing.assert_allclose(foot.mean(axis=0), track.mean(axis=0), atol=1.5e-3)
    assert result.moves.shape == (1, 4)
    assert result.moves[0, 3] == pytest.approx(yaw.mean(), abs=0.01)
    assert result.moves[0, 2] == 0.0
    assert result.trace.exact_error_percent < 0.01 and result.unmet == ()
    # It costs less than to stay, and than any place a little to the side.
    held = [of_site(one) for one in with_moves(free_foot(motion, ("x", "y", "yaw")), result.moves)]
    best = cost_of(result, motion)
    for shift in ((0.01, 0), (-0.01, 0), (0, 0.01), (0, -0.01)):
        aside = dataclasses.replace(held[1], position=some(held[1].position) + (*shift, 0.0))
        other = fit(motion, [held[0], aside], ik=ik, first_guess=False)
        assert cost_of(other, motion) > best
    fixed = fit(motion, free_foot(motion, ()), ik=ik, first_guess=False)
    assert best < 0.8 * cost_of(fixed, motion) and fixed.moves.shape == (0, 4)


def test_frames_that_count_more_draw_a_foothold_more() -> None:
    """A share that fades weighs its frames less: the foothold comes to the weighted mean."""
    motion, track, _ = sliding(1.0)
    constraints = free_foot(motion, ())
    share = np.linspace(1.0, 0.0, NFRAME)
    moved = SharedMove(FEET[0], np.arange(NFRAME), share, np.zeros(3), PLANE, rigidity=RIGIDITY)
    result = fit(motion, constraints, shared=[moved], first_guess=False)
    # Least Σ |track - spot - share u|²: u = Σ share (track - spot) / Σ share².
    spot = some(constraints[1].position)[0]
    u = (share[:, None] * (track - spot)).sum(axis=0) / (share @ share)
    np.testing.assert_allclose(result.moves[0, :2], u[:2], atol=3e-3)
    foot = loop_sites(motion.model, result.motion.qpos)[:, motion.model.site(FEET[0]).id]
    np.testing.assert_allclose(
        foot, spot + share[:, None] * (*result.moves[0, :2], 0.0), atol=SLIDE
    )


@pytest.mark.parametrize("free", [("x",), ("yaw",), ("y", "yaw"), ("x", "y", "z")])
def test_only_what_is_free_moves(free: tuple[str, ...]) -> None:
    motion, _, _ = sliding(1.0)
    constraints = free_foot(motion, free)
    result = fit(motion, constraints, first_guess=False)
    moved = of_site(with_moves(constraints, result.moves)[1])
    step = np.abs(some(moved.position) - some(constraints[1].position)).max(axis=0)
    np.testing.assert_array_equal(step > 1e-6, [name in free for name in "xyz"])
    turn = log(multiply(some(moved.quat), conjugate(some(constraints[1].quat))))
    assert (np.abs(turn).max() > 1e-3) == ("yaw" in free) and np.abs(turn[:, :2]).max() < 1e-9
    assert moved.free == () and constraints[1].free == free
    foot = loop_sites(motion.model, result.motion.qpos)[:, motion.model.site(FEET[0]).id]
    np.testing.assert_allclose(foot, some(moved.position), atol=SLIDE)
    np.testing.assert_allclose(result.targets.position[:, 1], some(moved.position), atol=1e-12)


def test_a_stiff_move_stays_and_a_soft_one_goes() -> None:
    motion, _, _ = sliding(1.0)
    constraints, gone = free_foot(motion, ()), []
    for rigidity in (1e-3, 30.0, 1e6):
        move = SharedMove(
            FEET[0], np.arange(NFRAME), np.array(1.0), np.zeros(3), PLANE, None, rigidity
        )
        result = fit(motion, constraints, shared=[move], first_guess=False, exact=False)
        gone.append(float(np.linalg.norm(result.moves[0, :2])))
    assert gone[0] > gone[1] > gone[2] and gone[0] > 0.02 and gone[2] < 1e-4


def test_two_moves_of_the_same_frames() -> None:
    """One contact free along x and another along y; they have some frames in common."""
    motion, track, _ = sliding(1.0)
    constraints = free_foot(motion, ())
    spot = some(constraints[1].position)[0]
    first, second = np.arange(0, 25), np.arange(15, NFRAME)
    moves = [
        SharedMove(FEET[0], first, np.array(1.0), spot, PLANE[:1]),
        SharedMove(FEET[0], second, np.array(1.0), spot, PLANE[1:]),
    ]
    result = fit(motion, constraints, shared=moves, first_guess=False, exact=False)
    wanted = ((track - spot)[first, 0].mean(), (track - spot)[second, 1].mean())
    np.testing.assert_allclose(result.moves[:, 0], wanted, atol=3e-3)
    target = result.targets.position[:, 1] - spot
    np.testing.assert_allclose(target[:15, 1], 0.0, atol=1e-12)
    np.testing.assert_allclose(target[25:, 0], 0.0, atol=1e-12)
    np.testing.assert_allclose(target[15:25, :2], [result.moves[:, 0]] * 10, atol=1e-12)


def test_a_model_without_limbs() -> None:
    """The numeric solver alone: any tree, any site."""
    model = mixed()
    qpos = np.tile(poses(model, 1, 17, 0.1), (20, 1))
    own = pin(model, qpos, "tip")
    spot = SiteConstraint(
        "tip", own.frames, some(own.position)[0] + (0.0, 0.1, 0.02), free=("x", "y")
    )
    for ik in ("hybrid", "numeric"):
        result = fit(Motion(model, qpos, 30.0), [spot], ik=ik, first_guess=False)
        tip = loop_sites(model, result.motion.qpos)[:, model.site("tip").id]
        assert np.ptp(tip, axis=0).max() < SLIDE
        # What is free goes back to where the motion had it; what is not is met.
        np.testing.assert_allclose(result.moves[0], (0.0, -0.1, 0.0, 0.0), atol=0.01)
        np.testing.assert_allclose(tip[:, 2], some(own.position)[0, 2] + 0.02, atol=1e-4)


def test_a_foothold_held_beside_other_kinds_at_other_frames() -> None:
    """Frames with nothing of a foothold's in them ask for no move, and break nothing."""
    motion, _, _ = sliding(1.0)
    right, left = free_foot(motion, ("x", "y"))
    early = dataclasses.replace(
        left, frames=left.frames[:15], position=some(left.position)[:15], quat=some(left.quat)[:15]
    )
    others: list[Constraint] = [
        RelativeConstraint("left_hand", np.arange(20, 35), "pelvis", np.array((0.02, 0.24, 0.0))),
        LookAt("face", np.arange(10, 35), np.array((3.0, 0.5, 1.5))),
    ]
    for ik in ("hybrid", "numeric"):
        for constraints in ([early, *others], [right, early, *others]):
            result = fit(motion, constraints, ik=ik, first_guess=False)
            assert result.unmet == ()
            foot = loop_sites(motion.model, result.motion.qpos)[:15, motion.model.site(FEET[0]).id]
            assert np.ptp(foot, axis=0).max() < SLIDE


@pytest.mark.parametrize("ik", ["hybrid", "numeric"])
def test_what_cannot_be_met_is_named_by_frame(ik: str) -> None:
    """A foothold that no leg reaches while the body is carried past it, feet held elsewhere."""
    motion, _, _ = sliding(1.0)
    qpos = motion.qpos.copy()
    qpos[:, 0] += np.linspace(0.0, 3.0, NFRAME)  # 3 m along, the foothold one spot for all of it
    away = Motion(motion.model, qpos, 30.0)
    right = pin(away.model, away.qpos, FEET[1])
    spot = loop_sites(away.model, away.qpos)[0, away.model.site(FEET[0]).id]
    left = SiteConstraint(FEET[0], np.arange(NFRAME), spot, free=("x", "y"))
    result = fit(away, [right, left], ik=ik, first_guess=False)
    (name,) = [one for one in result.unmet if one.constraint == f"position of {FEET[0]}"]
    target = of_site(with_moves([right, left], result.moves)[1])
    foot = loop_sites(away.model, result.motion.qpos)[:, away.model.site(FEET[0]).id]
    off = 1000.0 * np.linalg.norm(foot - some(target.position), axis=1)
    np.testing.assert_array_equal(name.frames, np.flatnonzero(off > 1.0))
    assert len(name.frames) > 0 and name.residual_mm == pytest.approx(off.max(), rel=1e-6)


# Free constraints as moves


def test_free_moves_are_read_from_constraints() -> None:
    frames, points = np.arange(3, 6), np.array(((0, 0, 1), (0, 0, 2), (3, 0, 3)), float)
    both = SiteConstraint("left_hand", frames, points, free=("yaw", "z", "x"))
    fixed = SiteConstraint("right_hand", frames, points)
    (move,) = free_moves([fixed, both, LookAt("face", frames, np.array((1, 0, 0)))])
    assert move.site == "left_hand" and move.rigidity == RIGIDITY
    np.testing.assert_array_equal(move.frames, frames)
    np.testing.assert_array_equal(move.share, 1.0)
    np.testing.assert_array_equal(move.pivot, (1, 0, 2))
    np.testing.assert_array_equal(move.directions, ((0, 0, 1), (1, 0, 0)))
    np.testing.assert_array_equal(move.axis, UP)


def test_with_moves_turns_about_the_middle() -> None:
    frames, points = np.arange(2), np.array(((1.0, 0, 1), (3.0, 0, 1)))
    quat = exp(np.array(((0.1, 0.2, 0.0), (0.0, 0.0, 0.5))))
    free = SiteConstraint("left_hand", frames, points, quat, free=("y", "yaw"))
    fixed = SiteConstraint("right_hand", frames, points)
    same, moved = with_moves([fixed, free], np.array(((0.3, 0.0, 0.0, np.pi / 2),)))
    assert same is fixed
    held = of_site(moved)
    wanted = np.array(((2, -0.7, 1), (2, 1.3, 1)))
    np.testing.assert_allclose(some(held.position), wanted, atol=1e-12)
    turned = log(multiply(some(held.quat), conjugate(quat)))
    np.testing.assert_allclose(turned, np.tile((0, 0, np.pi / 2), (2, 1)), atol=1e-12)
    assert held.free == () and held.weight == 1.0
