"""The paper's own numeric solver (§5.1), kept as a slow reference to compare the others with.

    result = fit(motion, constraints, ik=ConjugateGradientIK(motion.character))

Each frame is solved by itself. The unknown is the displacement x from the pose handed in (Eq. 5),
so quaternions need no constraint of their own, and what is minimised is Eq. 6,

    g(x) = ½ xᵀ M x + Σ ω_i c_i(x)² + Σ ω_i min(c_i(x), 0)²,

by conjugate gradients. Equalities are the positions [m] and orientations [rad] of sites,
inequalities are clearances and joint limits. A penalty alone leaves a residual of about M x / 2ω,
so ω grows from round to round, each starting from the pose of the one before.

Nothing here is shared with the fast solvers but the definition of the problem: kinematics and
Jacobians are MuJoCo's own, frame by frame.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.body.character import Character, CharacterLike
from mjmotion.body.joint_limits import swing_twist
from mjmotion.constraints import Targets
from mjmotion.exceptions import FitError
from mjmotion.ik.solver import Clearance, Deviation, Solution, default_rigidity
from mjmotion.numerics.rotations import from_matrix, log

Array = NDArray[np.float64]

PENALTIES = (1e2, 1e4, 1e6)  # ω of Eq. 6, round by round [1/m² or 1/rad²]
SOFT = 0.05  # compliance of a target at half weight, as in the fast solvers [m² or rad²]
LIMITS = 100.0  # how much more a joint limit counts than a target that is out of reach
ROOT_STIFFER = 1e3  # how much stiffer the root is in the exact pass
_GRADIENT = 1e-4  # a round ends when no part of the scaled gradient is larger
_MOST = 400  # steps of conjugate gradients a round

_BALL, _FREE = int(mujoco.mjtJoint.mjJNT_BALL), int(mujoco.mjtJoint.mjJNT_FREE)


class ConjugateGradientIK:
    """Penalties and conjugate gradients, one frame after the other; see :class:`IKSolver`.

    Args:
      character: any character.
      rigidity: (nv,) the diagonal of M; :func:`default_rigidity` without.
      penalties: ω of Eq. 6, growing.
    """

    def __init__(
        self,
        character: CharacterLike,
        rigidity: ArrayLike | None = None,
        penalties: Sequence[float] = PENALTIES,
    ) -> None:
        self.character = Character.of(character)
        self.model = self.character.model
        self.rigidity = (
            default_rigidity(self.model)
            if rigidity is None
            else np.asarray(rigidity, dtype=np.float64)
        )
        self.penalties = tuple(penalties)

    def prepare(
        self, targets: Targets, clearance: Clearance | None = None
    ) -> ConjugateGradientProblem:
        """Return the problem of some targets; see :class:`IKSolver`.

        Raises:
          FitError: targets that are relative or look at something: the paper has none of them.
        """
        if targets.relative or targets.look_at:
            raise FitError(
                f"{type(self).__name__} knows no relative constraints and look-ats: use"
                " ik='hybrid' or 'numeric'"
            )
        return ConjugateGradientProblem(self, targets, clearance)


@dataclasses.dataclass(frozen=True, eq=False)
class ConjugateGradientProblem:
    """Targets for :class:`ConjugateGradientIK`; see :class:`mjmotion.ik.solver.IKProblem`.

    It does not say what its targets cost: targets that are free to move are not for it.
    """

    solver: ConjugateGradientIK
    targets: Targets
    clearance: Clearance | None = None

    def solve(
        self, qpos: Array, last: Solution | None = None, deviation: Deviation | None = None
    ) -> Solution:
        """Return the least displacements towards the targets; nothing is kept of ``last``."""
        return self._minimise(qpos, self.clearance, self.solver.rigidity)

    def enforce(self, qpos: Array) -> Solution:
        """Return displacements that meet the targets with the root nearly still (§4.4)."""
        rigidity = self.solver.rigidity.copy()
        rigidity[:6] *= ROOT_STIFFER
        return self._minimise(qpos, None, rigidity)

    def _minimise(self, qpos: Array, clearance: Clearance | None, rigidity: Array) -> Solution:
        from scipy.optimize import minimize

        penalties, nv = self.solver.penalties, self.solver.model.nv
        displacement = np.zeros((len(qpos), nv))
        error = np.zeros(len(qpos))
        scale = 1.0 / np.sqrt(rigidity)  # in x / scale, M is the identity: fewer steps
        for row, pose in enumerate(qpos):
            targets = self.targets.at(np.array([row]))
            objective = PenaltyObjective(self.solver.character, pose, targets, rigidity, clearance)
            error[row] = objective.position_error()
            if objective(displacement[row], penalties[-1])[0] == 0.0:
                continue  # nothing is broken, so no displacement is the least
            scaled = np.zeros(nv)
            for penalty in penalties:

                def scaled_objective(
                    y: Array, goal: PenaltyObjective = objective, omega: float = penalty
                ) -> tuple[float, Array]:
                    value, gradient = goal(y * scale, omega)
                    return value, gradient * scale

                found = minimize(
                    scaled_objective,
                    scaled,
                    jac=True,
                    method="CG",
                    options={"gtol": _GRADIENT, "maxiter": _MOST},
                )
                scaled = found.x
            displacement[row] = scaled * scale
        return Solution(displacement, error)


class PenaltyObjective:
    """Eq. 6 of one frame: value and gradient over its displacement (Eq. 5).

    Args:
      character: the body.
      qpos: (nq,) the reference pose, m_{k-1}(t_j) of Eq. 4.
      targets: of this frame alone.
      rigidity: (nv,) diagonal of M.
      clearance: what to keep clear of.
    """

    def __init__(
        self,
        character: Character,
        qpos: Array,
        targets: Targets,
        rigidity: Array,
        clearance: Clearance | None = None,
    ) -> None:
        self.model = model = character.model
        self.reference = np.array(qpos, dtype=np.float64)
        self.targets = targets
        self.rigidity = rigidity
        self.clearance = clearance
        self._data = mujoco.MjData(model)
        boxes = character.limits.boxes
        self._boxed = np.array(sorted(boxes), dtype=np.int64)
        self._boxed_qpos = model.jnt_qposadr[self._boxed][:, None] + np.arange(4)
        self._low, self._high = np.moveaxis(
            np.array([boxes[joint] for joint in sorted(boxes)]).reshape(-1, 3, 2), 2, 0
        )
        self._ranged = [
            joint
            for joint in range(model.njnt)
            if model.jnt_limited[joint] and model.jnt_type[joint] != _FREE and joint not in boxes
        ]

    def position_error(self) -> float:
        """Return the largest position error of the reference pose [m]."""
        self._forward(self.reference)
        gap = self.targets.position[0] - self._data.site_xpos[self.targets.sites]
        held = self.targets.position_weight[0] > 0.0
        return float(np.max(np.linalg.norm(gap, axis=1) * held, initial=0.0))

    def __call__(self, displacement: Array, penalty: float) -> tuple[float, Array]:
        """Return g(x) and its gradient (nv,) for ω = ``penalty``."""
        moved = self.reference.copy()
        mujoco.mj_integratePos(self.model, moved, displacement, 1.0)
        self._forward(moved)
        value, slope = 0.0, np.zeros(self.model.nv)  # slope: over a further turn of the moved pose
        for part in (self._equalities, self._clearances, self._limits):
            more, gradient = part(moved, penalty)
            value, slope = value + more, slope + gradient
        own = self.rigidity * displacement
        return 0.5 * float(own @ displacement) + value, own + self._pull_back(displacement, slope)

    def _forward(self, qpos: Array) -> None:
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self._data)
        mujoco.mj_comPos(self.model, self._data)

    def _equalities(self, moved: Array, penalty: float) -> tuple[float, Array]:
        """Σ ω c² over positions and orientations; a target below full weight has a smaller ω."""
        value, slope = 0.0, np.zeros(self.model.nv)
        jacp, jacr = np.empty((3, self.model.nv)), np.empty((3, self.model.nv))
        for column, site in enumerate(self.targets.sites):
            mujoco.mj_jacSite(self.model, self._data, jacp, jacr, int(site))
            gap = self.targets.position[0, column] - self._data.site_xpos[site]
            matrix = self._data.site_xmat[site].reshape(3, 3)
            # |log|² changes by -2 log · δ when the site turns by δ, however far it is.
            turn = log(from_matrix(self.targets.matrix[0, column] @ matrix.T))
            for weight, c, jacobian in (
                (self.targets.position_weight[0, column], gap, jacp),
                (self.targets.turn_weight[0, column], turn, jacr),
            ):
                if weight > 0.0:
                    omega = 1.0 / (1.0 / penalty + 2.0 * SOFT * (1.0 / weight - 1.0))
                    value += omega * float(c @ c)
                    slope -= 2.0 * omega * (c @ jacobian)
        return value, slope

    def _clearances(self, moved: Array, penalty: float) -> tuple[float, Array]:
        """Σ ω min(c, 0)² with c = −needed."""
        if self.clearance is None:
            return 0.0, np.zeros(self.model.nv)
        broken = self.clearance(moved[None], self.targets.frames)
        needed = np.maximum(broken.needed, 0.0)
        slope = -2.0 * penalty * (needed @ broken.rows)
        return penalty * float(needed @ needed), np.asarray(slope).reshape(self.model.nv)

    def _limits(self, moved: Array, penalty: float) -> tuple[float, Array]:
        """Σ ω min(c, 0)² with c how far each joint is inside each of its limits."""
        model, penalty = self.model, LIMITS * penalty
        value, slope = 0.0, np.zeros(model.nv)
        if len(self._boxed):
            quats = moved[self._boxed_qpos]
            angles = swing_twist(quats)
            outside = angles - np.clip(angles, self._low, self._high)
            value += penalty * float(np.sum(outside * outside))
            for ball in np.flatnonzero(outside.any(axis=1)):
                dof = model.jnt_dofadr[self._boxed[ball]]
                pull = outside[ball] @ swing_twist_jacobian(quats[ball])
                slope[dof : dof + 3] += 2.0 * penalty * pull
        for joint in self._ranged:
            address, dof = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
            low, high = model.jnt_range[joint]
            if model.jnt_type[joint] == _BALL:  # MuJoCo's own range, of the whole angle
                turn = log(moved[address : address + 4])
                angle = float(np.linalg.norm(turn))
                out = max(angle - high, 0.0)
                slope[dof : dof + 3] += 2.0 * penalty * out / max(angle, 1e-12) * turn
            else:
                out = float(min(moved[address] - low, 0.0) + max(moved[address] - high, 0.0))
                slope[dof] += 2.0 * penalty * out
            value += penalty * out * out
        return value, slope

    def _pull_back(self, displacement: Array, slope: Array) -> Array:
        """Turn a gradient over a further displacement of the moved pose into one over x itself.

        exp(v + dv) = exp(v) exp(J_r(v) dv): each rotation's three numbers go through J_rᵀ.
        """
        model = self.model
        gradient = slope.copy()
        for joint in range(model.njnt):
            first = model.jnt_dofadr[joint]
            if model.jnt_type[joint] == _FREE:
                first += 3
            elif model.jnt_type[joint] != _BALL:
                continue
            block = slice(first, first + 3)
            gradient[block] = right_jacobian(displacement[block]).T @ slope[block]
        return gradient


def right_jacobian(vector: Array) -> Array:
    """Return J_r (3, 3) with ``exp(v + dv) = exp(v) exp(J_r(v) dv)`` to first order."""
    x, y, z = vector
    skew = np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))
    square = float(vector @ vector)
    angle = np.sqrt(square)
    if angle < 1e-3:
        first, second = 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
    else:
        first, second = (1.0 - np.cos(angle)) / square, (angle - np.sin(angle)) / (square * angle)
    return np.asarray(np.eye(3) - first * skew + second * (skew @ skew))


def swing_twist_jacobian(quat: Array) -> Array:
    """Return how swing_x, swing_y and twist change when a ball turns about its own axes.

    Args:
      quat: (4,) unit quaternion wxyz.

    Returns:
      (3, 3): d(:func:`mjmotion.body.joint_limits.swing_twist`) / dδ for ``quat exp(δ)``, at δ = 0.
    """
    w, x, y, z = quat
    real, swung = np.hypot(w, z), np.hypot(x, y)
    if real < 1e-9:  # a swing of π: its direction and the twist are not defined
        return np.zeros((3, 3))
    # swing = factor (x w − y z, x z + y w), factor = angle / (swung real)
    if swung > 1e-6:
        factor = 2.0 * np.arctan2(swung, real) / (swung * real)
        by_swung, by_real = (2.0 - factor) / swung, -(2.0 + factor) / real
        d_swung = np.array((0.0, x, y, 0.0)) / swung
    else:
        factor, by_swung, by_real = 2.0 / real**2, 0.0, -4.0 / real**3
        d_swung = np.zeros(4)
    d_real = np.array((w, 0.0, 0.0, z)) / real
    d_factor = by_swung * d_swung + by_real * d_real
    by_quat = np.array(
        (
            factor * np.array((x, w, -z, -y)) + (x * w - y * z) * d_factor,
            factor * np.array((y, z, w, x)) + (x * z + y * w) * d_factor,
            2.0 * np.array((-z, 0.0, 0.0, w)) / real**2,
        )
    )
    by_turn = 0.5 * np.array(((-x, -y, -z), (w, -z, y), (z, w, -x), (-y, x, w)))
    return np.asarray(by_quat @ by_turn)
