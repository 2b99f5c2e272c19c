"""The body that carries the limbs: its degrees of freedom, the reduced problem in them (§5.2)."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.character import Character
from mjmotion.body.joint_coupling import Coupling
from mjmotion.body.joint_limits import swing_twist
from mjmotion.body.kinematics import body_dofs, body_pose
from mjmotion.body.limbs import Limbs, LimbState
from mjmotion.constraints import Targets
from mjmotion.ik.edges import Edges
from mjmotion.numerics.rotations import cross, exp, multiply, rotate, to_matrix

Array = NDArray[np.float64]

_OVER = 1e-4  # out of its range by more than this, a joint needs a solver that knows it [rad]
_STRAIGHT = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)


@dataclasses.dataclass(frozen=True, eq=False)
class Reduced:
    """The reduced problem, weighted: swivels (n, nlimb, 7) and T (n, nbase, nlimb · 7).

    ``closure`` is how limbs follow their bases, unweighted, at ``state``.
    """

    base: Base
    swivel: Array
    rows: Array
    matrix: Array
    sqrt_rigidity: Array
    closure: tuple[Array, Array]
    state: LimbState
    edges: Edges | None

    def follow_ends(self, limbs: Limbs, targets: Targets) -> Array:
        """Return what limbs do when their ends' sites move and turn in the world (n, nlimb, 7, 6).

        Weighted, with swivels taken out, as T is. A base that moves asks of its limb what an end
        that moves the other way does.
        """
        moving, turning = self.closure
        state = self.state
        frame = np.swapaxes(to_matrix(state.base_quat), -1, -2)
        point = limbs.bones.site_pos[..., targets.sites, :] - limbs.end_anchor
        arm = rotate(state.base_quat, rotate(state.end, point))
        moving, turning = -(moving @ frame), -(turning @ frame)
        follow = np.concatenate((moving, np.zeros_like(moving)), axis=-1)
        # Turning about the site takes the ankle along: v = ω × (ankle − site) = arm × ω.
        follow[..., 3:] = np.cross(moving, arm[..., None, :])
        follow[..., 4:, 3:] += turning
        follow *= self.sqrt_rigidity[..., None]
        along = np.einsum("nkd,nkde->nke", self.swivel, follow)
        return follow - self.swivel[..., None] * along[..., None, :]


class Base:
    """Degrees of freedom between the world and the limbs' bases, in the bases' own frames.

    Attributes:
      dofs: (m,) the degrees of freedom.
      rigidity: (nbase,) α of each parameter: as many, less those that follow others (§4.2).
    """

    def __init__(
        self,
        character: Character,
        limbs: Limbs,
        qpos: Array,
        state: LimbState,
        rigidity: Array,
    ) -> None:
        self._character, model = character, character.model
        # (nlimb, nbase) which of them carry which limb
        carried = np.stack([body_dofs(model, limb.base) for limb in limbs.limbs])
        self.dofs = np.flatnonzero(carried.any(axis=0))
        self._fold, self.rigidity = _fold(character.coupling, self.dofs, rigidity)
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

    def beyond(self, qpos: Array, displacement: Array) -> NDArray[np.bool_]:
        """Return the frames (n,) in which a displacement (n, nv) takes a joint out of its range."""
        model, out = self._character.model, np.zeros(len(qpos), dtype=bool)
        for joint in np.unique(model.dof_jntid[self.dofs]):
            dof, at = model.jnt_dofadr[joint], model.jnt_qposadr[joint]
            box = self._character.limits.boxes.get(int(joint))
            if box is not None:
                turn = exp(displacement[:, dof : dof + 3])
                value = swing_twist(multiply(qpos[:, at : at + 4], turn))
            elif model.jnt_limited[joint] and model.jnt_type[joint] in _STRAIGHT:
                box = model.jnt_range[joint][None]
                value = (qpos[:, at] + displacement[:, dof])[:, None]
            else:
                continue
            out |= ((value < box[:, 0] - _OVER) | (value > box[:, 1] + _OVER)).any(axis=1)
        return out

    def gather(self, displacement: Array) -> Array:
        """Return the parameters (n, nbase) of displacements (n, m) of :attr:`dofs`."""
        if self._fold is None:
            return displacement
        return np.asarray(displacement @ np.linalg.pinv(self._fold).T)


def _fold(
    coupled: Coupling, dofs: NDArray[np.int64], rigidity: Array
) -> tuple[Array | None, Array]:
    """Return what each parameter does to ``dofs`` (m, nbase), and the parameters' rigidities.

    None stands for the identity: no degree of freedom follows another.
    """
    inside = np.isin(coupled.follower, dofs)
    if not inside.any():
        return None, rigidity[dofs]
    fold = np.eye(len(dofs))
    place = {int(dof): index for index, dof in enumerate(dofs)}
    following = []
    for row in np.flatnonzero(inside):
        leader, follower = place[int(coupled.leader[row])], place[int(coupled.follower[row])]
        fold[follower] = 0.0
        fold[follower, leader] = coupled.ratio[row]
        following.append(follower)
    fold = np.delete(fold, following, axis=1)
    return fold, fold.T**2 @ rigidity[dofs]
