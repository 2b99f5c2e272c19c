"""Feet of a clip on the humanoid: soles level in stance, pinned to the ground, within reach.

The humanoid's foot has other lengths than the recorded one, and a sole. A foot that only copied the
recording would float, or push into the ground at every heel-off. So each stance gets a pose of its
own: level while the recorded foot is flat, then turning about its ball as high as the recorded
ankle rises, and before it turning about the heel. The differences from the recorded pose are
carried smoothly through the swings. The toes lie on the ground while the ball stands, and bend as
recorded else.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.feet import Toes
from mjmotion.body.reach import drop_to_reach
from mjmotion.clips.dimensions import HumanoidDimensions
from mjmotion.clips.floor import EVEN, Floor
from mjmotion.clips.foot_turns import flat_stays, foot_yaw, stance_yaw, turns_on_heel
from mjmotion.clips.recorded_feet import STILL, RecordedFoot, RecordedStance
from mjmotion.clips.rig import SIDES
from mjmotion.clips.upright import UP, speed_of
from mjmotion.numerics import rotations as rot
from mjmotion.numerics.smoothing import cover, envelope

Array = rot.Array

_REACH = 0.9985  # of the leg's length: a knee is never straighter than 6 degrees
_RISING = 0.05  # [rad] a foot pitched further has its heel off the ground
_HEEL_DOWN = 0.04  # [m] a heel that is no higher, before flat stance, has struck
_STEEPEST = 0.95  # height of the ankle over the ball, of the most that it can be, that tells pitch
_TIPPED = 1.0  # the same of a recorded foot whose ball still stands
_CLEAR = 0.004  # [m] how deep a sole may graze the ground in a swing
_GIVE = 0.03  # [s] how far on either side it is felt that toes keep out of the ground
_SHARP, _SOFT = 10.0, 1e-2  # [Hz] what corrections follow in contact; weight of none in swing


def plant_feet(
    root: Array,
    pelvis: Array,
    feet: Sequence[RecordedFoot],
    stances: Sequence[Sequence[RecordedStance]],
    humanoid: HumanoidDimensions,
    floor: Floor,
    fps: float,
) -> tuple[Array, list[RecordedFoot]]:
    """Put the soles on the ground at z = 0 and the ankles within reach.

    Args:
      root: (nframe, 3) positions of the pelvis [m].
      pelvis: (nframe, 4) its orientations.
      feet: the left and the right foot.
      stances: of each of them, as recorded.
      humanoid: lengths and places of its parts.
      floor: the ground under the recording.
      fps: frames a second.

    Returns:
      The moved root and feet.
    """
    root = root - floor.under(root)[:, None] * UP
    pinned = []
    for side, foot, group in zip(SIDES, feet, stances, strict=True):
        under = floor.under(foot.ankle)
        low = [stance.lowered(under) for stance in group]
        if not floor.uneven:
            low = [_on_flat_ground(stance) for stance in low]
        heel, toe = humanoid.site(f"{side}_heel"), humanoid.site(f"{side}_toe")
        pinned.append(_pin(foot.lowered(under), low, heel, toe, fps))
    drop = np.zeros(len(root))
    for at, side in enumerate(SIDES):
        hip = root + rot.rotate(pelvis, humanoid.hips[side])
        toe = humanoid.site(f"{side}_toe")
        # A leg that trails behind raises its heel further; only then does the pelvis come down.
        for _ in range(4):
            lack = drop_to_reach(hip, pinned[at].ankle, _REACH * humanoid.leg)
            rising = rot.rotate(pinned[at].quat, toe)[:, 2] < toe[2] - _RISING * toe[0]
            lack = np.where(rising, np.maximum(lack, 0.0), 0.0)
            if lack.max() < 1e-3:
                break
            pinned[at] = pinned[at].tipped(cover(lack, 0.12 * fps) / toe[0], toe)
        drop = np.maximum(drop, drop_to_reach(hip, pinned[at].ankle, _REACH * humanoid.leg))
    return root - cover(drop, 0.4 * fps)[:, None] * UP, pinned


def _on_flat_ground(stance: RecordedStance) -> RecordedStance:
    """Return a stance on flat ground; one that seems higher is on its toes, one askew is level."""
    if abs(stance.height) < EVEN / 2 and stance.level:
        return stance
    return dataclasses.replace(stance, flat=stance.flat[:0], level=True, height=0.0)


@dataclasses.dataclass(frozen=True, eq=False)
class _StanceGoals:
    """What the stances ask of a foot in each frame; filled stance by stance, in place.

    Attributes:
      quat: (nframe, 4) orientation of the foot body.
      turned: (nframe,) weight of that orientation, 1 or 0.
      contact: (nframe, 3) the point that stands, in the foot body [m].
      position: (nframe, 3) where it stands [m].
      fixed: (nframe,) weight of that position, 1 or 0.
    """

    quat: Array
    turned: Array
    contact: Array
    position: Array
    fixed: Array

    @classmethod
    def none(cls, foot: RecordedFoot) -> _StanceGoals:
        """Return goals that ask nothing: the foot as recorded, no weights."""
        n = len(foot.ankle)
        zeros = np.zeros
        return cls(np.array(foot.quat), zeros(n), zeros((n, 3)), zeros((n, 3)), zeros(n))

    def fix(self, frames: NDArray[np.int64], contact: Array, position: Array) -> None:
        """Ask for a point of the foot body to be at a position (3,) [m] in some frames."""
        self.contact[frames], self.position[frames], self.fixed[frames] = contact, position, 1.0

    def turn(self, frames: NDArray[np.int64], quat: Array) -> None:
        """Ask for orientations (n, 4) in some frames."""
        self.quat[frames], self.turned[frames] = quat, 1.0


def _pin(
    foot: RecordedFoot, stances: Sequence[RecordedStance], heel: Array, toe: Array, fps: float
) -> RecordedFoot:
    """Return the foot with its soles level and its contact points fixed in every stance."""
    goals, points = _StanceGoals.none(foot), foot_yaw(foot)
    for stance in stances:
        if not stance.level:
            goals.fix(stance.flat, np.zeros(3), foot.ankle[stance.flat].mean(axis=0))
            continue
        if turns_on_heel(foot, stance):
            _turn_on_heel(goals, foot, stance, points, heel, fps)
            continue
        tip = _roll_over_toe(goals, foot, stance, points, toe, fps)
        if len(stance.flat):
            landed = goals.quat[stance.flat[0]]
            back = tip + rot.rotate(landed, heel - toe)
            struck = _roll_over_heel(goals, foot, stance, heel, back, fps)
            # A foot that slaps down may swing through: on its heel its toe is not under the ground.
            deep = rot.rotate(foot.quat[struck], toe - heel)[:, 2] < (toe - heel)[2]
            level = points[struck] + _yaw_of(landed) - points[stance.flat[0]]
            goals.turn(struck[deep], rot.yaw_quat(level[deep]))
    change = rot.log(rot.multiply(goals.quat, rot.conjugate(foot.quat)))
    quat = rot.multiply(rot.exp(smooth_correction(change, goals.turned, fps)), foot.quat)
    standing = (goals.fixed > 0) & (goals.contact == toe).all(axis=1)
    foot = dataclasses.replace(foot, quat=quat, standing=standing)
    return _fix_contacts(foot, goals, heel, toe, fps)


def _yaw_of(quat: Array) -> float:
    """Return the yaw [rad] of a turn (4,) about the vertical."""
    return float(2.0 * np.arctan2(quat[3], quat[0]))


def _roll_over_toe(
    goals: _StanceGoals,
    foot: RecordedFoot,
    stance: RecordedStance,
    points: Array,
    toe: Array,
    fps: float,
) -> Array:
    """Level the foot in flat stance, else turn it about its ball: heel up, and as it points.

    Args:
      goals: what is filled in.
      foot: the foot.
      stance: one of its stances.
      points: (nframe,) which way the recorded foot points [rad].
      toe: (3,) its ball in the foot body [m].
      fps: frames a second.

    Returns:
      Where the ball stands (3,) [m].
    """
    frames = np.arange(stance.start, stance.end)
    # The foot turns about its ball as far as brings the ankle to its height.
    radius, flat_angle = np.hypot(toe[0], toe[2]), np.arctan2(-toe[2], toe[0])
    sine = (foot.ankle[frames, 2] - stance.height) / radius
    pitch = np.maximum(np.arcsin(np.clip(sine, -1, 1)) - flat_angle, 0.0)
    pitch = _over_upright(pitch, sine < _STEEPEST, foot.quat[frames])
    flat = stance.flat
    for stay in flat_stays(stance, fps):
        pitch[stay - stance.start] = 0.0
    if len(flat) == 0:
        flat = frames[[int(np.argmin(sine))]]
    yaw = rot.yaw_quat(stance_yaw(points, stance, frames, fps))
    zero = np.zeros(len(frames))
    tilt = np.stack([np.cos(pitch / 2), zero, np.sin(pitch / 2), zero], axis=-1)
    quat = rot.multiply(yaw, tilt)
    tip = (foot.ankle[flat] + rot.rotate(quat[flat - stance.start], toe)).mean(axis=0)
    tip[2] = 0.0 if abs(stance.height) < EVEN / 2 else stance.height
    # Straight over its ball a foot can rise no more; the ball leaves the ground before.
    use = sine < _TIPPED
    if len(stance.flat):
        use &= frames >= flat[0]
    goals.turn(frames[use], quat[use])
    goals.fix(frames[use], toe, tip)
    return tip


def _over_upright(pitch: Array, told: NDArray[np.bool_], quat: Array) -> Array:
    """Return pitches (n,) [rad] of a foot on its ball that are right where it is upright too.

    There the ankle's height tells little of pitch, and not to which side of upright: the foot is
    pitched as recorded, and off that by as much as where its height tells it last and next.

    Args:
      pitch: (n,) from its height [rad].
      told: (n,) where that holds.
      quat: (n, 4) the recorded foot.
    """
    ahead, up = (rot.rotate(quat, axis)[:, 2] for axis in (np.array((1.0, 0.0, 0.0)), UP))
    own = np.arctan2(-ahead, up)
    known = np.flatnonzero(told)
    if len(known) == 0:
        return np.maximum(own, 0.0)
    off = np.interp(np.flatnonzero(~told), known, (pitch - own)[known])
    pitch = np.array(pitch)
    pitch[~told] = np.maximum(own[~told] + off, 0.0)
    return pitch


def _turn_on_heel(
    goals: _StanceGoals,
    foot: RecordedFoot,
    stance: RecordedStance,
    points: Array,
    heel: Array,
    fps: float,
) -> None:
    """Hold the heel of a foot that turns on it, level; arguments as of :func:`_roll_over_toe`."""
    frames = np.arange(stance.start, stance.end)
    quat = rot.yaw_quat(stance_yaw(points, stance, frames, fps))
    place = (foot.ankle[frames] + rot.rotate(quat, heel)).mean(axis=0)
    place[2] = 0.0 if abs(stance.height) < EVEN / 2 else stance.height
    goals.turn(frames, quat)
    goals.fix(frames, heel, place)


def _roll_over_heel(
    goals: _StanceGoals,
    foot: RecordedFoot,
    stance: RecordedStance,
    heel: Array,
    position: Array,
    fps: float,
) -> NDArray[np.int64]:
    """Fix the heel at its ``position`` (3,) [m] from where it has struck up to flat stance.

    Returns:
      (n,) the frames of that.
    """
    recorded = foot.point(heel)
    struck = recorded[:, 2] - stance.height < _HEEL_DOWN
    struck &= speed_of(recorded, fps) < 3 * STILL
    first = int(stance.flat[0])
    while first > 0 and struck[first - 1] and goals.fixed[first - 1] == 0:
        first -= 1
    frames = np.arange(first, stance.flat[0])
    goals.fix(frames, heel, position)
    return frames


def _fix_contacts(
    foot: RecordedFoot, goals: _StanceGoals, heel: Array, toe: Array, fps: float
) -> RecordedFoot:
    """Return the turned foot moved so that its contact points stand and swings clear the ground."""
    shift, fixed = goals.position - foot.point(goals.contact), goals.fixed
    moved = smooth_correction(shift, fixed, fps)
    lowest = np.minimum(foot.point(heel)[:, 2], foot.point(toe)[:, 2])
    # In the swing nothing holds the sole up: lift it where it would cut through the ground.
    for _ in range(4):
        low = lowest + moved[:, 2]
        deep = (low < -_CLEAR) & (fixed == 0)
        if not deep.any():
            break
        shift[deep, 2] = moved[deep, 2] + _CLEAR / 2 - low[deep]
        fixed = np.maximum(fixed, deep)
        moved[:, 2] = smooth_correction(shift[:, 2:], fixed, fps)[:, 0]
    return foot.moved_by(moved)


def toe_bend(foot: RecordedFoot, toes: Toes, ball: Array, tip: Array, fps: float) -> Array:
    """Return how far toes bend up (nframe,) [rad]: flat where the ball stands, else as recorded.

    In the swing they keep out of the ground at z = 0, as far as they bend.

    Args:
      foot: the foot as it is on the humanoid at last.
      toes: its toes.
      ball: (3,) the ball in the foot body [m].
      tip: (3,) the tip of the toes there [m].
      fps: frames a second.
    """
    ahead = rot.rotate(foot.quat, np.array((1.0, 0.0, 0.0)))
    pitch = np.arctan2(-ahead[:, 2], np.hypot(ahead[:, 0], ahead[:, 1]))
    free = np.clip(foot.bend, toes.low, toes.high)
    weight = foot.standing.astype(float)
    change = np.where(foot.standing, pitch - free, 0.0)
    bend = free + smooth_correction(change[:, None], weight, fps)[:, 0]
    bend = np.where(foot.standing, pitch, bend)
    # The tip of toes that are bent less than this would be under the ground.
    high = foot.point(ball)[:, 2] / float(np.linalg.norm(tip - ball))
    least = np.where(foot.standing, -np.inf, pitch - np.arcsin(np.clip(high, -1.0, 1.0)))
    lack = np.minimum(least, toes.high) - bend
    if lack.max(initial=0.0) > 0.0:
        bend = bend + envelope(lack, foot.standing, _GIVE * fps)
    return np.clip(bend, toes.low, toes.high)


def smooth_correction(values: Array, weight: Array, fps: float) -> Array:
    """Return a smooth curve through ``values`` where they count, going to zero where they do not.

    Least squares on the distance to the values, to zero, and on the third differences.

    Args:
      values: (nframe, n).
      weight: (nframe,) 1 where a value counts, 0 where it does not.
      fps: frames a second.

    Returns:
      (nframe, n).
    """
    nframe = len(values)
    if nframe < 4 or not weight.any():
        return values * weight[:, None]
    from scipy.linalg import solveh_banded

    stiff = (2 * np.sin(np.pi * min(_SHARP / fps, 0.5))) ** -6.0
    difference = np.array((-1.0, 3.0, -3.0, 1.0))
    band = np.zeros((4, nframe))  # lower diagonals of the matrix
    for row in range(4):
        for lag in range(4 - row):
            band[lag, row : nframe - 3 + row] += stiff * difference[row] * difference[row + lag]
    band[0] += weight + _SOFT * (1 - weight)
    return np.asarray(solveh_banded(band, values * weight[:, None], lower=True))
