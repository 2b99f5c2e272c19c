"""The one large problem: every frame's displacement and every shared move in one least squares.

The unknowns are the control points of one displacement spline (Gleicher's spacetime problem with
Eq. 4 for its objective) and the shared moves. A frame's displacement ``d_t`` is applied in one
piece to the motion after the first guess, ``m_t = m0_t ⊕ d_t``, and never re-linearised: so
``Σ α |d|²`` is the objective itself at any distance, and Jacobians at ``d ≠ 0`` go through the
right Jacobian of exp, which says how ``exp(d)`` answers to a change of ``d``.

Residuals, whose squares are added up: ``√α d``, ``√rigidity · move``, ``√ω c`` for positions [m]
and orientations [rad] of constrained sites, and ``√ω`` times how far a joint is out of its range
[rad].
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from mjmotion.body.bones import Bones
from mjmotion.body.character import Character
from mjmotion.body.kinematics import Kinematics, Pose, body_dofs
from mjmotion.constraints import Targets
from mjmotion.constraints.shared_targets import SharedMove
from mjmotion.numerics.bspline import basis_matrix
from mjmotion.numerics.rotations import from_matrix, log
from mjmotion.numerics.tangent import oplus
from mjmotion.paper.spacetime.moves import Effect, MovedTargets
from mjmotion.paper.spacetime.ranges import Ranges, turning_threes
from mjmotion.paper.spacetime.rotating import (
    inverse_right_jacobian,
    right_jacobian,
)

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

SOFT = 0.05  # compliance of a target at half weight, as in the IK solvers [m² or rad²]


@dataclasses.dataclass(frozen=True, eq=False)
class State:
    """The problem at one point.

    Attributes:
      unknowns: (nunknown,) the point.
      displacement: (nframe, k) of the degrees of freedom that serve.
      moves: (nmove, 4).
      qpos: (nframe, nq) poses.
      pose: where everything is at the targets' frames.
      targets: as the moves leave them.
      effects: what the moves do there.
      error: (n, e) what is left of the constraints, 0 where nothing is wanted [m or rad].
      angles: (nframe, l) of joints that have ranges [rad].
    """

    unknowns: Array
    displacement: Array
    moves: Array
    qpos: Array
    pose: Pose
    targets: Targets
    effects: list[Effect]
    error: Array
    angles: Array


class Problem:
    """Residuals and their sparse Jacobian.

    Args:
      character: the body.
      guess: (nframe, nq) the motion after the first guess.
      targets: what is to hold, without any move.
      moves: the shared moves.
      rigidity: (nv,) α of Eq. 4.
      frames_per_knot: frames a knot.
      bones: a body for each frame, where it changes.

    Attributes:
      dofs: (k,) degrees of freedom that move a constrained site; the others stay.
      nunknown: control points times ``k``, and the free ones of each move's four numbers.
      spread: sparse (nframe k + nfree, nunknown): displacements and free moves from the unknowns.
    """

    def __init__(
        self,
        character: Character,
        guess: Array,
        targets: Targets,
        moves: Sequence[SharedMove],
        rigidity: Array,
        frames_per_knot: float,
        bones: Bones | None = None,
    ) -> None:
        model = character.model
        self.model, self.guess = model, guess
        self.moved = MovedTargets(moves, targets, model)
        serving = np.zeros(model.nv, dtype=bool)
        for site in targets.sites:
            serving |= body_dofs(model, int(model.site_bodyid[site]))
        self.dofs = np.flatnonzero(serving)
        self.alpha = rigidity[self.dofs]
        self._turning = turning_threes(model, self.dofs)
        self.ranges = Ranges(character, self.dofs, self._turning)
        nframe = len(guess)
        basis = basis_matrix(np.arange(nframe), nframe, frames_per_knot)
        self.ncontrol = basis.shape[1]
        nfree = int(self.moved.free.sum())
        self.nunknown = self.ncontrol * len(self.dofs) + nfree
        self._basis = basis
        each = sparse.kron(basis, sparse.eye_array(len(self.dofs)), format="csr")
        self.spread = sparse.block_diag((each, sparse.eye_array(nfree)), format="csr")
        changing = bones is not None and bones.nframe is not None
        if bones is not None and changing:
            bones = bones.at(targets.frames)
        self._kinematics = Kinematics(model, len(targets.frames), bones=bones)
        weight = np.stack((targets.position_weight, targets.turn_weight), axis=-1)
        weight = np.repeat(weight.reshape(len(weight), -1), 3, axis=1)
        self._present = weight > 0.0
        self._soft = np.where(self._present, SOFT * (1.0 / np.maximum(weight, 1e-6) - 1.0), 0.0)
        # What a unit of each displacement and of each free move costs, and its root.
        rigidity = np.broadcast_to(self.moved.rigidity[:, None], self.moved.free.shape)
        cost = np.concatenate((np.tile(self.alpha, nframe), rigidity[self.moved.free]))
        self._root = np.sqrt(cost)
        self._own = sparse.csr_array(sparse.diags_array(self._root) @ self.spread)

    def state(self, unknowns: Array) -> State:
        """Return the problem at ``unknowns`` (nunknown,)."""
        size = self.ncontrol * len(self.dofs)
        displacement = self._basis @ unknowns[:size].reshape(self.ncontrol, -1)
        moves = np.zeros(self.moved.free.shape)
        moves[self.moved.free] = unknowns[size:]
        whole = np.zeros((len(self.guess), self.model.nv))
        whole[:, self.dofs] = displacement
        qpos = oplus(self.model, self.guess, whole)
        targets, effects = self.moved(moves)
        pose = self._kinematics.forward(qpos[targets.frames])
        parts = []
        for column, site in enumerate(targets.sites):
            parts.append(targets.position[:, column] - pose.site_xpos[:, site])
            turn = targets.matrix[:, column] @ np.swapaxes(pose.site_xmat[:, site], 1, 2)
            parts.append(log(from_matrix(turn)))
        error = np.concatenate(parts, axis=1) * self._present
        angles = self.ranges.angles(qpos)
        return State(unknowns, displacement, moves, qpos, pose, targets, effects, error, angles)

    def objective(self, state: State) -> float:
        """Return ``Σ α |d|² + Σ rigidity |move|²``."""
        moves = self.moved.rigidity @ np.sum(state.moves**2, axis=1)
        return float(np.sum(self.alpha * state.displacement**2) + moves)

    @property
    def nresidual(self) -> int:
        """Number of residuals."""
        ranges = len(self.guess) * len(self.ranges.bounds)
        return self._present.size + ranges + len(self._root)

    def penalties(self, omega: float) -> Array:
        """Return ω (n, e) of each constraint; of soft ones it stays below their softness allows."""
        return np.asarray(1.0 / (1.0 / omega + self._soft))

    def merit(self, state: State, omega: float) -> float:
        """Return the sum of all residuals' squares."""
        out = self.ranges.out(state.angles)
        penalty = float(np.sum(self.penalties(omega) * state.error**2) + omega * np.sum(out**2))
        return self.objective(state) + penalty

    def residuals(self, state: State, omega: float) -> Array:
        """Return all residuals: constraints, ranges, displacements and moves."""
        free = state.moves[self.moved.free]
        own = self._root * np.concatenate((state.displacement.ravel(), free))
        out = self.ranges.out(state.angles)
        penalties = np.sqrt(self.penalties(omega))
        return np.concatenate(
            ((penalties * state.error).ravel(), np.sqrt(omega) * out.ravel(), own)
        )

    def jacobian(self, state: State, omega: float) -> sparse.csr_array:
        """Return the derivatives of :meth:`residuals` by the unknowns."""
        frame, column = np.nonzero(self.ranges.out(state.angles))
        rows = self.ranges.rows(state.qpos, self.right(state), frame, column)
        place = frame * state.angles.shape[1] + column
        scatter = sparse.csr_array(
            (np.ones(len(place)), (place, np.arange(len(place)))),
            shape=(state.angles.size, len(place)),
        )
        scale = sparse.diags_array(np.sqrt(self.penalties(omega)).ravel())
        asked = (
            scale @ self.constraint_rows(state),
            np.sqrt(omega) * (scatter @ self.spread_out(frame, rows)),
        )
        by_unknowns = sparse.vstack(asked, format="csr") @ self.spread
        return sparse.csr_array(sparse.vstack((by_unknowns, self._own), format="csr"))

    def right(self, state: State) -> Array:
        """Return the right Jacobians (nframe, nball, 3, 3) of all rotations that serve."""
        return right_jacobian(state.displacement[:, self._turning])

    def constraint_rows(self, state: State) -> sparse.csr_array:
        """Return derivatives (n e, nframe k + nfree) of the constraints' errors.

        By each frame's own displacement, and by the free moves.
        """
        targets, error = state.targets, state.error
        rows = np.zeros((*error.shape, len(self.dofs)))
        for column, site in enumerate(targets.sites):
            body = int(self.model.site_bodyid[site])
            jacp, jacr = state.pose.jacobian(state.pose.site_xpos[:, site], body, self.dofs)
            turn = error[:, 6 * column + 3 : 6 * column + 6]
            rows[:, 6 * column : 6 * column + 3] = -jacp
            rows[:, 6 * column + 3 : 6 * column + 6] = -inverse_right_jacobian(turn) @ jacr
        right = self.right(state)[targets.frames]
        for ball, columns in enumerate(self._turning):
            rows[:, :, columns] = rows[:, :, columns] @ right[:, ball]
        rows *= self._present[..., None]
        count, width = error.shape
        frames = np.repeat(targets.frames, width)
        mine = self.spread_out(frames, rows.reshape(count * width, -1))
        return sparse.csr_array(mine + self._move_columns(state))

    def _move_columns(self, state: State) -> sparse.csr_array:
        """Return the derivatives by the free moves, in their columns."""
        width = state.error.shape[1]
        first = len(self.guess) * len(self.dofs)
        number = np.full(self.moved.free.shape, -1)
        number[self.moved.free] = first + np.arange(self.moved.free.sum())
        data, row, column = [np.empty(0)], [np.empty(0, np.int64)], [np.empty(0, np.int64)]
        for effect, numbers in zip(state.effects, number, strict=True):
            six = 6 * effect.column + np.arange(6)
            turn = state.error[np.ix_(effect.row, six[3:])]
            change = effect.change.copy()
            # A target that turns in the world: log(exp(δ) R) = r + J_r⁻¹(-r) δ.
            change[:, 3:] = inverse_right_jacobian(-turn) @ change[:, 3:]
            change *= self._present[np.ix_(effect.row, six)][..., None]
            free = np.flatnonzero(numbers >= 0)
            shape = (len(effect.row), 6, len(free))
            data.append(change[:, :, free].ravel())
            at = width * effect.row[:, None] + six
            row.append(np.broadcast_to(at[..., None], shape).ravel())
            column.append(np.broadcast_to(numbers[free], shape).ravel())
        return sparse.csr_array(
            (np.concatenate(data), (np.concatenate(row), np.concatenate(column))),
            shape=(state.error.size, self.spread.shape[0]),
        )

    def spread_out(self, frame: Rows, rows: Array) -> sparse.csr_array:
        """Return rows (m, k), each about one frame, in the columns of all frames."""
        count, k = rows.shape
        columns = k * np.asarray(frame)[:, None] + np.arange(k)
        return sparse.csr_array(
            (rows.ravel(), columns.ravel(), k * np.arange(count + 1)),
            shape=(count, self.spread.shape[0]),
        )
