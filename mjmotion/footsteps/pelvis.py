"""The root's way over new ground: one smooth curve between what legs reach and what ankles bend.

Over the plane the root follows its feet. Its height is the least-squares curve near the feet's mean
shift that is smooth in its third differences, not above what standing legs reach, and not so low
that a heel would have to leave the ground because its ankle can bend no further. A heel that leaves
early is a price, not a wall, and lower than that of a leg that would not reach; a swinging leg's is
lower still, and in flight nothing is asked.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.feet import Foot
from mjmotion.body.joint_limits import swing_twist
from mjmotion.body.kinematics import Pose, site_id
from mjmotion.body.limbs import Limb
from mjmotion.body.motion import Motion
from mjmotion.body.reach import drop_to_reach
from mjmotion.fitting import default_levels
from mjmotion.footsteps.contacts import Contact, contact_mask
from mjmotion.footsteps.paths import FootPath
from mjmotion.footsteps.swings import LIFT_PULL, frames_to
from mjmotion.numerics.bspline import fit_multilevel
from mjmotion.numerics.rotations import conjugate, exp, multiply, rotate
from mjmotion.numerics.smoothing import Bound, between, envelope

Array = NDArray[np.float64]

REACH_FREE = 0.97  # share of a leg's length that a root path may always ask for
REACH_MOST = 0.995  # the most it may ask for, where the source did
LEAST_HEIGHT = 0.5  # of a leg's length that a hip keeps over its ankle, however far that is
DROP_TIME = 0.3  # how far on either side it is felt that a leg would not reach [s]
HEIGHT_TIME = 0.22  # τ of the root's height [s]
PLANE_TIME = 0.3  # τ of its way over the plane, which only follows the feet [s]
ANKLE_SPARE = 0.08  # how far within its range an ankle is planned [rad]
# Prices of being out of a bound, against being off the feet's mean shift.
STANDING, ROLLING, HEEL, SWINGING = 40000.0, 50.0, 200.0, 3.0
# How much further than in the source a foot may roll on its toe, a rigid one and one whose toes
# bend: over its ball it rises less for the same turn [rad].
MOST_TIP = (0.3, 0.5)
NEAR_TIME = 0.06  # scale in which a swinging foot is lifted nearer to the hip [s]
_ROLLS = 2  # times that the roll of a shank is found
STEEPEST_TOE = (1.1, 1.3)  # how steep either may stand on its toe for that [rad]
TIP_PULL = 60.0  # angular acceleration with which it can begin to [rad/s²]
TIP_TIME = 0.08  # scale of the rise and fall of that [s]


def root_shift(
    source: Motion,
    pose: Pose,
    paths: Sequence[FootPath],
    contacts: Sequence[Contact],
    rolling: float = STANDING,
) -> Array:
    """Return how far the root is to be moved (nframe, 3) [m]: the first guess of §4.5.

    Args:
      source: the motion.
      pose: its poses.
      paths: where its feet are to be.
      contacts: who stands when.
      rolling: price of being out of reach of a foot that stands on its toe alone.
    """
    mean = np.mean([path.shift for path in paths], axis=0)
    shift = np.zeros_like(mean)
    for axis in (0, 1):
        shift[:, axis] = between(mean[:, axis], PLANE_TIME * source.fps)
    legs = [leg for path in paths if (leg := _Leg.of(source, pose, path, contacts, shift))]
    shift[:, 2] = between(
        mean[:, 2],
        HEIGHT_TIME * source.fps,
        [bound for leg in legs for bound in leg.bounds(rolling)],
    )
    return shift


def mean_shift(source: Motion, paths: Sequence[FootPath]) -> Array:
    """Return the feet's mean shift (nframe, 3) [m], fitted with the coarse knots alone (§4.5)."""
    mean = np.mean([path.shift for path in paths], axis=0)
    levels = default_levels(source.fps)
    return fit_multilevel(np.arange(source.nframe), mean, source.nframe, levels[:-1])


