"""A motion between its frames, and at another rate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.body.character import quaternion_addresses
from mjmotion.body.motion import Motion
from mjmotion.exceptions import ClipError
from mjmotion.footsteps.contacts import Contact
from mjmotion.numerics.rotations import continuous, normalized

Array = NDArray[np.float64]


def sample(motion: Motion, at: ArrayLike) -> Array:
    """Return poses (n, nq) of a motion at places (n,) between its frames, by cubic splines.

    Quaternions are interpolated as four numbers, made continuous first and normalised after: at
    the rates of motions the turn from frame to frame is small, and so the error of that.

    Args:
      motion: the motion.
      at: (n,) frames, whole or not; before the first and after the last, the motion stands still.
    """
    from scipy.interpolate import CubicSpline

    at = np.clip(np.asarray(at, dtype=np.float64), 0.0, motion.nframe - 1.0)
    if motion.nframe == 1:
        return np.repeat(motion.qpos, len(at), axis=0)
    columns = np.array(quaternion_addresses(motion.model))[:, None] + np.arange(4)
    qpos = np.array(motion.qpos)
    qpos[:, columns] = continuous(qpos[:, columns])
    values = np.asarray(CubicSpline(np.arange(motion.nframe), qpos)(at))
    values[:, columns] = normalized(values[:, columns])
    return values


def resample(motion: Motion, fps: float) -> Motion:
    """Return a motion at another rate: the same poses at the same times.

    Raises:
      ClipError: the rate is not positive.
    """
    if not (np.isfinite(fps) and fps > 0.0):
        raise ClipError(f"fps is {fps}: it must be a positive number")
    if fps == motion.fps:
        return motion
    count = int(np.floor(motion.duration * fps + 1e-6)) + 1
    qpos = sample(motion, np.arange(count) * (motion.fps / fps))
    return Motion(motion.character, qpos, fps)


def resample_contacts(
    contacts: Sequence[Contact], fps: float, wanted: float, nframe: int
) -> tuple[Contact, ...]:
    """Return contacts of a motion at ``fps`` for the same motion at ``wanted`` frames a second.

    Args:
      contacts: the contacts.
      fps: the rate that they are for.
      wanted: the rate that they are to be for.
      nframe: frames at that rate.

    Returns:
      Contacts that last a frame at least.
    """
    if fps == wanted:
        return tuple(contacts)
    scaled = []
    for contact in contacts:
        start, end = (round(edge * wanted / fps) for edge in (contact.start, contact.end))
        if start < min(end, nframe):
            scaled.append(Contact(contact.site, start, min(end, nframe)))
    return tuple(scaled)
