"""The plots of the page, as SVG text that takes its ink from the page around it."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mjmotion.output.report.data import ReportData
from mjmotion.output.report.style import axes_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# Maximum error after each level on the paper's terrain job, percent of body height.
PAPER_ERROR_PERCENT = (14.31, 9.24, 3.48, 1.06)

_INK = "#010203"  # stands for the page's own text colour
_HEEL, _TOE = "#2f7fc1", "#e07b39"
_ADAPTED, _SOURCE = "#2f7fc1", "#a9adb5"
_BAD = "#cf4a4a"
_STYLE: dict[str, Any] = {
    **axes_style(_INK),
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    "lines.linewidth": 1.4,
}


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

    def draw(figure: Figure) -> None:
        rows = figure.subplots(len(feet), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        for axes, (foot, names) in zip(rows, feet.items(), strict=True):
            for colour, site in zip((_HEEL, _TOE, "#5a9e6f", "#9b6bb5"), names, strict=False):
                held = figures.per_frame[f"contact/{site}"]
                axes.plot(time, figures.per_frame[f"height_m/{site}"], color=colour, label=site)
                axes.plot(
                    time,
                    figures.per_frame[f"ground_m/{site}"],
                    color=colour,
                    linestyle=(0, (2, 2)),
                    linewidth=1.0,
                    label=f"ground under {site}",
                )
                for start, end in _runs(held):
                    axes.axvspan(time[start], time[end - 1], color=colour, alpha=0.13, linewidth=0)
            axes.set_ylabel("height [m]")
            axes.set_title(foot.replace("_", " "), loc="left", fontsize=10)
            axes.legend(ncols=4, fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 0.98))
            axes.margins(x=0.005)
        rows[-1].set_xlabel("time [s]")

    return _svg(draw, (10.4, 2.3 * len(feet) + 0.4), "feet")


def residuals(report: ReportData) -> str:
    """Plot the greatest error after each level, next to the paper's."""
    if not report.levels:
        return ""
    names = [f"{level['frames_per_knot']:g}" for level in report.levels]
    errors = [float(level["max_error_percent"]) for level in report.levels]
    if report.exact_error_percent is not None:
        names.append("exact pass")
        errors.append(float(report.exact_error_percent))
    smallest = 1e-4  # percent: below this a bar would only show rounding

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        place = np.arange(len(names))
        shown = np.maximum(errors, smallest)
        bars = axes.bar(place, shown, width=0.55, color=_ADAPTED, label="this fit", bottom=0)
        for bar, error in zip(bars, errors, strict=True):
            text = f"{error:.2g}" if error >= smallest else f"under {smallest:g}"
            middle = bar.get_x() + bar.get_width() / 2
            inside = error >= 10 * smallest  # out of the way of the paper's line
            axes.annotate(
                text,
                (middle, max(error, smallest)),
                xytext=(0, -14 if inside else 3),
                textcoords="offset points",
                ha="center",
                fontsize=9,
                color="white" if inside else _INK,
            )
        # The paper's levels are 16, 8, 4 and 2 frames a knot: only those are next to each other.
        paper = [
            (i, PAPER_ERROR_PERCENT[k])
            for k, knots in enumerate((16.0, 8.0, 4.0, 2.0))
            for i, level in enumerate(report.levels)
            if float(level["frames_per_knot"]) == knots
        ]
        if paper:
            axes.plot(
                *zip(*paper, strict=True),
                color=_TOE,
                marker="o",
                markersize=5,
                label="Lee and Shin 1999, their terrain job",
            )
        axes.set_yscale("log")
        axes.set_ylim(smallest / 2, max([*shown, 20.0]) * 2)
        axes.set_xticks(place, names)
        axes.grid(False, axis="x")
        axes.set_xlabel("frames a knot")
        axes.set_ylabel("greatest error [% of height]")
        axes.legend(fontsize=9, loc="lower left", bbox_to_anchor=(0, 0.98), ncols=2)

    return _svg(draw, (5.6, 3.2), "levels")


