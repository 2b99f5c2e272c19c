"""The hybrid solver (§5.2): few parameters left to optimise, limbs closed in form.

Where a limb's end is held, its seven joints follow from the body it hangs from and from one swivel
angle. What is left to find is the root, the joints between the root and the limbs' bases, and a
swivel a limb: 8 numbers for a walk instead of 20. Each solve is one Gauss–Newton step on them:

1. close every held limb where the body now is (Eq. 7), which costs a displacement ``d0``;
2. with ``T`` how all joints follow the parameters z when the limbs stay closed, find the z that
   minimises ``|d0 + T z|²`` in the weights of Eq. 4, with a penalty (Eq. 6) on hips that are
   further from their ankles than the limb reaches;
3. the displacement is ``d0 + T z``.

T and its normal matrix are kept from level to level once the errors are small (a chord step): z
decides only how a displacement is shared, d0 closes the limbs whatever it is.

Frames that break an inequality, or hold a site that is on no limb's end, need every joint and not
only these; they are few, and go to the numeric solver.
"""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.bones import Bones
from mjmotion.constraints import Targets
from mjmotion.coupling import Coupling, coupling
from mjmotion.ik.limb import Limb, Limbs, LimbState, find_limbs, limbs_of
from mjmotion.ik.numeric import NumericIK
from mjmotion.ik.solver import Clearance, Solution, default_weights
from mjmotion.kinematics import body_dofs, body_pose
from mjmotion.rotations import (
    conjugate,
    cross,
    dot,
    exp,
    log,
    multiply,
    norm,
    rotate,
    to_matrix,
)

Array = NDArray[np.float64]

REACH_PENALTY = 3e3  # ω of Eq. 6 for a limb that does not reach [1/m²]
KEEP_WITHIN = 0.08  # T is kept from level to level while errors are below this share of a limb
FOLD_SHARE = 1.001  # the same for the least length that a knee can fold it to
REACH_SHARE = 0.996  # share of a limb's length that counts as reach: a straight knee is singular


