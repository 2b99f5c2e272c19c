"""Feet as a clip has them: where ankle and ball go, how the sole is turned, and when it stands."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.clips.standing import at_rest, stays
from mjmotion.clips.upright import UP, calibrate, frame_of, speed_of
from mjmotion.numerics import rotations as rot

Array = rot.Array

STILL = 0.2  # [m/s] a point that stands is slower
_MOVING = 0.4  # [m/s] a point that stood and is faster has left the ground
_NEAR_FLAT = np.radians(10)  # pitch of a foot that may well be flat
TOE_TIME = 0.04  # [s] toes are told by one marker, whose noise shakes them: averaged over this
RAISED = 0.035  # [m] a foot this far over the other that stands all the while is in the air
_ALONE = 0.1  # share of a stance in which a foot that bears the body has it alone, at least
_LYING = 0.35  # upward part of a shank less than which it lies: about 20 degrees
_LEVEL = np.radians(10)  # a still foot steeper than this stands on a rung or an edge


@dataclasses.dataclass(frozen=True, eq=False)
class RecordedFoot:
    """One foot over all frames.

    Attributes:
      ankle: (nframe, 3) where the ankle is to be [m].
      ball: (nframe, 3) the recorded ball of the foot [m].
      quat: (nframe, 4) orientation of the foot body.
      normal: (nframe, 3) axis of the knee.
      bend: (nframe,) how far the recorded toes are bent up from where they are as the foot stands
        flat [rad]; 0 in a recording without toes.
      standing: (nframe,) when the ball stands, where that is known.
      noise: of its points as recorded, before anything was smoothed, about an axis [m].
      knee: (nframe, 3) the recorded knee [m]; None where it is not told.
    """

    ankle: Array
    ball: Array
    quat: Array
    normal: Array
    bend: Array
    standing: NDArray[np.bool_]
    noise: float = 0.0
    knee: Array | None = None

    @property
    def lying(self) -> NDArray[np.bool_]:
        """When the shank lies (nframe,), as that of one who kneels: such a foot does not stand."""
        if self.knee is None:
            return np.zeros(len(self.ankle), dtype=bool)
        shank = self.knee - self.ankle
        return np.asarray(shank[:, 2] < _LYING * np.linalg.norm(shank, axis=1))

    @classmethod
    def recorded(
        cls,
        ankle: Array,
        ball: Array,
        joint: Array,
        toes: Array | None,
        normal: Array,
        rest_pitch: float | None,
        fps: float,
    ) -> RecordedFoot:
        """Return the foot as recorded, its sole calibrated to be level in flat stance.

        Args:
          ankle: (nframe, 3) ankle positions [m].
          ball: (nframe, 3) positions of the ball of the foot or the toe [m].
          joint: (nframe, 3, 3) rotations of the clip's ankle joint.
          toes: (nframe, 3, 3) rotations of its toe joint, if it has one.
          normal: (nframe, 3) axis of the knee.
          rest_pitch: how far the line from ankle to ball points down at rest [rad], if known.
          fps: frames a second.
        """
        from scipy.ndimage import gaussian_filter1d

        up = np.broadcast_to(UP, ankle.shape)
        line = ball - ankle
        pitch = np.arctan2(-line[:, 2], np.hypot(line[:, 0], line[:, 1]))
        still = (speed_of(ankle, fps) < STILL) & (speed_of(ball, fps) < STILL)
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
        foot = joint @ constant
        bend = np.zeros(len(ankle))
        if toes is not None:
            # As the foot's own axes see them: both joints have one orientation at rest.
            ahead = (np.swapaxes(foot, 1, 2) @ (toes @ constant))[..., 0]
            bend = np.arctan2(ahead[:, 2], ahead[:, 0])
            bend = bend - np.median(bend[near] if near.sum() >= 5 else bend[still])
            bend = gaussian_filter1d(bend, TOE_TIME * fps, mode="nearest")
        none = np.zeros(len(ankle), dtype=bool)
        return cls(ankle, ball, rot.from_matrix(foot), normal, bend, none)

    def with_knee(self, knee: Array, standing: Array | None) -> RecordedFoot:
        """Return the foot with its knee (nframe, 3) [m].

        Where its shank lies in every frame, none shows how it stands: it is turned as its rest pose
        says, ``standing`` (nframe, 3, 3), if that is known.
        """
        foot = dataclasses.replace(self, knee=knee)
        if standing is None or not foot.lying.all():
            return foot
        return dataclasses.replace(foot, quat=rot.from_matrix(standing))

    def moved(self, turn: Array, start: Array) -> RecordedFoot:
        """Return the foot after the clip moved by ``-start`` and was turned by ``turn``."""
        return dataclasses.replace(
            self,
            ankle=rot.rotate(turn, self.ankle - start),
            ball=rot.rotate(turn, self.ball - start),
            quat=rot.multiply(np.broadcast_to(turn, self.quat.shape), self.quat),
            normal=rot.rotate(turn, self.normal),
            knee=None if self.knee is None else rot.rotate(turn, self.knee - start),
        )

    def moved_by(self, shift: Array) -> RecordedFoot:
        """Return the foot moved by ``shift`` (nframe, 3) [m]."""
        knee = None if self.knee is None else self.knee + shift
        return dataclasses.replace(
            self, ankle=self.ankle + shift, ball=self.ball + shift, knee=knee
        )

    def lowered(self, height: Array) -> RecordedFoot:
        """Return the foot ``height`` (nframe,) [m] lower."""
        return self.moved_by(-height[:, None] * UP)

    def tipped(self, angle: Array, toe: Array) -> RecordedFoot:
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
class RecordedStance:
    """Frames ``start`` up to ``end`` in which the ball of a foot stands.

    Attributes:
      start: first frame.
      end: frame after the last.
      flat: (n,) frames in which the whole foot stands still; none for a foot on its toes.
      level: whether the foot stands on level ground, not steeply on a rung or an edge.
      height: height of the ground under the sole, as recorded [m].
      ball: the same by the ball alone: of a foot on its toes, the ground's, not the heel's [m].
    """

    start: int
    end: int
    flat: NDArray[np.int64]
    level: bool
    height: float
    ball: float

    def lowered(self, floor: Array) -> RecordedStance:
        """Return it over a floor that is at ``floor`` (nframe,) under its foot [m]."""
        under = float(np.mean(floor[self.start : self.end]))
        return dataclasses.replace(self, height=self.height - under, ball=self.ball - under)


def find_stances(foot: RecordedFoot, sole: float, fps: float) -> list[RecordedStance]:
    """Return the stances of a foot, in order.

    Args:
      foot: the foot as recorded.
      sole: height of the ankle over the sole [m].
      fps: frames a second.
    """
    both = [at_rest(points, fps, foot.noise, STILL) for points in (foot.ball, foot.ankle)]
    rests = both[0] & both[1] & ~foot.lying
    tilt = np.arccos(np.clip(rot.rotate(foot.quat, UP)[:, 2], -1, 1))
    # As high as this over the ground the ball is when the foot stands flat.
    local = rot.rotate(rot.conjugate(foot.quat), foot.ball - foot.ankle)
    over = sole + float(np.median(local[:, 2]))
    stances = []
    for start, end in _upright(stays(foot.ball, fps, foot.noise, STILL, _MOVING), foot.lying):
        frames = np.arange(start, end)
        if len(frames) < 0.06 * fps:
            continue
        still = frames[rests[frames]]
        flat = still[tilt[still] < _LEVEL]
        ball = float(np.median(foot.ball[frames, 2])) - over
        if len(still) < 3:
            # Where only the toes stand, the ball tells the ground.
            stances.append(RecordedStance(start, end, flat[:0], True, ball, ball))
        elif len(flat) >= max(3, len(still) / 2):
            height = float(np.median(foot.ankle[flat, 2])) - sole
            stances.append(RecordedStance(start, end, flat, True, height, ball))
        else:
            height = float(np.median(foot.ankle[still, 2])) - sole
            stances.append(RecordedStance(start, end, still, False, height, ball))
    return stances


def _upright(spans: Sequence[tuple[int, int]], lying: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return what is left of stays without the frames in which the shank lies."""
    left = []
    for start, end in spans:
        edges = np.flatnonzero(np.diff(np.r_[True, lying[start:end], True].astype(int)))
        left += [(start + int(a), start + int(b)) for a, b in edges.reshape(-1, 2)]
    return left


def without_raised(
    stances: Sequence[Sequence[RecordedStance]],
) -> tuple[tuple[RecordedStance, ...], ...]:
    """Return each foot's stances without those in which it is held still over the ground.

    Such a foot is well over the other one, and the other stands all the while: it never bears the
    body alone.
    """
    kept = []
    for own, others in zip(stances, stances[::-1], strict=True):
        kept.append(tuple(stance for stance in own if not _is_raised(stance, others)))
    return tuple(kept)


def _is_raised(stance: RecordedStance, others: Sequence[RecordedStance]) -> bool:
    beside = [o for o in others if o.start < stance.end and o.end > stance.start]
    if not beside or stance.ball - max(o.ball for o in beside) < RAISED:
        return False
    alone = np.ones(stance.end - stance.start, dtype=bool)
    for o in beside:
        alone[max(o.start - stance.start, 0) : o.end - stance.start] = False
    return bool(alone.mean() < _ALONE)