def drifts(report: ReportData) -> str:
    """Plot the drift of every contact over the time that it lasts."""
    entries = report.validation.per_contact
    if not entries:
        return ""
    limit = report.validation.thresholds.get("stance_drift_mm")
    fps = report.validation.fps

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        sites = sorted({entry["site"] for entry in entries})
        palette = (_HEEL, _TOE, "#5a9e6f", "#9b6bb5", "#c2a83e", "#4fb0ae")
        for i, site in enumerate(sites):
            mine = [entry for entry in entries if entry["site"] == site]
            span = [(entry["end"] - entry["start"]) / fps for entry in mine]
            axes.bar(
                [entry["start"] / fps for entry in mine],
                [entry["drift_mm"] for entry in mine],
                width=span,
                align="edge",
                color=palette[i % len(palette)],
                alpha=0.55,
                label=site,
            )
        if isinstance(limit, float):
            axes.axhline(limit, color=_BAD, linewidth=1.0, linestyle=(0, (4, 3)))
            axes.annotate(
                f"threshold {limit:g} mm",
                (1.0, limit),
                xycoords=("axes fraction", "data"),
                xytext=(0, 3),
                textcoords="offset points",
                ha="right",
                fontsize=9,
                color=_BAD,
            )
        axes.set_xlabel("time [s]")
        axes.set_ylabel("drift [mm]")
        axes.margins(x=0.005)
        axes.legend(fontsize=9, ncols=4, loc="lower left", bbox_to_anchor=(0, 0.98))

    return _svg(draw, (10.4, 2.6), "drift")


def penetrations(report: ReportData) -> str:
    """Plot how deep feet and other bodies are in the scene over time."""
    figures = report.validation
    time = np.arange(figures.nframe) / figures.fps

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for colour, name, label in (
            (_ADAPTED, "sole_penetration_mm", "soles"),
            (_BAD, "obstacle_penetration_mm", "all other bodies"),
        ):
            axes.plot(time, figures.per_frame[name], color=colour, label=label)
        axes.set_xlabel("time [s]")
        axes.set_ylabel("penetration [mm]")
        axes.set_ylim(bottom=0, top=max(axes.get_ylim()[1], 1.0))
        axes.margins(x=0.005)
        axes.legend(fontsize=9, ncols=2, loc="lower left", bbox_to_anchor=(0, 0.98))

    return _svg(draw, (10.4, 2.2), "penetration")


def jerks(report: ReportData) -> str:
    """Plot the RMS jerk of every joint, adapted next to source."""
    joints = report.validation.per_joint
    if not joints:
        return ""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        place = np.arange(len(joints))[::-1]
        for offset, column, colour, label in (
            (0.2, 1, _SOURCE, "source"),
            (-0.2, 0, _ADAPTED, "adapted"),
        ):
            axes.barh(
                place + offset,
                [values[column] for values in joints.values()],
                height=0.38,
                color=colour,
                label=label,
            )
        axes.set_yticks(place, [name.replace("_", " ") for name in joints])
        axes.grid(False, axis="y")
        axes.set_xlabel("RMS jerk [rad/s³]")
        axes.set_ylim(-0.6, len(joints) - 0.4)
        axes.legend(fontsize=9, ncols=2, loc="lower left", bbox_to_anchor=(0, 0.99))

    return _svg(draw, (5.6, 0.8 + 0.24 * max(len(joints), 3)), "jerk")


def _runs(held: Any) -> list[tuple[int, int]]:
    """Return the first frame and the one past the last of every stretch of True."""
    edge = np.flatnonzero(np.diff(np.concatenate(([False], held, [False])).astype(np.int8)))
    return [(int(start), int(end)) for start, end in edge.reshape(-1, 2)]


def _svg(draw: Any, size: Sequence[float], salt: str) -> str:
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    style: Any = {**_STYLE, "svg.hashsalt": salt}
    with rc_context(style):
        figure = Figure(figsize=(size[0], size[1]), layout="constrained")
        FigureCanvasSVG(figure)
        draw(figure)
        stream = io.StringIO()
        figure.savefig(stream, format="svg", metadata={"Date": None}, bbox_inches="tight")
    text = stream.getvalue()
    text = text[text.index("<svg") :].replace(_INK, "currentColor")
    # Names of parts must differ between the plots of one page, and the size is the page's to give.
    text = re.sub(r'(id="|url\(#|href="#)', rf"\g<1>{salt}-", text)
    width = round(size[0] * 96)
    tag = text[: text.index(">")]
    view = re.search(r'viewBox="[^"]*"', tag)
    assert view is not None
    opening = (
        f'<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
        f' {view.group()} style="width: 100%; max-width: {width}px"'
    )
    # The page's own typeface; the size is in the units of the drawing.
    return opening + re.sub(r"font: ([\d.]+px) [^;\"]*", r"font-size: \1", text[len(tag) :])
