"""The root's way over new ground: one smooth curve between what legs reach and what ankles bend.

Over the plane the root follows its feet, and stays back a little where uphill an ankle would bend
too far: with the hips further back the shank is more upright. Its height is the least-squares curve
near the feet's mean shift that is smooth in its third differences, not above what standing legs
reach, and not so low that a heel would have to leave the ground because its ankle can bend no
further. A heel that leaves early is a price, not a wall, and lower than that of a leg that would
not reach; a swinging leg's is lower still, and in flight nothing is asked.
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
REACH_MOST = 0.9995  # the most it may ask for, where the source did
LEAST_HEIGHT = 0.5  # of a leg's length that a hip keeps over its ankle, however far that is
DROP_TIME = 0.3  # how far on either side it is felt that a leg would not reach [s]
HEIGHT_TIME = 0.3  # τ of the root's height [s]
PLANE_TIME = 0.3  # τ of its way over the plane, which only follows the feet [s]
ANKLE_SPARE = 0.08  # how far within its range an ankle is planned [rad]
# Prices of being out of a bound, against being off the feet's mean shift.
STANDING, ROLLING, HEEL, SWINGING = 40000.0, 50.0, 300.0, 3.0
FOLDING = 30.0  # price of a hip so near to a swinging foot that its knee folds further than that
FOLDED = 0.5  # of a leg's length that hip and ankle keep apart in a swing, or as in the source
MOST_BACK = 0.15  # the most that hips stay back for an ankle [m]
BACK = 50.0  # price of staying back less than that
UPHILL = 0.05  # a foot that is pitched up by less than that does not stand uphill
BACK_TIME = 0.45  # τ of staying back [s]
KNEE = 200.0  # price of a hip that is lower than that
KNEE_MORE = 0.07  # how much more than in the source a knee is bent on the level [rad]
LEVEL_TIME = 0.2  # for how long to either side ground is to be level for that [s]
LEVEL = 0.01  # ground whose heights differ by less than that is level [m]
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
) -> tuple[Array, Array]:
    """Return how far the root is to be moved (nframe, 3) [m], and how far of that it stays back.

    The first is the first guess of §4.5; the second (nframe,) is 0 but where it climbs [m].

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
    follow = mean[:, 2], rolling
    shift[:, 2], legs = _height(source, pose, paths, contacts, shift, follow)
    # Where some ankle still lacks, hips that stay back let its shank be more upright.
    ahead = _ahead(source)
    needs = [leg.staying_back(shift[:, 2], ahead) for leg in legs]
    bounds = [Bound(need, need > 0.0, BACK, upper=False) for need in needs if need.any()]
    back = np.zeros(source.nframe)
    if bounds:
        back = np.maximum(between(back, BACK_TIME * source.fps, bounds), 0.0)
        shift -= back[:, None] * ahead
        shift[:, 2], _ = _height(source, pose, paths, contacts, shift, follow)
    return shift, back


def _height(
    source: Motion,
    pose: Pose,
    paths: Sequence[FootPath],
    contacts: Sequence[Contact],
    shift: Array,
    follow: tuple[Array, float],
) -> tuple[Array, list[_Leg]]:
    """Return the height (nframe,) of the root's shift [m], and the legs where it is so far.

    ``follow`` is the feet's mean shift upwards (nframe,), and the price of rolling feet.
    """
    mean, rolling = follow
    level = _level(paths, source.fps)
    legs = [leg for path in paths if (leg := _Leg.of(source, pose, path, contacts, shift, level))]
    bounds = [bound for leg in legs for bound in leg.bounds(rolling)]
    return between(mean, HEIGHT_TIME * source.fps, bounds), legs


def _level(paths: Sequence[FootPath], fps: float) -> NDArray[np.bool_]:
    """Return when all feet that stand around a frame stand on one level (nframe,)."""
    from scipy.ndimage import maximum_filter1d

    height = np.array([path.shift[:, 2] for path in paths])
    stance = np.array([path.stance for path in paths])
    around = 2 * round(LEVEL_TIME * fps) + 1
    high = maximum_filter1d(np.where(stance, height, -np.inf).max(axis=0), around)
    low = -maximum_filter1d(np.where(stance, -height, -np.inf).max(axis=0), around)
    return np.asarray(high - low < LEVEL)


