"""Charts as SVG text, with no library: the page needs lines, bars and bands, and at once.

matplotlib takes a second to load and to draw the page's five plots, a third of a whole run.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.boundary.words import harmless

Array = NDArray[np.float64]

UNITS = 72  # of a drawing, an inch; all sizes below are in these units
SIZE, SMALL = 10.5, 9.0  # of letters
_LETTER = 0.6  # mean width of a letter or digit over its size, on the wide side
_GRID = 'stroke="#8a8f98" stroke-opacity="0.25" stroke-width="0.6"'
_AXIS = 'stroke="currentColor" stroke-width="0.6" stroke-linecap="square"'
_MARK = 'stroke="currentColor" stroke-width="0.8"'
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_TICK, _GAP = 3.5, 3.5  # length of a tick, and from it to its number
_POINTS = 2.0  # of a line, a unit, at most


def text_width(text: str, size: float = SIZE) -> float:
    """Return about how wide a text is: which typeface shows it is the reader's."""
    return _LETTER * size * len(text)


@dataclasses.dataclass(frozen=True)
class Scale:
    """One axis: which numbers lie where.

    Attributes:
      low: the number at ``start``.
      high: the number at ``end``.
      start: where it begins in the drawing.
      end: where it ends.
      log: whether equal ratios are equally long.
    """

    low: float
    high: float
    start: float = 0.0
    end: float = 0.0
    log: bool = False

    @classmethod
    def around(cls, values: ArrayLike, margin: float = 0.05) -> Scale:
        """Return a scale from the least to the greatest finite value, and a share more."""
        numbers: Array = np.asarray(values, dtype=np.float64)
        numbers = numbers[np.isfinite(numbers)]
        low, high = (float(numbers.min()), float(numbers.max())) if numbers.size else (0.0, 1.0)
        if high - low < 1e-9 * max(abs(low), abs(high), 1e-3):
            low, high = low - 0.05 * max(abs(low), 1.0), high + 0.05 * max(abs(high), 1.0)
        more = margin * (high - low)
        return cls(low - more, high + more)

    def within(self, start: float, end: float) -> Scale:
        """Return the same numbers at another place."""
        return dataclasses.replace(self, start=start, end=end)

    def __call__(self, values: ArrayLike) -> Array:
        """Return where numbers lie."""
        numbers: Array = np.asarray(values, dtype=np.float64)
        low, high = self.low, self.high
        if self.log:
            numbers = np.log10(np.maximum(numbers, 1e-300))
            low, high = float(np.log10(low)), float(np.log10(high))
        return np.asarray(self.start + (numbers - low) / (high - low) * (self.end - self.start))

    def ticks(self, most: int) -> list[tuple[float, str]]:
        """Return at most about ``most`` round numbers and their text."""
        if self.log:
            powers = range(int(np.ceil(np.log10(self.low))), int(np.log10(self.high)) + 1)
            every = -(-len(powers) // max(most, 1))
            return [(10.0**n, "10" + str(n).translate(_RAISED)) for n in powers[::every]]
        rough = (self.high - self.low) / max(most, 1)
        power = 10.0 ** np.floor(np.log10(rough))
        step = float(next(s for s in (1, 2, 2.5, 5, 10) if s * power >= rough * (1 - 1e-9)) * power)
        digits = next((d for d in range(12) if abs(round(step, d) - step) < 1e-6 * step), 12)
        numbers = np.arange(np.ceil(self.low / step - 1e-9), self.high / step + 1e-9) * step
        return [(float(n), f"{n + 0.0:.{digits}f}".replace("-", "−")) for n in numbers]


class Panel:
    """One chart: axes on two sides, a faint grid, what is drawn on them, and a legend above.

    Args:
      x: across; placed in the drawing.
      y: up; placed in the drawing: it starts at the bottom.
    """

    def __init__(self, x: Scale, y: Scale) -> None:
        self.x, self.y = x, y
        self._back: list[str] = []
        self._front: list[str] = []
        self._words: list[str] = []
        self._legend: list[tuple[str, str]] = []

    def line(
        self,
        x: ArrayLike,
        y: ArrayLike,
        colour: str,
        label: str = "",
        *,
        width: float = 1.4,
        dash: str = "",
        dots: float = 0.0,
    ) -> None:
        """Draw a line through points; it is broken where one is not finite.

        Args:
          x: of the points.
          y: of the points.
          colour: of the line.
          label: in the legend; none without.
          width: of the line.
          dash: lengths of dashes and gaps.
          dots: diameter of a dot on every point.
        """
        look = f'fill="none" stroke="{colour}" stroke-width="{width:g}" stroke-linejoin="round"'
        look += f' stroke-dasharray="{dash}"' if dash else ""
        across, up = self.x(x), self.y(y)
        self._front.append(f'<path d="{_path(across, up)}" {look}/>')
        key = f'<path d="M0 0H20" {look}/>'
        if dots:
            spot = f'r="{dots / 2:g}" fill="{colour}"/>'
            places = zip(across, up, strict=True)
            self._front += [f'<circle cx="{a:.2f}" cy="{b:.2f}" {spot}' for a, b in places]
            key += f'<circle cx="10" cy="0" {spot}'
        if label:
            self._legend.append((key, label))

    def boxes(
        self,
        across: ArrayLike,
        up: ArrayLike,
        colour: str,
        label: str = "",
        *,
        opacity: float = 1.0,
    ) -> None:
        """Draw boxes, behind the lines.

        Args:
          across: (n, 2) from where to where.
          up: (n, 2) from which height to which.
          colour: of all of them.
          label: in the legend; none without.
          opacity: of all of them.
        """
        look = f'fill="{colour}"' + (f' fill-opacity="{opacity:g}"' if opacity < 1.0 else "")
        rows = np.hstack((np.sort(self.x(across)), np.sort(self.y(up))))
        for left, right, top, bottom in rows:
            if np.isfinite(left + right + top + bottom):
                self._back.append(
                    f'<path d="M{left:.2f} {top:.2f}H{right:.2f}V{bottom:.2f}H{left:.2f}z" {look}/>'
                )
        if label:
            self._legend.append((f'<path d="M0 -3.5H20V3.5H0z" {look}/>', label))

    def band(self, start: float, end: float, colour: str, opacity: float) -> None:
        """Shade all heights between two numbers across."""
        self.boxes([(start, end)], [(self.y.low, self.y.high)], colour, opacity=opacity)

    def title(self, text: str) -> None:
        """Write what this chart is of above it, at the left."""
        self._words.append(write(text, self.x.start, self.y.end - 6.0, 10.0, "start"))

    def note(
        self, text: str, x: float, y: float, colour: str, size: float = SMALL, anchor: str = "end"
    ) -> None:
        """Write at a place of the drawing."""
        self._words.append(write(text, x, y, size, anchor, colour))

    def number_axis_x(self, label: str = "", *, grid: bool = True) -> None:
        """Draw the axis at the bottom with round numbers, and these as text if it has a label."""
        ticks = self.x.ticks(int((self.x.end - self.x.start) / (5 * SIZE)))
        self.axis_x([(at, text if label else "") for at, text in ticks], label, grid=grid)

    def axis_x(self, ticks: Sequence[tuple[float, str]], label: str, *, grid: bool) -> None:
        """Draw the axis at the bottom with ticks at numbers, what each says, and a label."""
        low, base = self.y.end, self.y.start
        for place, (_, text) in zip(self.x([at for at, _ in ticks]), ticks, strict=True):
            if grid:
                self._back.insert(0, f'<path d="M{place:.2f} {base:.2f}V{low:.2f}" {_GRID}/>')
            self._words.append(f'<path d="M{place:.2f} {base:.2f}v{_TICK}" {_MARK}/>')
            self._words.append(write(text, place, base + _TICK + _GAP + 0.76 * SIZE))
        self._words.append(f'<path d="M{self.x.start:.2f} {base:.2f}H{self.x.end:.2f}" {_AXIS}/>')
        middle = (self.x.start + self.x.end) / 2
        self._words.append(write(label, middle, base + 2 * (_TICK + SIZE) + 2))

    def number_axis_y(self, label: str) -> None:
        """Draw the axis at the left with round numbers, and a label at the drawing's edge."""
        ticks = self.y.ticks(int((self.y.start - self.y.end) / (2.2 * SIZE)))
        self.axis_y(ticks, grid=True)
        y = (self.y.start + self.y.end) / 2
        self._words.append(write(label, 1.2 * SIZE, y, turned=True))

    def axis_y(self, ticks: Sequence[tuple[float, str]], *, grid: bool) -> None:
        """Draw the axis at the left with ticks at numbers and what each says."""
        left = self.x.start
        for place, (_, text) in zip(self.y([at for at, _ in ticks]), ticks, strict=True):
            if grid:
                self._back.insert(
                    0, f'<path d="M{left:.2f} {place:.2f}H{self.x.end:.2f}" {_GRID}/>'
                )
            self._words.append(f'<path d="M{left:.2f} {place:.2f}h{-_TICK}" {_MARK}/>')
            self._words.append(write(text, left - _TICK - _GAP, place + 0.36 * SIZE, anchor="end"))
        self._words.append(f'<path d="M{left:.2f} {self.y.start:.2f}V{self.y.end:.2f}" {_AXIS}/>')

    def legend(self, *, right: bool = False, size: float = SMALL) -> None:
        """Name all lines and boxes that have a label, in a row above, from the left or right."""
        widths = [26.0 + text_width(label, size) + 12.0 for _, label in self._legend]
        x = self.x.end - sum(widths) + 12.0 if right else self.x.start + 4.0
        y = self.y.end - 9.0
        for (key, label), width in zip(self._legend, widths, strict=True):
            self._words.append(f'<g transform="translate({x:.2f} {y - 0.36 * size:.2f})">{key}</g>')
            self._words.append(write(label, x + 26.0, y, size, "start"))
            x += width

    def svg(self) -> str:
        """Return all that was drawn."""
        return "\n".join([*self._back, *self._front, *self._words])


def drawing(panels: Sequence[Panel], width: float, height: float) -> str:
    """Return a drawing that is ``width`` × ``height`` inches on the page at most, as SVG."""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {UNITS * width:g}'
        f' {UNITS * height:g}" style="width: 100%; max-width: {96 * width:.0f}px"'
        f' font-size="{SIZE:g}" fill="currentColor">\n'
        + "\n".join(panel.svg() for panel in panels)
        + "\n</svg>"
    )


