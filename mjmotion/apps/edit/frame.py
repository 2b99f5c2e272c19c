"""One frame is dragged into another pose, and the frames around follow (§4.4, Figure 2)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.apps.edit.hold import HOLDS, Hold, keep
from mjmotion.apps.edit.local import LocalEdit
from mjmotion.apps.edit.span import Span
from mjmotion.apps.edit.window import Window
from mjmotion.body.kinematics import Kinematics, site_id, site_positions
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.constraints import SiteConstraint, lay_out
from mjmotion.constraints.unmet import find_unmet
from mjmotion.exceptions import ConstraintError, FitError, unknown_name
from mjmotion.fitting import TOLERANCE
from mjmotion.fitting.levels import check_levels, check_tolerance
from mjmotion.footsteps.contacts import Contact, check_contacts, detect_contacts
from mjmotion.ik.solver import default_rigidity
from mjmotion.output.result import Result
from mjmotion.scene import with_ground

Array = NDArray[np.float64]

LEVELS = (12.0, 6.0, 3.0, 1.5)  # frames a knot of each level


def edit_frame(  # more than eight parameters: all but the first three have a default
    motion: Motion | str | Path,
    frame: int,
    site: str | Sequence[str],
    *,
    by: ArrayLike | None = None,
    to: ArrayLike | None = None,
    levels: Sequence[float] = LEVELS,
    tolerance: float = TOLERANCE,
    contacts: Sequence[Contact] | None = None,
    hold: Hold = "feet",
) -> Result:
    """Drag sites at one frame; the frames covered by seven knots of the first level follow.

    The whole pose is found by IK, so a pelvis that sinks bends the knees over feet that stay.
    Frames at the outermost of the seven knots and beyond stay to the bit.

    Args:
      motion: the motion; it is not touched; or a file or built-in name. It gets a floor if it has
        no ground.
      frame: which frame to change.
      site: what to drag, one or more sites.
      by: (3,) or one row a site, how far, along the world's axes [m].
      to: (3,) or one row a site, where to, in place of ``by`` [m].
      levels: frames a knot of each level, coarse to fine, one or more each; the first a whole
        number: the change covers the frames less than three knots of it away.
      tolerance: further levels follow while anything is off by more [m].
      contacts: who stands when; found in the motion without.
      hold: what stays where it was within the range: ``"feet"``, both feet on their paths, on the
        ground and in the air, and whatever else has contacts; ``"contacts"``, what stands, while it
        stands; ``"frame"``, what stands at the edited frame, and feet may slide at others.

    Returns:
      The unedited motion as ``source`` and the edited one on the same model, who stands when, the
      levels, and what could not be met: a drag is followed as far as nothing that is held gives.

    Raises:
      FitError: a frame that there is not, levels that make no sense.
      ConstraintError: neither or both of ``by`` and ``to``, or not one row a site.
      ModelError: an unknown site.
      ContactError: contacts that do not fit the motion.
    """
    motion = motion if isinstance(motion, Motion) else load_clip(motion)
    levels = _check(motion, frame, levels, hold)
    source = motion.on(with_ground(motion.character))
    stands = (
        detect_contacts(source)
        if contacts is None
        else check_contacts(contacts, source.model, source.nframe)
    )
    span = Span(frame, int(levels[0]), source.nframe)
    drags = _drags(source, frame, [site] if isinstance(site, str) else list(site), by, to)
    return _edited(source, stands, span, drags, hold, (levels, check_tolerance(tolerance)))


def _edited(
    source: Motion,
    stands: Sequence[Contact],
    span: Span,
    drags: list[SiteConstraint],
    hold: Hold,
    until: tuple[tuple[float, ...], float],
) -> Result:
    """Return the result of drags; ``until`` are the levels and the tolerance."""
    window = Window.of(source, stands, span)
    mine = window.constraints(drags)
    held = keep(window.motion, window.contacts, window.span, mine, hold)
    edit = LocalEdit(window.motion, window.span, held, default_rigidity(source.model))
    part, held, trace = edit.run(mine, *until)
    targets = lay_out([*held.constraints(), *mine], source.model, part.nframe)
    unmet = find_unmet(part, targets, [*held.constraints(), *mine])
    moved, contacts = window.put_back(part, held.contacts)
    shown = tuple(
        dataclasses.replace(one, frames=tuple(frame + window.low for frame in one.frames))
        for one in unmet
    )
    return Result(source, moved, contacts, trace, shown)


def deformation(edited: Result) -> Array:
    """Return how far the furthest moved body of every frame is from where it was (nframe,) [m]."""
    kinematics = Kinematics(edited.motion.model, edited.motion.nframe)
    before = np.array(kinematics.forward(edited.source.qpos).xpos)
    after = kinematics.forward(edited.motion.qpos).xpos
    return np.asarray(np.linalg.norm(after - before, axis=-1).max(axis=1))


def _check(motion: Motion, frame: int, levels: Sequence[float], hold: str) -> tuple[float, ...]:
    """Return the levels, if they and the rest make sense."""
    if not 0 <= frame < motion.nframe:
        raise FitError(
            f"frame {frame} is not within the motion's 0 to {motion.nframe - 1}: give one of those"
        )
    checked = check_levels(levels)
    if checked[0] != int(checked[0]) or checked[-1] < 1.0:
        raise FitError(
            f"levels {list(checked)} of an edit must begin with a whole number of frames a knot,"
            " and none may be below 1"
        )
    if hold not in HOLDS:
        raise FitError(unknown_name("hold", hold, HOLDS))
    return checked


def _drags(
    motion: Motion,
    frame: int,
    sites: list[str],
    by: ArrayLike | None,
    to: ArrayLike | None,
) -> list[SiteConstraint]:
    """Where the dragged sites are to be at the frame."""
    if (by is None) == (to is None):
        raise ConstraintError("a drag takes either by, how far, or to, where to")
    if not sites or len(set(sites)) < len(sites):
        raise ConstraintError(f"drag one or more different sites: got {', '.join(sites) or 'none'}")
    given = np.asarray(by if to is None else to, dtype=np.float64)
    if given.ndim == 1 and len(sites) == 1:
        given = given[None]
    if given.shape != (len(sites), 3):
        raise ConstraintError(
            f"by or to has shape {given.shape}: give 3 numbers for each of {len(sites)} sites"
        )
    ids = np.array([site_id(motion.model, name) for name in sites])
    if by is not None:
        given = given + site_positions(motion.model, motion.qpos[frame : frame + 1], ids)[0]
    at = np.array([frame])
    return [SiteConstraint(name, at, position) for name, position in zip(sites, given, strict=True)]


__all__ = ["LEVELS", "deformation", "edit_frame"]
