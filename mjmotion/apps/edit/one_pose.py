"""Gauss–Newton (§5.1) on a single pose, with MuJoCo's own Jacobians: a step costs 0.1 ms.

    solver = OnePose(character, rigidity)
    qpos = solver.solve(qpos, goals, iterations)

The same least-deviation steps as :class:`mjmotion.ik.NumericIK`, which takes all frames at once and
for one frame mostly waits for NumPy. Goals that may be out of reach are damped by the square of
what is left of them (Levenberg–Marquardt), so that they are met exactly where they can be, and
come near where they cannot.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.character import Character
from mjmotion.constraints import Targets
from mjmotion.ik.numeric import STEP_LIMIT
from mjmotion.numerics.tangent import ominus, oplus

Array = NDArray[np.float64]

MET = 1e-7  # with nothing off by more, a pose is found [m, rad]
_RIDGE = 1e-9  # keeps the dual solvable where a limb is straight [m²]
_DAMPING = 0.01  # compliance of a row that may be out of reach, over the square of what is left
_LIMIT_TOLERANCE = 1e-9  # [rad]


@dataclasses.dataclass(frozen=True, eq=False)
class Goal:
    """Where a site is to be.

    Attributes:
      site: id of the site.
      position: (3,) where [m]; None for anywhere.
      quat: (4,) how turned, wxyz; None for anyhow.
      soft: whether it gives way to others where not all can be met.
    """

    site: int
    position: Array | None
    quat: Array | None = None
    soft: bool = False


def goals_of(targets: Targets, soft: bool = False) -> list[Goal]:
    """Return the goals of targets at one frame."""
    return [
        Goal(
            int(site),
            targets.position[0, column] if targets.position_weight[0, column] > 0.0 else None,
            targets.quat[0, column] if targets.turn_weight[0, column] > 0.0 else None,
            soft,
        )
        for column, site in enumerate(targets.sites)
    ]


class Places:
    """Where sites are, in a few dozen poses at a time, again and again; for one thread.

    Args:
      model: whose sites.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        self._data = mujoco.MjData(model)

    def __call__(self, qpos: Array, sites: NDArray[np.int64]) -> Array:
        """Return where sites (s,) are in poses (n, nq): (n, s, 3) [m]."""
        model, data, kinematics = self.model, self._data, mujoco.mj_kinematics
        found, pose, place = np.empty((len(qpos), model.nsite, 3)), data.qpos, data.site_xpos
        for all_sites, row in zip(found, qpos, strict=True):  # MuJoCo takes one frame at a time
            pose[:] = row
            kinematics(model, data)
            all_sites[:] = place
        return found[:, sites]