def _ahead(source: Motion) -> Array:
    """Return the way that the root faces, level and of unit length (nframe, 3)."""
    quat = source.qpos[:, 3:7]
    ahead = rotate(quat, np.broadcast_to(np.eye(3)[0], (len(quat), 3))) * (1.0, 1.0, 0.0)
    return np.asarray(ahead / np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9))


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
    """Return paths whose swings are no further from the hip than the leg is long, nor nearer.

    A foot in the air asks next to nothing of the root: it comes nearer, or stays away as far as a
    knee folds, and the hip goes its way.
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
      was: (nframe,) how far hip and ankle are apart in the source [m].
      most: (nframe,) the most that they may be [m].
      level: (nframe,) when the feet that stand are on one level.
      stance, heel: (nframe,) when the foot stands, and its heel.
    """

    source: Motion
    limb: Limb
    foot: Foot
    hip: Array
    ankle: Array
    turn: Array
    was: Array
    most: Array
    level: NDArray[np.bool_]
    stance: NDArray[np.bool_]
    heel: NDArray[np.bool_]

    @property
    def long(self) -> float:
        """How long it is [m]."""
        return float(self.source.character.chains((self.limb,)).reach[0])

    @classmethod
    def of(
        cls,
        source: Motion,
        pose: Pose,
        path: FootPath,
        contacts: Sequence[Contact],
        shift: Array,
        level: NDArray[np.bool_] | None = None,
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
            was,
            np.clip(was, REACH_FREE * long, REACH_MOST * long),
            np.zeros(source.nframe, dtype=bool) if level is None else level,
            path.stance,
            contact_mask(contacts, f"{foot.side}_heel", source.nframe),
        )

    def bounds(self, rolling: float) -> list[Bound]:
        """Return what the leg asks of the root's shift upwards: bounds above, and one below."""
        least = LEAST_HEIGHT * self.long
        reach = -drop_to_reach(self.hip, self.ankle, self.most, least)
        bounds = [
            Bound(reach, self.heel, STANDING, upper=True),
            Bound(reach, self.stance & ~self.heel, rolling, upper=True),
            Bound(reach, ~self.stance, SWINGING, upper=True),
        ]
        folded = -drop_to_reach(self.hip, self.ankle, self._folded())
        bounds.append(Bound(folded, ~self.stance, FOLDING, upper=False))
        straight = -drop_to_reach(self.hip, self.ankle, self._least_apart())
        bounds.append(Bound(straight, self.stance & self.level, KNEE, upper=False))
        bent = self._bent_knee()
        if bent is not None:
            knee, thigh = bent
            rest = thigh**2 - ((self.hip - knee)[:, :2] ** 2).sum(axis=1)
            lowest = knee[:, 2] + np.sqrt(np.maximum(rest, 0.0)) - self.hip[:, 2]
            bounds.append(Bound(lowest, self.heel & (rest > 0.0), HEEL, upper=False))
        return bounds

    def staying_back(self, height: Array, ahead: Array) -> Array:
        """Return how far back (nframe,) the hip must be for its ankle to let the heel stand [m].

        A hip nearer than a thigh's length to the knee of an ankle that is bent as far as it goes
        would push that knee further forwards. Back by d along ``ahead`` a it is a length away:
        ``|h − d a − k| = thigh``.

        Args:
          height: (nframe,) the root's shift upwards [m].
          ahead: (nframe, 3) the way that the root faces, level.
        """
        bent = self._bent_knee()
        if bent is None:
            return np.zeros(len(height))
        knee, thigh = bent
        way = self.hip + height[:, None] * (0.0, 0.0, 1.0) - knee
        along, lacking = (way * ahead).sum(axis=1), thigh**2 - (way**2).sum(axis=1)
        back = along + np.sqrt(np.maximum(along**2 + lacking, 0.0))
        # On the level the source stands so itself.
        up = rotate(self.turn, np.array((0.0, 0.0, 1.0)))
        uphill = (up * ahead).sum(axis=1) < -UPHILL
        needs = self.heel & uphill & (lacking > 0.0)
        return np.where(needs, np.clip(back, 0.0, MOST_BACK), 0.0)

    def _folded(self) -> Array:
        """How near hip and ankle may come in a swing (nframe,) [m]."""
        return np.minimum(self.was, FOLDED * self.long)

    def _least_apart(self) -> Array:
        """How near hip and ankle may come (nframe,) with a knee bent little more than before [m].

        ``d² = a² + b² + 2 a b cos φ`` of thigh a, shank b and the bend φ between them.
        """
        a, b = (float(np.linalg.norm(bone)) for bone in self._bones())
        cosine = np.clip((self.was**2 - a * a - b * b) / (2.0 * a * b), -1.0, 1.0)
        bend = np.minimum(np.arccos(cosine) + KNEE_MORE, np.pi)
        return np.sqrt(a * a + b * b + 2.0 * a * b * np.cos(bend))

    def _bones(self) -> tuple[Array, Array]:
        """Thigh, from hip to knee, and shank, from ankle to knee, at rest (3,) [m]."""
        model, limb = self.source.model, self.limb
        knee = model.jnt_pos[model.body_jntadr[limb.lower]]
        end = model.body_pos[limb.end] + model.jnt_pos[model.body_jntadr[limb.end]]
        hip = model.jnt_pos[model.body_jntadr[limb.upper]]
        return model.body_pos[limb.lower] + knee - hip, knee - end

    def _bent_knee(self) -> tuple[Array, float] | None:
        """Where a standing foot's knee is with its ankle bent as far as it goes, and the thigh.

        Returns:
          (nframe, 3) and a length [m]; None where the ankle has no such range. With the shank as
          far forwards as the ankle lets it, no hip may be nearer than the thigh is long.
        """
        model, limb = self.source.model, self.limb
        joint = int(model.body_jntadr[limb.end])
        box = self.source.character.limits.boxes.get(joint)
        if box is None:
            return None
        upper, shank = self._bones()
        # A margin within its range, or as far as the source bends it.
        first = int(model.jnt_qposadr[joint])
        own = -swing_twist(self.source.qpos[:, first : first + 4])[:, 1]
        pitch = np.zeros((len(own), 3))
        pitch[:, 1] = np.clip(own, -box[1, 0] - ANKLE_SPARE, -box[1, 0])
        forward = rotate(exp(pitch), shank)
        thigh, hip = float(np.linalg.norm(upper)), self.hip
        for _ in range(_ROLLS):
            # A leg that is off to a side takes its shank along.
            off = rotate(conjugate(self.turn), hip - self.ankle)
            roll = np.zeros_like(off)
            roll[:, 0] = np.arctan2(-off[:, 1], np.maximum(off[:, 2], 1e-9))
            at = self.ankle + rotate(self.turn, rotate(exp(roll), forward))
            rest = thigh**2 - ((hip - at)[:, :2] ** 2).sum(axis=1)
            height = at[:, 2] + np.sqrt(np.maximum(rest, 0.0))
            hip = np.concatenate((hip[:, :2], height[:, None]), axis=1)
        return at, thigh

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
        """Return the path with its swings brought to where the leg reaches them, and folds to."""
        away = self.ankle - self.hip - shift * (0.0, 0.0, 1.0)
        far = np.linalg.norm(away, axis=1)
        apart = frames_to(self.stance) / self.source.fps
        most = np.where(self.stance, 0.0, 0.5 * LIFT_PULL * apart**2)
        move = np.zeros(len(far))
        for sign, lack in ((-1.0, far - self.most), (1.0, self._folded() - far)):
            need = np.minimum(lack, most)
            if need.max(initial=0.0) > 0.0:
                move += sign * envelope(need, self.stance, NEAR_TIME * self.source.fps)
        if not move.any():
            return path
        moved = (move / np.maximum(far, 1e-9))[:, None] * away
        return dataclasses.replace(
            path, position=path.position + moved, lift=path.lift + moved[:, 2]
        )
