"""Hierarchical motion fitting: Algorithm 1, the first guess of §4.5 and the exact pass of §4.4.

    result = fit(motion, constraints, levels=(16, 8, 4, 2), ik="hybrid")
    result.motion, result.trace

At each level an IK solver finds, for every constrained frame on its own, the least displacement
that meets the constraints; a uniform cubic B-spline is fitted through those displacements; the
motion moves by the spline; the knots halve. Submaps never add up: each is applied to the motion
that the one before it left (Eq. 3).
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.body.bones import Bones
from mjmotion.body.joint_coupling import couple
from mjmotion.body.kinematics import character_height, site_positions
from mjmotion.body.motion import Motion
from mjmotion.constraints import Constraint, Gaze, Link, Targets, lay_out
from mjmotion.constraints.shared_targets import SETTLED, SharedMove, SharedMoves, free_moves
from mjmotion.exceptions import FitError, unknown_name
from mjmotion.fitting.exact import ExactPass, within_limits
from mjmotion.fitting.result import (
    UNMET,
    Fit,
    LevelTrace,
    Trace,
    find_unmet,
    other_residuals,
    residuals,
)
from mjmotion.fitting.submap import fit_submap
from mjmotion.ik.hybrid import HybridIK
from mjmotion.ik.numeric import NumericIK
from mjmotion.ik.solver import Clearance, IKSolver, Solution
from mjmotion.numerics.bspline import Curve, fit_level, fit_multilevel
from mjmotion.numerics.tangent import ominus, oplus

Array = NDArray[np.float64]

SOLVERS = ("hybrid", "numeric")
FIRST_SPACING = 16.0 / 30.0  # the paper's coarsest knots: 16 frames at 30 fps [s]
FINEST = 2.0  # frames a knot of the last level
EDGE_RESIDUAL = 1e-4  # what may be left beside free frames before the exact pass [m]
TOUCHING = 0.004  # nearer than this to an obstacle, and another level follows [m]
_BETTER = 0.8  # another level only while each leaves less than this share of the one before
_EXTRA_LEVELS = 6  # at most, at the finest spacing, to get the edges that close
_PASSES = 2  # times that Eq. 2 is applied at a level's knots: then to what the first time left
_ASKED = 6  # frames of the shortest shared move that tell what moves would cost


def default_levels(fps: float) -> tuple[float, ...]:
    """Return frames a knot of every level: 16, 8, 4, 2 at 30 fps, as long in seconds at others."""
    first = max(FINEST, FIRST_SPACING * fps)
    count = 1 + max(0, round(math.log2(first / FINEST)))
    return tuple(FINEST * 2.0 ** (count - 1 - level) for level in range(count))


def fit(
    motion: Motion,
    constraints: Sequence[Constraint],
    *,
    levels: Sequence[float] | None = None,
    tolerance: float = 0.0,
    ik: str | IKSolver = "hybrid",
    weights: ArrayLike | None = None,
    clearance: Clearance | None = None,
    first_guess: Array | bool = True,
    exact: bool = True,
    unmet_tolerance: float = UNMET,
    shared: Sequence[SharedMove] = (),
    bones: Bones | None = None,
    curve: Curve = fit_level,
    progress: Callable[[int, int], None] | None = None,
) -> Fit:
    """Fit a motion to constraints (Algorithm 1).

    Args:
      motion: the motion to change; it is not touched.
      constraints: what must hold; see :mod:`mjmotion.constraints`.
      levels: frames a knot, coarse to fine; :func:`default_levels` without.
      tolerance: refinement stops once no position is off by more [m]; where a turn or a gaze is
        asked for without a position, it does not stop before the last level.
      ik: ``"hybrid"``, ``"numeric"`` or a solver of one's own.
      weights: (nv,) rigidity α of Eq. 4.
      clearance: what to keep clear of.
      first_guess: shift the root by the contacts' average shift first (§4.5), not at all, or by a
        path (nframe, 3) of one's own [m].
      exact: enforce every constrained frame at the end (§4.4).
      unmet_tolerance: residual from which a constraint counts as not met [m].
      shared: moves that frames have in common (§7), besides those of ``free`` constraints.
      bones: a body that is not the model's own, or one for each frame (Figure 5d).
      curve: fits a level in place of Eq. 2, to compare it with (§7).
      progress: called with levels done and levels in all.

    Raises:
      FitError: settings that make no sense.
      ConstraintError, ModelError: a frame or site that does not exist.
    """
    began = time.perf_counter()
    spacings = _check_levels(default_levels(motion.fps) if levels is None else levels)
    if bones is not None:
        bones.check(motion.model, motion.nframe)
    solver = _make_solver(motion, ik, weights, bones)
    targets = lay_out(constraints, motion.model, motion.nframe)
    if clearance is not None:
        targets = over_all_frames(targets, motion.nframe)
    moves = [*shared, *free_moves(constraints)]
    together = SharedMoves(moves, targets, motion.model) if moves else None
    values = np.zeros((len(moves), 4))
    height = character_height(motion.model)
    guessing = time.perf_counter()
    qpos = couple(motion.model, motion.qpos)
    if isinstance(first_guess, np.ndarray):
        qpos[:, :3] += first_guess
    elif first_guess and targets.contact.any():
        qpos[:, :3] += contact_shift(motion, targets, spacings, bones)
    guessed = time.perf_counter() - guessing

    guess, settled = qpos, False
    alone = np.ones(len(targets.frames), dtype=bool) if together is None else ~together.touched
    traced: list[tuple[float, float, float]] = []  # spacing, seconds, error before the level
    queue = list(spacings)
    last_error, worst_left = math.nan, math.inf
    while queue:
        spacing = queue.pop(0)
        start = time.perf_counter()
        poses, deviation = qpos[targets.frames], None
        if together is not None:
            # Moves add up over the levels, and so must the deviation that they are to keep least.
            deviation = np.zeros((len(poses), motion.model.nv))
            if traced:
                deviation = ominus(motion.model, poses, guess[targets.frames])
            deviation[alone] = np.nan
            if not settled:
                values, settled = _move(*(together, values, solver, poses, targets, deviation))
                targets = together.moved(values)
        solution, last_error = _solve_level(solver, poses, targets, clearance, deviation)
        if solution.pushed is not None:
            alone |= solution.pushed  # what was pushed out of something must not be drawn back in
        done = last_error <= tolerance and not targets.turning and (together is None or settled)
        if traced and done:
            break
        if len(targets.frames):
            submap = fit_submap(
                motion.model, targets, solution, motion.nframe, spacing, _PASSES, curve
            )
            qpos = couple(motion.model, oplus(motion.model, qpos, submap))
        traced.append((spacing, time.perf_counter() - start, last_error))
        if progress is not None:
            progress(len(traced), len(spacings) + int(exact))
        if not queue and exact and len(traced) - len(spacings) < _EXTRA_LEVELS:
            left = _left_to_do(motion, qpos, targets, clearance, bones)
            if left > 0.0 and left < _BETTER * worst_left:
                queue.append(spacings[-1])
            worst_left = left
    if exact and targets.held.any():
        qpos, last_error = ExactPass(motion, solver, targets, spacings[0], bones)(qpos)
    else:
        qpos = within_limits(motion, qpos)
    fitted = motion.replace(qpos)
    residual = residuals(fitted, targets, bones)
    others = other_residuals(fitted, targets, bones)[: len(targets.links)]
    seconds = time.perf_counter() - began
    worst = max(float(error.max(initial=0.0)) for error in (residual, *(e for _, e in others)))
    if not exact:
        last_error = worst
    percent = 100.0 / height
    after = [error for _, _, error in traced[1:]] + [last_error]
    trace = Trace(
        tuple(
            LevelTrace(index + 1, spacing, took, percent * error)
            for index, ((spacing, took, _), error) in enumerate(zip(traced, after, strict=True))
        ),
        seconds,
        percent * (traced[0][2] if traced else 0.0),
        percent * worst,
        sum(constraint.nscalar for constraint in constraints),
        guessed,
    )
    unmet = find_unmet(fitted, targets, residual, unmet_tolerance, bones)
    return Fit(fitted, trace, unmet, values, targets)


def _check_levels(levels: Sequence[float]) -> list[float]:
    spacings = [float(spacing) for spacing in levels]
    if not spacings:
        raise FitError("levels is empty: give frames a knot, such as 16, 8, 4, 2")
    if any(not (math.isfinite(spacing) and spacing > 0) for spacing in spacings):
        raise FitError(f"levels {spacings} must be positive numbers of frames")
    if any(b > a for a, b in pairwise(spacings)):
        raise FitError(f"levels {spacings} must go from coarse to fine")
    return spacings


def _make_solver(
    motion: Motion, ik: str | IKSolver, weights: ArrayLike | None, bones: Bones | None
) -> IKSolver:
    if not isinstance(ik, str):
        return ik
    if ik not in SOLVERS:
        raise FitError(unknown_name("IK solver", ik, SOLVERS))
    alpha = None if weights is None else np.asarray(weights, dtype=np.float64)
    if alpha is not None and (alpha.shape != (motion.model.nv,) or not (alpha > 0).all()):
        raise FitError(f"weights must be {motion.model.nv} positive numbers, one a dof")
    kind = HybridIK if ik == "hybrid" else NumericIK
    return kind(motion.model, alpha, bones=bones)


def over_all_frames(targets: Targets, nframe: int) -> Targets:
    """Return targets for every frame, nothing held where they say nothing."""
    shape = (nframe, len(targets.sites))
    quat = np.zeros((*shape, 4))
    quat[..., 0] = 1.0
    spread = {
        "position": np.zeros((*shape, 3)),
        "matrix": np.broadcast_to(np.eye(3), (*shape, 3, 3)).copy(),
        "quat": quat,
        "position_weight": np.zeros(shape),
        "turn_weight": np.zeros(shape),
        "contact": np.zeros(shape, dtype=bool),
    }
    for name, values in spread.items():
        values[targets.frames] = getattr(targets, name)
    links, gazes = [], []
    for link in targets.links:
        names = ("position", "quat", "position_weight", "turn_weight")
        links.append(dataclasses.replace(link, **_spread_out(link, names, targets.frames, nframe)))
    for gaze in targets.gazes:
        more = _spread_out(gaze, ("point", "weight"), targets.frames, nframe)
        gazes.append(dataclasses.replace(gaze, **more))
    return Targets(
        frames=np.arange(nframe),
        sites=targets.sites,
        links=tuple(links),
        gazes=tuple(gazes),
        **spread,
    )


def _spread_out(
    one: Link | Gaze, names: Sequence[str], frames: NDArray[np.int64], nframe: int
) -> dict[str, Any]:
    """Return fields of a link or gaze for every frame: zero, or upright, where it says nothing."""
    spread = {}
    for name in names:
        values = getattr(one, name)
        whole = np.zeros((nframe, *values.shape[1:]))
        if name == "quat":
            whole[:, 0] = 1.0
        whole[frames] = values
        spread[name] = whole
    return spread


def _move(
    together: SharedMoves,
    values: Array,
    solver: IKSolver,
    poses: Array,
    targets: Targets,
    deviation: Array,
) -> tuple[Array, bool]:
    """Return better shared moves, and whether they hardly changed.

    What frames answer varies slowly: a few of the shortest move speak for all.
    """
    rows = together.some_rows(_ASKED)
    some = targets.at(rows)
    sensitivity = solver.sensitivity(poses[rows], some, deviation[rows])
    better = together.step(values, targets, rows, sensitivity)
    return better, bool(np.abs(better - values).max() < SETTLED)


def _solve_level(
    solver: IKSolver,
    poses: Array,
    targets: Targets,
    clearance: Clearance | None,
    deviation: Array | None,
) -> tuple[Solution, float]:
    kept = {} if deviation is None else {"deviation": deviation}
    solution = solver.solve(poses, targets, clearance, **kept)
    return solution, float(solution.error.max(initial=0.0))


def contact_shift(
    motion: Motion, targets: Targets, spacings: Sequence[float], bones: Bones | None = None
) -> Array:
    """Return the root shift of §4.5 (nframe, 3) [m]: the contacts' average shift, smoothed."""
    mine = bones if bones is None else bones.at(targets.frames)
    sites = site_positions(motion.model, motion.qpos[targets.frames], targets.sites, mine)
    shift = targets.position - sites
    share = (targets.contact & (targets.position_weight > 0)).astype(float)
    count = share.sum(axis=1)
    has = count > 0
    mean = (shift * share[..., None]).sum(axis=1)[has] / count[has, None]
    return fit_multilevel(targets.frames[has], mean, motion.nframe, spacings)


