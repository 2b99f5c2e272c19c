"""Three ablations of §7: what the paper argues against, beside its own method, on the same job.

    for ablation in compare(make_job()):
        ablation.comparison, ablation.name, ablation.seconds, ablation.max_error_percent

1. An *interpolating spline* goes through the displacement of every constrained frame; multilevel
   B-splines approximate them, coarse to fine, and the exact pass (§4.4) meets what is left.
2. The *global* least squares fit of a level finds all its control points at once, by the pseudo
   inverse of the whole; the *local* one, Eq. 2, each from the data in its own support. Both fill
   the same levels of the same algorithm, without the exact pass, which would hide what they leave.
3. *One large optimisation* over all frames against many small ones, a frame each.

The overshoot says how far a displacement goes beyond the data: at every frame, beyond the interval
that holds zero and all displacements that IK asks for at constrained frames at most
:data:`WINDOW` frames away. Zero belongs to it, because a curve that fades to nothing where nothing
is asked does no harm.
"""

from __future__ import annotations

import dataclasses
import statistics
from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.body.motion import Motion
from mjmotion.constraints import Targets, lay_out
from mjmotion.constraints.unmet import residuals
from mjmotion.fitting import contact_shift
from mjmotion.ik.hybrid import HybridIK, HybridProblem
from mjmotion.ik.solver import Clearance, Deviation, Solution
from mjmotion.numerics.bspline import basis_matrix, fit_level
from mjmotion.numerics.tangent import ominus, oplus
from mjmotion.paper.job import LEVELS, Job
from mjmotion.paper.spacetime import objective, solve_spacetime
from mjmotion.paper.timing import run_in_turns
from mjmotion.validation.figures import jerk_dofs, joint_jerk_ratio

Array = NDArray[np.float64]

WINDOW = 16  # frames on either side whose data a displacement may be within: the coarsest knots
COMPARISONS = ("curve", "least squares", "optimisation")
_EXACT = 1e-6  # when IK has converged [m]
_MOST_STEPS = 12  # of IK towards that
_RIDGE = 1e-12  # what keeps normal equations solvable where no data touches a control point


@dataclasses.dataclass(frozen=True)
class Ablation:
    """What one method of a comparison came to.

    Attributes:
      job: the job's name.
      comparison: one of :data:`COMPARISONS`.
      name: of the method; the paper's own comes first in its comparison.
      seconds: median time of the whole fit [s].
      max_error_percent: largest position error [% of the character's height].
      overshoot_deg: furthest that a joint's displacement goes beyond the data [degrees].
      jerk_ratio: RMS jerk of the joint angles over the source's.
      deviation: ``Σ_t Σ_i α_i |d|²`` from the first guess (Eq. 4 over all frames).
    """

    job: str
    comparison: str
    name: str
    seconds: float
    max_error_percent: float
    overshoot_deg: float
    jerk_ratio: float
    deviation: float


def compare(job: Job, repeats: int = 5) -> tuple[Ablation, ...]:
    """Run a job with every method and measure the results.

    Args:
      job: the job.
      repeats: times are the medians of so many runs; the large optimisation runs once.
    """
    measure = Measure(job)
    ablations = []
    for comparison in COMPARISONS:
        methods = METHODS[comparison]
        quick = {name: partial(run, job) for name, run in methods.items() if run is not spacetime}
        slow = {name: partial(run, job) for name, run in methods.items() if run is spacetime}
        runs = run_in_turns(quick, repeats) | run_in_turns(slow, 1, warm=False)
        for name in methods:
            seconds = statistics.median(duration for duration, _ in runs[name])
            ablations.append(measure(comparison, name, seconds, runs[name][-1][1]))
    return tuple(ablations)


# The methods: each takes a job and returns the fitted motion


def multilevel(job: Job) -> Motion:
    """Fit it as the library does: levels, then the exact pass."""
    return job.fit().motion