class HybridIK:
    """Closed-form limbs under a numeric body.

    Args:
      model: a MuJoCo model with a free root and limbs (:func:`mjmotion.ik.limb.find_limbs`).
      weights: (nv,) rigidity α of Eq. 4.
      bones: a body for each frame of the motion, where it changes.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        weights: Array | None = None,
        bones: Bones | None = None,
    ) -> None:
        self.model = model
        self.weights = default_weights(model) if weights is None else np.asarray(weights)
        self.bones = Bones.of(model) if bones is None else bones
        self._numeric = NumericIK(model, self.weights, bones=bones)
        self._ends = {limb.end: limb for limb in find_limbs(model)}
        self._kept: _Reduced | None = None
        self._fixed: tuple[Targets, Array] | None = None
        self._plan: tuple[bytes, Limbs | None, NDArray[np.bool_]] | None = None

    def solve(
        self, qpos: Array, targets: Targets, inequalities: Clearance | None = None
    ) -> Solution:
        """Return the least displacements towards ``targets``; see :class:`IKSolver`."""
        displacement = np.zeros((len(qpos), self.model.nv))
        error = np.zeros(len(qpos))
        limbs, closable, other = self._split(targets)
        if limbs is not None:
            state = limbs.state(qpos)
            goal, end, error = self._goals(limbs, state, closable)
            d0 = limbs.close(state, goal, end)
            near = error.max(initial=0.0) < KEEP_WITHIN * float(limbs.reach.min())
            if not (near and self._kept is not None and self._kept.targets is closable):
                self._kept = self._reduce(qpos, limbs, state, closable)
            base = self._kept.base
            body, step = self._body_step(limbs, self._kept, d0, goal)
            displacement[:, base.dofs] = base.spread(body)
            displacement[:, limbs.dofs.ravel()] = step.reshape(len(qpos), -1)
        if inequalities is not None:
            other = other.copy()
            other[inequalities(qpos, targets.frames).frame] = True
        rows = np.flatnonzero(other)
        if len(rows):
            few = self._numeric.solve(qpos[rows], targets.at(rows), inequalities)
            displacement[rows], error[rows] = few.displacement, few.error
        return Solution(displacement, error)

    def enforce(self, qpos: Array, targets: Targets) -> Solution:
        """Close every held limb where the body is (§4.4): the body stays as fitted."""
        displacement = np.zeros((len(qpos), self.model.nv))
        error, rise = np.zeros(len(qpos)), np.zeros(len(qpos))
        limbs, closable, other = self._split(targets)
        if limbs is not None:
            state = limbs.state(qpos)
            goal, end, error = self._goals(limbs, state, closable)
            step = limbs.close(state, goal, end)
            displacement[:, limbs.dofs.ravel()] = step.reshape(len(qpos), -1)
            rise = _rise(limbs, state, goal)
        rows = np.flatnonzero(other)
        if len(rows):
            few = self._numeric.enforce(qpos[rows], targets.at(rows))
            displacement[rows], error[rows] = few.displacement, few.error
        return Solution(displacement, error, rise)

    def _split(self, targets: Targets) -> tuple[Limbs | None, Targets, NDArray[np.bool_]]:
        """Return the limbs to close, their targets, and which frames (n,) hold something else.

        A site is closable when it is on a limb's end and no site before it is on the same end.
        """
        changing = self.bones.nframe is not None
        key = targets.sites.tobytes() + (targets.frames.tobytes() if changing else b"")
        if self._plan is None or self._plan[0] != key:
            limbs: list[Limb] = []
            closable = np.zeros(len(targets.sites), dtype=bool)
            for column, site in enumerate(targets.sites):
                limb = self._ends.get(int(self.model.site_bodyid[site]))
                if limb is not None and limb not in limbs:
                    limbs.append(limb)
                    closable[column] = True
            made = None
            if limbs and changing:
                made = Limbs(self.model, limbs, self.bones.at(targets.frames))
            elif limbs:
                made = limbs_of(self.model, tuple(limbs))
            self._plan = (key, made, closable)
        _, found, closable = self._plan
        if closable.all() and not (targets.links or targets.gazes):
            return found, targets, np.zeros(len(targets.frames), dtype=bool)
        weight = np.maximum(targets.position_weight, targets.turn_weight)
        other = (weight[:, ~closable] > 0.0).any(axis=1) | targets.other
        return found, targets.columns(closable), other

    def _goals(
        self, limbs: Limbs, state: LimbState, targets: Targets
    ) -> tuple[Array, Array, Array]:
        """Hip to ankle and end orientation in the bases' frames, and position errors (n,) [m].

        What is not held stays as it is: the orientation of the end, or the place of the site.
        """
        point = limbs.bones.site_pos[..., targets.sites, :] - limbs.end_anchor
        to_base = conjugate(state.base_quat)
        arm = state.ankle + rotate(state.end, point)
        held = targets.position_weight
        if (targets.turn_weight == 1.0).all() and (held == 1.0).all():
            site = rotate(to_base, targets.position - state.hip)
            end = multiply(to_base, self._end_quat(targets))
            gap = site - arm
        else:
            wanted = multiply(to_base, self._end_quat(targets))
            turn = log(multiply(conjugate(state.end), wanted)) * targets.turn_weight[..., None]
            end = multiply(state.end, exp(turn))
            gap = rotate(to_base, targets.position - state.hip) - arm
            site = arm + held[..., None] * gap
        error = np.sqrt(np.max(dot(gap, gap) * (held > 0.0), axis=1, initial=0.0))
        return site - rotate(end, point), end, error

    def _end_quat(self, targets: Targets) -> Array:
        """Return the orientations of the ends that targets ask for, kept from level to level."""
        if self._fixed is None or self._fixed[0] is not targets:
            to_end = conjugate(self.model.site_quat[targets.sites])
            self._fixed = (targets, multiply(targets.quat, to_end))
        return self._fixed[1]

    def _reduce(self, qpos: Array, limbs: Limbs, state: LimbState, targets: Targets) -> _Reduced:
        """Find how all joints follow the body while the limbs stay closed (T), swivels taken out.

        A swivel couples its own limb only: each column of T keeps just what no swivel makes up for.
        """
        base = _Base(self.model, limbs, qpos, state, self.weights)
        moving, turning, swivel = limbs.closure(state)
        turn, move = base.twist(state.ankle)
        follow = np.empty((len(qpos), len(base.weights), *swivel.shape[1:]))
        by_limb = follow.swapaxes(1, 2)
        np.matmul(move, np.swapaxes(moving, 2, 3), out=by_limb)
        by_limb[..., 4:] += turn @ np.swapaxes(turning, 2, 3)
        root = np.sqrt(self.weights[limbs.dofs])
        swivel = swivel * root
        swivel = swivel / np.maximum(norm(swivel), 1e-9)[..., None]
        follow *= root
        follow -= np.einsum("nbkd,nkd->nbk", follow, swivel)[..., None] * swivel[:, None]
        rows = follow.reshape(len(follow), len(base.weights), -1)
        matrix = rows @ rows.swapaxes(1, 2)
        index = np.arange(len(base.weights))
        matrix[:, index, index] += base.weights
        return _Reduced(targets, base, swivel, rows, matrix, root)

    def _body_step(
        self, limbs: Limbs, reduced: _Reduced, d0: Array, goal: Array
    ) -> tuple[Array, Array]:
        """Solve ``(Tᵀ M T) z = −Tᵀ M d0``: moves of the body (n, nbase) and limbs (n, nlimb, 7)."""
        rest = d0 * reduced.root
        rest = rest - dot(rest, reduced.swivel)[..., None] * reduced.swivel
        matrix = reduced.matrix
        right = -(reduced.rows @ rest.reshape(len(rest), -1, 1))
        far = dot(goal, goal) > (REACH_SHARE * limbs.reach) ** 2
        if far.any():
            matrix = matrix.copy()
            self._pull_into_reach(limbs, reduced.base, goal, far, matrix, right)
        body = np.linalg.solve(matrix, right)
        step = rest.reshape(len(rest), -1) + (body.swapaxes(1, 2) @ reduced.rows)[:, 0]
        return np.asarray(body[..., 0]), step.reshape(d0.shape) / reduced.root

    def _pull_into_reach(
        self,
        limbs: Limbs,
        base: _Base,
        goal: Array,
        far: NDArray[np.bool_],
        matrix: Array,
        right: Array,
    ) -> None:
        """Add the penalty on limbs that are too short for their goals to the normal equations."""
        rows = np.flatnonzero(far.any(axis=1))
        length = norm(goal[rows])
        reach = np.broadcast_to(limbs.reach, far.shape)[rows]
        over = np.where(far[rows], length - REACH_SHARE * reach, 0.0)
        line = goal[rows] / length[..., None]
        pull = (base.twist(np.zeros_like(line), rows)[1] @ line[..., None])[..., 0]
        pull = pull * (REACH_PENALTY**0.5 * far[rows])[..., None]
        matrix[rows] += np.einsum("nkb,nkc->nbc", pull, pull)
        right[rows] += (REACH_PENALTY**0.5 * np.einsum("nkb,nk->nb", pull, over))[..., None]


@dataclasses.dataclass(frozen=True, eq=False)
class _Reduced:
    """The reduced problem, weighted: swivels (n, nlimb, 7) and T (n, nbase, nlimb · 7)."""

    targets: Targets
    base: _Base
    swivel: Array
    rows: Array
    matrix: Array
    root: Array


def _rise(limbs: Limbs, state: LimbState, goal: Array) -> Array:
    """How far the root would have to go up (n,) [m] for every limb to reach; down is negative."""
    rise = np.zeros(len(goal))
    square = dot(goal, goal)
    reach = np.broadcast_to(REACH_SHARE * limbs.reach, square.shape)
    fold = np.broadcast_to(FOLD_SHARE * limbs.fold, square.shape)
    far = square > reach * reach
    rows, which = np.nonzero(far | (square < fold * fold))
    if len(rows):
        base_quat = np.broadcast_to(state.base_quat, (*goal.shape[:2], 4))
        apart = rotate(base_quat[rows, which], goal[rows, which])
        flat = apart[:, 0] ** 2 + apart[:, 1] ** 2
        beyond, longest = far[rows, which], reach[rows, which]
        length = np.where(beyond, longest, fold[rows, which])
        wanted = np.sqrt(np.maximum(length**2 - flat, (0.5 * longest) ** 2 * beyond))
        short = np.abs(apart[:, 2]) - wanted
        order = np.argsort(np.abs(short))  # the limb that is furthest off decides
        rise[rows[order]] = (np.sign(apart[:, 2]) * short)[order]
    return rise


class _Base:
    """Degrees of freedom between the world and the limbs' bases, in the bases' own frames.

    Attributes:
      dofs: (m,) the degrees of freedom.
      weights: (nbase,) rigidity of each parameter: as many, less those that follow others (§4.2).
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        limbs: Limbs,
        qpos: Array,
        state: LimbState,
        weights: Array,
    ) -> None:
        # (nlimb, nbase) which of them carry which limb
        carried = np.stack([body_dofs(model, limb.base) for limb in limbs.limbs])
        self.dofs = np.flatnonzero(carried.any(axis=0))
        self._fold, self.weights = _fold(coupling(model), self.dofs, weights)
        self._moves = None if carried[:, self.dofs].all() else carried[:, self.dofs]
        frame = to_matrix(state.base_quat)
        count = len(self.dofs)
        shape = (len(qpos), len(limbs), count, 3)
        self._turn, self._move = np.zeros(shape), np.zeros(shape)
        self._arm = np.zeros(shape)  # from each axis to the limb's hip
        self._turning = np.ones(count, dtype=bool)
        column = 0
        while column < count:
            joint = int(model.dof_jntid[self.dofs[column]])
            body = int(model.jnt_bodyid[joint])
            position, quat = body_pose(model, qpos, body, limbs.bones)
            pivot = limbs.bones.jnt_pos[..., joint, :]
            kind = mujoco.mjtJoint(int(model.jnt_type[joint]))
            own = all(limb.base == body for limb in limbs.limbs)
            if kind == mujoco.mjtJoint.mjJNT_FREE:
                self._move[:, :, column : column + 3] = frame
                self._turning[column : column + 3] = False
                column += 3
            if kind in (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL):
                width = 3
                axis = np.eye(3) if own else np.swapaxes(to_matrix(quat), 1, 2)[:, None] @ frame
            else:
                local = rotate(quat, np.broadcast_to(model.jnt_axis[joint], position.shape))
                axis, width = local[:, None, None] @ frame, 1
                self._turning[column] = kind == mujoco.mjtJoint.mjJNT_HINGE
            columns = slice(column, column + width)
            if self._turning[column]:
                if own and not np.any(pivot):
                    arm = limbs.hip_pos[..., None, :]  # the base turns about its own origin
                else:
                    anchor = position + rotate(quat, np.broadcast_to(pivot, position.shape))
                    arm = (state.hip - anchor[:, None])[:, :, None] @ frame
                self._turn[:, :, columns], self._arm[:, :, columns] = axis, arm
            else:
                self._move[:, :, columns] = axis
            column += width

    def twist(self, point: Array, rows: NDArray[np.int64] | None = None) -> tuple[Array, Array]:
        """Return what each dof does at ``point``, hip to point (n, nlimb, 3) in the base's frame.

        Returns:
          turning and moving (n, nlimb, nbase, 3), of the frames ``rows`` or of all.
        """
        chosen = slice(None) if rows is None else rows
        turn = self._turn[chosen]
        move = cross(turn, self._arm[chosen] + point[:, :, None]) + self._move[chosen]
        if self._moves is not None:
            moves = self._moves[None, :, :, None]
            turn, move = turn * moves, move * moves
        if self._fold is None:
            return turn, move
        fold = self._fold.T
        return fold @ np.broadcast_to(turn, move.shape), fold @ move

    def spread(self, parameters: Array) -> Array:
        """Return displacements (n, m) of :attr:`dofs` for parameters (n, nbase)."""
        return parameters if self._fold is None else parameters @ self._fold.T


def _fold(coupled: Coupling, dofs: NDArray[np.int64], weights: Array) -> tuple[Array | None, Array]:
    """Return what each parameter does to ``dofs`` (m, nbase), and the parameters' weights.

    None stands for the identity: no degree of freedom follows another.
    """
    inside = np.isin(coupled.follower, dofs)
    if not inside.any():
        return None, weights[dofs]
    fold = np.eye(len(dofs))
    place = {int(dof): index for index, dof in enumerate(dofs)}
    following = []
    for row in np.flatnonzero(inside):
        leader, follower = place[int(coupled.leader[row])], place[int(coupled.follower[row])]
        fold[follower] = 0.0
        fold[follower, leader] = coupled.ratio[row]
        following.append(follower)
    fold = np.delete(fold, following, axis=1)
    return fold, fold.T**2 @ weights[dofs]
