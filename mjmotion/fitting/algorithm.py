"""Algorithm 1: hierarchical motion fitting, with a first guess (§4.5) and an exact pass (§4.4).

    result = fit(motion, constraints, levels=(16, 8, 4, 2), ik="hybrid")
    result.motion, result.trace, result.unmet

Line by line of the paper: the loop over levels (1) stands in :func:`fit`; what one level does to
the constrained frames (2 to 7), the curve (8) and the motion (9) in
:func:`mjmotion.fitting.level.run_level`. Submaps never add up: each is applied to the motion that
the one before it left (Eq. 3).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.bones import Bones
from mjmotion.body.motion import Motion
from mjmotion.constraints import Constraint, Targets, lay_out
from mjmotion.constraints.shared_targets import SharedMove, free_moves
from mjmotion.constraints.unmet import find_unmet, relational_residuals, residuals
from mjmotion.exceptions import FitError, wrong_type
from mjmotion.fitting.exact import ExactPass
from mjmotion.fitting.first_guess import first_guess as make_guess
from mjmotion.fitting.goal import Goal
from mjmotion.fitting.level import run_level
from mjmotion.fitting.levels import (
    TOLERANCE,
    Refinement,
    check_levels,
    check_tolerance,
    default_levels,
    left_to_close,
)
from mjmotion.fitting.result import Fit
from mjmotion.fitting.submap import fit_submap
from mjmotion.fitting.trace import Stopwatch
from mjmotion.ik import IKSolver, make_solver
from mjmotion.ik.solver import Clearance
from mjmotion.numerics.bspline import Curve, fit_level
from mjmotion.numerics.progress import Progress, no_progress

Array = NDArray[np.float64]

PASSES = 2  # times that Eq. 2 is applied at a level's knots: then to what the first time left


def fit(  # many parameters and lines: the settings of the algorithm, explained here, once
    motion: Motion,
    constraints: Sequence[Constraint],
    *,
    levels: Sequence[float] | None = None,
    tolerance: float = TOLERANCE,
    ik: str | IKSolver = "hybrid",
    clearance: Clearance | None = None,
    first_guess: Array | bool = True,
    exact: bool = True,
    shared: Sequence[SharedMove] = (),
    curve: Curve = fit_level,
    progress: Progress = no_progress,
) -> Fit:
    """Fit a motion to constraints (Algorithm 1).

    Args:
      motion: the motion to change; it is not touched.
      constraints: what must hold; see :mod:`mjmotion.constraints`.
      levels: frames a knot of each level, coarse to fine; :func:`default_levels` without.
      tolerance: refinement stops once no position is off by more [m]; where a turn or a look-at is
        asked for without a position, it does not stop before the last level.
      ik: ``"hybrid"``, ``"numeric"`` or a solver of one's own (:mod:`mjmotion.ik.solver`), which
        may have other rigidities α of Eq. 4, or bones that change from frame to frame.
      clearance: what to keep clear of.
      first_guess: shift the root by the contacts' average shift first (§4.5), not at all, or by a
        path (nframe, 3) of one's own [m].
      exact: enforce every constrained frame at the end (§4.4).
      shared: moves that frames have in common (§7), besides those of ``free`` constraints.
      curve: fits a level in place of Eq. 2, to compare it with (§7).
      progress: called with ``"fit"``, levels done and levels in all.

    Raises:
      FitError: settings that make no sense, or free targets with a solver that cannot move them.
      ConstraintError, ModelError: a frame or site that does not exist.
    """
    if not isinstance(motion, Motion):
        raise FitError(wrong_type("motion", motion, "a Motion (load_clip gives one)"))
    character = motion.character
    levels = check_levels(default_levels(motion.fps) if levels is None else levels)
    solver = make_solver(character, ik)
    bones: Bones | None = getattr(solver, "bones", None)
    if bones is not None:
        bones.check(motion.model, motion.nframe)
    targets = lay_out(constraints, motion.model, motion.nframe)
    if clearance is not None:
        targets = targets.over_all_frames(motion.nframe)

    watch = Stopwatch(character.height)
    qpos = make_guess(motion, targets, first_guess, levels, bones)  # m_0
    watch.guessed()
    moves = [*shared, *free_moves(constraints)]
    goal = Goal.begin(solver, character, targets, moves, clearance, qpos)
    refinement, level = Refinement(levels, check_tolerance(tolerance), exact), None

    def left(qpos: Array, targets: Targets) -> float:
        return left_to_close(motion, qpos, targets, clearance, bones)

    while frames_per_knot := refinement.next(len(watch), partial(left, qpos, goal.targets)):
        watch.start()
        goal = goal.advanced(qpos, None if level is None else level.solution)
        spline = partial(
            fit_submap, character, goal.targets, motion.nframe, frames_per_knot, PASSES, curve
        )
        level = run_level(character, qpos, goal.targets.frames, goal.solve, spline)
        if len(watch) and refinement.reached(level.error, goal.targets, goal.settled):
            break
        qpos = level.qpos  # m_k
        watch.level(frames_per_knot, level.error)
        progress("fit", len(watch), len(levels) + int(exact))

    error = None
    if exact and goal.targets.held.any():
        qpos, error = ExactPass(motion, goal.problem, goal.targets, levels[0], bones)(qpos)
    fitted = motion.replace(qpos if error is not None else character.within_limits(qpos))
    gap = residuals(fitted, goal.targets, bones)
    relative = relational_residuals(fitted, goal.targets, bones)[:, : len(goal.targets.relative)]
    worst = float(max(gap.max(initial=0.0), relative.max(initial=0.0)))
    trace = watch.trace(
        worst if error is None else error,
        worst,
        sum(constraint.nscalar for constraint in constraints),
    )
    unmet = find_unmet(fitted, goal.targets, constraints, bones, gap=gap)
    return Fit(fitted, trace, unmet, goal.moves, goal.targets)
