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

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion import limits
from mjmotion.constraints import SiteConstraint, Targets, lay_out
from mjmotion.exceptions import FitError, unknown_name
from mjmotion.ik.hybrid import HybridIK
from mjmotion.ik.numeric import NumericIK
from mjmotion.ik.solver import Clearance, IKSolver, default_weights, position_error
from mjmotion.kinematics import character_height, site_positions
from mjmotion.motion import Motion
from mjmotion.smoothing import cover
from mjmotion.spline import fit_level, fit_multilevel
from mjmotion.tangent import oplus

Array = NDArray[np.float64]

SOLVERS = ("hybrid", "numeric")
FIRST_SPACING = 16.0 / 30.0  # the paper's coarsest knots: 16 frames at 30 fps [s]
FINEST = 2.0  # frames a knot of the last level
EDGE_RESIDUAL = 1e-4  # what may be left beside free frames before the exact pass [m]
UNMET = 1e-3  # residual from which a constraint counts as not met [m]
TOUCHING = 0.004  # nearer than this to an obstacle, and another level follows [m]
RISE_TIME = 0.25  # over how long the root rises or sinks for a limb to reach at last [s]
LIMIT_SLACK = 1e-5  # how far a closed limb may be out of its range before the root gives [rad]
_EASES = 4
_BETTER = 0.8  # another level only while each leaves less than this share of the one before
_EXTRA_LEVELS = 6  # at most, at the finest spacing, to get the edges that close
_PASSES = 2  # times that Eq. 2 is applied at a level's knots: then to what the first time left
_STILL = 1e-6  # a displacement this small is rounding [rad or m]


@dataclasses.dataclass(frozen=True)
class LevelTrace:
    """One level: its place (from 1), knots, time [s] and the error it left [% of height]."""

    level: int
    frames_per_knot: float
    seconds: float
    max_error_percent: float


@dataclasses.dataclass(frozen=True)
class Trace:
    """What a fit did: its levels, its whole time [s] and the errors before and after [%]."""

    levels: tuple[LevelTrace, ...]
    fit_seconds: float
    first_error_percent: float
    exact_error_percent: float
    nscalar: int


@dataclasses.dataclass(frozen=True)
class Unmet:
    """A constraint that could not be met: where and by how much [mm]."""

    constraint: str
    frames: tuple[int, ...]
    residual_mm: float


@dataclasses.dataclass(frozen=True, eq=False)
class Fit:
    """A fitted motion, what the fit did, and what it could not meet."""

    motion: Motion
    trace: Trace
    unmet: tuple[Unmet, ...]


def default_levels(fps: float) -> tuple[float, ...]:
    """Return frames a knot of every level: 16, 8, 4, 2 at 30 fps, as long in seconds at others."""
    first = max(FINEST, FIRST_SPACING * fps)
    count = 1 + max(0, round(math.log2(first / FINEST)))
    return tuple(FINEST * 2.0 ** (count - 1 - level) for level in range(count))


def fit(
    motion: Motion,
    constraints: Sequence[SiteConstraint],
    *,
    levels: Sequence[float] | None = None,
    tolerance: float = 0.0,
    ik: str | IKSolver = "hybrid",
    weights: ArrayLike | None = None,
    clearance: Clearance | None = None,
    first_guess: Array | bool = True,
    exact: bool = True,
    unmet_tolerance: float = UNMET,
    progress: Callable[[int, int], None] | None = None,
) -> Fit:
    """Fit a motion to constraints (Algorithm 1).

    Args:
      motion: the motion to change; it is not touched.
      constraints: what must hold; see :class:`SiteConstraint`.
      levels: frames a knot, coarse to fine; :func:`default_levels` without.
      tolerance: refinement stops once no position is off by more [m].
      ik: ``"hybrid"``, ``"numeric"`` or a solver of one's own.
      weights: (nv,) rigidity α of Eq. 4.
      clearance: what to keep clear of.
      first_guess: shift the root by the contacts' average shift first (§4.5), not at all, or by a
        path (nframe, 3) of one's own [m].
      exact: enforce every constrained frame at the end (§4.4).
      unmet_tolerance: residual from which a constraint counts as not met [m].
      progress: called with levels done and levels in all.

    Raises:
      FitError: settings that make no sense.
      ConstraintError, ModelError: a frame or site that does not exist.
    """
    began = time.perf_counter()
    spacings = _check_levels(default_levels(motion.fps) if levels is None else levels)
    solver = _make_solver(motion, ik, weights)
    everywhere = clearance is not None
    targets = lay_out(constraints, motion.model, motion.nframe)
    if everywhere:
        targets = over_all_frames(targets, motion.nframe)
    height = character_height(motion.model)
    qpos = np.array(motion.qpos)
    if isinstance(first_guess, np.ndarray):
        qpos[:, :3] += first_guess
    elif first_guess and targets.contact.any():
        qpos[:, :3] += contact_shift(motion, targets, spacings)

    traced: list[tuple[float, float, float]] = []  # spacing, seconds, error before the level
    queue = list(spacings)
    last_error, worst_left = math.nan, math.inf
    while queue:
        spacing = queue.pop(0)
        start = time.perf_counter()
        frames, displacement, last_error = _solve_level(solver, qpos, targets, clearance)
        if traced and last_error <= tolerance:
            break
        if len(frames):
            submap = fit_level(frames, displacement, motion.nframe, spacing, passes=_PASSES)
            qpos = oplus(motion.model, qpos, submap)
        traced.append((spacing, time.perf_counter() - start, last_error))
        if progress is not None:
            progress(len(traced), len(spacings) + int(exact))
        if not queue and exact and len(traced) - len(spacings) < _EXTRA_LEVELS:
            left = _left_to_do(motion, qpos, targets, clearance)
            if left > 0.0 and left < _BETTER * worst_left:
                queue.append(spacings[-1])
            worst_left = left
    if exact and len(targets.frames) and len(targets.sites):
        qpos, last_error = _enforce(solver, motion, qpos, targets, spacings)
    else:
        qpos = limits.clamp_to_limits(motion.model, qpos)
    fitted = motion.replace(qpos)
    residual = residuals(fitted, targets)
    seconds = time.perf_counter() - began
    worst = float(residual.max(initial=0.0))
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
    )
    return Fit(fitted, trace, find_unmet(motion, targets, residual, unmet_tolerance))


