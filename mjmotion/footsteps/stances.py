"""Stances: a foot's stays on one spot, from heel strike to toe-off."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.feet import Foot
from mjmotion.body.kinematics import Pose, site_id
from mjmotion.body.motion import Motion
from mjmotion.exceptions import ContactError
from mjmotion.footsteps.contacts import Contact, contact_mask
from mjmotion.footsteps.pivots import Pivot, find_pivot, foot_yaw
from mjmotion.numerics.rotations import rotate, yaw_quat

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Stance:
    """One foot on one spot.

    Attributes:
      foot: which of the feet.
      heel, toe: frames ``(start, end)`` of its contacts; empty ``(0, 0)`` where there is none.
      heel_off, toe_off: frames within those in which it is off the ground, as of one who rises on
        to the toes and comes down again.
      start, end: all its frames.
      source_pos: (3,) posed site when the foot stands flat on level ground [m].
      source_quat: (4,) the same, wxyz: only a turn about the vertical.
      pivot: how the foot turns meanwhile, where it stands flat in more than one way.
    """

    foot: int
    heel: tuple[int, int]
    toe: tuple[int, int]
    source_pos: Array
    source_quat: Array
    heel_off: tuple[tuple[int, int], ...] = ()
    toe_off: tuple[tuple[int, int], ...] = ()
    pivot: Pivot | None = None

    @property
    def start(self) -> int:
        """First frame."""
        return min(span[0] for span in (self.heel, self.toe) if span[1] > span[0])

    @property
    def end(self) -> int:
        """First frame after."""
        return max(self.heel[1], self.toe[1])


def find_stances(
    motion: Motion, pose: Pose, feet: Sequence[Foot], contacts: Sequence[Contact]
) -> tuple[Stance, ...]:
    """Join each foot's heel and toe contacts into stances, in order of their start.

    Raises:
      ContactError: a contact's site is not one of the feet's.
    """
    known = {f"{foot.side}_{part}" for foot in feet for part in ("heel", "toe")}
    for contact in contacts:
        if contact.site not in known:
            stand = ", ".join(sorted(known))
            raise ContactError(f"contact site '{contact.site}' is no heel or toe: use {stand}")
    stances = []
    for index, foot in enumerate(feet):
        heel = contact_mask(contacts, f"{foot.side}_heel", motion.nframe)
        toe = contact_mask(contacts, f"{foot.side}_toe", motion.nframe)
        edges = np.flatnonzero(np.diff(np.concatenate(([0], heel | toe, [0])).astype(np.int8)))
        for start, end in edges.reshape(-1, 2):
            spans = [_span(mask, start, end) for mask in (heel, toe)]
            flat = heel[start:end] & toe[start:end]
            pivot = find_pivot(foot_yaw(pose, foot, start, end), heel[start:end], toe[start:end])
            if pivot is not None:
                flat &= np.abs(pivot.turn) < 1e-9  # as it first stands
            frames = start + np.flatnonzero(
                flat if flat.any() else heel[start:end] | toe[start:end]
            )
            position, quat = _level_pose(pose, motion, foot, frames, spans)
            off = [_gaps(mask, *span) for mask, span in zip((heel, toe), spans, strict=True)]
            heel_off, toe_off = off
            stances.append(
                Stance(index, spans[0], spans[1], position, quat, heel_off, toe_off, pivot)
            )
    return tuple(sorted(stances, key=lambda stance: (stance.start, stance.foot)))


def contacts_of(stances: Sequence[Stance], feet: Sequence[Foot]) -> tuple[Contact, ...]:
    """Return the contacts of heels and toes that stances are made of, in order of their start."""
    found = [
        Contact(f"{feet[stance.foot].side}_{part}", start, end)
        for stance in stances
        for part, span, off in (
            ("heel", stance.heel, stance.heel_off),
            ("toe", stance.toe, stance.toe_off),
        )
        for start, end in _between(span, off)
        if end > start
    ]
    return tuple(sorted(found, key=lambda contact: (contact.start, contact.site)))


def _span(mask: NDArray[np.bool_], start: int, end: int) -> tuple[int, int]:
    held = start + np.flatnonzero(mask[start:end])
    return (int(held[0]), int(held[-1]) + 1) if len(held) else (0, 0)


def _gaps(mask: NDArray[np.bool_], start: int, end: int) -> tuple[tuple[int, int], ...]:
    """Return the stretches of a span in which a mask does not hold."""
    off = np.concatenate(([0], ~mask[start:end], [0])).astype(np.int8)
    edges = start + np.flatnonzero(np.diff(off)).reshape(-1, 2)
    return tuple((int(first), int(last)) for first, last in edges)


def _between(span: tuple[int, int], off: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return the stretches of a span that are left without some of it."""
    starts = [span[0], *(last for _, last in off)]
    ends = [*(first for first, _ in off), span[1]]
    return list(zip(starts, ends, strict=True))


def _level_pose(
    pose: Pose,
    motion: Motion,
    foot: Foot,
    frames: NDArray[np.int64],
    spans: Sequence[tuple[int, int]],
) -> tuple[Array, Array]:
    """Where the foot stands when put down flat: mean yaw, mean place of the sites that stand."""
    model = motion.model
    heel = pose.site_xpos[frames, site_id(model, f"{foot.side}_heel")]
    toe = pose.site_xpos[frames, site_id(model, f"{foot.side}_toe")]
    along = (toe - heel).sum(axis=0)
    local = foot.toe - foot.heel
    yaw = np.arctan2(along[1], along[0]) - np.arctan2(local[1], local[0])
    quat = yaw_quat(np.asarray(yaw))
    places = []
    for site, local, span in ((heel, foot.heel, spans[0]), (toe, foot.toe, spans[1])):
        held = (frames >= span[0]) & (frames < span[1])
        if held.any():
            places.append(site[held].mean(axis=0) - rotate(quat, local))
    return np.mean(places, axis=0), quat
