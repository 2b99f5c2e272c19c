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

Frames that break an inequality, hold a site that is on no limb's end, or bend the body further than
its joints go, need every joint and not only these; they are few, and go to the numeric solver. So
do limbs with coupled joints (§4.2), and all where a coupled joint of the body has its like
elsewhere.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.bones import Bones
from mjmotion.body.joint_coupling import coupling
from mjmotion.body.kinematics import body_dofs
from mjmotion.body.limbs import Limb, Limbs, LimbState, find_limbs, limbs_of
from mjmotion.constraints import Targets
from mjmotion.constraints.shared_targets import Sensitivity
from mjmotion.ik.body import Base, Reduced
from mjmotion.ik.edges import Edges, find_edges, same
from mjmotion.ik.numeric import NumericIK
from mjmotion.ik.solver import Clearance, Solution, default_weights
from mjmotion.numerics.rotations import (
    conjugate,
    dot,
    exp,
    log,
    multiply,
    norm,
    rotate,
)

Array = NDArray[np.float64]

REACH_PENALTY = 3e3  # ω of Eq. 6 for a limb that does not reach [1/m²]
KEEP_WITHIN = 0.08  # T is kept from level to level while errors are below this share of a limb
FOLD_SHARE = 1.001  # the same for the least length that a knee can fold it to
REACH_SHARE = 0.996  # share of a limb's length that counts as reach: a straight knee is singular