def _check_levels(levels: Sequence[float]) -> list[float]:
    spacings = [float(spacing) for spacing in levels]
    if not spacings:
        raise FitError("levels is empty: give frames a knot, such as 16, 8, 4, 2")
    if any(not (math.isfinite(spacing) and spacing > 0) for spacing in spacings):
        raise FitError(f"levels {spacings} must be positive numbers of frames")
    if any(b > a for a, b in pairwise(spacings)):
        raise FitError(f"levels {spacings} must go from coarse to fine")
    return spacings


def _make_solver(motion: Motion, ik: str | IKSolver, weights: ArrayLike | None) -> IKSolver:
    if not isinstance(ik, str):
        return ik
    if ik not in SOLVERS:
        raise FitError(unknown_name("IK solver", ik, SOLVERS))
    alpha = None if weights is None else np.asarray(weights, dtype=np.float64)
    if alpha is not None and (alpha.shape != (motion.model.nv,) or not (alpha > 0).all()):
        raise FitError(f"weights must be {motion.model.nv} positive numbers, one a dof")
    return (HybridIK if ik == "hybrid" else NumericIK)(motion.model, alpha)


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
    return Targets(frames=np.arange(nframe), sites=targets.sites, **spread)


def _enforce(
    solver: IKSolver, motion: Motion, qpos: Array, targets: Targets, spacings: Sequence[float]
) -> tuple[Array, float]:
    """Make the exact pass (§4.4): poses within limits that meet the targets, and the error before.

    Where a limb would not reach, or would leave its range, the root gives first, over more frames
    than those, so that nothing jerks.
    """
    frames = targets.frames
    solution = solver.enforce(qpos[frames], targets)
    error = float(solution.error.max(initial=0.0))
    if solution.rise is not None and solution.rise.any():
        qpos = qpos.copy()
        qpos[:, 2] += _spread(solution.rise, frames, motion)
        solution = solver.enforce(qpos[frames], targets)
    before = math.inf
    for turn in range(_EASES + 1):
        closed = qpos.copy()
        closed[frames] = oplus(motion.model, qpos[frames], solution.displacement)
        clamped = limits.clamp_to_limits(motion.model, closed)
        beyond = np.abs(clamped[frames] - closed[frames]).max(axis=1)
        over, worst = beyond > LIMIT_SLACK, float(beyond.max())
        # What no smooth move of the root mends stays within limits, and is reported.
        if not over.any() or turn == _EASES or worst > _BETTER * before:
            break
        before = worst
        qpos = _ease(motion, qpos, targets, np.flatnonzero(over), spacings)
        solution = solver.enforce(qpos[frames], targets)
    return clamped, error


def _spread(rise: Array, frames: NDArray[np.int64], motion: Motion) -> Array:
    """Spread smoothly over frames (nframe,) what the root must rise or sink at some."""
    spread = np.zeros(motion.nframe)
    for sign in (1.0, -1.0):
        need = np.zeros(motion.nframe)
        need[frames] = sign * rise
        spread += sign * cover(need, RISE_TIME * motion.fps)
    return spread