def interpolating(job: Job) -> Motion:
    """Fit one cubic spline through the displacements of all constrained frames."""
    solver = Converged(job.motion.character, job.rigidity, bones=job.bones)
    # The same first guess: of itself the fit would smooth it by its own levels.
    shift = first_guess(job)[:, :3] - job.motion.qpos[:, :3]
    fit = job.fit(solver, levels=(1.0,), exact=False, curve=natural_spline, first_guess=shift)
    return fit.motion


def local_levels(job: Job) -> Motion:
    """Fit the levels by Eq. 2, without the exact pass."""
    return job.fit(exact=False, curve=fit_level).motion


def global_levels(job: Job) -> Motion:
    """Fit the levels by the pseudo inverse of the whole, without the exact pass."""
    return job.fit(exact=False, curve=pseudo_inverse).motion


def banded_levels(job: Job) -> Motion:
    """Fit the levels by banded global least squares, without the exact pass."""
    return job.fit(exact=False, curve=normal_equations).motion


def spacetime(job: Job) -> Motion:
    """Fit all frames by one large optimisation, as Gleicher does, then the exact pass."""
    return solve_spacetime(
        job.motion,
        job.constraints,
        first_guess=job.first_guess,
        rigidity=job.rigidity,
        bones=job.bones,
    ).motion


METHODS: Mapping[str, Mapping[str, Callable[[Job], Motion]]] = {
    "curve": {
        "multilevel B-splines, exact pass": multilevel,
        "interpolating spline": interpolating,
    },
    "least squares": {
        "local, Eq. 2": local_levels,
        "global, pseudo inverse": global_levels,
        "global, banded": banded_levels,
    },
    "optimisation": {
        "many small": multilevel,
        "one large": spacetime,
    },
}


# Curves that fill a level in place of Eq. 2; frames_per_knot and passes mean nothing to some


def natural_spline(
    frames: ArrayLike, data: Array, nframe: int, frames_per_knot: float, *, passes: int = 1
) -> Array:
    """Return the natural cubic spline through all data, level before the first and after the last.

    Args:
      frames: (n,) frames that have data, rising.
      data: (n, k) values.
      nframe: frames of the result.
      frames_per_knot: does not count: every data point is a knot.
      passes: does not count.

    Returns:
      (nframe, k) values.
    """
    from scipy.interpolate import CubicSpline

    knots = np.asarray(frames, dtype=np.float64)
    if len(knots) < 2:
        return np.broadcast_to(data.sum(axis=0), (nframe, data.shape[1])).copy()
    clipped = np.clip(np.arange(nframe), knots[0], knots[-1])
    return np.asarray(CubicSpline(knots, data, bc_type="natural")(clipped))


def pseudo_inverse(
    frames: ArrayLike, data: Array, nframe: int, frames_per_knot: float, *, passes: int = 1
) -> Array:
    """Return a level whose control points are the least-squares ones of least norm, all at once.

    Args:
      frames: (n,) frames that have data.
      data: (n, k) values.
      nframe: frames of the result.
      frames_per_knot: frames a knot.
      passes: does not count: once is the optimum.

    Returns:
      (nframe, k) values.
    """
    from scipy.linalg import lstsq

    basis = basis_matrix(frames, nframe, frames_per_knot).toarray()
    # Complete orthogonal factorisation: the same solution as by singular values, sooner.
    control = lstsq(basis, data, lapack_driver="gelsy", check_finite=False)[0]
    return np.asarray(basis_matrix(np.arange(nframe), nframe, frames_per_knot) @ control)


def normal_equations(
    frames: ArrayLike, data: Array, nframe: int, frames_per_knot: float, *, passes: int = 1
) -> Array:
    """Return what :func:`pseudo_inverse` does, all but for rounding, in time linear in frames.

    A control point meets only its neighbours, so the normal equations have seven diagonals. What
    the paper holds against the cost of a global fit does not hold for these.
    """
    from scipy.linalg import solveh_banded

    basis = basis_matrix(frames, nframe, frames_per_knot)
    normal = basis.T @ basis
    band = np.zeros((4, basis.shape[1]))
    for offset in range(4):
        band[3 - offset, offset:] = normal.diagonal(offset)
    band[3] += _RIDGE * band[3].max()
    control = solveh_banded(band, basis.T @ data, check_finite=False)
    return np.asarray(basis_matrix(np.arange(nframe), nframe, frames_per_knot) @ control)