def push_offs(
    source: Motion,
    pose: Pose,
    paths: Sequence[FootPath],
    contacts: Sequence[Contact],
    shift: Array,
) -> list[Array]:
    """Return how much further feet roll on to their toes (nframe,) [rad], one a foot.

    Someone who steps up pushes off with the toe of the lower foot, where the root is too high for
    it to stay as it is.
    """
    legs = [_Leg.of(source, pose, path, contacts, shift) for path in paths]
    none = np.zeros(source.nframe)
    return [
        none if leg is None else leg.push_off(path, shift)
        for leg, path in zip(legs, paths, strict=True)
    ]


def within_reach(
    source: Motion,
    pose: Pose,
    paths: Sequence[FootPath],
    contacts: Sequence[Contact],
    shift: Array,
) -> tuple[FootPath, ...]:
    """Return paths whose swings are nowhere further from the hip than the leg is long.

    A foot in the air asks nothing of the root: it is lifted, and the hip goes its way.
    """
    near = []
    for path in paths:
        leg = _Leg.of(source, pose, path, contacts, shift)
        near.append(path if leg is None else leg.within_reach(path, shift))
    return tuple(near)


@dataclasses.dataclass(frozen=True, eq=False)
class _Leg:
    """One leg at every frame: where its hip is if the root only follows in the plane, its ankle.

    Attributes:
      source: the motion.
      limb: the leg.
      foot: its foot.
      hip: (nframe, 3) [m].
      ankle: (nframe, 3) where it is to be [m].
      turn: (nframe, 4) how the end body is to be turned.
      most: (nframe,) the most that hip and ankle may be apart [m].
      stance, heel: (nframe,) when the foot stands, and its heel.
    """

    source: Motion
    limb: Limb
    foot: Foot
    hip: Array
    ankle: Array
    turn: Array
    most: Array
    stance: NDArray[np.bool_]
    heel: NDArray[np.bool_]

    @classmethod
    def of(
        cls,
        source: Motion,
        pose: Pose,
        path: FootPath,
        contacts: Sequence[Contact],
        shift: Array,
    ) -> _Leg | None:
        """Return the leg of a path; None where its site is on no limb's end."""
        model = source.model
        site = site_id(model, path.site)
        limb = source.character.limb_by_end.get(int(model.site_bodyid[site]))
        if limb is None:
            return None
        (foot,) = (foot for foot in source.character.feet if foot.site == path.site)
        hip = pose.xanchor[:, model.body_jntadr[limb.upper]]
        long = float(source.character.chains((limb,)).reach[0])
        was = np.linalg.norm(hip - pose.xanchor[:, model.body_jntadr[limb.end]], axis=1)
        local = model.jnt_pos[model.body_jntadr[limb.end]] - model.site_pos[site]
        turn = multiply(path.quat, conjugate(model.site_quat[site]))
        return cls(
            source,
            limb,
            foot,
            hip + shift * (1.0, 1.0, 0.0),
            path.position + rotate(turn, np.broadcast_to(local, path.position.shape)),
            turn,
            np.clip(was, REACH_FREE * long, REACH_MOST * long),
            path.stance,
            contact_mask(contacts, f"{foot.side}_heel", source.nframe),
        )

    def bounds(self, rolling: float) -> list[Bound]:
        """Return what the leg asks of the root's shift upwards: bounds above, and one below."""
        least = LEAST_HEIGHT * float(self.source.character.chains((self.limb,)).reach[0])
        reach = -drop_to_reach(self.hip, self.ankle, self.most, least)
        bounds = [
            Bound(reach, self.heel, STANDING, upper=True),
            Bound(reach, self.stance & ~self.heel, rolling, upper=True),
            Bound(reach, ~self.stance, SWINGING, upper=True),
        ]
        lowest = self._lowest_hip()
        if lowest is not None:
            bounds.append(Bound(lowest - self.hip[:, 2], self.heel, HEEL, upper=False))
        return bounds

    def _lowest_hip(self) -> Array | None:
        """Height (nframe,) under which a hip bends the ankle of a flat foot out of its range [m].

        With the shank as far forwards as the ankle lets it, the knee is known, and so is how high
        above its place in the plane a hip is that is a thigh's length away from it.
        """
        model, limb = self.source.model, self.limb
        joint = int(model.body_jntadr[limb.end])
        box = self.source.character.limits.boxes.get(joint)
        if box is None:
            return None
        knee = model.jnt_pos[model.body_jntadr[limb.lower]]
        shank = knee - model.body_pos[limb.end] - model.jnt_pos[joint]
        thigh = model.body_pos[limb.lower] + knee - model.jnt_pos[model.body_jntadr[limb.upper]]
        # A margin within its range, or as far as the source bends it.
        first = int(model.jnt_qposadr[joint])
        own = -swing_twist(self.source.qpos[:, first : first + 4])[:, 1]
        pitch = np.zeros((len(own), 3))
        pitch[:, 1] = np.clip(own, -box[1, 0] - ANKLE_SPARE, -box[1, 0])
        forward = rotate(exp(pitch), shank)
        long, hip = float(thigh @ thigh), self.hip
        for _ in range(_ROLLS):
            # A leg that is off to a side takes its shank along.
            off = rotate(conjugate(self.turn), hip - self.ankle)
            roll = np.zeros_like(off)
            roll[:, 0] = np.arctan2(-off[:, 1], np.maximum(off[:, 2], 1e-9))
            at = self.ankle + rotate(self.turn, rotate(exp(roll), forward))
            rest = long - ((hip - at)[:, :2] ** 2).sum(axis=1)
            height = at[:, 2] + np.sqrt(np.maximum(rest, 0.0))
            hip = np.concatenate((hip[:, :2], height[:, None]), axis=1)
        return np.where(rest > 0.0, height, -np.inf)

    def push_off(self, path: FootPath, shift: Array) -> Array:
        """Return the turn (nframe,) about the toe that brings the ankle in reach [rad]."""
        toe = path.position + rotate(path.quat, np.broadcast_to(self.foot.toe, self.hip.shape))
        hip = self.hip + shift * (0.0, 0.0, 1.0) - toe
        arm = self.ankle - toe
        far, lever = np.linalg.norm(hip, axis=1), np.linalg.norm(arm, axis=1)
        # The angle at the toe between ankle and hip: as it is, and as the leg's reach lets it be.
        lengths = np.maximum(far * lever, 1e-9)
        angle = np.arccos(np.clip((hip * arm).sum(axis=1) / lengths, -1.0, 1.0))
        square = far**2 + lever**2 - self.most**2
        near = np.arccos(np.clip(0.5 * square / lengths, -1.0, 1.0))
        rolls, bends = self.stance & ~self.heel, int(self.foot.toes is not None)
        # A foot cannot be on its toe at once: how long its heel may have risen bounds a tip.
        apart = frames_to(self.heel) / self.source.fps
        most = np.minimum(0.5 * TIP_PULL * apart**2, MOST_TIP[bends])
        pitch = np.arcsin(np.clip(-rotate(path.quat, np.eye(3)[0])[:, 2], -1.0, 1.0))
        most = np.minimum(most, np.maximum(STEEPEST_TOE[bends] - pitch, 0.0))
        need = np.where(rolls, np.minimum(angle - near, most), 0.0)
        return envelope(need, self.heel, TIP_TIME * self.source.fps)

    def within_reach(self, path: FootPath, shift: Array) -> FootPath:
        """Return the path with its swings lifted to where the leg reaches them."""
        least = LEAST_HEIGHT * float(self.source.character.chains((self.limb,)).reach[0])
        hip = self.hip + shift * (0.0, 0.0, 1.0)
        apart = frames_to(self.stance) / self.source.fps
        lack = drop_to_reach(hip, self.ankle, self.most, least)
        need = np.where(self.stance, 0.0, np.minimum(lack, 0.5 * LIFT_PULL * apart**2))
        if need.max(initial=0.0) <= 0.0:
            return path
        lift = envelope(need, self.stance, NEAR_TIME * self.source.fps)
        move = lift[:, None] * np.array((0.0, 0.0, 1.0))
        return dataclasses.replace(path, position=path.position + move, lift=path.lift + lift)