def write(
    text: str,
    x: float,
    y: float,
    size: float = SIZE,
    anchor: str = "middle",
    colour: str = "",
    *,
    turned: bool = False,
) -> str:
    """Return a text whose base line is at a place."""
    if not text:
        return ""
    look = f' font-size="{size:g}"' if size != SIZE else ""
    look += f' fill="{colour}"' if colour else ""
    look += f' transform="rotate(-90 {x:.2f} {y:.2f})"' if turned else ""
    said = escape(harmless(text))
    return f'<text x="{x:.2f}" y="{y:.2f}" text-anchor="{anchor}"{look}>{said}</text>'


def _path(x: Array, y: Array) -> str:
    """Return a line through points as SVG's ``d``, with a gap where one is not finite."""
    good = np.isfinite(x) & np.isfinite(y)
    x, y, good = _thinned(x, y, good)
    starts = good & ~np.r_[False, good[:-1]]
    points = zip(x[good], y[good], starts[good], strict=True)
    return "".join(f"{'M' if start else 'L'}{a:.2f} {b:.2f}" for a, b, start in points)


def _thinned(x: Array, y: Array, good: Any) -> tuple[Array, Array, Any]:
    """Return points without those that nobody would see: of many close ones, lowest and highest."""
    span = float(np.ptp(x[good])) if good.any() else 0.0
    together = int(2 * len(x) / max(_POINTS * span, 1.0))
    if together < 4 or not good.all():
        return x, y, good
    kept = [0, len(x) - 1]
    for start in range(0, len(x), together):
        part = y[start : start + together]
        kept += [start + int(np.argmin(part)), start + int(np.argmax(part))]
    some = np.unique(kept)
    return x[some], y[some], good[some]
