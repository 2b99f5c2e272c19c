"""The plots of the page, as SVG text that takes its ink from the page around it."""

from __future__ import annotations

from typing import Any

import numpy as np

from mjmotion.output.report.chart import UNITS, Panel, Scale, drawing, text_width
from mjmotion.output.report.data import ReportData

# Maximum error after each level on the paper's terrain job, percent of body height.
PAPER_ERROR_PERCENT = (14.31, 9.24, 3.48, 1.06)

_HEEL, _TOE = "#2f7fc1", "#e07b39"
_ADAPTED, _SOURCE = "#2f7fc1", "#a9adb5"
_BAD = "#cf4a4a"
_PALETTE = (_HEEL, _TOE, "#5a9e6f", "#9b6bb5", "#c2a83e", "#4fb0ae")

_WIDE, _HALF = 10.4, 5.6  # of a drawing [inch]
_LEFT, _RIGHT, _ABOVE, _BELOW = 52.0, 8.0, 24.0, 38.0  # around the axes [units of a drawing]
_SMALLEST = 1e-4  # percent: below this a bar would only show rounding
_LEAST_AXIS = 1.0  # of penetration, so that rounding does not fill the plot [mm]


def foot_heights(report: ReportData) -> str:
    """Plot every foot's heel and toe over the ground under them, contacts shaded."""
    figures, model = report.validation, report.motion.model
    sites = [key.removeprefix("height_m/") for key in figures.per_frame if key[:9] == "height_m/"]
    feet: dict[str, list[str]] = {}
    for site in sites:
        body = int(model.site_bodyid[model.site(site).id])
        feet.setdefault(model.body(body).name, []).append(site)
    if not feet:
        return ""
    time = np.arange(figures.nframe) / figures.fps
    lines = [figures.per_frame[f"{kind}/{s}"] for s in sites for kind in ("height_m", "ground_m")]
    across, up = Scale.around(time, 0.005), Scale.around(np.array(lines))
    height = 2.3 * len(feet) + 0.4
    each = (UNITS * height - _BELOW) / len(feet)
    panels = []
    for row, (foot, names) in enumerate(feet.items()):
        panel = Panel(
            across.within(_LEFT, UNITS * _WIDE - _RIGHT),
            up.within((row + 1) * each - 4.0, row * each + _ABOVE),
        )
        for colour, site in zip(_PALETTE, names, strict=False):
            for start, end in _runs(figures.per_frame[f"contact/{site}"]):
                panel.band(time[start], time[end - 1], colour, 0.13)
            panel.line(time, figures.per_frame[f"height_m/{site}"], colour, site)
            ground = figures.per_frame[f"ground_m/{site}"]
            panel.line(time, ground, colour, f"ground under {site}", width=1.0, dash="2 2")
        panel.number_axis_y("height [m]")
        panel.number_axis_x("time [s]" if row == len(feet) - 1 else "")
        panel.title(foot.replace("_", " "))
        panel.legend(right=True, size=8.0)
        panels.append(panel)
    return drawing(panels, _WIDE, height)


def residuals(report: ReportData) -> str:
    """Plot the greatest error after each level, next to the paper's."""
    if not report.levels:
        return ""
    names = [f"{level['frames_per_knot']:g}" for level in report.levels]
    errors = [float(level["max_error_percent"]) for level in report.levels]
    if report.exact_error_percent is not None:
        names.append("exact pass")
        errors.append(float(report.exact_error_percent))
    place = np.arange(len(names))
    shown = np.maximum(errors, _SMALLEST)
    width, height = _HALF, 3.2
    low = _SMALLEST / 2
    panel = Panel(
        Scale(-0.5, len(names) - 0.5).within(_LEFT, UNITS * width - _RIGHT),
        Scale(low, max([*shown, 20.0]) * 2, log=True).within(UNITS * height - _BELOW, _ABOVE),
    )
    sides = np.column_stack((place - 0.275, place + 0.275))
    panel.boxes(sides, [(low, value) for value in shown], _ADAPTED, "this fit")
    # The paper's levels are 16, 8, 4 and 2 frames a knot: only those are next to each other.
    paper = [
        (i, PAPER_ERROR_PERCENT[k])
        for k, knots in enumerate((16.0, 8.0, 4.0, 2.0))
        for i, level in enumerate(report.levels)
        if float(level["frames_per_knot"]) == knots
    ]
    if paper:
        label = "Lee and Shin 1999, their terrain job"
        levels, percent = np.array(paper).T
        panel.line(levels, percent, _TOE, label, dots=5.0)
    for middle, top, error in zip(panel.x(place), panel.y(shown), errors, strict=True):
        text = f"{error:.2g}" if error >= _SMALLEST else f"under {_SMALLEST:g}"
        inside = error >= 10 * _SMALLEST  # out of the way of the paper's line
        colour = "white" if inside else ""
        panel.note(text, middle, top + (13.0 if inside else -3.0), colour, anchor="middle")
    panel.axis_x([(float(i), name) for i, name in enumerate(names)], "frames a knot", grid=False)
    panel.number_axis_y("greatest error [% of height]")
    panel.legend()
    return drawing([panel], width, height)