def _held_columns(targets: Targets) -> NDArray[np.bool_]:
    """Return (n, s + links + gazes) what holds a place, or a gaze, at each constrained frame."""
    columns = [targets.position_weight, *(x.position_weight[:, None] for x in targets.links)]
    return np.concatenate((*columns, *(x.weight[:, None] for x in targets.gazes)), axis=1) > 0.0


def _left_to_do(
    motion: Motion,
    qpos: Array,
    targets: Targets,
    clearance: Clearance | None,
    bones: Bones | None,
) -> float:
    """How far the exact pass would jump beside free frames, or a body is still too near [m]."""
    left = 0.0
    held = _held_columns(targets)
    if len(held) < motion.nframe or not held.all():
        edge = _edge_residual(motion, qpos, targets, held, bones)
        left = edge if edge > EDGE_RESIDUAL else 0.0
    if clearance is not None:
        distance = clearance(qpos, np.arange(motion.nframe)).distance
        left = max(left, TOUCHING - float(distance.min(initial=TOUCHING)))
    return left


def _edge_residual(
    motion: Motion,
    qpos: Array,
    targets: Targets,
    columns: NDArray[np.bool_],
    bones: Bones | None,
) -> float:
    """Largest error in frames next to one where what is held there is free [m]."""
    held = np.zeros((motion.nframe + 2, columns.shape[1]), dtype=bool)
    held[targets.frames + 1] = columns
    held[0], held[-1] = held[1], held[-2]
    edge = held[1:-1] & ~(held[:-2] & held[2:])
    moved = motion.replace(qpos)
    others = [error[:, None] for _, error in other_residuals(moved, targets, bones)]
    gap = np.concatenate((residuals(moved, targets, bones), *others), axis=1)
    return float((gap * edge[targets.frames]).max(initial=0.0))
