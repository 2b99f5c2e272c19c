"""Joints that share one set of degrees of freedom by given shares (§4.2): a flexible spine.

A model says it with a tuple whose name begins with ``couple_``, in MJCF:

    <tuple name="couple_spine">
      <element objtype="joint" objname="spine_low" prm="0.3"/>
      <element objtype="joint" objname="spine_mid" prm="0.3"/>
      <element objtype="joint" objname="spine_top" prm="0.4"/>
    </tuple>

The joints are all balls or all hinges. Ball i turns by ``exp(prm_i · w)`` with one ``w`` (3,) [rad]
for all; hinge i by ``prm_i · w``. IK then has the leader's degrees of freedom alone: to first order
a displacement of joint i is ``prm_i / prm_leader`` times the leader's (:meth:`Coupling.gather`,
:meth:`Coupling.spread`), and :meth:`Coupling.couple` puts what is left of second order right.
"""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.body.joint_limits import JointLimits
from mjmotion.exceptions import ModelError
from mjmotion.numerics.rotations import exp, log

Array = NDArray[np.float64]

PREFIX = "couple_"
_HALVINGS = 20
_SLACK = 1e-9  # a limit passed by less than this is rounding [rad]
_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
_KINDS = (int(mujoco.mjtJoint.mjJNT_BALL), _HINGE)


@dataclasses.dataclass(frozen=True)
class CoupledJoints:
    """One tuple: its joints, in order, and their shares; the first is the leader."""

    name: str
    joints: tuple[int, ...]
    shares: tuple[float, ...]


def coupled_joints(model: mujoco.MjModel) -> tuple[CoupledJoints, ...]:
    """Return the coupled joints of a model.

    Raises:
      ModelError: a ``couple_`` tuple that names no joints, joints of two kinds, a joint twice, a
        share that is not positive, or hinges whose ranges exclude each other.
    """
    found, taken = [], set[int]()
    for index in range(model.ntuple):
        name = model.tuple(index).name
        if not name.startswith(PREFIX):
            continue
        first, size = model.tuple_adr[index], model.tuple_size[index]
        kinds = model.tuple_objtype[first : first + size]
        joints = tuple(int(joint) for joint in model.tuple_objid[first : first + size])
        shares = tuple(float(share) for share in model.tuple_objprm[first : first + size])
        if size < 2 or (kinds != int(mujoco.mjtObj.mjOBJ_JOINT)).any():
            raise ModelError(f"tuple '{name}' must name two joints or more, and nothing else")
        types = {int(model.jnt_type[joint]) for joint in joints}
        if len(types) > 1 or not types <= set(_KINDS):
            raise ModelError(
                f"tuple '{name}' must name joints of one kind: all balls or all hinges"
            )
        if min(shares) <= 0.0:
            raise ModelError(f"tuple '{name}': every prm must be a positive share")
        if len(set(joints)) < size or taken & set(joints):
            raise ModelError(f"tuple '{name}' names a joint that is coupled already")
        taken |= set(joints)
        group = CoupledJoints(name.removeprefix(PREFIX), joints, shares)
        if types == {_HINGE} and np.subtract(*_hinge_range(model, group)) > 0.0:
            raise ModelError(
                f"tuple '{name}': there is no turn that the ranges of all joints allow"
            )
        found.append(group)
    return tuple(found)


