"""The part of a clip that an edit can see: its span, cut out and put back.

window = Window.of(motion, contacts, span, pinned)
window.motion, window.contacts, window.span, window.pinned     # of those frames alone
whole, contacts = window.put_back(edited, held_contacts)

An edit costs what its span costs, however long the clip is, and the frames outside stay to the bit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.edit.span import Span
from mjmotion.body.motion import Motion
from mjmotion.constraints import SiteConstraint
from mjmotion.footsteps.contacts import Contact, contact_mask


@dataclasses.dataclass(frozen=True, eq=False)
class Window:
    """The frames from ``low`` up to ``high`` of a clip, counted from 0.

    Attributes:
      whole: the clip.
      all_contacts: its contacts.
      low, high: first frame, and first after.
      motion: those frames.
      contacts: what of the contacts lies within.
      span: the edit's span.
      pinned: what of earlier constraints lies within.
    """

    whole: Motion
    all_contacts: tuple[Contact, ...]
    low: int
    high: int
    motion: Motion
    contacts: tuple[Contact, ...]
    span: Span
    pinned: tuple[SiteConstraint, ...]

    @classmethod
    def of(
        cls,
        motion: Motion,
        contacts: Sequence[Contact],
        span: Span,
        pinned: Sequence[SiteConstraint] = (),
    ) -> Window:
        """Cut a span out, with its outermost knots."""
        low = max(0, int(span.knots[0]))
        high = min(motion.nframe, int(span.knots[-1]) + 1)
        within = tuple(
            dataclasses.replace(one, start=max(one.start, low) - low, end=min(one.end, high) - low)
            for one in contacts
            if one.start < high and one.end > low
        )
        part = dataclasses.replace(span, frame=span.frame - low, nframe=high - low)
        return cls(
            motion,
            tuple(contacts),
            low,
            high,
            motion.put(motion.qpos[low:high]),
            within,
            part,
            tuple(one for old in pinned if (one := _within(old, low, high)) is not None),
        )

    def constraints(self, asked: Sequence[SiteConstraint]) -> list[SiteConstraint]:
        """Return constraints of the clip as those of the window; they lie within."""
        return [dataclasses.replace(one, frames=one.frames - self.low) for one in asked]

    def whole_constraints(self, asked: Sequence[SiteConstraint]) -> list[SiteConstraint]:
        """Return constraints of the window as those of the clip."""
        return [dataclasses.replace(one, frames=one.frames + self.low) for one in asked]

    def put_back(
        self, edited: Motion, contacts: Sequence[Contact]
    ) -> tuple[Motion, tuple[Contact, ...]]:
        """Return the clip with the window's frames, and contacts, in place of its own."""
        qpos = np.array(self.whole.qpos)
        qpos[self.low : self.high] = edited.qpos
        if tuple(contacts) == self.contacts:
            return self.whole.put(qpos), self.all_contacts
        sites = {one.site for one in (*self.all_contacts, *contacts)}
        found = []
        for site in sorted(sites):
            mask = contact_mask(self.all_contacts, site, self.whole.nframe)
            mask[self.low : self.high] = contact_mask(contacts, site, edited.nframe)
            found += _runs(site, mask)
        return self.whole.put(qpos), tuple(sorted(found, key=lambda one: (one.start, one.site)))


def _within(one: SiteConstraint, low: int, high: int) -> SiteConstraint | None:
    inside = (one.frames >= low) & (one.frames < high)
    if one.position is None or not inside.any():
        return None
    return dataclasses.replace(one, frames=one.frames[inside] - low, position=one.position[inside])


def _runs(site: str, mask: NDArray[np.bool_]) -> list[Contact]:
    edges = np.flatnonzero(np.diff(np.concatenate(([0], mask, [0])).astype(np.int8)))
    return [Contact(site, int(start), int(end)) for start, end in edges.reshape(-1, 2)]
