"""The timeline as rectangles: where a frame is, what a mouse is on, and what a drag of it means.

    bars = Bars(shown, left=10.0, top=500.0, width=900.0)
    bars.hit((420.0, 530.0))            # Hit("contact", 3, "end")

Plain numbers; the page draws them.
"""

from __future__ import annotations

import dataclasses
from functools import cached_property

from mjmotion.apps.edit.span import Span
from mjmotion.apps.session.edits import Footprint
from mjmotion.editor.shown import Shown
from mjmotion.footsteps.contacts import Contact

ROW = 16.0  # height of a row [pixel]
RULER = 20.0  # height of the ruler at the top, on which the mouse scrubs [pixel]
LABEL = 92.0  # width of the rows' names [pixel]
GRIP = 5.0  # so near to the end of a bar the mouse is on it [pixel]
_MARK = 6.0  # so near to the mark of an edit the mouse is on it [pixel]


@dataclasses.dataclass(frozen=True)
class Hit:
    """What the mouse is on.

    Attributes:
      kind: ``"scrub"``, ``"contact"``, ``"edit"`` or ``"pin"`` (the empty row of pins).
      index: of the contact or edit.
      end: of a contact, ``"start"`` or ``"end"``; "" between.
      frame: at which frame the mouse is.
    """

    kind: str
    index: int = -1
    end: str = ""
    frame: int = 0


@dataclasses.dataclass(frozen=True, eq=False)
class Bars:
    """Where everything is on the timeline.

    Attributes:
      shown: what it is of.
      left, top, width: of the whole [pixel].
    """

    shown: Shown
    left: float
    top: float
    width: float

    @cached_property
    def sites(self) -> tuple[str, ...]:
        """The sites that have contacts, a row each."""
        return tuple(sorted({one.site for one in self.shown.contacts}))

    @property
    def edits_top(self) -> float:
        """Upper edge of the row of edits [pixel]."""
        return self.top + RULER + ROW * len(self.sites)

    @property
    def pins_top(self) -> float:
        """Upper edge of the row of pins [pixel]."""
        return self.edits_top + ROW

    @property
    def bottom(self) -> float:
        """Lower edge [pixel]."""
        return self.pins_top + ROW

    def x(self, frame: float) -> float:
        """Return where a frame begins [pixel]."""
        return self.left + LABEL + (self.width - LABEL) * frame / max(self.shown.nframe, 1)

    def frame(self, x: float) -> int:
        """Return the frame at a pixel, or the nearest."""
        share = (x - self.left - LABEL) / max(self.width - LABEL, 1.0)
        return int(min(max(share * self.shown.nframe, 0.0), self.shown.nframe - 1.0))

    def row(self, site: str) -> float:
        """Return the upper edge of a site's row [pixel]."""
        return self.top + RULER + ROW * self.sites.index(site)

    def mark(self, index: int) -> tuple[float, float]:
        """Return where the mark of an edit is [pixel]."""
        edit = self.shown.edits[index]
        pin = len(range(*edit.frames)) > 1 and not isinstance(edit, Footprint)
        return self.x(edit.frames[0] + 0.5), (self.pins_top if pin else self.edits_top) + ROW / 2

    def hit(self, mouse: tuple[float, float]) -> Hit | None:
        """Return what the mouse is on; None outside."""
        x, y = mouse
        if not (self.left <= x <= self.left + self.width and self.top <= y < self.bottom):
            return None
        at = self.frame(x)
        if y < self.top + RULER:
            return Hit("scrub", frame=at)
        for index in range(len(self.shown.edits)):
            mark_x, mark_y = self.mark(index)
            first, end = self.shown.edits[index].frames
            on = abs(x - mark_x) <= _MARK or self.x(first) <= x <= self.x(end)
            if on and abs(y - mark_y) <= ROW / 2:
                return Hit("edit", index, frame=at)
        if y >= self.pins_top:
            return Hit("pin", frame=at)
        if y >= self.edits_top:
            return Hit("scrub", frame=at)
        return self._contact(x, y, at)

    def _contact(self, x: float, y: float, at: int) -> Hit:
        """Return the contact whose end is nearest to the mouse, the one that it is on, or none."""
        best, found = GRIP, Hit("scrub", frame=at)
        for index, one in enumerate(self.shown.contacts):
            row = self.row(one.site)
            if not row <= y < row + ROW:
                continue
            for name, frame in (("start", one.start), ("end", one.end)):
                if (away := abs(x - self.x(frame))) <= best:
                    best, found = away, Hit("contact", index, name, at)
            if not found.end and self.x(one.start) <= x < self.x(one.end):
                found = Hit("contact", index, "", at)
        return found

    def moved_contact(self, hit: Hit, x: float) -> Contact:
        """Return a contact whose end is dragged to a pixel: never empty, never over its neighbours.

        Its frames stay within the clip.
        """
        one = self.shown.contacts[hit.index]
        others = [
            c for i, c in enumerate(self.shown.contacts) if c.site == one.site and i != hit.index
        ]
        share = (x - self.left - LABEL) / max(self.width - LABEL, 1.0)
        edge = round(share * self.shown.nframe)
        if hit.end == "start":
            low = max([0, *(c.end for c in others if c.end <= one.start)])
            return dataclasses.replace(one, start=min(max(edge, low), one.end - 1))
        high = min([self.shown.nframe, *(c.start for c in others if c.start >= one.end)])
        return dataclasses.replace(one, end=max(min(edge, high), one.start + 1))

    def knots(self, frame: int, length: int = 1) -> tuple[float, ...]:
        """Return where the knots of the first level are [pixel], within the clip."""
        span = Span(frame, self.shown.settings.frames_per_knot, self.shown.nframe, length)
        return tuple(self.x(float(k) + 0.5) for k in span.knots if 0 <= k < self.shown.nframe)

    def reach(self, frame: int, length: int = 1) -> tuple[float, float]:
        """Return from where to where an edit reaches [pixel]."""
        span = Span(frame, self.shown.settings.frames_per_knot, self.shown.nframe, length)
        return self.x(float(span.frames[0])), self.x(float(span.frames[-1]) + 1.0)
