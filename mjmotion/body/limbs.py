"""Limbs closed in form (§5.3, Eq. 7): ball, hinge, ball put a hand or foot where it has to be.

A limb is found by its joints alone: a body on a ball joint (thigh, upper arm), a child on a hinge
(shank, forearm), a child of that on a ball (foot, hand). All limbs of a model are handled together:
arrays are (n, nlimb, …), so the cost is that of one.

Geometry, in the frame of the upper segment with the hip at its origin: the knee stands at ``v1``,
the ankle at ``v1 + R(axis, θ) v2``. With ``r1``, ``r2`` the distances of hip and ankle from the
knee axis and ``s`` the product of the parts along it, the hip–ankle distance is

    L² = |v1|² + |v2|² + 2 s + 2 r1 r2 cos(θ + θ0),

which is Eq. 7 with φ = π − θ − θ0.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.body.bones import Bones
from mjmotion.body.joint_limits import swing_twist
from mjmotion.body.kinematics import body_pose
from mjmotion.numerics.rotations import (
    between,
    conjugate,
    cross,
    dot,
    exp,
    log,
    multiply,
    norm,
    normalized,
    rotate,
    to_matrix,
)

Array = NDArray[np.float64]

_BALL = mujoco.mjtJoint.mjJNT_BALL
_HINGE = mujoco.mjtJoint.mjJNT_HINGE
_STRAIGHT = 0.02  # least lever of a knee, so that a straight limb's rates stay finite [m]


@dataclasses.dataclass(frozen=True)
class Limb:
    """One ball–hinge–ball chain: its bodies from the hip down, and the body it hangs from."""

    base: int
    upper: int
    lower: int
    end: int


def find_limbs(model: mujoco.MjModel) -> tuple[Limb, ...]:
    """Return every ball–hinge–ball chain of single-joint bodies in the model."""
    limbs = []
    for end in range(1, model.nbody):
        lower = int(model.body_parentid[end])
        upper = int(model.body_parentid[lower])
        kinds = [_only_joint(model, body) for body in (upper, lower, end)]
        if kinds == [_BALL, _HINGE, _BALL] and model.body_parentid[upper] > 0:
            limbs.append(Limb(int(model.body_parentid[upper]), upper, lower, end))
    return tuple(limbs)


def _only_joint(model: mujoco.MjModel, body: int) -> int | None:
    return int(model.jnt_type[model.body_jntadr[body]]) if model.body_jntnum[body] == 1 else None


@dataclasses.dataclass(frozen=True, eq=False)
class LimbState:
    """Where the limbs are, (n, nlimb, …); all but ``base_quat`` and ``hip`` in the base's frame.

    Attributes:
      base_quat: (n, nlimb, 4) world orientation of the body each limb hangs from, or (n, 1, 4).
      hip: (n, nlimb, 3) world position of the hip [m].
      upper: (n, nlimb, 4) orientation of the upper segment.
      angle: (n, nlimb) knee angle from ``qpos0`` [rad].
      ankle: (n, nlimb, 3) hip to ankle [m].
      ankle_turn: (n, nlimb, 4) the ankle joint's own quaternion.
      end: (n, nlimb, 4) orientation of the end body.
    """

    base_quat: Array
    hip: Array
    upper: Array
    angle: Array
    ankle: Array
    ankle_turn: Array
    end: Array


class Limbs:
    """Some limbs of one model, solved together.

    Args:
      model: the MuJoCo model.
      limbs: which of :func:`find_limbs`.
      bones: how long they are, where that is not the model's own: one body for all frames, or one a
        frame, in the order of the poses that the methods are given.
    """

    def __init__(
        self, model: mujoco.MjModel, limbs: Sequence[Limb], bones: Bones | None = None
    ) -> None:
        self.model = model
        self.limbs = tuple(limbs)
        self.bones = Bones.of(model) if bones is None else bones
        body_pos, jnt_pos = self.bones.body_pos, self.bones.jnt_pos
        joints = [[model.body_jntadr[b] for b in (x.upper, x.lower, x.end)] for x in limbs]
        hip, knee, ankle = np.array(joints, dtype=np.int64).reshape(-1, 3).T
        self._qposadr = tuple(model.jnt_qposadr[joint] for joint in (hip, knee, ankle))
        # (nlimb, 7): hip 3, knee 1, ankle 3
        self.dofs = np.concatenate(
            (
                model.jnt_dofadr[hip][:, None] + np.arange(3),
                model.jnt_dofadr[knee][:, None],
                model.jnt_dofadr[ankle][:, None] + np.arange(3),
            ),
            axis=1,
        )
        upper = np.array([x.upper for x in limbs])
        lower = np.array([x.lower for x in limbs])
        end = np.array([x.end for x in limbs])
        self._hip_pos = body_pos[..., upper, :] + rotate(
            model.body_quat[upper], jnt_pos[..., hip, :]
        )
        self._upper0 = _unless_identity(model.body_quat[upper])
        self._end0 = _unless_identity(multiply(model.body_quat[lower], model.body_quat[end]))
        self.end_anchor = jnt_pos[..., ankle, :]
        self._axis = rotate(model.body_quat[lower], model.jnt_axis[knee])
        self._v1 = (
            body_pos[..., lower, :]
            + rotate(model.body_quat[lower], jnt_pos[..., knee, :])
            - jnt_pos[..., hip, :]
        )
        v2 = rotate(
            model.body_quat[lower],
            body_pos[..., end, :]
            + rotate(model.body_quat[end], jnt_pos[..., ankle, :])
            - jnt_pos[..., knee, :],
        )
        along1, along2 = dot(self._v1, self._axis), dot(v2, self._axis)
        flat1 = self._v1 - along1[..., None] * self._axis
        flat2 = v2 - along2[..., None] * self._axis
        # v2 turned by θ about the axis is fixed + cos θ flat + sin θ side
        self._fixed, self._flat, self._side = v2 - flat2, flat2, cross(self._axis, flat2)
        self._r1r2 = norm(flat1) * norm(flat2)
        self._constant = dot(self._v1, self._v1) + dot(v2, v2) + 2.0 * along1 * along2
        self._angle0 = np.arctan2(dot(self._axis, cross(flat1, flat2)), dot(flat1, flat2))
        self._knee_ref = model.qpos0[self._qposadr[1]]
        limited = model.jnt_limited[knee].astype(bool)
        low = np.where(limited, model.jnt_range[knee, 0] - self._knee_ref, -np.pi)
        high = np.where(limited, model.jnt_range[knee, 1] - self._knee_ref, np.pi)
        self._range = (low, high)
        # The way the knee bends: the side of its straight line on which its range mostly lies.
        self._way = np.where(np.sin(0.5 * (low + high) + self._angle0) < 0.0, -1.0, 1.0)

    def __len__(self) -> int:
        return len(self.limbs)

    @property
    def hip_pos(self) -> Array:
        """(nlimb, 3) or (n, nlimb, 3) the hips in their bases' frames [m]."""
        return self._hip_pos

    @property
    def reach(self) -> Array:
        """(…, nlimb) the longest hip–ankle distance that the knee's range allows [m]."""
        return self.distance(np.clip(-self._angle0, *self._range) + self._angle0)

    @property
    def fold(self) -> Array:
        """(…, nlimb) the shortest hip–ankle distance that the knee's range allows [m]."""
        low, high = (self.distance(bound + self._angle0) for bound in self._range)
        return np.minimum(low, high)

    def distance(self, bend: ArrayLike) -> Array:
        """Return the hip–ankle distances (…, nlimb) of knees bent so far from straight [rad]."""
        square = self._constant + 2.0 * self._r1r2 * np.cos(bend)
        return np.asarray(np.sqrt(np.maximum(square, 0.0)))

    def bases(self, qpos: Array) -> tuple[Array, Array]:
        """Return hips (n, nlimb, 3) [m] and base orientations in the world.

        The orientations are (n, nlimb, 4), or (n, 1, 4) where all limbs hang from one body.
        """
        bodies = list(dict.fromkeys(limb.base for limb in self.limbs))
        poses = {body: body_pose(self.model, qpos, body, self.bones) for body in bodies}
        carrying = bodies if len(bodies) == 1 else [limb.base for limb in self.limbs]
        position, quat = (
            np.stack([poses[body][part] for body in carrying], axis=1) for part in (0, 1)
        )
        return position + rotate(quat, self._hip_pos), quat

    def state(self, qpos: Array) -> LimbState:
        """Return where the limbs of poses (n, nq) are."""
        hip, base_quat = self.bases(qpos)
        hip_adr, knee_adr, ankle_adr = self._qposadr
        upper = qpos[:, hip_adr[:, None] + np.arange(4)]
        if self._upper0 is not None:
            upper = multiply(self._upper0, upper)
        angle = qpos[:, knee_adr] - self._knee_ref
        ankle_turn = qpos[:, ankle_adr[:, None] + np.arange(4)]
        bend, stretch = self._bend(angle)
        end = multiply(self._lower(upper, bend), ankle_turn)
        ankle = rotate(upper, stretch)
        return LimbState(base_quat, hip, upper, angle, ankle, ankle_turn, end)

    def _bend(self, angle: Array) -> tuple[Array, Array]:
        """Knee turns (n, nlimb, 4) and hip to ankle (n, nlimb, 3) in the upper's frame."""
        half = 0.5 * angle[..., None]
        sine = np.sin(half)
        bend = np.concatenate((np.cos(half), sine * self._axis), axis=-1)
        cosine = 1.0 - 2.0 * sine * sine
        stretch = self._v1 + self._fixed + cosine * self._flat + np.sin(2.0 * half) * self._side
        return bend, stretch

    def _lower(self, upper: Array, bend: Array) -> Array:
        """Orientation of the end body with its ankle at rest."""
        lower = multiply(upper, bend)
        return lower if self._end0 is None else multiply(lower, self._end0)

    def knee_angle(self, square: Array) -> Array:
        """Return the knee angles (n, nlimb) for squared hip–ankle distances, within range (Eq. 7).

        Where a target is out of reach the limb stretches, or folds, as far as it goes.
        """
        angle = self._way * bend_angle(square - self._constant, self._r1r2) - self._angle0
        return np.clip(np.mod(angle + np.pi, 2.0 * np.pi) - np.pi, *self._range)

    def goal(self, state: LimbState, position: Array, end_quat: Array, point: Array) -> Array:
        """Return hip to ankle (n, nlimb, 3), in the base's frame, that puts a point in its place.

        Args:
          state: where the limbs are; only the bases count.
          position: (n, nlimb, 3) where a point of the end body is to be, in the world [m].
          end_quat: (n, nlimb, 4) how the end body is to be turned, in the world.
          point: (nlimb, 3) the point in the end body's frame [m].
        """
        ankle = position - rotate(end_quat, point - self.end_anchor)
        return rotate(conjugate(state.base_quat), ankle - state.hip)

    def close(self, state: LimbState, goal: Array, end: Array) -> Array:
        """Return the displacement (n, nlimb, 7) that closes every limb.

        First the knee opens or bends until the ankle is as far from the hip as the goal (Eq. 7),
        then the hip turns the least that brings the ankle there, then the ankle turns the end. The
        knee keeps its side: the swivel about the hip–ankle line is what the least turn makes it.

        Args:
          state: where the limbs are.
          goal: (n, nlimb, 3) hip to ankle in the base's frame [m].
          end: (n, nlimb, 4) orientation of the end body in the base's frame.
        """
        angle = self.knee_angle(dot(goal, goal))
        bend, stretch = self._bend(angle)
        local = rotate(conjugate(state.upper), goal)
        turn = between(normalized(stretch), normalized(local))
        lower = self._lower(multiply(state.upper, turn), bend)
        ankle_turn = multiply(conjugate(lower), end)
        ankle = log(multiply(conjugate(state.ankle_turn), ankle_turn))
        return np.concatenate((log(turn), (angle - state.angle)[..., None], ankle), axis=-1)

    def ankle_turn(self, state: LimbState, displacement: Array) -> Array:
        """Return the ankles' own quaternions (n, nlimb, 4) after a displacement (n, nlimb, 7)."""
        return multiply(state.ankle_turn, exp(displacement[..., 4:]))

    def joint_angles(self, qpos: Array, displacement: Array) -> Array:
        """Return swing and twist of hips, knee angles, swing and twist of ankles (n, nlimb, 7).

        Args:
          qpos: (n, nq) poses.
          displacement: (n, nlimb, 7) what they are moved by.
        """
        hip_adr, knee_adr, ankle_adr = self._qposadr
        angles = np.empty(displacement.shape)
        angles[..., 3] = qpos[:, knee_adr] + displacement[..., 3]
        for address, columns in ((hip_adr, slice(0, 3)), (ankle_adr, slice(4, 7))):
            quat = multiply(
                qpos[:, address[:, None] + np.arange(4)], exp(displacement[..., columns])
            )
            angles[..., columns] = swing_twist(quat)
        return angles

    def closure(self, state: LimbState) -> tuple[Array, Array, Array]:
        """Return how a limb's joints follow when its base moves and its end stays.

        Returns:
          (n, nlimb, 7, 3) rates of the limb's degrees of freedom for a base that moves with unit
          velocity at the ankle, in the base's frame [1/m]; (n, nlimb, 3, 3) those of the ankle
          alone for a base that turns about it with unit velocity; and (n, nlimb, 7) the rates for
          one radian a second of swivel about the hip–ankle line.
        """
        length = np.maximum(norm(state.ankle), 1e-9)
        line = state.ankle / length[..., None]
        upper, end = to_matrix(state.upper), to_matrix(state.end)
        axis = (upper @ self._axis[..., None])[..., 0]
        push = cross(axis, state.ankle - (upper @ self._v1[..., None])[..., 0])
        lever = dot(push, line)
        lever = np.where(lever < 0.0, -1.0, 1.0) * np.maximum(np.abs(lever), _STRAIGHT)
        # Moving with velocity u asks the ankle for -u: the knee gives the part along the line ...
        knee = -line / lever[..., None]
        # ... and the hip the rest: ω = line × (-u - knee_rate push) / length.
        across = cross(line, push) / length[..., None]
        hip = _skew(-line / length[..., None]) - across[..., :, None] * knee[..., None, :]
        upper, end = np.swapaxes(upper, -1, -2), np.swapaxes(end, -1, -2)
        follow = np.empty((*length.shape, 7, 3))
        follow[..., :3, :] = upper @ hip
        follow[..., 3, :] = knee
        hip += axis[..., :, None] * knee[..., None, :]
        follow[..., 4:, :] = -(end @ hip)
        swivel = np.zeros((*length.shape, 7))
        swivel[..., :3] = (upper @ line[..., None])[..., 0]
        swivel[..., 4:] = -(end @ line[..., None])[..., 0]
        return follow, -end, swivel