class Converged(HybridIK):
    """Hybrid IK that goes on until its targets are met: what an interpolating spline needs."""

    def prepare(self, targets: Targets, clearance: Clearance | None = None) -> ConvergedProblem:
        """Return the problem of some targets; see :class:`IKSolver`."""
        return ConvergedProblem(self, targets, clearance)


class ConvergedProblem(HybridProblem):
    """The problem of :class:`Converged`."""

    def solve(
        self, qpos: Array, last: Solution | None = None, deviation: Deviation | None = None
    ) -> Solution:
        """Return displacements for poses (n, nq) that meet the targets; see :class:`IKProblem`."""
        model, moved = self._model, qpos
        first = solution = super().solve(qpos, last, deviation)
        for _ in range(_MOST_STEPS):
            moved = oplus(model, moved, solution.displacement)
            solution = super().solve(moved, solution, deviation)
            if solution.error.max(initial=0.0) < _EXACT:
                break
        moved = oplus(model, moved, self.enforce(moved).displacement)
        return Solution(ominus(model, moved, qpos), first.error)


class Measure:
    """Measures the motions that several methods make of one job."""

    def __init__(self, job: Job) -> None:
        self.job, self.model = job, job.motion.model
        self.targets = lay_out(job.constraints, self.model, job.nframe)
        self.guess = first_guess(job)
        self.joints = jerk_dofs(self.model)
        self.low, self.high = self._range()

    def __call__(self, comparison: str, name: str, seconds: float, motion: Motion) -> Ablation:
        """Return the figures of a method's motion, whose fit took so long [s]."""
        job = self.job
        error = float(residuals(motion, self.targets, job.bones).max(initial=0.0))
        return Ablation(
            job=job.name,
            comparison=comparison,
            name=name,
            seconds=seconds,
            max_error_percent=100.0 * error / job.motion.character.height,
            overshoot_deg=float(np.degrees(self.overshoot(motion).max(initial=0.0))),
            jerk_ratio=joint_jerk_ratio(motion, [job.source or job.motion]),
            deviation=objective(motion, self.guess, job.rigidity),
        )

    def overshoot(self, motion: Motion) -> Array:
        """Return how far every joint goes beyond the data (nframe, njoint) [rad]."""
        displacement = ominus(self.model, motion.qpos, self.guess)[:, self.joints]
        return np.maximum(np.maximum(displacement - self.high, self.low - displacement), 0.0)

    def _range(self) -> tuple[Array, Array]:
        """Least and greatest data (nframe, njoint) within the window of every frame, with zero."""
        from scipy.ndimage import maximum_filter1d, minimum_filter1d

        job, frames = self.job, self.targets.frames
        solver = Converged(job.motion.character, job.rigidity, bones=job.bones)
        data = np.zeros((job.nframe, self.model.nv))
        data[frames] = solver.prepare(self.targets).solve(self.guess[frames]).displacement
        data = data[:, self.joints]
        size = 2 * WINDOW + 1
        low = minimum_filter1d(np.minimum(data, 0.0), size, axis=0, mode="constant")
        return low, maximum_filter1d(np.maximum(data, 0.0), size, axis=0, mode="constant")


def first_guess(job: Job) -> Array:
    """Return the job's poses (nframe, nq) after the first guess, from which deviations count."""
    qpos = job.guess
    if job.first_guess is True:
        targets = lay_out(job.constraints, job.motion.model, job.nframe)
        qpos[:, :3] += contact_shift(job.motion, targets, LEVELS, job.bones)
    return qpos