def _ease(
    motion: Motion,
    qpos: Array,
    targets: Targets,
    rows: NDArray[np.int64],
    spacings: Sequence[float],
) -> Array:
    """Move the root, smoothly, where closed limbs would leave their range.

    The numeric solver knows limits and finds where the root would have to be at those frames; a
    level of its own spreads that to the frames around them.
    """
    weights = default_weights(motion.model)
    weights[:6] = 1.0
    frames = targets.frames[rows]
    wish = NumericIK(motion.model, weights, iterations=4).solve(qpos[frames], targets.at(rows))
    root = np.zeros((len(frames), motion.model.nv))
    root[:, :6] = wish.displacement[:, :6]
    spacing = min(spacings[0], RISE_TIME * motion.fps)
    return oplus(motion.model, qpos, fit_level(frames, root, motion.nframe, spacing))


def _held(targets: Targets) -> NDArray[np.bool_]:
    """Which of the targets' frames hold anything (n,)."""
    weight = np.maximum(targets.position_weight, targets.turn_weight)
    return np.asarray((weight > 0).any(axis=1))


def _solve_level(
    solver: IKSolver, qpos: Array, targets: Targets, clearance: Clearance | None
) -> tuple[NDArray[np.int64], Array, float]:
    solution = solver.solve(qpos[targets.frames], targets, clearance)
    error = float(solution.error.max(initial=0.0))
    if clearance is None:
        return targets.frames, solution.displacement, error
    wanted = _held(targets) | (np.abs(solution.displacement).max(axis=1) > _STILL)
    return targets.frames[wanted], solution.displacement[wanted], error


def contact_shift(motion: Motion, targets: Targets, spacings: Sequence[float]) -> Array:
    """Return the root shift of §4.5 (nframe, 3) [m]: the contacts' average shift, smoothed."""
    sites = site_positions(motion.model, motion.qpos[targets.frames], targets.sites)
    shift = targets.position - sites
    share = (targets.contact & (targets.position_weight > 0)).astype(float)
    count = share.sum(axis=1)
    has = count > 0
    mean = (shift * share[..., None]).sum(axis=1)[has] / count[has, None]
    return fit_multilevel(targets.frames[has], mean, motion.nframe, spacings)


def _has_edges(targets: Targets, motion: Motion) -> bool:
    return not (
        len(targets.frames) == motion.nframe
        and (targets.position_weight > 0).all(axis=0).sum() == len(targets.sites)
    )


def _left_to_do(
    motion: Motion, qpos: Array, targets: Targets, clearance: Clearance | None
) -> float:
    """How far the exact pass would jump beside free frames, or a body is still too near [m]."""
    left = 0.0
    if _has_edges(targets, motion):
        edge = _edge_residual(motion, qpos, targets)
        left = edge if edge > EDGE_RESIDUAL else 0.0
    if clearance is not None:
        distance = clearance(qpos, np.arange(motion.nframe)).distance
        left = max(left, TOUCHING - float(distance.min(initial=TOUCHING)))
    return left


def _edge_residual(motion: Motion, qpos: Array, targets: Targets) -> float:
    """Largest position error in frames next to one where that site is free [m]."""
    held = np.zeros((motion.nframe + 2, len(targets.sites)), dtype=bool)
    held[targets.frames + 1] = targets.position_weight > 0
    held[0], held[-1] = held[1], held[-2]
    edge = held[1:-1] & ~(held[:-2] & held[2:])
    gap = residuals(motion.replace(qpos), targets)
    return float((gap * edge[targets.frames]).max(initial=0.0))


def residuals(motion: Motion, targets: Targets) -> Array:
    """Return position errors (n, s) [m] at the targets' frames, 0 where nothing is wanted."""
    if len(targets.frames) == 0 or len(targets.sites) == 0:
        return np.zeros((len(targets.frames), len(targets.sites)))
    sites = site_positions(motion.model, motion.qpos[targets.frames], targets.sites)
    gap = np.linalg.norm(targets.position - sites, axis=-1)
    return np.asarray(gap * (targets.position_weight > 0))


def find_unmet(
    motion: Motion, targets: Targets, residual: Array, tolerance: float = UNMET
) -> tuple[Unmet, ...]:
    """Return the exact position targets of a motion that are off by more than ``tolerance`` [m].

    Args:
      motion: the fitted motion.
      targets: what was to hold.
      residual: (n, s) :func:`residuals` of the two [m].
      tolerance: residual from which a constraint counts as not met [m].
    """
    found = []
    for column, site in enumerate(targets.sites):
        exact = targets.position_weight[:, column] == 1.0
        bad = np.flatnonzero(exact & (residual[:, column] > tolerance))
        if len(bad):
            frames = tuple(int(frame) for frame in targets.frames[bad])
            worst = 1000.0 * float(residual[bad, column].max())
            found.append(Unmet(f"position of {motion.model.site(site).name}", frames, worst))
    return tuple(found)


__all__ = [
    "Fit",
    "LevelTrace",
    "Trace",
    "Unmet",
    "contact_shift",
    "default_levels",
    "find_unmet",
    "fit",
    "position_error",
    "residuals",
]
