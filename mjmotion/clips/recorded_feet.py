"""Feet of a clip on the humanoid: soles level in stance, pinned to the ground, within reach.

The humanoid's foot is one rigid piece, a recorded foot bends at the ball. A foot that only copied
the recording would push its toes through the ground at every heel-off. So each stance gets a wanted
pose: level while the recorded foot is flat, then turning about the tip of the toe as high as the
recorded ankle rises, and before it turning about the heel. The differences from the recorded pose
are carried smoothly through the swings.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.reach import drop_to_reach
from mjmotion.clips.frames import UP, calibrate, frame_of, speed_of
from mjmotion.clips.measures import HumanoidMeasures
from mjmotion.clips.rig import SIDES
from mjmotion.numerics import rotations as rot
from mjmotion.numerics.smoothing import cover

Array = rot.Array

_STILL = 0.2  # [m/s] a point that stands is slower
_MOVING = 0.4  # [m/s] a point that stood and is faster has left the ground
_NEAR_FLAT = np.radians(10)  # pitch of a foot that may well be flat
_LEVEL = np.radians(10)  # a still foot steeper than this stands on a rung or an edge
_REACH = 0.9985  # of the leg's length: a knee is never straighter than 6 degrees
_RISING = 0.05  # [rad] a foot pitched further has its heel off the ground
_HEEL_DOWN = 0.04  # [m] a heel that is no higher, before flat stance, has struck
_EVEN = 0.04  # [m] stances on flat ground differ by less
_TILT = 0.04  # slope of a floor that was meant to be level
_CLEAR = 0.004  # [m] how deep a sole may graze the ground in a swing
_SHARP, _SOFT = 10.0, 1e-2  # [Hz] what corrections follow in contact; weight of none in swing


@dataclasses.dataclass(frozen=True, eq=False)
class Foot:
    """One foot over all frames.

    Attributes:
      ankle: (nframe, 3) where the ankle is to be [m].
      ball: (nframe, 3) the recorded ball of the foot [m].
      quat: (nframe, 4) orientation of the foot body.
      normal: (nframe, 3) axis of the knee.
    """

    ankle: Array
    ball: Array
    quat: Array
    normal: Array

    @classmethod
    def recorded(
        cls,
        ankle: Array,
        ball: Array,
        joint: Array,
        normal: Array,
        rest_pitch: float | None,
        fps: float,
    ) -> Foot:
        """Return the foot as recorded, its sole calibrated to be level in flat stance.

        Args:
          ankle: (nframe, 3) ankle positions [m].
          ball: (nframe, 3) positions of the ball of the foot or the toe [m].
          joint: (nframe, 3, 3) rotations of the clip's ankle joint.
          normal: (nframe, 3) axis of the knee.
          rest_pitch: how far the line from ankle to ball points down at rest [rad], if known.
          fps: frames a second.
        """
        up = np.broadcast_to(UP, ankle.shape)
        line = ball - ankle
        pitch = np.arctan2(-line[:, 2], np.hypot(line[:, 0], line[:, 1]))
        still = (speed_of(ankle, fps) < _STILL) & (speed_of(ball, fps) < _STILL)
        if not still.any():
            still = np.ones(len(ankle), dtype=bool)
        # A still foot may stand on its toes: the rest pose tells which pitch is flat, roughly.
        flat = rest_pitch if rest_pitch is not None else float(np.percentile(pitch[still], 15))
        near = still & (np.abs(pitch - flat) < _NEAR_FLAT)
        if near.sum() >= 5:
            flat = float(np.median(pitch[near]))
        half = (pitch - flat) / 2
        zero = np.zeros_like(half)
        tilt = rot.to_matrix(np.stack([np.cos(half), zero, np.sin(half), zero], axis=-1))
        weight = still * (np.exp(-(((pitch - flat) / _NEAR_FLAT) ** 2)) + 1e-3)
        constant = calibrate(joint, frame_of(up, rot.cross(up, line)) @ tilt, weight)
        return cls(ankle, ball, rot.from_matrix(joint @ constant), normal)

    def moved(self, turn: Array, start: Array) -> Foot:
        """Return the foot after the clip moved by ``-start`` and was turned by ``turn``."""
        return Foot(
            rot.rotate(turn, self.ankle - start),
            rot.rotate(turn, self.ball - start),
            rot.multiply(np.broadcast_to(turn, self.quat.shape), self.quat),
            rot.rotate(turn, self.normal),
        )

    def moved_by(self, shift: Array) -> Foot:
        """Return the foot moved by ``shift`` (nframe, 3) [m]."""
        return dataclasses.replace(self, ankle=self.ankle + shift, ball=self.ball + shift)

    def lowered(self, height: Array) -> Foot:
        """Return the foot ``height`` (nframe,) [m] lower."""
        return self.moved_by(-height[:, None] * UP)

    def tipped(self, angle: Array, toe: Array) -> Foot:
        """Return the foot turned about its toe, heel up, by ``angle`` (nframe,) [rad]."""
        half = angle / 2
        zero = np.zeros_like(half)
        turn = np.stack([np.cos(half), zero, np.sin(half), zero], axis=-1)
        quat = rot.multiply(self.quat, turn)
        ankle = self.point(toe) - rot.rotate(quat, toe)
        return dataclasses.replace(self, quat=quat, ankle=ankle)

    def point(self, local: Array) -> Array:
        """Return (nframe, 3) positions of a point given in the foot body."""
        return self.ankle + rot.rotate(self.quat, local)


@dataclasses.dataclass(frozen=True)
class Stance:
    """Frames ``start`` up to ``end`` in which the ball of a foot stands.

    Attributes:
      start: first frame.
      end: frame after the last.
      flat: (n,) frames in which the whole foot stands still; none for a foot on its toes.
      level: whether the foot stands on level ground, not steeply on a rung or an edge.
      height: height of the ground under the sole, as recorded [m].
    """

    start: int
    end: int
    flat: NDArray[np.int64]
    level: bool
    height: float


def find_stances(foot: Foot, sole: float, fps: float) -> list[Stance]:
    """Return the stances of a foot, in order.

    Args:
      foot: the foot as recorded.
      sole: height of the ankle over the sole [m].
      fps: frames a second.
    """
    speed = speed_of(foot.ball, fps)
    ankle = speed_of(foot.ankle, fps)
    tilt = np.arccos(np.clip(rot.rotate(foot.quat, UP)[:, 2], -1, 1))
    stances, on_toes = [], []
    moving = np.flatnonzero(np.diff(np.r_[True, speed >= _MOVING, True].astype(int)))
    for start, end in moving.reshape(-1, 2):
        frames = np.arange(start, end)
        if not (speed[frames] < _STILL).any() or len(frames) < 0.06 * fps:
            continue
        still = frames[(ankle[frames] < _STILL) & (speed[frames] < _STILL)]
        flat = still[tilt[still] < _LEVEL]
        if len(still) < 3:
            on_toes.append((start, end))
        elif len(flat) >= max(3, len(still) / 2):
            height = float(np.median(foot.ankle[flat, 2])) - sole
            stances.append(Stance(start, end, flat, True, height))
        else:
            height = float(np.median(foot.ankle[still, 2])) - sole
            stances.append(Stance(start, end, still, False, height))
    # Where only the toes stand, the ball tells the ground: it is as high over it as when flat.
    local = rot.rotate(rot.conjugate(foot.quat), foot.ball - foot.ankle)
    over = sole + float(np.median(local[:, 2]))
    for start, end in on_toes:
        height = float(np.median(foot.ball[start:end, 2])) - over
        stances.append(Stance(start, end, np.zeros(0, dtype=np.int64), True, height))
    return sorted(stances, key=lambda stance: stance.start)


def place_feet(
    root: Array, pelvis: Array, feet: Sequence[Foot], measures: HumanoidMeasures, fps: float
) -> tuple[Array, list[Foot]]:
    """Put the soles on the ground at z = 0 and the ankles within reach.

    Args:
      root: (nframe, 3) positions of the pelvis [m].
      pelvis: (nframe, 4) its orientations.
      feet: the left and the right foot.
      measures: the humanoid's measures.
      fps: frames a second.

    Returns:
      The moved root and feet.
    """
    sole = -float(measures.site("left_foot")[2])
    stances = [find_stances(foot, sole, fps) for foot in feet]
    ground, uneven = _ground(feet, stances, sole)
    root = root - (ground[0] + root[:, :2] @ ground[1:])[:, None] * UP
    pinned = []
    for side, foot, group in zip(SIDES, feet, stances, strict=True):
        heel, toe = measures.site(f"{side}_heel"), measures.site(f"{side}_toe")
        under = ground[0] + foot.ankle[:, :2] @ ground[1:]
        low = [
            dataclasses.replace(s, height=s.height - float(np.mean(under[s.start : s.end])))
            for s in group
        ]
        if not uneven:
            low = [_on_flat_ground(s) for s in low]
        pinned.append(_pin(foot.lowered(under), low, heel, toe, fps))
    drop = np.zeros(len(root))
    for at, side in enumerate(SIDES):
        hip = root + rot.rotate(pelvis, measures.hips[side])
        toe = measures.site(f"{side}_toe")
        # A leg that trails behind raises its heel further; only then does the pelvis come down.
        for _ in range(4):
            lack = drop_to_reach(hip, pinned[at].ankle, _REACH * measures.leg)
            rising = rot.rotate(pinned[at].quat, toe)[:, 2] < toe[2] - _RISING * toe[0]
            lack = np.where(rising, np.maximum(lack, 0.0), 0.0)
            if lack.max() < 1e-3:
                break
            pinned[at] = pinned[at].tipped(cover(lack, 0.12 * fps) / toe[0], toe)
        drop = np.maximum(drop, drop_to_reach(hip, pinned[at].ankle, _REACH * measures.leg))
    return root - cover(drop, 0.4 * fps)[:, None] * UP, pinned


def _ground(
    feet: Sequence[Foot], stances: Sequence[Sequence[Stance]], sole: float
) -> tuple[Array, bool]:
    """Return the plane (height, slope along x, slope along y) under a clip, and if it is uneven.

    A capture volume whose floor was a little tilted gives a walk that sinks or climbs steadily; the
    plane takes that out. Where the stances do not lie on one nearly level plane, the recorded
    ground was uneven: the plane is then level, at the lowest stance.
    """
    rows = [
        (*foot.ball[s.start : s.end, :2].mean(axis=0), s.height)
        for foot, group in zip(feet, stances, strict=True)
        for s in group
        if s.level
    ]
    if not rows:
        lowest = min(float(foot.ankle[:, 2].min()) for foot in feet)
        return np.array((lowest - sole, 0.0, 0.0)), True
    table = np.array(rows)
    height = table[:, 2]
    plane = np.array((float(np.median(height)), 0.0, 0.0))
    near = np.abs(height - plane[0]) < _EVEN
    if near.sum() >= 4:
        # Slopes the stances do not show, such as across a straight walk, stay zero (ridge).
        centre = table[near, :2].mean(axis=0)
        spread = table[near, :2] - centre
        slope = np.linalg.solve(
            spread.T @ spread + 0.1 * np.eye(2), spread.T @ (height[near] - height[near].mean())
        )
        if np.linalg.norm(slope) < _TILT:
            plane = np.array((height[near].mean() - centre @ slope, *slope))
    rest = height - plane[0] - table[:, :2] @ plane[1:]
    # A foot that stands still on its toes looks like a step; most stances tell the ground.
    if np.mean(np.abs(rest) < _EVEN / 2) >= 0.6 and np.abs(rest).max() < 2 * _EVEN:
        return plane, False
    return np.array((float(height.min()), 0.0, 0.0)), True


def _on_flat_ground(stance: Stance) -> Stance:
    """Return a stance on flat ground; one that seems higher is on its toes, one askew is level."""
    if abs(stance.height) < _EVEN / 2 and stance.level:
        return stance
    return dataclasses.replace(stance, flat=stance.flat[:0], level=True, height=0.0)


def _pin(foot: Foot, stances: Sequence[Stance], heel: Array, toe: Array, fps: float) -> Foot:
    """Return the foot with its soles level and its contact points fixed in every stance."""
    nframe = len(foot.ankle)
    wanted = np.array(foot.quat)
    turned = np.zeros(nframe)  # weight of the wanted orientation
    fixed = np.zeros(nframe)  # weight of the wanted position
    point = np.zeros((nframe, 3))  # the contact point, in the foot body
    place = np.zeros((nframe, 3))  # where it is to be
    radius, flat_angle = np.hypot(toe[0], toe[2]), np.arctan2(-toe[2], toe[0])
    for stance in stances:
        frames = np.arange(stance.start, stance.end)
        if not stance.level:
            place[stance.flat], fixed[stance.flat] = foot.ankle[stance.flat].mean(axis=0), 1.0
            continue
        ground = 0.0 if abs(stance.height) < _EVEN / 2 else stance.height
        # The foot turns about the tip of its toe as far as brings the ankle to its height.
        sine = (foot.ankle[frames, 2] - stance.height) / radius
        pitch = np.maximum(np.arcsin(np.clip(sine, -1, 1)) - flat_angle, 0.0)
        flat = stance.flat
        if len(flat):
            pitch[frames <= flat[-1]] = 0.0
        else:
            flat = frames[[int(np.argmin(sine))]]
        forward = rot.rotate(foot.quat[flat], np.array((1.0, 0.0, 0.0))).mean(axis=0)
        yaw = rot.yaw_quat(np.arctan2(forward[1], forward[0]))
        zero = np.zeros(len(frames))
        tilt = np.stack([np.cos(pitch / 2), zero, np.sin(pitch / 2), zero], axis=-1)
        quat = rot.multiply(np.broadcast_to(yaw, tilt.shape), tilt)
        reach = rot.rotate(quat[flat - stance.start], toe)
        tip = (foot.ankle[flat] + reach).mean(axis=0)
        tip[2] = ground
        # Straight over its toe a rigid foot can rise no more; it leaves the ground before.
        use = (frames >= flat[0]) & (sine < 0.95) if len(stance.flat) else sine < 0.95
        wanted[frames[use]] = quat[use]
        turned[frames[use]] = fixed[frames[use]] = 1.0
        point[frames[use]], place[frames[use]] = toe, tip
        if not len(stance.flat):
            continue
        # Backwards from flat stance: the heel has struck and the foot turns about it.
        back = foot.point(heel)
        struck = (back[:, 2] - stance.height < _HEEL_DOWN) & (speed_of(back, fps) < 3 * _STILL)
        first = int(flat[0])
        while first > 0 and struck[first - 1] and fixed[first - 1] == 0:
            first -= 1
        early = np.arange(first, flat[0])
        point[early], place[early] = heel, tip + rot.rotate(yaw, heel - toe)
        fixed[early] = 1.0
    change = rot.log(rot.multiply(wanted, rot.conjugate(foot.quat)))
    quat = rot.multiply(rot.exp(carry(change, turned, fps)), foot.quat)
    turned_foot = dataclasses.replace(foot, quat=quat)
    shift = place - (turned_foot.ankle + rot.rotate(quat, point))
    moved = carry(shift, fixed, fps)
    # In the swing nothing holds the sole up: lift it where it would cut through the ground.
    for _ in range(4):
        low = np.minimum(
            *(rot.rotate(quat, site)[:, 2] + foot.ankle[:, 2] + moved[:, 2] for site in (heel, toe))
        )
        deep = (low < -_CLEAR) & (fixed == 0)
        if not deep.any():
            break
        shift[deep, 2] = moved[deep, 2] + _CLEAR / 2 - low[deep]
        fixed = np.maximum(fixed, deep)
        moved[:, 2] = carry(shift[:, 2:], fixed, fps)[:, 0]
    return dataclasses.replace(turned_foot, ankle=foot.ankle + moved)


def carry(values: Array, weight: Array, fps: float) -> Array:
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