class HybridIK:
    """Closed-form limbs under a numeric body.

    Args:
      model: a MuJoCo model with a free root and limbs (:func:`mjmotion.body.limbs.find_limbs`).
      weights: (nv,) rigidity α of Eq. 4.
      bones: a body that is not the model's own, or one for each frame of the motion.
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
        self._ends = {limb.end: limb for limb in _free_limbs(model)}
        self._kept: Reduced | None = None
        self._last: tuple[Array, Limbs, LimbState] | None = None
        self._edges: Edges | None = None
        self._fixed: tuple[Array, Array] | None = None
        self._plan: tuple[bytes, Limbs | None, NDArray[np.bool_]] | None = None

    def solve(
        self,
        qpos: Array,
        targets: Targets,
        inequalities: Clearance | None = None,
        deviation: Array | None = None,
    ) -> Solution:
        """Return the least displacements towards ``targets``; see :class:`IKSolver`."""
        displacement = np.zeros((len(qpos), self.model.nv))
        error = np.zeros(len(qpos))
        limbs, closable, other = self._split(targets)
        if limbs is not None:
            state = self._state(limbs, qpos)
            goal, end, error = self._goals(limbs, state, closable)
            d0 = limbs.close(state, goal, end)
            reduced = self._reduced(qpos, limbs, state, closable, error)
            base = reduced.base
            before = None if deviation is None else self._before(limbs, base, deviation)
            body, step = self._body_step(limbs, reduced, d0, goal, before)
            if deviation is not None and before is not None:
                after, free = before[1] + step, np.isnan(deviation[:, 0])
                self._edges = find_edges(
                    self.model, limbs, targets.frames, qpos, step, after, reduced.edges, free
                )
            displacement[:, base.dofs] = base.spread(body)
            displacement[:, limbs.dofs.ravel()] = step.reshape(len(qpos), -1)
            other = other | base.beyond(qpos, displacement)
        if inequalities is not None:
            other = other.copy()
            other[inequalities(qpos, targets.frames).frame] = True
        rows, pushed = np.flatnonzero(other), np.zeros(len(qpos), dtype=bool)
        if len(rows):
            mine = None if deviation is None else deviation[rows]
            few = self._numeric.solve(qpos[rows], targets.at(rows), inequalities, mine)
            displacement[rows], error[rows] = few.displacement, few.error
            pushed[rows] = few.pushed
        return Solution(displacement, error, pushed=pushed)

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

    def sensitivity(
        self, qpos: Array, targets: Targets, deviation: Array | None = None
    ) -> Sensitivity:
        """Return what the frames' deviations cost when their targets change; see the protocol.

        A limb's joints follow its end as they follow its base, the other way; what the body makes
        up for is taken out through the reduced problem. Where anything is held that is not both
        place and orientation of a limb's end, the numeric solver answers.
        """
        limbs, closable, other = self._split(targets)
        if limbs is None:
            return self._numeric.sensitivity(qpos, targets, deviation)
        whole = (closable.position_weight == 1.0) & (closable.turn_weight == 1.0)
        rest = np.flatnonzero(other | ~whole.all(axis=1))
        if len(rest) == len(qpos):
            return self._numeric.sensitivity(qpos, targets, deviation)
        found = self._closed_sensitivity(limbs, qpos, closable, deviation)
        if len(rest) == 0 and len(closable.sites) == len(targets.sites):
            return found
        mine = np.flatnonzero(np.isin(targets.sites, closable.sites))
        shape = (len(qpos), len(targets.sites), 6)
        gradient, hessian = np.zeros(shape), np.zeros((*shape, *shape[1:]))
        gradient[:, mine] = found.gradient
        hessian[:, mine[:, None], :, mine] = found.hessian.transpose(1, 3, 0, 2, 4)
        if len(rest):
            before = None if deviation is None else deviation[rest]
            few = self._numeric.sensitivity(qpos[rest], targets.at(rest), before)
            gradient[rest], hessian[rest] = few.gradient, few.hessian
        return Sensitivity(gradient, hessian)

    def _closed_sensitivity(
        self, limbs: Limbs, qpos: Array, targets: Targets, deviation: Array | None
    ) -> Sensitivity:
        """Return the same of frames in which every limb is held in place and orientation."""
        state = self._state(limbs, qpos)
        goal, end, _ = self._goals(limbs, state, targets)
        d0 = limbs.close(state, goal, end)
        reduced = self._reduce(qpos, limbs, state, targets)
        follow = reduced.follow_ends(limbs, targets)
        rest, rows = d0 * reduced.root, reduced.rows
        if deviation is not None:
            body_before, limbs_before = self._before(limbs, reduced.base, deviation)
            if reduced.edges is not None:
                limbs_before = limbs_before - reduced.edges.level
            rest += limbs_before * reduced.root
        rest -= dot(rest, reduced.swivel)[..., None] * reduced.swivel
        count, nlimb = follow.shape[:2]
        by_body = rows.reshape(count, -1, nlimb, 7).swapaxes(1, 2) @ follow  # (n, nlimb, nbase, 6)
        by_body = by_body.swapaxes(1, 2).reshape(count, -1, 6 * nlimb)
        felt = rows @ rest.reshape(count, -1, 1)
        if deviation is not None:
            felt += (reduced.base.weights * body_before)[..., None]
        solved = np.linalg.solve(reduced.matrix, np.concatenate((by_body, felt), axis=2))
        gradient = (follow.swapaxes(2, 3) @ rest[..., None]).reshape(count, -1, 1)
        gradient = (gradient - by_body.swapaxes(1, 2) @ solved[:, :, -1:])[..., 0]
        hessian = -by_body.swapaxes(1, 2) @ solved[:, :, :-1]
        hessian = hessian.reshape(count, nlimb, 6, nlimb, 6)
        own = np.arange(nlimb)
        hessian[:, own, :, own] += (follow.swapaxes(2, 3) @ follow).swapaxes(0, 1)
        return Sensitivity(gradient.reshape(count, nlimb, 6), hessian)

    def _before(self, limbs: Limbs, base: Base, deviation: Array) -> tuple[Array, Array]:
        """Split a deviation (n, nv) into the body's (n, nbase) and the limbs' (n, nlimb, 7)."""
        deviation = np.nan_to_num(deviation)
        mine = deviation[:, limbs.dofs.ravel()].reshape(len(deviation), -1, 7)
        return base.gather(deviation[:, base.dofs]), mine

    def _state(self, limbs: Limbs, qpos: Array) -> LimbState:
        """Return where the limbs are; the same poses are asked about twice in a level."""
        if self._last is None or self._last[0] is not qpos or self._last[1] is not limbs:
            self._last = (qpos, limbs, limbs.state(qpos))
        return self._last[2]

    def _reduced(
        self, qpos: Array, limbs: Limbs, state: LimbState, targets: Targets, error: Array
    ) -> Reduced:
        """Return the reduced problem: of now, or while errors are small that of a level before."""
        near = error.max(initial=0.0) < KEEP_WITHIN * float(limbs.reach.min())
        kept, edges = self._kept, None if self._edges is None else self._edges.at(targets.frames)
        if kept is not None and kept.frames is targets.frames and near and same(kept.edges, edges):
            return kept
        self._kept = self._reduce(qpos, limbs, state, targets)
        return self._kept

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
            if _tied(self.model, limbs):
                limbs, closable = [], np.zeros_like(closable)
            made = None
            if limbs and self.bones is Bones.of(self.model):
                made = limbs_of(self.model, tuple(limbs))
            elif limbs:
                made = Limbs(self.model, limbs, self.bones.at(targets.frames))
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
        if self._fixed is None or self._fixed[0] is not targets.quat:
            to_end = conjugate(self.model.site_quat[targets.sites])
            self._fixed = (targets.quat, multiply(targets.quat, to_end))
        return self._fixed[1]

    def _reduce(self, qpos: Array, limbs: Limbs, state: LimbState, targets: Targets) -> Reduced:
        """Find how all joints follow the body while the limbs stay closed (T), swivels taken out.

        A swivel couples its own limb only: each column of T keeps just what no swivel makes up for.
        """
        base = Base(self.model, limbs, qpos, state, self.weights)
        moving, turning, swivel = limbs.closure(state)
        turn, move = base.twist(state.ankle)
        follow = np.empty((len(qpos), len(base.weights), *swivel.shape[1:]))
        by_limb = follow.swapaxes(1, 2)
        np.matmul(move, np.swapaxes(moving, 2, 3), out=by_limb)
        by_limb[..., 4:] += turn @ np.swapaxes(turning, 2, 3)
        root = np.sqrt(self.weights[limbs.dofs])
        edges = None if self._edges is None else self._edges.at(targets.frames)
        if edges is not None:
            root = edges.root(root)
        swivel = swivel * root
        swivel = swivel / np.maximum(norm(swivel), 1e-9)[..., None]
        follow *= root if edges is None else root[:, None]
        follow -= np.einsum("nbkd,nkd->nbk", follow, swivel)[..., None] * swivel[:, None]
        rows = follow.reshape(len(follow), len(base.weights), -1)
        matrix = rows @ rows.swapaxes(1, 2)
        index = np.arange(len(base.weights))
        matrix[:, index, index] += base.weights
        return Reduced(
            qpos, targets.frames, base, swivel, rows, matrix, root, (moving, turning), state, edges
        )

    def _body_step(
        self,
        limbs: Limbs,
        reduced: Reduced,
        d0: Array,
        goal: Array,
        before: tuple[Array, Array] | None,
    ) -> tuple[Array, Array]:
        """Solve ``(Tᵀ M T) z = −Tᵀ M d0``: moves of the body (n, nbase) and limbs (n, nlimb, 7).

        With what there is ``before``, of body and limbs, the two together are least.
        """
        rest = d0 if before is None else d0 + before[1]
        if reduced.edges is not None:
            rest = rest - reduced.edges.level
        rest = rest * reduced.root
        rest = rest - dot(rest, reduced.swivel)[..., None] * reduced.swivel
        matrix = reduced.matrix
        right = -(reduced.rows @ rest.reshape(len(rest), -1, 1))
        if before is not None:
            right -= (reduced.base.weights * before[0])[..., None]
        far = dot(goal, goal) > (REACH_SHARE * limbs.reach) ** 2
        if far.any():
            matrix = matrix.copy()
            self._pull_into_reach(limbs, reduced.base, goal, far, matrix, right)
        body = np.linalg.solve(matrix, right)
        step = rest.reshape(len(rest), -1) + (body.swapaxes(1, 2) @ reduced.rows)[:, 0]
        step = step.reshape(d0.shape) / reduced.root
        if reduced.edges is not None:
            step = step + reduced.edges.level
        return np.asarray(body[..., 0]), step if before is None else step - before[1]

    def _pull_into_reach(
        self,
        limbs: Limbs,
        base: Base,
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


def _free_limbs(model: mujoco.MjModel) -> list[Limb]:
    """Return the limbs that can be closed on their own: none of their joints is coupled."""
    tied = model.dof_bodyid[np.concatenate((coupling(model).leader, coupling(model).follower))]
    return [x for x in find_limbs(model) if not np.isin((x.upper, x.lower, x.end), tied).any()]


def _tied(model: mujoco.MjModel, limbs: list[Limb]) -> bool:
    """Return whether some joints of a couple, not all, carry the limbs: T knows only those."""
    carrying = np.zeros(model.nv, dtype=bool)
    for limb in limbs:
        carrying |= body_dofs(model, limb.base)
    return bool((carrying[coupling(model).leader] != carrying[coupling(model).follower]).any())


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
