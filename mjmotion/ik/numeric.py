"""The numeric solver (§5.1): Gauss–Newton on every frame at once, for any tree with a free root.

The unknown is the displacement itself (Eq. 5), so rotations need no unit-length constraint. Each
step solves the least-deviation problem

    minimise ½ dᵀ M d   subject to   J d = e + J d_prev

through its dual, ``d = M⁻¹ Jᵀ (J M⁻¹ Jᵀ + R)⁻¹ (e + J d_prev)``, which is E×E for E constraints and
far smaller than the D×D primal for D degrees of freedom. ``R`` softens rows of weight below 1.
Inequalities enter as equalities in the frames that break them, and joints that leave their range
are put on its edge and held there for the rest of the solve: the penalty of Eq. 6 in the limit.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.bones import Bones
from mjmotion.body.character import Character, CharacterLike
from mjmotion.body.kinematics import Kinematics, Pose, body_dofs
from mjmotion.constraints import Targets
from mjmotion.constraints.shared_targets import Sensitivity
from mjmotion.ik.rows import look_at_rows, relative_rows
from mjmotion.ik.solver import (
    Clearance,
    Deviation,
    Inequalities,
    Solution,
    default_rigidity,
    position_error,
)
from mjmotion.numerics.rotations import from_matrix, log
from mjmotion.numerics.tangent import ominus, oplus

Array = NDArray[np.float64]

STEP_LIMIT = 0.7  # the most that any degree of freedom changes in one step [rad or m]
_RIDGE = 1e-9  # keeps the dual solvable where a limb is straight [m²]
_SOFT = 0.05  # compliance of a row at half weight [m²]
_INEQUALITY_SOFT = 1e-5  # compliance of an inequality [m²]
_MAX_ROWS = 12  # inequalities of one frame that are solved at a time, the worst first
_LIMIT_TOLERANCE = 1e-9  # [rad]


class NumericIK:
    """Least-deviation Gauss–Newton over all frames.

    Args:
      character: any character.
      rigidity: (nv,) α of Eq. 4; :func:`default_rigidity` without.
      iterations: Gauss–Newton steps a solve.
      bones: a body that is not the character's own, or one for each frame of the motion.
    """

    def __init__(
        self,
        character: CharacterLike,
        rigidity: Array | None = None,
        iterations: int = 2,
        bones: Bones | None = None,
    ) -> None:
        self.character = Character.of(character)
        self.model = self.character.model
        self.rigidity = default_rigidity(self.model) if rigidity is None else np.asarray(rigidity)
        self.iterations = iterations
        self.bones = bones
        self._kinematics: Kinematics | None = None  # room for so many frames, nothing else

    def prepare(self, targets: Targets, clearance: Clearance | None = None) -> NumericProblem:
        """Return the problem of some targets; see :class:`mjmotion.ik.solver.IKSolver`."""
        return NumericProblem(self, targets, clearance)

    def pose(self, qpos: Array, frames: NDArray[np.int64]) -> Pose:
        """Return where everything is in poses (n, nq) at ``frames`` (n,) of the motion."""
        if self.bones is not None and self.bones.nframe is not None:
            if self._kinematics is None:
                self._kinematics = Kinematics(self.model, self.bones.nframe, bones=self.bones)
            return self._kinematics.forward(qpos, frames)
        if self._kinematics is None or self._kinematics.nframe < len(qpos):
            self._kinematics = Kinematics(self.model, len(qpos), bones=self.bones)
        rows = None if self._kinematics.nframe == len(qpos) else np.arange(len(qpos))
        return self._kinematics.forward(qpos, rows)


class NumericProblem:
    """Targets for :class:`NumericIK`; see :class:`mjmotion.ik.solver.SensitiveProblem`.

    Args:
      solver: the body, its rigidities and settings.
      targets: what is to hold.
      clearance: what to keep clear of.
    """

    def __init__(
        self, solver: NumericIK, targets: Targets, clearance: Clearance | None = None
    ) -> None:
        self._solver, self._targets, self._clearance = solver, targets, clearance
        self._model, self._coupling = solver.model, solver.character.coupling
        self._serving = self._find_serving()
        self._freedom = 1.0 / self._coupling.rigidity(solver.rigidity)
        self._freedom[self._coupling.follower] = 0.0  # they have none of their own

    def at(self, rows: NDArray[np.int64]) -> NumericProblem:
        """Return the problem of some of the constrained frames."""
        return NumericProblem(self._solver, self._targets.at(rows), self._clearance)

    def solve(
        self, qpos: Array, last: Solution | None = None, deviation: Deviation | None = None
    ) -> Solution:
        """Return the least displacements towards the targets; nothing is kept of ``last``."""
        freedom = np.broadcast_to(self._freedom, (len(qpos), self._model.nv))
        before = np.zeros(freedom.shape) if deviation is None else deviation.values
        return self._descend(qpos, self._clearance, freedom, self._solver.iterations, before)

    def enforce(self, qpos: Array) -> Solution:
        """Return displacements that meet the targets with the root nearly still (§4.4)."""
        freedom = np.tile(self._freedom, (len(qpos), 1))
        freedom[:, :6] *= 1e-3
        before = np.zeros(freedom.shape)
        return self._descend(qpos, None, freedom, self._solver.iterations + 4, before)

    def sensitivity(
        self, qpos: Array, deviation: Deviation | None = None, last: Solution | None = None
    ) -> Sensitivity:
        """Return what the frames' deviations cost when their targets change; see the protocol.

        The multipliers of the least-deviation step are the gradient, and the inverse of its dual
        matrix the Hessian.
        """
        targets, dofs = self._targets, self._serving
        jacobian, error, compliance = self._equalities(self._pose(qpos), dofs)
        if deviation is not None:
            error = error + (jacobian @ deviation.values[:, dofs, None])[..., 0]
        dual = (jacobian * self._freedom[dofs]) @ np.swapaxes(jacobian, 1, 2)
        index = np.arange(dual.shape[1])
        dual[:, index, index] += compliance + _RIDGE
        inverse = np.linalg.inv(dual)
        present = (jacobian != 0.0).any(axis=2)
        inverse *= present[:, :, None] * present[:, None, :]
        place: list[int] = []
        for column in range(len(targets.sites)):
            for part, weight in enumerate((targets.position_weight, targets.turn_weight)):
                if weight[:, column].any():
                    place += range(6 * column + 3 * part, 6 * column + 3 * part + 3)
        at = np.array(place, dtype=np.int64)
        count, size = len(qpos), 6 * len(targets.sites)
        gradient, hessian = np.zeros((count, size)), np.zeros((count, size, size))
        gradient[:, at] = (inverse @ error[..., None])[:, : len(at), 0]
        hessian[:, at[:, None], at] = inverse[:, : len(at), : len(at)]
        shape = (count, len(targets.sites), 6)
        return Sensitivity(gradient.reshape(shape), hessian.reshape(*shape, *shape[1:]))

    def _pose(self, qpos: Array) -> Pose:
        return self._solver.pose(qpos, self._targets.frames)

    def _descend(
        self,
        qpos: Array,
        clearance: Clearance | None,
        freedom: Array,
        iterations: int,
        before: Array,
    ) -> Solution:
        """Take Gauss–Newton steps from poses (n, nq) that deviate by ``before`` (n, nv) already."""
        displacement = np.zeros((len(qpos), self._model.nv))
        first_error = np.zeros(len(qpos))
        dofs = self._serving if clearance is None else np.arange(self._model.nv)
        frames, moved = self._targets.frames, qpos
        kept = _Kept(np.empty(0, np.int64), np.empty((0, self._model.nv)), np.empty(0))
        for iteration in range(iterations):
            pose = self._pose(moved)
            if iteration == 0:
                first_error = position_error(pose, self._targets)
            jacobian, error, compliance = self._equalities(pose, dofs)
            so_far = (before + displacement)[:, dofs]
            step, _ = least_deviation(jacobian, error, compliance, freedom[:, dofs], so_far)
            if clearance is not None:
                kept = _remembered(kept, clearance(moved, frames), displacement)
                if len(kept.frame):
                    rows, extended = _append(kept, displacement, jacobian, error, compliance, dofs)
                    step[rows] = _least_with_inequalities(
                        extended, jacobian.shape[1], freedom[rows][:, dofs], so_far[rows]
                    )
            change = step - so_far
            size = np.max(np.abs(change), axis=1, initial=0.0)
            change *= np.minimum(1.0, STEP_LIMIT / np.maximum(size, 1e-12))[:, None]
            displacement[:, dofs] += change
            if self._coupling:
                displacement = self._coupling.spread(displacement)
            moved, displacement, freedom = self._within_limits(qpos, displacement, freedom)
        return Solution(displacement, first_error, pushed=np.isin(np.arange(len(qpos)), kept.frame))

    def _find_serving(self) -> NDArray[np.int64]:
        """Degrees of freedom that can serve: those that move a constrained site."""
        targets, model = self._targets, self._model
        moves = np.zeros(model.nv, dtype=bool)
        sites = [*targets.sites, *(one.site for one in targets.look_at)]
        sites += [site for one in targets.relative for site in (one.site, one.to)]
        for site in sites:
            moves |= body_dofs(model, int(model.site_bodyid[site]))
        moves[self._coupling.leader[moves[self._coupling.follower]]] = True
        return np.flatnonzero(moves)

    def _equalities(self, pose: Pose, dofs: NDArray[np.int64]) -> tuple[Array, Array, Array]:
        """Rows (n, e, k), errors (n, e) and compliances (n, e) of all targets; absent rows 0."""
        targets, model = self._targets, self._model
        jacobians, errors, weights = [], [], []
        for column, site in enumerate(targets.sites):
            jacp, jacr = pose.jacobian(pose.site_xpos[:, site], int(model.site_bodyid[site]), dofs)
            if targets.position_weight[:, column].any():
                jacobians.append(jacp)
                errors.append(targets.position[:, column] - pose.site_xpos[:, site])
                weights.append(np.repeat(targets.position_weight[:, column, None], 3, axis=1))
            if targets.turn_weight[:, column].any():
                turn = targets.matrix[:, column] @ np.swapaxes(pose.site_xmat[:, site], 1, 2)
                jacobians.append(jacr)
                errors.append(log(from_matrix(turn)))
                weights.append(np.repeat(targets.turn_weight[:, column, None], 3, axis=1))
        more = [relative_rows(pose, one, dofs) for one in targets.relative]
        more += [look_at_rows(pose, one, dofs) for one in targets.look_at]
        for rows, error, held in more:
            jacobians.append(rows)
            errors.append(error)
            weights.append(held)
        if not jacobians:
            shape = (len(pose.xpos), 0)
            return np.zeros((*shape, len(dofs))), np.zeros(shape), np.zeros(shape)
        weight = np.concatenate(weights, axis=1)
        present = weight > 0.0
        compliance = np.where(present, _SOFT * (1.0 / np.maximum(weight, 1e-6) - 1.0), 1.0)
        jacobian = np.concatenate(jacobians, axis=1)
        if self._coupling:
            whole = np.zeros((*jacobian.shape[:2], model.nv))
            whole[..., dofs] = jacobian
            jacobian = self._coupling.gather(whole)[..., dofs]
        return (
            jacobian * present[..., None],
            np.concatenate(errors, axis=1) * present,
            compliance,
        )

    def _within_limits(
        self, qpos: Array, displacement: Array, freedom: Array
    ) -> tuple[Array, Array, Array]:
        """Put joints that left their range on its edge and hold them there."""
        moved = oplus(self._model, qpos, displacement)
        clamped = inside = self._solver.character.limits.clamp(moved)
        if self._coupling:
            clamped = self._coupling.couple(inside)
        wrong = np.flatnonzero(np.abs(clamped - moved).max(axis=1) > _LIMIT_TOLERANCE)
        if len(wrong) == 0:
            return moved, displacement, freedom
        displacement, freedom = displacement.copy(), np.array(freedom)
        edge = ominus(self._model, clamped[wrong], qpos[wrong])
        off = np.abs(edge - displacement[wrong])
        if self._coupling:
            # Shares are put right in every step; a limit that one of them reaches holds them all.
            off = self._coupling.gather(np.abs(ominus(self._model, inside[wrong], moved[wrong])))
        moved[wrong] = clamped[wrong]
        # A ball is held as a whole: its three numbers are one joint.
        for joint in range(self._model.njnt):
            columns = np.flatnonzero(self._model.dof_jntid == joint)
            hit = (off[:, columns] > _LIMIT_TOLERANCE).any(axis=1)
            if joint > 0 and hit.any():
                freedom[np.ix_(wrong[hit], columns)] = 0.0
        displacement[wrong] = edge
        return moved, displacement, freedom


def least_deviation(
    jacobian: Array, error: Array, compliance: Array, freedom: Array, previous: Array
) -> tuple[Array, Array]:
    """Return the displacement of least ``Σ |d|²/freedom`` with ``J d = e + J d_prev``.

    Args:
      jacobian: (n, e, k) rows.
      error: (n, e) what is left of each row at ``previous``.
      compliance: (n, e) softness of each row; 0 is exact.
      freedom: (n, k) inverse rigidity, 1/α; 0 keeps a degree of freedom where it is.
      previous: (n, k) the displacement so far.

    Returns:
      (n, k) displacements, and (n, e) the multipliers of the rows.
    """
    if jacobian.shape[1] == 0:
        return np.zeros_like(previous), np.zeros_like(error)
    spread = jacobian * freedom[:, None, :]
    dual = spread @ np.swapaxes(jacobian, 1, 2)
    index = np.arange(dual.shape[1])
    dual[:, index, index] += compliance + _RIDGE
    held = np.where(freedom > 0.0, 0.0, previous)
    wanted = error + (jacobian @ (previous - held)[..., None])[..., 0]
    force = np.linalg.solve(dual, wanted[..., None])
    step = (np.swapaxes(spread, 1, 2) @ force)[..., 0] + held
    return np.asarray(step), np.asarray(force[..., 0])


@dataclasses.dataclass(frozen=True, eq=False)
class _Kept:
    """Inequalities that were broken at some step of a solve: ``rows @ d`` is to reach ``level``."""

    frame: NDArray[np.int64]
    rows: Array
    level: Array


def _remembered(kept: _Kept, broken: Inequalities, displacement: Array) -> _Kept:
    """Add what is broken now to what was before: what was pushed out must not slip back in.

    A frame that reports anything anew is measured anew; one that reports nothing keeps its rows.
    """
    old = ~np.isin(kept.frame, broken.frame)
    reached = np.einsum("mv,mv->m", broken.rows, displacement[broken.frame])
    return _Kept(
        np.concatenate((kept.frame[old], broken.frame)),
        np.concatenate((kept.rows[old], broken.rows)),
        np.concatenate((kept.level[old], broken.needed + reached)),
    )


def _least_with_inequalities(
    system: tuple[Array, Array, Array], nequality: int, freedom: Array, previous: Array
) -> Array:
    """Solve with inequalities as equalities, then again without those that would pull back."""
    jacobian, error, compliance = system
    step, force = least_deviation(jacobian, error, compliance, freedom, previous)
    pulling = force < 0.0
    pulling[:, :nequality] = False
    again = np.flatnonzero(pulling.any(axis=1))
    if len(again):
        push = ~pulling[again]
        step[again], _ = least_deviation(
            jacobian[again] * push[..., None],
            error[again] * push,
            np.where(push, compliance[again], 1.0),
            freedom[again],
            previous[again],
        )
    return step


def _append(
    kept: _Kept,
    displacement: Array,
    jacobian: Array,
    error: Array,
    compliance: Array,
    dofs: NDArray[np.int64],
) -> tuple[NDArray[np.int64], tuple[Array, Array, Array]]:
    """Add kept inequalities as rows, the worst first, in the frames that have any."""
    needed = kept.level - np.einsum("mv,mv->m", kept.rows, displacement[kept.frame])
    order = np.lexsort((-needed, kept.frame))
    frame = kept.frame[order]
    frames, first, count = np.unique(frame, return_index=True, return_counts=True)
    rank = np.arange(len(frame)) - np.repeat(first, count)
    keep = rank < _MAX_ROWS
    local, rank = np.searchsorted(frames, frame[keep]), rank[keep]
    size = int(rank.max()) + 1
    rows = np.zeros((len(frames), size, len(dofs)))
    wanted = np.zeros((len(frames), size))
    soft = np.ones((len(frames), size))
    rows[local, rank] = kept.rows[order[keep]][:, dofs]
    wanted[local, rank] = needed[order[keep]]
    soft[local, rank] = _INEQUALITY_SOFT
    return frames, (
        np.concatenate((jacobian[frames], rows), axis=1),
        np.concatenate((error[frames], wanted), axis=1),
        np.concatenate((compliance[frames], soft), axis=1),
    )
