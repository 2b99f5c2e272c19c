"""A plan from above: the walk's way before and after, its footsteps, what is in the way.

svg = plan_svg(plan)
draw_plan("plan.png", plan, candidates)
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator
from html import escape
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mjmotion.boundary.words import harmless
from mjmotion.footsteps.plan import Plan
from mjmotion.numerics.rotations import rotate
from mjmotion.route.shapes import hull

Array = NDArray[np.float64]

LEFT, RIGHT = "#2f7fc1", "#e07b39"
OWN, TAKEN = "#a9adb5", "#26794a"
TALL, LOW, OVERHEAD, CANDIDATE = "#8a4b4b", "#c9b79c", "#9b6bb5", "#c9ced6"
LEGEND = (
    "dashed: the clip's own way; green: the way taken; blue: left foot; orange: right;"
    " dots: where it could stand as well"
)
MARGIN = 0.8  # around the walk [m]
WIDE, HIGH = 1000.0, 1400.0  # of a drawing, at most [units]
_SHARP = 2  # samples of a pixel either way


@dataclasses.dataclass(frozen=True, eq=False)
class Mark:
    """One thing drawn.

    Attributes:
      points: (k, 2) [m].
      colour: of it.
      closed: whether it is an area.
      width: of its line [units]; 0 for none.
      opacity: of an area.
      dashed: whether its line is.
      text: written at the first point.
    """

    points: Array
    colour: str
    closed: bool = False
    width: float = 1.5
    opacity: float = 1.0
    dashed: bool = False
    text: str = ""


@dataclasses.dataclass(frozen=True, eq=False)
class Sheet:
    """What is drawn, and of which part of the plane.

    Attributes:
      marks: from the back to the front.
      low: (2,) its lower left [m].
      high: (2,) its upper right [m].
    """

    marks: tuple[Mark, ...]
    low: Array
    high: Array

    @property
    def scale(self) -> float:
        """Units a metre."""
        width, height = self.high - self.low
        return float(min(WIDE / width, HIGH / height))

    def placed(self, points: Array) -> Array:
        """Return points (k, 2) on the drawing [units], y down."""
        away = (points - self.low) * self.scale
        return np.column_stack((away[:, 0], self.scale * (self.high - self.low)[1] - away[:, 1]))


def plan_sheet(plan: Plan, candidates: Array | None = None) -> Sheet:
    """Return what is to be drawn of a plan.

    Args:
      plan: the plan.
      candidates: (k, 2) other places where feet could stand [m].
    """
    root = plan.source.qpos[:, :2]
    seen = [root] if plan.route is None else [root, plan.route.own]
    seen.append(np.array([one.position[:2] for one in plan.footholds]).reshape(-1, 2))
    every = np.concatenate(seen)
    low, high = every.min(axis=0) - MARGIN, every.max(axis=0) + MARGIN
    marks = list(_grid(low, high))
    for obstacle in plan.obstacles:
        colour = OVERHEAD if obstacle.overhead else TALL if obstacle.tall else LOW
        outline = np.clip(hull(obstacle.points[:, :2]), low - 1.0, high + 1.0)
        marks.append(Mark(outline, colour, True, 0.8, 0.35))
        marks.append(Mark(outline.mean(axis=0)[None], colour, text=obstacle.name))
    if candidates is not None:
        marks += [Mark(point[None], CANDIDATE, True, 0.0) for point in candidates]
    if plan.route is not None:
        marks.append(Mark(plan.route.own, OWN, width=2.0, dashed=True))
        if plan.route.bent:
            marks.append(Mark(plan.route.line, TAKEN, width=2.5))
    marks += _prints(plan)
    corner = np.array(((low[0] + 0.1, high[1] - 0.15),))
    marks.append(Mark(corner, "#5d6570", text=LEGEND))
    return Sheet(tuple(marks), low, high)


def _grid(low: Array, high: Array) -> Iterator[Mark]:
    """Yield a line a metre either way."""
    for axis in (0, 1):
        for at in np.arange(np.ceil(low[axis]), high[axis]):
            ends = np.array((low, high))
            ends[:, axis] = at
            yield Mark(ends, "#dde1e6", width=0.6)
            yield Mark(ends[:1] + 0.04, "#8a8f98", text=f"{at:.0f} m" if axis == 0 else f"{at:.0f}")


def _prints(plan: Plan) -> Iterator[Mark]:
    """Yield a sole for every foothold, with its number."""
    feet = plan.source.character.feet
    for number, (stance, one) in enumerate(zip(plan.stances, plan.footholds, strict=True), 1):
        foot = feet[stance.foot]
        colour = LEFT if foot.side == "left" else RIGHT
        outline = hull((one.position + rotate(one.quat, foot.sole))[:, :2])
        yield Mark(outline, colour, True, 1.0, 0.55)
        yield Mark(one.position[None, :2], colour, text=str(number))


def plan_svg(plan: Plan, candidates: Array | None = None) -> str:
    """Return a drawing of a plan as SVG text."""
    sheet = plan_sheet(plan, candidates)
    width, height = sheet.scale * (sheet.high - sheet.low)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}"'
        f' style="width: 100%; max-width: {width:.0f}px" font-size="12">',
        f'<rect width="{width:.0f}" height="{height:.0f}" fill="#ffffff"/>',
    ]
    for mark in sheet.marks:
        points = sheet.placed(mark.points)
        if mark.text:
            x, y = points[0]
            said = escape(harmless(mark.text))
            parts.append(f'<text x="{x:.1f}" y="{y:.1f}" fill="{mark.colour}">{said}</text>')
        elif len(points) == 1:
            x, y = points[0]
            parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="1.5" fill="{mark.colour}"/>')
        else:
            text = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
            look = f'stroke="{mark.colour}" stroke-width="{mark.width:g}"'
            look += ' stroke-dasharray="6 4"' * mark.dashed
            fill = f'fill="{mark.colour}" fill-opacity="{mark.opacity:g}"'
            fill = fill if mark.closed else 'fill="none"'
            shape = "polygon" if mark.closed else "polyline"
            parts.append(f'<{shape} points="{text}" {fill} {look}/>')
    return "\n".join([*parts, "</svg>"])


def draw_plan(path: str | Path, plan: Plan, candidates: Array | None = None) -> None:
    """Write a drawing of a plan as a PNG file; OSError where that is not possible."""
    from PIL import Image, ImageColor, ImageDraw

    sheet = plan_sheet(plan, candidates)
    size = tuple(int(_SHARP * side) for side in sheet.scale * (sheet.high - sheet.low))
    picture = Image.new("RGB", (max(size[0], 1), max(size[1], 1)), "#ffffff")
    pen = ImageDraw.Draw(picture, "RGBA")
    for mark in sheet.marks:
        points = [(float(x), float(y)) for x, y in _SHARP * sheet.placed(mark.points)]
        colour = ImageColor.getrgb(mark.colour)
        if mark.text:
            pen.text(
                points[0], harmless(mark.text), fill=colour, font_size=12 * _SHARP, anchor="ls"
            )
        elif len(points) == 1:
            x, y = points[0]
            pen.ellipse((x - 3, y - 3, x + 3, y + 3), fill=colour)
        elif mark.closed and len(points) > 2:
            pen.polygon(points, fill=(*colour, int(255 * mark.opacity)), outline=colour)
        else:
            width = max(1, round(_SHARP * mark.width))
            pieces = list(itertools.pairwise(points))
            for number, piece in enumerate(pieces):
                if not mark.dashed or number // 3 % 2 == 0:
                    pen.line(piece, fill=colour, width=width)
    picture.resize(
        (max(size[0] // _SHARP, 1), max(size[1] // _SHARP, 1)), Image.Resampling.LANCZOS
    ).save(path)
