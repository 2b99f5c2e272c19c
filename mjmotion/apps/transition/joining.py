"""Clips joined by transitions, every contact enforced by the fit.

The blend slides its feet wherever two clips' strides differ. Each contact of it becomes a foothold
on level ground, the mean of where the blend puts that foot; feet go there as on any ground
(:mod:`mjmotion.footsteps.paths`), and the fit takes the body along.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.adaptation import as_clip, fit_plan
from mjmotion.apps.clearing import FitSettings
from mjmotion.apps.transition.blending import blend
from mjmotion.apps.transition.overlap import (
    Overlap,
    cadence_ratio,
    default_length,
    find_overlap,
    spans,
)
from mjmotion.apps.transition.sampling import resample, resample_contacts
from mjmotion.apps.transition.warp import find_warp
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.exceptions import ClipError, ModelError, wrong_type
from mjmotion.fitting import TOLERANCE
from mjmotion.footsteps.contacts import Contact, check_contacts, detect_contacts
from mjmotion.footsteps.planning import make_plan
from mjmotion.ik import IKSolver
from mjmotion.numerics.progress import Progress, no_progress
from mjmotion.output.result import Result
from mjmotion.scene import load_scene, with_ground

Array = NDArray[np.float64]
Place = Overlap | tuple[int, int, int]
Contacts = Sequence[Contact] | None
Ready = tuple[Motion, tuple[Contact, ...]]

MIDDLE = 2.5  # an overlap takes no more than one of so many parts of a clip between two others


@dataclasses.dataclass(frozen=True, eq=False)
class Joined:
    """Clips in one, before any fit.

    Attributes:
      motion: the blend, beginning as the first clip does.
      contacts: who stands when.
      overlaps: of every two clips: frames of the result ``(start, end)``.
      places: the same in the clips' own frames, at the result's rate.
      clips: the clips at that rate.
    """

    motion: Motion
    contacts: tuple[Contact, ...]
    overlaps: tuple[tuple[int, int], ...]
    places: tuple[Overlap, ...]
    clips: tuple[Motion, ...]


def blend_clips(
    clips: Sequence[Motion],
    *,
    overlaps: Sequence[Place | None] | None = None,
    contacts: Sequence[Contacts] | None = None,
    length: int | None = None,
) -> Joined:
    """Return clips in one, each gone over into the next, with nothing enforced.

    Args:
      clips: two or more, of one model; the others are put at the first's rate.
      overlaps: one fewer: where each goes over into the next (frame of the one, frame of the other,
        frames it lasts), by the clips' own frames at the first's rate; the best found where None.
      contacts: of each clip, at its own rate; found in it where None.
      length: frames that an overlap lasts which is found.

    Raises:
      ClipError: fewer than two clips, different models, clips too short to overlap, an overlap that
        is not within its clips.
      ContactError: contacts that do not fit their clip, or a clip without any.
    """
    if len(clips) < 2:
        raise ClipError(f"{len(clips)} clip cannot be joined: give two at least")
    ready = _at_one_rate(clips, contacts or [None] * len(clips))
    places = list(overlaps) if overlaps is not None else [None] * (len(clips) - 1)
    if len(places) != len(clips) - 1:
        raise ClipError(
            f"{len(places)} overlaps for {len(clips)} clips: give {len(clips) - 1}, None for those"
            " to be found"
        )
    first, standing = ready[0]
    cut = 0  # frames that the clip at the end of the blend has lost of its own
    earliest = 0
    found, used = [], []
    for number, ((second, others), place) in enumerate(zip(ready[1:], places, strict=True)):
        pair = (standing, others)
        if place is None:
            where = find_overlap(
                first,
                second,
                pair,
                length=_length(ready, number, length),
                earliest=earliest,
                spare=_spare(ready, places, number + 1, length),
            )
        else:
            given = place if isinstance(place, Overlap) else Overlap(*place)
            where = dataclasses.replace(given, first=given.first + cut)
            if where.first < earliest:
                raise ClipError(
                    f"an overlap begins at frame {given.first} of a clip, before the one before it"
                    f" has ended at {earliest - cut}: begin later"
                )
        warp = find_warp(first, second, pair, where, align=place is None)
        both = blend(first, second, pair, warp)
        used.append(Overlap(where.first - cut, round(float(warp.second[0])), warp.length))
        cut, earliest = both.end - both.unused, both.end
        first, standing = both.motion, both.contacts
        found.append((both.start, both.end))
    return Joined(first, standing, tuple(found), tuple(used), tuple(m for m, _ in ready))


def _length(ready: Sequence[Ready], number: int, length: int | None) -> int:
    """Return how long an overlap is to last; clips in the middle have two to take part in."""
    if length is not None:
        return length
    (first, standing), (second, others) = ready[number : number + 2]
    parts = (2.0 if number == 0 else MIDDLE, 2.0 if number + 2 == len(ready) else MIDDLE)
    return default_length(first, second, cadence_ratio(first, second, (standing, others)), parts)


def _spare(
    ready: Sequence[Ready], places: Sequence[Place | None], number: int, length: int | None
) -> int:
    """Return the frames at the end of a clip that its next overlap takes."""
    if number == len(places):
        return 0
    first, standing = ready[number]
    place = places[number]
    if place is not None:
        begin = place.first if isinstance(place, Overlap) else place[0]
        return max(0, first.nframe - begin)
    second, others = ready[number + 1]
    ratio = cadence_ratio(first, second, (standing, others))
    return int(np.ceil(spans(_length(ready, number, length), ratio)[0])) + 2


def _at_one_rate(clips: Sequence[Motion], contacts: Sequence[Contacts]) -> list[Ready]:
    """Return the clips at the first's rate, with their contacts."""
    fps, ready = clips[0].fps, []
    if len(contacts) != len(clips):
        raise ClipError(f"contacts of {len(contacts)} clips for {len(clips)}: give one a clip")
    for number, (clip, given) in enumerate(zip(clips, contacts, strict=True), start=1):
        _check_level(clip, number)
        try:
            clip = clip.on(clips[0].character)
        except ModelError as error:
            raise ClipError(
                f"clip {number} has another model than clip 1: clips of one character can be"
                " joined; retarget the one first"
            ) from error
        motion = resample(clip, fps)
        if given is None:
            found = detect_contacts(motion)
        else:
            found = check_contacts(given, clip.model, clip.nframe)
            found = resample_contacts(found, clip.fps, fps, motion.nframe)
        ready.append((motion, found))
    _ = clips[0].character.feet  # a character without feet has no contacts to join
    return ready