class Coupling:
    """Which joints of a model share degrees of freedom, and which follow which.

    Args:
      model: the model.
      limits: of its joints.

    Attributes:
      groups: the coupled joints.
      leader: (m,) leading degrees of freedom.
      follower: (m,) a degree of freedom that follows it; a leader may have several.
      ratio: (m,) follower's displacement over leader's.

    Raises:
      ModelError: see :func:`coupled_joints`.
    """

    def __init__(self, model: mujoco.MjModel, limits: JointLimits) -> None:
        self.model = model
        self.groups = coupled_joints(model)
        self._limits = limits
        leader, follower, ratio = [], [], []
        for group in self.groups:
            width = 3 if _is_ball(model, group) else 1
            for joint, share in zip(group.joints[1:], group.shares[1:], strict=True):
                leader += list(model.jnt_dofadr[group.joints[0]] + np.arange(width))
                follower += list(model.jnt_dofadr[joint] + np.arange(width))
                ratio += width * [share / group.shares[0]]
        self.leader: NDArray[np.int64] = np.array(leader, np.int64)
        self.follower: NDArray[np.int64] = np.array(follower, np.int64)
        self.ratio: Array = np.array(ratio, np.float64)

    def __bool__(self) -> bool:
        return len(self.leader) > 0

    def gather(self, rows: Array) -> Array:
        """Return Jacobian rows (..., nv) with the followers' columns added to the leaders'."""
        gathered = np.array(rows)
        for leader, follower, ratio in zip(self.leader, self.follower, self.ratio, strict=True):
            gathered[..., leader] += ratio * rows[..., follower]
        gathered[..., self.follower] = 0.0
        return gathered

    def spread(self, displacement: Array) -> Array:
        """Return displacements (..., nv) whose followers do what their leaders do."""
        spread = np.array(displacement)
        spread[..., self.follower] = self.ratio * displacement[..., self.leader]
        return spread

    def rigidity(self, rigidity: Array) -> Array:
        """Return rigidities (nv,) whose leaders bear their followers' too (Eq. 4)."""
        borne = np.array(rigidity)
        np.add.at(borne, self.leader, self.ratio**2 * rigidity[self.follower])
        return borne

    def shared_turn(self, group: CoupledJoints, qpos: Array) -> Array:
        """Return the turn w (n, 3) or (n, 1) [rad] that fits a group's joints best."""
        shares = np.array(group.shares)
        address = [int(self.model.jnt_qposadr[joint]) for joint in group.joints]
        if _is_ball(self.model, group):
            turns = np.stack([log(qpos[:, start : start + 4]) for start in address], axis=1)
        else:
            turns = qpos[:, address][..., None]
        return np.asarray(np.einsum("s,nsk->nk", shares, turns) / np.sum(shares**2))

    def couple(self, qpos: ArrayLike) -> Array:
        """Return poses (n, nq) whose coupled joints have their shares of one turn, within limits.

        Where a joint of a group would leave its range, the turn of the whole group is another, or,
        of balls, less.
        """
        result = np.array(qpos, dtype=np.float64)
        for group in self.groups:
            turn = self.shared_turn(group, result)
            if not _is_ball(self.model, group):
                turn = np.clip(turn, *_hinge_range(self.model, group))
            result = self._put(group, result, turn)
            over = np.flatnonzero(self._excess(group, result) > _SLACK)
            if len(over) == 0:
                continue
            low, high = np.zeros(len(over)), np.ones(len(over))
            for _ in range(_HALVINGS):
                middle = 0.5 * (low + high)
                tried = self._put(group, result[over], turn[over] * middle[:, None])
                inside = self._excess(group, tried) <= _SLACK
                low, high = np.where(inside, middle, low), np.where(inside, high, middle)
            result[over] = self._put(group, result[over], turn[over] * low[:, None])
        return result

    def _put(self, group: CoupledJoints, qpos: Array, turn: Array) -> Array:
        placed = np.array(qpos)
        for joint, share in zip(group.joints, group.shares, strict=True):
            start = int(self.model.jnt_qposadr[joint])
            if _is_ball(self.model, group):
                quat = exp(share * turn)
                flip = (quat * qpos[:, start : start + 4]).sum(axis=1, keepdims=True) < 0.0
                placed[:, start : start + 4] = np.where(flip, -quat, quat)
            else:
                placed[:, start] = share * turn[:, 0]
        return placed

    def _excess(self, group: CoupledJoints, qpos: Array) -> Array:
        """Return how far (n,) the worst joint of a group is out of its range [rad]."""
        names = {self.model.joint(joint).name for joint in group.joints}
        names |= {f"{name}.{part}" for name in names for part in ("swing_x", "swing_y", "twist")}
        columns = [i for i, name in enumerate(self._limits.names) if name in names]
        return np.asarray(self._limits.excess(qpos)[:, columns].max(axis=1, initial=0.0))


def _is_ball(model: mujoco.MjModel, group: CoupledJoints) -> bool:
    return bool(model.jnt_type[group.joints[0]] == mujoco.mjtJoint.mjJNT_BALL)


def _hinge_range(model: mujoco.MjModel, group: CoupledJoints) -> tuple[float, float]:
    """Return the least and the largest angle [rad] that all hinges of a group allow."""
    low, high = -np.inf, np.inf
    for joint, share in zip(group.joints, group.shares, strict=True):
        if model.jnt_limited[joint]:
            low = max(low, model.jnt_range[joint, 0] / share)
            high = min(high, model.jnt_range[joint, 1] / share)
    return low, high
