"""How noisy a recording's joints are, and a recording without most of that noise.

A usual recording has a few tenths of a degree of noise a joint. One with much more (cheap cameras,
a suit near iron) shakes its feet so that none of them seems to stand.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mjmotion.clips.rig import SIDES, Rig
from mjmotion.clips.skeleton import Clip, pose_skeleton
from mjmotion.clips.standing import QUIET, point_noise
from mjmotion.numerics import rotations as rot
from mjmotion.numerics.smoothing import follow

Array = NDArray[np.float64]

ABOVE = 10.0  # [Hz] what a joint does faster is taken for noise
ONE = np.radians(1.0)
CUTOFF = 6.0  # [Hz] what is kept of joints that have 1 degree of noise: gait has little beyond
CUTOFFS = (4.5, 10.0)  # [Hz] what is kept of those that have more and less
LEAST = np.radians(0.1)  # [rad] joints that are half as noisy are left as they are
NOISY = np.radians(0.7)  # [rad] more is told
LOWEST_RATE = 25.0  # [Hz] of frames: below, nothing is fast enough to be told from movement
FEWEST = 12  # frames that tell anything


def time_of(cutoff: float, fps: float) -> float:
    """Return the τ [frames] with which :func:`follow` leaves half of what is at a cutoff [Hz]."""
    return float(1.0 / (2.0 * np.sin(np.pi * min(cutoff / fps, 0.5))))


def joint_noise(clip: Clip) -> Array:
    """Return how noisy each joint is (njoint,): the RMS of its noise about an axis [rad].

    What of its turn against its parent is faster than :data:`ABOVE` is measured; white noise has
    the share ``1 - 2 ABOVE / fps`` of its power there. Zero where the rate is too low to tell.
    """
    if clip.fps < LOWEST_RATE or clip.nframe < FEWEST:
        return np.zeros(len(clip.parents))
    quats = _local(clip)
    flat = quats.reshape(clip.nframe, -1)
    slow = follow(flat, np.ones(clip.nframe), time_of(ABOVE, clip.fps)).reshape(quats.shape)
    # A small turn is twice what the quaternion is off by, over three axes.
    off = 2.0 * np.linalg.norm(quats - slow, axis=2)
    share = max(1.0 - 2.0 * ABOVE / clip.fps, 0.1)
    return np.asarray(np.sqrt((off**2).mean(axis=0) / 3.0 / share))


def leg_noise(clip: Clip, rig: Rig) -> float:
    """Return how noisy pelvis and legs are, the median over their joints [rad]."""
    noise = joint_noise(clip)
    roles = ["pelvis", *(f"{side}_{part}" for side in SIDES for part in ("hip", "knee", "ankle"))]
    return float(np.median([noise[clip.index(rig.joints[role])] for role in roles]))


def quieted(clip: Clip, rig: Rig, scale: float) -> tuple[Clip, str | None]:
    """Return a clip without most of its noise where that shakes its feet, and a note if it is much.

    Turns against the parent lose what is faster than :data:`CUTOFF`, or less the noisier they are,
    without delay.

    Args:
      clip: the clip.
      rig: role to joint.
      scale: metres of the humanoid per unit of the clip.
    """
    ankles = [clip.index(rig.joints[f"{side}_ankle"]) for side in SIDES]
    shaken = max(point_noise(scale * clip.positions[:, joint], clip.fps) for joint in ankles)
    if shaken <= QUIET:
        return clip, None
    usual = max(leg_noise(clip, rig), LEAST)
    noisy = joint_noise(clip) > 0.5 * LEAST
    time = time_of(float(np.clip(CUTOFF * ONE / usual, *CUTOFFS)), clip.fps)
    even, quats = np.ones(clip.nframe), _local(clip)
    flat = quats[:, noisy].reshape(clip.nframe, -1)
    quats[:, noisy] = rot.normalized(follow(flat, even, time).reshape(clip.nframe, -1, 4))
    parents = np.maximum(clip.parents, 0)
    turn = np.swapaxes(clip.rotations[:, parents], -1, -2)
    shift = (turn @ (clip.positions - clip.positions[:, parents])[..., None])[..., 0]
    shift = np.where((clip.parents < 0)[:, None], clip.positions, shift)
    quiet = pose_skeleton(
        clip.name,
        clip.joint_names,
        clip.parents,
        clip.offsets,
        shift,
        rot.to_matrix(quats),
        clip.fps,
        clip.ends,
    )
    said = f"the recording is noisy, by {np.degrees(usual):.1f} degrees a joint: it was smoothed"
    return quiet, said if usual > NOISY else None


def _local(clip: Clip) -> Array:
    """Return each joint's turn against its parent (nframe, njoint, 4), continuous."""
    parents = np.maximum(clip.parents, 0)
    turn = np.swapaxes(clip.rotations[:, parents], -1, -2) @ clip.rotations
    turn = np.where((clip.parents < 0)[:, None, None], clip.rotations, turn)
    return rot.continuous(rot.from_matrix(turn))
