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

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body import joint_limits as limits
from mjmotion.body.bones import Bones
from mjmotion.body.joint_coupling import couple, coupling
from mjmotion.body.kinematics import Kinematics, Pose, body_dofs
from mjmotion.constraints import Targets
from mjmotion.constraints.shared_targets import Sensitivity
from mjmotion.ik.rows import gaze_rows, link_rows
from mjmotion.ik.solver import (
    Clearance,
    Inequalities,
    Solution,
    default_weights,
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
      model: any MuJoCo model with a free root.
      weights: (nv,) rigidity α of Eq. 4; :func:`default_weights` without.
      iterations: Gauss–Newton steps a solve.
      bones: a body that is not the model's own, or one for each frame of the motion.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        weights: Array | None = None,
        iterations: int = 2,
        bones: Bones | None = None,
    ) -> None:
        self.model = model
        self.weights = default_weights(model) if weights is None else np.asarray(weights)
        self.iterations = iterations
        self.bones = bones
        self._coupling = coupling(model)
        self._kinematics: Kinematics | None = None

    def solve(
        self,
        qpos: Array,
        targets: Targets,
        inequalities: Clearance | None = None,
        deviation: Array | None = None,
    ) -> Solution:
        """Return the least displacements towards ``targets``; see :class:`IKSolver`."""
        freedom = np.broadcast_to(self._freedom(), (len(qpos), self.model.nv))
        return self._descend(qpos, targets, inequalities, freedom, self.iterations, deviation)

    def enforce(self, qpos: Array, targets: Targets) -> Solution:
        """Return displacements that meet ``targets`` with the root nearly still (§4.4)."""
        freedom = np.array(np.broadcast_to(self._freedom(), (len(qpos), self.model.nv)))
        freedom[:, :6] *= 1e-3
        return self._descend(qpos, targets, None, freedom, self.iterations + 4)

    def sensitivity(
        self, qpos: Array, targets: Targets, deviation: Array | None = None
    ) -> Sensitivity:
        """Return what the frames' deviations cost when their targets change; see the protocol.

        The multipliers of the least-deviation step are the gradient, and the inverse of its dual
        matrix the Hessian.
        """
        pose = self._pose(qpos, targets.frames)
        dofs = self._dofs(targets, everything=False)
        jacobian, error, compliance = self._equalities(pose, targets, dofs)
        if deviation is not None:
            error = error + (jacobian @ np.nan_to_num(deviation[:, dofs, None]))[..., 0]
        dual = (jacobian * self._freedom()[dofs]) @ np.swapaxes(jacobian, 1, 2)
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

    def _freedom(self) -> Array:
        """Inverse rigidity (nv,); joints that follow others have none of their own."""
        freedom = 1.0 / self._coupling.weights(self.weights)
        freedom[self._coupling.follower] = 0.0
        return np.asarray(freedom)

    def _pose(self, qpos: Array, frames: NDArray[np.int64]) -> Pose:
        if self.bones is not None and self.bones.nframe is not None:
            if self._kinematics is None:
                self._kinematics = Kinematics(self.model, self.bones.nframe, bones=self.bones)
            return self._kinematics.forward(qpos, frames)
        if self._kinematics is None or self._kinematics.nframe < len(qpos):
            self._kinematics = Kinematics(self.model, len(qpos), bones=self.bones)
        rows = None if self._kinematics.nframe == len(qpos) else np.arange(len(qpos))
        return self._kinematics.forward(qpos, rows)

    def _descend(
        self,
        qpos: Array,
        targets: Targets,
        inequalities: Clearance | None,
        freedom: Array,
        iterations: int,
        deviation: Array | None = None,
    ) -> Solution:
        displacement = np.zeros((len(qpos), self.model.nv))
        before = np.zeros_like(displacement) if deviation is None else np.nan_to_num(deviation)
        first_error = np.zeros(len(qpos))
        dofs = self._dofs(targets, inequalities is not None)
        moved = qpos
        kept = _Kept(np.empty(0, np.int64), np.empty((0, self.model.nv)), np.empty(0))
        for iteration in range(iterations):
            pose = self._pose(moved, targets.frames)
            if iteration == 0:
                first_error = position_error(pose, targets)
            jacobian, error, compliance = self._equalities(pose, targets, dofs)
            step, _ = least_deviation(
                *(jacobian, error, compliance, freedom[:, dofs]),
                (before + displacement)[:, dofs],
            )
            if inequalities is not None:
                kept = _remembered(kept, inequalities(moved, targets.frames), displacement)
                if len(kept.frame):
                    rows, extended = _append(kept, displacement, jacobian, error, compliance, dofs)
                    step[rows] = _least_with_inequalities(
                        extended,
                        jacobian.shape[1],
                        freedom[rows][:, dofs],
                        (before + displacement)[rows][:, dofs],
                    )
            change = step - (before + displacement)[:, dofs]
            size = np.max(np.abs(change), axis=1, initial=0.0)
            change *= np.minimum(1.0, STEP_LIMIT / np.maximum(size, 1e-12))[:, None]
            displacement[:, dofs] += change
            if self._coupling:
                displacement = self._coupling.spread(displacement)
            moved, displacement, freedom = self._within_limits(qpos, displacement, freedom)
        return Solution(displacement, first_error, pushed=np.isin(np.arange(len(qpos)), kept.frame))

    def _dofs(self, targets: Targets, everything: bool) -> NDArray[np.int64]:
        """Degrees of freedom that can serve: those that move a constrained site."""
        if everything:
            return np.arange(self.model.nv)
        moves = np.zeros(self.model.nv, dtype=bool)
        sites = [*targets.sites, *(site for link in targets.links for site in (link.site, link.to))]
        for site in [*sites, *(gaze.site for gaze in targets.gazes)]:
            moves |= body_dofs(self.model, int(self.model.site_bodyid[site]))
        moves[self._coupling.leader[moves[self._coupling.follower]]] = True
        return np.flatnonzero(moves)

    def _equalities(
        self, pose: Pose, targets: Targets, dofs: NDArray[np.int64]
    ) -> tuple[Array, Array, Array]:
        """Rows (n, e, k), errors (n, e) and compliances (n, e) of all targets; absent rows 0."""
        jacobians, errors, weights = [], [], []
        for column, site in enumerate(targets.sites):
            jacp, jacr = pose.jacobian(
                pose.site_xpos[:, site], int(self.model.site_bodyid[site]), dofs
            )
            if targets.position_weight[:, column].any():
                jacobians.append(jacp)
                errors.append(targets.position[:, column] - pose.site_xpos[:, site])
                weights.append(np.repeat(targets.position_weight[:, column, None], 3, axis=1))
            if targets.turn_weight[:, column].any():
                turn = targets.matrix[:, column] @ np.swapaxes(pose.site_xmat[:, site], 1, 2)
                jacobians.append(jacr)
                errors.append(log(from_matrix(turn)))
                weights.append(np.repeat(targets.turn_weight[:, column, None], 3, axis=1))
        more = [link_rows(pose, link, dofs) for link in targets.links]
        more += [gaze_rows(pose, gaze, dofs) for gaze in targets.gazes]
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
            whole = np.zeros((*jacobian.shape[:2], self.model.nv))
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
        moved = oplus(self.model, qpos, displacement)
        clamped = inside = limits.clamp_to_limits(self.model, moved)
        if self._coupling:
            clamped = couple(self.model, inside)
        wrong = np.flatnonzero(np.abs(clamped - moved).max(axis=1) > _LIMIT_TOLERANCE)
        if len(wrong) == 0:
            return moved, displacement, freedom
        displacement, freedom = displacement.copy(), np.array(freedom)
        edge = ominus(self.model, clamped[wrong], qpos[wrong])
        off = np.abs(edge - displacement[wrong])
        if self._coupling:
            # Shares are put right in every step; a limit that one of them reaches holds them all.
            off = self._coupling.gather(np.abs(ominus(self.model, inside[wrong], moved[wrong])))
        moved[wrong] = clamped[wrong]
        # A ball is held as a whole: its three numbers are one joint.
        for joint in range(self.model.njnt):
            columns = np.flatnonzero(self.model.dof_jntid == joint)
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
