"""The hybrid solver (§5.2): few parameters left to optimise, limbs closed in form.

Where a limb's end is held, its seven joints follow from the body it hangs from and from one swivel
angle. What is left to find is the root, the joints between the root and the limbs' bases, and a
swivel a limb: 8 numbers for a walk instead of 20. Each solve is one Gauss–Newton step on them:

1. close every held limb where the body now is (Eq. 7), which costs a displacement ``d0``;
2. with ``T`` how all joints follow the parameters z when the limbs stay closed, find the z that
   minimises ``|d0 + T z|²`` in the weights of Eq. 4, with a penalty (Eq. 6) on hips that are
   further from their ankles than the limb reaches;
3. the displacement is ``d0 + T z``.

T and its normal matrix are handed on from level to level once the errors are small (a chord step):
z decides only how a displacement is shared, d0 closes the limbs whatever it is.

Frames that break an inequality, hold a site that is on no limb's end, or bend the body further than
its joints go, need every joint and not only these; they are few, and go to the numeric solver. So
do limbs with coupled joints (§4.2), and all where a coupled joint of the body has its like
elsewhere.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.bones import Bones
from mjmotion.body.character import Character, CharacterLike
from mjmotion.body.kinematics import body_dofs
from mjmotion.body.limbs import Limb, Limbs, LimbState
from mjmotion.constraints import Targets
from mjmotion.constraints.shared_targets import Sensitivity
from mjmotion.ik.body import Base, Reduced
from mjmotion.ik.edges import Edges, find_edges, same
from mjmotion.ik.numeric import NumericIK
from mjmotion.ik.rise import REACH_SHARE, rises_to_reach
from mjmotion.ik.solver import Clearance, Deviation, Solution, default_rigidity
from mjmotion.numerics.rotations import conjugate, dot, exp, log, multiply, norm, rotate

Array = NDArray[np.float64]

REACH_PENALTY = 3e3  # ω of Eq. 6 for a limb that does not reach [1/m²]
KEEP_WITHIN = 0.08  # T is kept from level to level while errors are below this share of a limb


class HybridIK:
    """Closed-form limbs under a numeric body.

    Args:
      character: a character with limbs (:func:`mjmotion.body.limbs.find_limbs`).
      rigidity: (nv,) α of Eq. 4; :func:`default_rigidity` without.
      bones: a body that is not the character's own, or one for each frame of the motion.
    """

    def __init__(
        self,
        character: CharacterLike,
        rigidity: Array | None = None,
        bones: Bones | None = None,
    ) -> None:
        self.character = Character.of(character)
        self.model = self.character.model
        self.rigidity = default_rigidity(self.model) if rigidity is None else np.asarray(rigidity)
        self.bones = bones
        self.numeric = NumericIK(self.character, self.rigidity, bones=bones)

    def prepare(self, targets: Targets, clearance: Clearance | None = None) -> HybridProblem:
        """Return the problem of some targets; see :class:`mjmotion.ik.solver.IKSolver`."""
        return HybridProblem(self, targets, clearance)


@dataclasses.dataclass(frozen=True, eq=False)
class _Memory:
    """What a level hands on: the reduced problem, and joints that stand at their edges."""

    reduced: Reduced | None = None
    edges: Edges | None = None


class HybridProblem:
    """Targets for :class:`HybridIK`; see :class:`mjmotion.ik.solver.SensitiveProblem`.

    A site is closable when it is on a limb's end and no site before it is on the same end.

    Args:
      solver: the body, its rigidities and settings.
      targets: what is to hold.
      clearance: what to keep clear of.
    """

    def __init__(
        self, solver: HybridIK, targets: Targets, clearance: Clearance | None = None
    ) -> None:
        self._solver, self._targets, self._clearance = solver, targets, clearance
        self._character, self._model = solver.character, solver.model
        self._numeric = solver.numeric.prepare(targets, clearance)
        limbs, closable = _closable(self._character, targets.sites)
        self._limbs: Limbs | None = None
        if limbs and solver.bones is None:
            self._limbs = self._character.chains(limbs)
        elif limbs and solver.bones is not None:
            self._limbs = Limbs(self._model, limbs, solver.bones.at(targets.frames))
        weight = np.maximum(targets.position_weight, targets.turn_weight)
        self._other = (weight[:, ~closable] > 0.0).any(axis=1) | targets.relational
        everything = closable.all() and not (targets.relative or targets.look_at)
        self._mine = targets if everything else targets.columns(closable)
        # How the ends are to be turned: the sites' orientations, less how sites sit in their ends.
        to_end = conjugate(self._model.site_quat[self._mine.sites])
        self._end_quat = multiply(self._mine.quat, to_end)

    def solve(
        self, qpos: Array, last: Solution | None = None, deviation: Deviation | None = None
    ) -> Solution:
        """Return the least displacements towards the targets; see the protocol."""
        displacement = np.zeros((len(qpos), self._model.nv))
        error, other = np.zeros(len(qpos)), self._other.copy()
        memory = _memory_of(last)
        if self._limbs is not None:
            limbs = self._limbs
            state = limbs.state(qpos)
            goal, end, error = self._goals(limbs, state)
            d0 = limbs.close(state, goal, end)
            reduced = self._reduced(qpos, limbs, state, error, memory)
            base, edges = reduced.base, memory.edges
            before = None if deviation is None else self._before(limbs, base, deviation)
            body, step = self._body_step(limbs, reduced, d0, goal, before)
            if deviation is not None and before is not None:
                after, frames = before[1] + step, self._targets.frames
                edges = find_edges(
                    self._character,
                    limbs,
                    frames,
                    qpos,
                    step,
                    after,
                    reduced.edges,
                    ~deviation.counts,
                )
            displacement[:, base.dofs] = base.spread(body)
            displacement[:, limbs.dofs.ravel()] = step.reshape(len(qpos), -1)
            other |= base.beyond(qpos, displacement)
            memory = _Memory(reduced, edges)
        if self._clearance is not None:
            other[self._clearance(qpos, self._targets.frames).frame] = True
        rows, pushed = np.flatnonzero(other), np.zeros(len(qpos), dtype=bool)
        if len(rows):
            own = None if deviation is None else deviation.at(rows)
            few = self._numeric.at(rows).solve(qpos[rows], deviation=own)
            displacement[rows], error[rows] = few.displacement, few.error
            pushed[rows] = few.pushed
        return Solution(displacement, error, pushed=pushed, memory=memory)

    def enforce(self, qpos: Array) -> Solution:
        """Close every held limb where the body is (§4.4): the body stays as fitted."""
        displacement = np.zeros((len(qpos), self._model.nv))
        error, rise, standing = (np.zeros(len(qpos)) for _ in range(3))
        if self._limbs is not None:
            limbs = self._limbs
            state = limbs.state(qpos)
            goal, end, error = self._goals(limbs, state)
            step = limbs.close(state, goal, end)
            displacement[:, limbs.dofs.ravel()] = step.reshape(len(qpos), -1)
            counts = (self._mine.position_weight > 0.0, self._mine.contact)
            rise, standing = rises_to_reach(limbs, state, goal, counts)
        rows = np.flatnonzero(self._other)
        if len(rows):
            few = self._numeric.at(rows).enforce(qpos[rows])
            displacement[rows], error[rows] = few.displacement, few.error
        return Solution(displacement, error, rise, standing_rise=standing)

    def sensitivity(
        self, qpos: Array, deviation: Deviation | None = None, last: Solution | None = None
    ) -> Sensitivity:
        """Return what the frames' deviations cost when their targets change; see the protocol.

        A limb's joints follow its end as they follow its base, the other way; what the body makes
        up for is taken out through the reduced problem. Where anything is held that is not both
        place and orientation of a limb's end, the numeric solver answers.
        """
        if self._limbs is None:
            return self._numeric.sensitivity(qpos, deviation)
        targets, closable = self._targets, self._mine
        whole = (closable.position_weight == 1.0) & (closable.turn_weight == 1.0)
        rest = np.flatnonzero(self._other | ~whole.all(axis=1))
        if len(rest) == len(qpos):
            return self._numeric.sensitivity(qpos, deviation)
        found = self._closed_sensitivity(self._limbs, qpos, deviation, _memory_of(last).edges)
        if len(rest) == 0 and len(closable.sites) == len(targets.sites):
            return found
        mine = np.flatnonzero(np.isin(targets.sites, closable.sites))
        shape = (len(qpos), len(targets.sites), 6)
        gradient, hessian = np.zeros(shape), np.zeros((*shape, *shape[1:]))
        gradient[:, mine] = found.gradient
        hessian[:, mine[:, None], :, mine] = found.hessian.transpose(1, 3, 0, 2, 4)
        if len(rest):
            before = None if deviation is None else deviation.at(rest)
            few = self._numeric.at(rest).sensitivity(qpos[rest], before)
            gradient[rest], hessian[rest] = few.gradient, few.hessian
        return Sensitivity(gradient, hessian)

    def _closed_sensitivity(
        self, limbs: Limbs, qpos: Array, deviation: Deviation | None, edges: Edges | None
    ) -> Sensitivity:
        """Return the same of frames in which every limb is held in place and orientation."""
        state = limbs.state(qpos)
        goal, end, _ = self._goals(limbs, state)
        d0 = limbs.close(state, goal, end)
        reduced = self._reduce(qpos, limbs, state, edges)
        follow = reduced.follow_ends(limbs, self._mine)
        rest, rows = d0 * reduced.sqrt_rigidity, reduced.rows
        if deviation is not None:
            body_before, limbs_before = self._before(limbs, reduced.base, deviation)
            if reduced.edges is not None:
                limbs_before = limbs_before - reduced.edges.level
            rest += limbs_before * reduced.sqrt_rigidity
        rest -= dot(rest, reduced.swivel)[..., None] * reduced.swivel
        count, nlimb = follow.shape[:2]
        by_body = rows.reshape(count, -1, nlimb, 7).swapaxes(1, 2) @ follow  # (n, nlimb, nbase, 6)
        by_body = by_body.swapaxes(1, 2).reshape(count, -1, 6 * nlimb)
        felt = rows @ rest.reshape(count, -1, 1)
        if deviation is not None:
            felt += (reduced.base.rigidity * body_before)[..., None]
        solved = np.linalg.solve(reduced.matrix, np.concatenate((by_body, felt), axis=2))
        gradient = (follow.swapaxes(2, 3) @ rest[..., None]).reshape(count, -1, 1)
        gradient = (gradient - by_body.swapaxes(1, 2) @ solved[:, :, -1:])[..., 0]
        hessian = -by_body.swapaxes(1, 2) @ solved[:, :, :-1]
        hessian = hessian.reshape(count, nlimb, 6, nlimb, 6)
        own = np.arange(nlimb)
        hessian[:, own, :, own] += (follow.swapaxes(2, 3) @ follow).swapaxes(0, 1)
        return Sensitivity(gradient.reshape(count, nlimb, 6), hessian)

    def _before(self, limbs: Limbs, base: Base, deviation: Deviation) -> tuple[Array, Array]:
        """Split a deviation (n, nv) into the body's (n, nbase) and the limbs' (n, nlimb, 7)."""
        values = deviation.values
        mine = values[:, limbs.dofs.ravel()].reshape(len(values), -1, 7)
        return base.gather(values[:, base.dofs]), mine

    def _reduced(
        self, qpos: Array, limbs: Limbs, state: LimbState, error: Array, memory: _Memory
    ) -> Reduced:
        """Return the reduced problem: of now, or while errors are small that of a level before."""
        near = error.max(initial=0.0) < KEEP_WITHIN * float(limbs.reach.min())
        edges = None if memory.edges is None else memory.edges.at(self._targets.frames)
        if memory.reduced is not None and near and same(memory.reduced.edges, edges):
            return memory.reduced
        return self._reduce(qpos, limbs, state, memory.edges)

    def _goals(self, limbs: Limbs, state: LimbState) -> tuple[Array, Array, Array]:
        """Hip to ankle and end orientation in the bases' frames, and position errors (n,) [m].

        What is not held stays as it is: the orientation of the end, or the place of the site.
        """
        targets = self._mine
        point = limbs.bones.site_pos[..., targets.sites, :] - limbs.end_anchor
        to_base = conjugate(state.base_quat)
        arm = state.ankle + rotate(state.end, point)
        held = targets.position_weight
        if (targets.turn_weight == 1.0).all() and (held == 1.0).all():
            site = rotate(to_base, targets.position - state.hip)
            end = multiply(to_base, self._end_quat)
            gap = site - arm
        else:
            wanted = multiply(to_base, self._end_quat)
            turn = log(multiply(conjugate(state.end), wanted)) * targets.turn_weight[..., None]
            end = multiply(state.end, exp(turn))
            gap = rotate(to_base, targets.position - state.hip) - arm
            site = arm + held[..., None] * gap
        error = np.sqrt(np.max(dot(gap, gap) * (held > 0.0), axis=1, initial=0.0))
        return site - rotate(end, point), end, error

    def _reduce(self, qpos: Array, limbs: Limbs, state: LimbState, edges: Edges | None) -> Reduced:
        """Find how all joints follow the body while the limbs stay closed (T), swivels taken out.

        A swivel couples its own limb only: each column of T keeps just what no swivel makes up for.
        """
        base = Base(self._character, limbs, qpos, state, self._solver.rigidity)
        moving, turning, swivel = limbs.closure(state)
        turn, move = base.twist(state.ankle)
        follow = np.empty((len(qpos), len(base.rigidity), *swivel.shape[1:]))
        by_limb = follow.swapaxes(1, 2)
        np.matmul(move, np.swapaxes(moving, 2, 3), out=by_limb)
        by_limb[..., 4:] += turn @ np.swapaxes(turning, 2, 3)
        sqrt_rigidity = np.sqrt(self._solver.rigidity[limbs.dofs])
        edges = None if edges is None else edges.at(self._targets.frames)
        if edges is not None:
            sqrt_rigidity = edges.stiffened(sqrt_rigidity)
        swivel = swivel * sqrt_rigidity
        swivel = swivel / np.maximum(norm(swivel), 1e-9)[..., None]
        follow *= sqrt_rigidity if edges is None else sqrt_rigidity[:, None]
        follow -= np.einsum("nbkd,nkd->nbk", follow, swivel)[..., None] * swivel[:, None]
        rows = follow.reshape(len(follow), len(base.rigidity), -1)
        matrix = rows @ rows.swapaxes(1, 2)
        index = np.arange(len(base.rigidity))
        matrix[:, index, index] += base.rigidity
        closure = (moving, turning)
        return Reduced(base, swivel, rows, matrix, sqrt_rigidity, closure, state, edges)

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
        rest = rest * reduced.sqrt_rigidity
        rest = rest - dot(rest, reduced.swivel)[..., None] * reduced.swivel
        matrix = reduced.matrix
        right = -(reduced.rows @ rest.reshape(len(rest), -1, 1))
        if before is not None:
            right -= (reduced.base.rigidity * before[0])[..., None]
        far = dot(goal, goal) > (REACH_SHARE * limbs.reach) ** 2
        if far.any():
            matrix = matrix.copy()
            self._pull_into_reach(limbs, reduced.base, goal, far, matrix, right)
        body = np.linalg.solve(matrix, right)
        step = rest.reshape(len(rest), -1) + (body.swapaxes(1, 2) @ reduced.rows)[:, 0]
        step = step.reshape(d0.shape) / reduced.sqrt_rigidity
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


def _memory_of(last: Solution | None) -> _Memory:
    return last.memory if last is not None and isinstance(last.memory, _Memory) else _Memory()


def _closable(
    character: Character, sites: NDArray[np.int64]
) -> tuple[tuple[Limb, ...], NDArray[np.bool_]]:
    """Return the limbs to close for sites (s,), and which sites (s,) those are."""
    model, coupling = character.model, character.coupling
    coupled = model.dof_bodyid[np.concatenate((coupling.leader, coupling.follower))]
    limbs: list[Limb] = []
    closable = np.zeros(len(sites), dtype=bool)
    for column, site in enumerate(sites):
        limb = character.limb_by_end.get(int(model.site_bodyid[site]))
        if limb is None or limb in limbs:
            continue
        # A limb is closed on its own: none of its joints may be coupled.
        if not np.isin((limb.upper, limb.lower, limb.end), coupled).any():
            limbs.append(limb)
            closable[column] = True
    carrying = np.zeros(model.nv, dtype=bool)
    for limb in limbs:
        carrying |= body_dofs(model, limb.base)
    if (carrying[coupling.leader] != carrying[coupling.follower]).any():
        # Some joints of a couple carry the limbs and some do not: T knows only those that do.
        return (), np.zeros_like(closable)
    return tuple(limbs), closable