def _check_level(clip: Motion, number: int) -> None:
    """Raise ClipError where a clip comes with ground that is not one level plane."""
    model = clip.model
    still = model.body_weldid[model.geom_bodyid] == 0
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    if (still & solid & (model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE)).any():
        raise ClipError(
            f"clip {number} is on ground that is not level: join clips first and adapt them then"
        )


def join(  # more than eight parameters: all but the first have a default
    clips: Sequence[Motion | str | Path],
    *,
    overlaps: Sequence[Place | None] | None = None,
    contacts: Sequence[Contacts] | None = None,
    length: int | None = None,
    levels: Sequence[float] | None = None,
    tolerance: float = TOLERANCE,
    ik: str | IKSolver = "hybrid",
    progress: Progress = no_progress,
) -> Result:
    """Join clips by transitions and enforce their contacts on level ground.

    Args:
      clips: two or more, on one character; or files or built-in names. The others are put at the
        first's rate.
      overlaps: one fewer, as :func:`blend_clips` takes them.
      contacts: of each clip; found in it where None.
      length: frames that an overlap lasts which is found.
      levels: frames a knot of each level, coarse to fine.
      tolerance: refinement stops once no constraint is off by more [m].
      ik: ``"hybrid"``, ``"numeric"`` or a solver of one's own.
      progress: called with stage, done, of.

    Returns:
      The source is the blend, before the fit.

    Raises:
      ClipError, ContactError: as :func:`blend_clips`; a clip in which no foot stands.
      ConstraintError, ModelError, FitError: bad input.
    """
    if not isinstance(clips, Sequence) or isinstance(clips, str):
        raise ClipError(wrong_type("clips", clips, "a list of two or more"))
    progress("overlaps and blends", 0, 0)
    motions = [clip if isinstance(clip, Motion) else load_clip(clip) for clip in clips]
    joined = blend_clips(motions, overlaps=overlaps, contacts=contacts, length=length)
    return keep_contacts(joined, FitSettings(levels, tolerance, ik, progress))


def keep_contacts(joined: Joined, settings: FitSettings | None = None) -> Result:
    """Enforce the contacts of clips in one on level ground.

    Args:
      joined: what :func:`blend_clips` returned.
      settings: how it is fitted.

    Raises:
      ContactError: no foot stands in any clip.
      ConstraintError, ModelError, FitError: bad input.
    """
    settings = FitSettings() if settings is None else settings
    settings.progress("footholds", 0, 0)
    plan = make_plan(as_clip(joined.motion), load_scene("flat"), joined.contacts)
    return fit_plan(plan, with_ground(joined.motion.character), settings=settings)


def transition(  # more than eight parameters: all but the first two have a default
    a: Motion | str | Path,
    b: Motion | str | Path,
    *,
    overlap: Place | None = None,
    contacts_a: Contacts = None,
    contacts_b: Contacts = None,
    length: int | None = None,
    levels: Sequence[float] | None = None,
    tolerance: float = TOLERANCE,
    ik: str | IKSolver = "hybrid",
    progress: Progress = no_progress,
) -> Result:
    """Go over from one clip into another; see :func:`join`.

    Args:
      a: the clip that is left.
      b: the clip that is gone into.
      overlap: frame of ``a``, frame of ``b`` and how many frames it lasts; the best one without.
      contacts_a: who stands when in ``a``; found in it without.
      contacts_b: the same of ``b``.
      length: frames that an overlap lasts which is found.
      levels: frames a knot of each level, coarse to fine.
      tolerance: refinement stops once no constraint is off by more [m].
      ik: ``"hybrid"``, ``"numeric"`` or a solver of one's own.
      progress: called with stage, done, of.

    Raises:
      ClipError, ContactError, ConstraintError, ModelError, FitError: as :func:`join`.
    """
    return join(
        [a, b],
        overlaps=[overlap],
        contacts=[contacts_a, contacts_b],
        length=length,
        levels=levels,
        tolerance=tolerance,
        ik=ik,
        progress=progress,
    )


__all__ = ["Contacts", "Joined", "Place", "blend_clips", "join", "keep_contacts", "transition"]
