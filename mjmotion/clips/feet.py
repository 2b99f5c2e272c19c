"""Feet of a clip on the humanoid: soles level in stance, on the ground, within the legs' reach."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from mjmotion import rotations as rot
from mjmotion.clips.frames import UP, Upright, calibrate, frame_of, speed_of
from mjmotion.clips.rig import SIDES

if TYPE_CHECKING:
    from mjmotion.clips.mapping import Figure

Array = rot.Array

_STILL = 0.15  # [m/s] ankle and toe slower than this stand
_REACH = 0.9985  # of the leg's length: a knee is never straighter than 6 degrees


@dataclasses.dataclass(frozen=True, eq=False)
class Foot:
    """One foot over all frames.

    Attributes:
      ankle: (nframe, 3) where the ankle is to be [m].
      quat: (nframe, 4) orientation of the foot body.
      normal: (nframe, 3) axis of the knee.
    """

    ankle: Array
    quat: Array
    normal: Array

    @classmethod
    def recorded(
        cls, ankle: Array, toe: Array, joint: Array, normal: Array, source: Upright, rest: Array
    ) -> Foot:
        """Return the foot as recorded, its sole calibrated to be level in flat stance.

        Args:
          ankle: (nframe, 3) ankle positions [m].
          toe: (nframe, 3) positions of the ball of the foot or the toe [m].
          joint: (nframe, 3, 3) rotations of the clip's ankle joint.
          normal: (nframe, 3) axis of the knee.
          source: the clip.
          rest: (3,) ankle to toe in the rest pose.
        """
        fps = source.clip.fps
        flat = toe - ankle
        flat = frame_of(
            np.broadcast_to(UP, flat.shape), rot.cross(np.broadcast_to(UP, flat.shape), flat)
        )
        still = (speed_of(ankle, fps) < _STILL) & (speed_of(toe, fps) < _STILL)
        constant = None
        if source.facing is not None:
            constant = source.turn.T @ frame_of(UP, rot.cross(UP, rest))
        if still.sum() >= 5:
            weight = still.astype(float)
            constant = calibrate(joint, flat, weight)
            # A still foot may stand on its toes: keep the frames near the common pose only.
            for _ in range(3):
                tilt = np.arccos(np.clip((joint @ constant)[:, 2, 2], -1, 1))
                weight = still * np.exp(-((tilt / np.radians(8)) ** 2))
                constant = calibrate(joint, flat, weight)
        elif constant is None:
            constant = calibrate(joint, flat)
        return cls(ankle, rot.from_matrix(joint @ constant), normal)

    def moved(self, turn: Array, start: Array) -> Foot:
        """Return the foot after the clip moved by ``-start`` and was turned by ``turn``."""
        quat = rot.multiply(np.broadcast_to(turn, self.quat.shape), self.quat)
        return Foot(rot.rotate(turn, self.ankle - start), quat, rot.rotate(turn, self.normal))

    def point(self, local: Array) -> Array:
        """Return (nframe, 3) positions of a point given in the foot body."""
        return self.ankle + rot.rotate(self.quat, local)


def place_feet(
    root: Array, pelvis: Array, feet: Sequence[Foot], figure: Figure, fps: float
) -> tuple[Array, list[Foot]]:
    """Put the soles on the ground at z = 0 and the ankles within reach.

    Args:
      root: (nframe, 3) positions of the pelvis [m].
      pelvis: (nframe, 4) its orientations.
      feet: the left and the right foot.
      figure: the humanoid's measures.
      fps: frames a second.

    Returns:
      The moved root and feet.
    """
    floor = _floor(feet, figure, fps)
    root = root - floor * UP
    feet = [dataclasses.replace(foot, ankle=foot.ankle - floor * UP) for foot in feet]
    drop = np.zeros(len(root))
    for side, foot in zip(SIDES, feet, strict=True):
        hip = root + rot.rotate(pelvis, figure.hips[side])
        flat = np.linalg.norm((foot.ankle - hip)[:, :2], axis=1)
        most = np.sqrt(np.maximum((_REACH * figure.leg) ** 2 - flat**2, 0))
        drop = np.maximum(drop, hip[:, 2] - foot.ankle[:, 2] - most)
    return root - _envelope(drop, 0.1 * fps)[:, None] * UP, feet


def _floor(feet: Sequence[Foot], figure: Figure, fps: float) -> float:
    """Return the height [m] of the ground the clip stands on: the lowest, where there are several."""
    heights = []
    for side, foot in zip(SIDES, feet, strict=True):
        for name in ("heel", "toe"):
            point = foot.point(figure.site(f"{side}_{name}"))
            heights.append(point[speed_of(point, fps) < _STILL, 2])
    height = np.concatenate(heights)
    if len(height) < 5:
        return float(min(foot.ankle[:, 2].min() for foot in feet) + figure.site("left_foot")[2])
    low, middle = np.percentile(height, (5, 50))
    return float(middle if middle - low < 0.03 else low)


def _envelope(need: Array, width: float) -> Array:
    """Return a smooth curve that lies on or above ``need`` (nframe,), zero where it is far from it."""
    if not (need > 0).any():
        return np.zeros_like(need)
    from scipy.ndimage import gaussian_filter1d, maximum_filter1d

    width = max(width, 1.0)
    wide = maximum_filter1d(need, 2 * int(4 * width) + 1, mode="nearest")
    return gaussian_filter1d(wide, width, mode="nearest", truncate=4.0)
