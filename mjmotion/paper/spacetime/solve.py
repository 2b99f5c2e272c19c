"""One large optimisation against many small ones (§7): Gleicher's, as a reference for the fit.

    found = solve_spacetime(motion, constraints, shared=moves, first_guess=shift)
    found.motion, found.objective, found.max_error, found.seconds

All frames are solved at once: the control points of one displacement spline and the shared moves,
by SciPy's sparse least squares (trust region, LSMR, columns scaled by their own size) with exact
derivatives, constraints as residuals whose weights rise from round to round. It is tuned to be
quick: unscaled, or solved more exactly inside each step, it takes twice the time or more.

Whether constraints can be met depends on the knots. With one a frame they all can, and the rounds
go on until they are. With two frames a knot there are more constraints than unknowns to meet them
where every frame is held: heavier weights then buy little error for much deviation and jerk, so one
round of moderate weight is run, and the exact pass (§4.4) meets the rest, as it does for the fit.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.body.bones import Bones
from mjmotion.body.motion import Motion
from mjmotion.constraints import Constraint, SiteConstraint, Targets, lay_out
from mjmotion.constraints.shared_targets import SharedMove, free_moves
from mjmotion.constraints.unmet import residuals
from mjmotion.exceptions import FitError
from mjmotion.fitting import contact_shift, default_levels
from mjmotion.fitting.exact import ExactPass
from mjmotion.ik.hybrid import HybridIK
from mjmotion.ik.solver import default_rigidity
from mjmotion.numerics.tangent import ominus
from mjmotion.paper.spacetime.problem import Problem, State

Array = NDArray[np.float64]

SPACING = 2.0  # frames a knot: those of the fit's finest level
MET = (1e3, 1e6)  # ω of each round where every frame has a knot of its own [1/m² or 1/rad²]
COARSE = (1e3,)  # the same with fewer knots, which cannot meet constraints of every frame
TOLERANCE = 1e-3  # a round ends when a step lowers the sum of squares by a smaller share
_NEGLIGIBLE = 1e-8  # share of the unknowns' length below which a step ends a round
_MOST = 200  # steps a round
_EXACT = 1e-4  # error from which the exact pass is worth its while, as a share of height
_INNER = 0.1  # tolerance of the linear solves, in that of a round: less hurries nothing


@dataclasses.dataclass(frozen=True, eq=False)
class Spacetime:
    """What the large optimisation found.

    Attributes:
      motion: the motion.
      moves: (nshared, 4) what each shared move came to: along its directions [m], its turn [rad].
      targets: what was to hold, with shared moves made.
      guess: (nframe, nq) the motion after the first guess, from which deviations count.
      seconds: the whole time.
      iterations: steps of the optimisation, each with residuals of its own.
      objective: ``Σ_t Σ_i α_i |d_t,i|² + Σ rigidity |move|²`` of the motion.
      max_error: largest position error [m].
      left: the same before the exact pass, which is not run where this is small.
      nunknown, nresidual: size of the least squares.
      converged: every round ended because it could do no better.
    """

    motion: Motion
    moves: Array
    targets: Targets
    guess: Array
    seconds: float
    iterations: int
    objective: float
    max_error: float
    left: float
    nunknown: int
    nresidual: int
    converged: bool


def solve_spacetime(  # many parameters and lines: its settings, explained here, once
    motion: Motion,
    constraints: Sequence[Constraint],
    *,
    shared: Sequence[SharedMove] = (),
    first_guess: Array | bool = True,
    frames_per_knot: float = SPACING,
    rigidity: ArrayLike | None = None,
    penalties: Sequence[float] | None = None,
    tolerance: float = TOLERANCE,
    exact: bool = True,
    bones: Bones | None = None,
) -> Spacetime:
    """Find the least deviation of all frames at once that meets the constraints.

    Args:
      motion: the motion to change; it is not touched.
      constraints: what must hold: places and orientations of sites.
      shared: moves that frames have in common (§7), besides those of ``free`` constraints.
      first_guess: as for ``fit``: the contacts' average shift (§4.5), nothing, or
        a path (nframe, 3) for the root [m].
      frames_per_knot: frames a knot of the one displacement spline.
      rigidity: (nv,) α of Eq. 4.
      penalties: ω of each round, rising; without, chosen by whether every frame has its own knot.
      tolerance: a round ends when a step lowers the sum of squares by a smaller share.
      exact: meet at the end what is left (§4.4).
      bones: a body for each frame, where it changes.

    Raises:
      FitError: settings that make no sense, constraints of another kind, nothing to meet.
      ConstraintError, ModelError: a frame or site that does not exist.
    """
    began = time.perf_counter()
    alpha = _alpha(motion, rigidity)
    _check(motion, constraints, alpha, frames_per_knot, penalties, tolerance)
    targets = lay_out(constraints, motion.model, motion.nframe)
    guess = np.array(motion.qpos)
    if isinstance(first_guess, np.ndarray):
        guess[:, :3] += first_guess
    elif first_guess and targets.contact.any():
        guess[:, :3] += contact_shift(motion, targets, default_levels(motion.fps), bones)
    moves = [*shared, *free_moves(constraints)]
    problem = Problem(motion.character, guess, targets, moves, alpha, frames_per_knot, bones)
    if penalties is None:
        penalties = MET if frames_per_knot <= 1.0 else COARSE
    state, iterations, converged = _minimise(problem, penalties, tolerance)
    found = motion.replace(state.qpos)
    left = float(residuals(found, state.targets, bones).max(initial=0.0))
    if exact and left > _EXACT * motion.character.height:
        closing = HybridIK(motion.character, alpha, bones=bones).prepare(state.targets)
        coarsest = default_levels(motion.fps)[0]
        qpos, _ = ExactPass(motion, closing, state.targets, coarsest, bones)(state.qpos)
        found = motion.replace(qpos)
    return Spacetime(
        found,
        state.moves,
        state.targets,
        guess,
        time.perf_counter() - began,
        iterations,
        objective(found, guess, alpha, state.moves, moves),
        float(residuals(found, state.targets, bones).max(initial=0.0)),
        left,
        problem.nunknown,
        problem.nresidual,
        converged,
    )


def objective(
    motion: Motion,
    guess: Array,
    rigidity: ArrayLike | None = None,
    values: Array | None = None,
    shared: Sequence[SharedMove] = (),
) -> float:
    """Return what a motion costs: ``Σ_t Σ_i α_i |d_t,i|² + Σ rigidity |move|²``, d = m ⊖ guess.

    Args:
      motion: the motion.
      guess: (nframe, nq) the motion after the first guess.
      rigidity: (nv,) α of Eq. 4.
      values: (nshared, 4) what shared moves came to.
      shared: those moves.
    """
    alpha = _alpha(motion, rigidity)
    deviation = ominus(motion.model, motion.qpos, guess)
    cost = float(np.sum(alpha * deviation**2))
    if values is not None:
        for move, value in zip(shared, values, strict=True):
            cost += move.rigidity * float(value @ value)
    return cost


def _alpha(motion: Motion, rigidity: ArrayLike | None) -> Array:
    return default_rigidity(motion.model) if rigidity is None else np.asarray(rigidity, np.float64)


def _check(
    motion: Motion,
    constraints: Sequence[Constraint],
    alpha: Array,
    frames_per_knot: float,
    penalties: Sequence[float] | None,
    tolerance: float,
) -> None:
    if alpha.shape != (motion.model.nv,) or not (alpha > 0).all():
        raise FitError(f"rigidity must be {motion.model.nv} positive numbers, one a dof")
    if not (math.isfinite(frames_per_knot) and frames_per_knot > 0.0):
        raise FitError(f"{frames_per_knot} frames a knot must be a positive number")
    if penalties is not None and not (len(penalties) and min(penalties) > 0.0):
        raise FitError(f"penalties {list(penalties)} must be positive numbers, at least one")
    if not tolerance > 0.0:
        raise FitError(f"tolerance {tolerance} must be positive")
    if not constraints:
        raise FitError("no constraints: there is nothing for the optimisation to meet")
    for constraint in constraints:
        if not isinstance(constraint, SiteConstraint):
            raise FitError(
                f"{type(constraint).__name__} on site '{constraint.site}': the one large"
                " optimisation takes places and orientations of sites only; fit takes all kinds"
            )
    if motion.character.coupling:
        raise FitError(
            "the model couples joints: the one large optimisation cannot; give the rigid model"
        )


def _minimise(
    problem: Problem, penalties: Sequence[float], tolerance: float
) -> tuple[State, int, bool]:
    """Return where the rounds end, how many steps they took, and whether all came to rest."""
    from scipy.optimize import least_squares

    state = problem.state(np.zeros(problem.nunknown))
    iterations, converged = 0, True
    for omega in penalties:
        point = _Point(problem, state)
        result = least_squares(
            lambda x, at=point, ω=omega: problem.residuals(at(x), ω),
            state.unknowns,
            jac=lambda x, at=point, ω=omega: problem.jacobian(at(x), ω),
            method="trf",
            tr_solver="lsmr",
            tr_options={"atol": _INNER * tolerance, "btol": _INNER * tolerance},
            x_scale="jac",
            ftol=tolerance,
            xtol=_NEGLIGIBLE,
            gtol=None,
            max_nfev=_MOST,
        )
        state = point(result.x)
        iterations += int(result.nfev)
        converged &= bool(result.status > 0)
    return state, iterations, converged


class _Point:
    """The problem at the last point asked for: residuals and Jacobian are asked for in turn."""

    def __init__(self, problem: Problem, state: State) -> None:
        self._problem, self._state = problem, state

    def __call__(self, unknowns: Array) -> State:
        if not np.array_equal(unknowns, self._state.unknowns):
            self._state = self._problem.state(unknowns.copy())
        return self._state