def bend_angle(excess: Array, product: ArrayLike) -> Array:
    """Return how far two bones are bent, 0 in line [rad]; out of reach, as far as they go.

    Law of cosines: ``excess = 2 product cos(angle)``.

    Args:
      excess: (…) squared distance of the far ends, less the bones' squared lengths or what stands
        for them in Eq. 7 [m²].
      product: (…) product of the bones' lengths [m²].
    """
    cosine = excess / (2.0 * np.asarray(product))
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def two_bone_angles(first: float, second: float, distance: Array) -> tuple[Array, Array]:
    """Return the angles of the triangle of two bones and the line between their far ends.

    Args:
      first: length of a bone, such as a thigh [m].
      second: length of the next, such as a shank [m].
      distance: (…) of the far ends [m]; beyond reach it counts as the nearest within.

    Returns:
      (…) between the first bone and the line, and (…) how far the second is bent from the first,
      0 in line [rad].
    """
    distance = np.clip(distance, abs(first - second) + 1e-9, first + second)
    lean = np.pi - bend_angle(second**2 - (first**2 + distance**2), first * distance)
    return lean, bend_angle(distance**2 - first**2 - second**2, first * second)


def _unless_identity(quat: Array) -> Array | None:
    return None if np.allclose(quat, (1.0, 0.0, 0.0, 0.0), atol=1e-12) else quat


def _skew(vector: Array) -> Array:
    """Return the matrices (..., 3, 3) with skew(a) b = a × b."""
    skew = np.zeros((*vector.shape, 3))
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    skew[..., 0, 1], skew[..., 0, 2], skew[..., 1, 2] = -z, y, -x
    skew[..., 1, 0], skew[..., 2, 0], skew[..., 2, 1] = z, -y, x
    return skew