class OnePose:
    """Least-deviation Gauss–Newton on one pose after another.

    It has room of its own to work in: for one thread.

    Args:
      character: any character.
      rigidity: (nv,) α of Eq. 4.
    """

    def __init__(self, character: Character, rigidity: Array) -> None:
        self.character, self.model = character, character.model
        self._data = mujoco.MjData(self.model)
        self._freedom = 1.0 / character.coupling.rigidity(rigidity)
        self._freedom[character.coupling.follower] = 0.0  # they have none of their own
        self._joint = self.model.dof_jntid

    def positions(self, qpos: Array, sites: NDArray[np.int64]) -> Array:
        """Return where sites (s,) are in a pose (nq,): (s, 3) [m]."""
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self._data)
        return np.array(self._data.site_xpos[sites])

    def off(self, qpos: Array, goals: Sequence[Goal], lever: float) -> float:
        """Return how far the worst goal is off [m]: by distance, or by turn at a lever [m]."""
        data, most = self._data, 0.0
        data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, data)
        for goal in goals:
            if goal.position is not None:
                gap = goal.position - data.site_xpos[goal.site]
                most = max(most, float(gap @ gap) ** 0.5)
            if goal.quat is not None:
                turn = _turn_to(goal.quat, data.site_xmat[goal.site])
                most = max(most, lever * float(turn @ turn) ** 0.5)
        return most

    def solve(
        self, qpos: Array, goals: Sequence[Goal], iterations: int, stride: float = np.inf
    ) -> Array:
        """Return the pose (nq,) within limits that meets goals and deviates least, or comes near.

        Args:
          qpos: (nq,) the pose to start and to deviate from.
          goals: where sites are to be.
          iterations: steps at most.
          stride: the way of a soft goal is gone in steps no longer than this [m].
        """
        displacement, freedom, pose = np.zeros(self.model.nv), self._freedom.copy(), qpos
        hard = np.concatenate([np.full(_rows(goal), not goal.soft) for goal in goals])
        coupling = self.character.coupling
        for _ in range(iterations):
            jacobian, error = self._linear(pose, goals, stride)
            if np.abs(error).max(initial=0.0) < MET:
                break
            soft = np.where(hard, 0.0, _DAMPING * float(np.square(error[~hard]).sum()))
            change = _step(jacobian, error, soft, freedom, displacement) - displacement
            size = float(np.abs(change).max(initial=0.0))
            displacement = displacement + change * min(1.0, STEP_LIMIT / max(size, 1e-12))
            if coupling:
                displacement = coupling.spread(displacement)
            pose, displacement = self._inside(qpos, displacement, freedom)
        return pose

    def _linear(self, pose: Array, goals: Sequence[Goal], stride: float) -> tuple[Array, Array]:
        """Return rows (e, nv) and what is left of them (e,), of soft ones no more than a stride."""
        model, data = self.model, self._data
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        count = sum(_rows(goal) for goal in goals)
        jacobian, error, at = np.zeros((count, model.nv)), np.zeros(count), 0
        place, turn = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        for goal in goals:
            mujoco.mj_jacSite(model, data, place, turn, goal.site)
            if goal.position is not None:
                gap = goal.position - data.site_xpos[goal.site]
                length = float(np.sqrt(gap @ gap))
                jacobian[at : at + 3] = place
                most = stride if goal.soft else np.inf
                error[at : at + 3] = gap * min(1.0, most / max(length, 1e-12))
                at += 3
            if goal.quat is not None:
                jacobian[at : at + 3] = turn
                error[at : at + 3] = _turn_to(goal.quat, data.site_xmat[goal.site])
                at += 3
        coupling = self.character.coupling
        return (coupling.gather(jacobian) if coupling else jacobian), error

    def _inside(self, qpos: Array, displacement: Array, freedom: Array) -> tuple[Array, Array]:
        """Put joints that left their range on its edge, and hold them there in ``freedom``."""
        model = self.model
        moved = oplus(model, qpos[None], displacement[None])
        clamped = self.character.within_limits(moved)
        if not np.abs(clamped - moved).max() > _LIMIT_TOLERANCE:
            return moved[0], displacement
        edge = ominus(model, clamped, qpos[None])[0]
        off = np.abs(edge - displacement) > _LIMIT_TOLERANCE
        hit = np.unique(self._joint[off])
        # A ball is held as a whole; coupled joints are put right in every step.
        held = np.isin(self._joint, hit[hit > 0])
        held[self.character.coupling.leader] = False
        freedom[held] = 0.0
        return clamped[0], edge


def _rows(goal: Goal) -> int:
    return 3 * (goal.position is not None) + 3 * (goal.quat is not None)


def _turn_to(quat: Array, matrix: Array) -> Array:
    """Return the rotation vector (3,) in the world [rad] that is left to an orientation."""
    own, left, turn = np.empty(4), np.empty(4), np.empty(3)
    mujoco.mju_mat2Quat(own, matrix)
    mujoco.mju_negQuat(own, own)
    mujoco.mju_mulQuat(left, quat, own)
    mujoco.mju_quat2Vel(turn, left, 1.0)
    return turn


def _step(jacobian: Array, error: Array, soft: Array, freedom: Array, so_far: Array) -> Array:
    """Return the displacement (nv,) of least ``Σ |d|²/freedom`` with ``J d = e + J d_so_far``.

    ``soft`` (e,) are the rows' compliances; what has no freedom stays where it is.
    """
    spread = jacobian * freedom
    dual = spread @ jacobian.T
    index = np.arange(len(error))
    dual[index, index] += soft + _RIDGE
    held = np.where(freedom > 0.0, 0.0, so_far)
    force = np.linalg.solve(dual, error + jacobian @ (so_far - held))
    return np.asarray(force @ spread + held)