def drifts(report: ReportData) -> str:
    """Plot the drift of every contact over the time that it lasts."""
    entries = report.validation.per_contact
    if not entries:
        return ""
    limit = report.validation.thresholds.get("stance_drift_mm")
    limit = limit if isinstance(limit, float) else None
    fps = report.validation.fps
    spans = [(entry["start"] / fps, entry["end"] / fps) for entry in entries]
    drift = [float(entry["drift_mm"]) for entry in entries]
    panel = _time_panel(
        Scale.around(spans, 0.005),
        np.array([*drift, 0.0 if limit is None else limit]),
        2.6,
        "drift [mm]",
    )
    for i, site in enumerate(sorted({entry["site"] for entry in entries})):
        mine = [k for k, entry in enumerate(entries) if entry["site"] == site]
        panel.boxes(
            [spans[k] for k in mine],
            [(0.0, drift[k]) for k in mine],
            _PALETTE[i % len(_PALETTE)],
            site,
            opacity=0.55,
        )
    if limit is not None:
        panel.line([panel.x.low, panel.x.high], [limit] * 2, _BAD, width=1.0, dash="4 3")
        panel.note(f"threshold {limit:g} mm", panel.x.end, float(panel.y(limit)) - 3.0, _BAD)
    panel.legend()
    return drawing([panel], _WIDE, 2.6)


def penetrations(report: ReportData) -> str:
    """Plot how deep feet and other bodies are in the scene over time."""
    figures = report.validation
    time = np.arange(figures.nframe) / figures.fps
    soles = figures.per_frame["sole_penetration_mm"]
    bodies = figures.per_frame["obstacle_penetration_mm"]
    deep = np.array([*soles, *bodies, _LEAST_AXIS / 1.05])
    panel = _time_panel(Scale.around(time, 0.005), deep, 2.2, "penetration [mm]")
    panel.line(time, soles, _ADAPTED, "soles")
    panel.line(time, bodies, _BAD, "all other bodies")
    panel.legend()
    return drawing([panel], _WIDE, 2.2)


def jerks(report: ReportData) -> str:
    """Plot the RMS jerk of every joint, adapted next to source."""
    joints = report.validation.per_joint
    if not joints:
        return ""
    names = [name.replace("_", " ") for name in joints]
    width, height = _HALF, 0.8 + 0.24 * max(len(joints), 3)
    left = 12.0 + text_width("n" * max(len(name) for name in names))
    values = np.array(list(joints.values()), dtype=np.float64)
    panel = Panel(
        _from_zero(values[:, :2]).within(left, UNITS * width - _RIGHT),
        Scale(-0.6, len(joints) - 0.4).within(UNITS * height - _BELOW, _ABOVE),
    )
    place = np.arange(len(joints))[::-1]
    for offset, column, colour, label in (
        (0.2, 1, _SOURCE, "source"),
        (-0.2, 0, _ADAPTED, "adapted"),
    ):
        middle = place + offset
        ends = np.column_stack((np.zeros(len(joints)), values[:, column]))
        panel.boxes(ends, np.column_stack((middle - 0.19, middle + 0.19)), colour, label)
    panel.axis_y([(float(i), name) for i, name in zip(place, names, strict=True)], grid=False)
    panel.number_axis_x("RMS jerk [rad/s³]")
    panel.legend()
    return drawing([panel], width, height)


def _time_panel(time: Scale, values: Any, height: float, label: str) -> Panel:
    """Return a wide chart over time of values that start at 0, with its axes."""
    panel = Panel(
        time.within(_LEFT, UNITS * _WIDE - _RIGHT),
        _from_zero(values).within(UNITS * height - _BELOW, _ABOVE),
    )
    panel.number_axis_y(label)
    panel.number_axis_x("time [s]")
    return panel


def _from_zero(values: Any) -> Scale:
    """Return a scale from 0 to a bit over the greatest finite value."""
    most = float(np.max(values, initial=0.0, where=np.isfinite(values)))
    return Scale(0.0, 1.05 * most if most > 0.0 else 1.0)


def _runs(held: Any) -> list[tuple[int, int]]:
    """Return the first frame and the one past the last of every stretch of True."""
    edge = np.flatnonzero(np.diff(np.concatenate(([False], held, [False])).astype(np.int8)))
    return [(int(start), int(end)) for start, end in edge.reshape(-1, 2)]
