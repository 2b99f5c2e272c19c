"""A motion and its contacts at another rate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mjmotion.body.motion import Motion
from mjmotion.body.sampling import sample
from mjmotion.exceptions import ClipError
from mjmotion.footsteps.contacts import Contact


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
