"""The range of an edit and its growth with the knots (Figure 2), as a picture.

write_ranges("edit.png", {4: edit_4, 6: edit_6, 12: edit_12}, frame=60)
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mjmotion.apps.edit import Span, deformation
from mjmotion.exceptions import OutputError
from mjmotion.output.report.style import axes_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from mjmotion.output.result import Result

_CURVE, _RANGE, _KNOT, _INK = "#2f7fc1", "#2f7fc1", "#e07b39", "#2b2f36"
_STYLE: Any = {**axes_style(_INK), "lines.linewidth": 1.6}


def write_ranges(path: str | Path, edits: Mapping[int, Result], frame: int) -> Path:
    """Draw how far every frame was moved, one row an edit, with the seven knots of each.

    Args:
      path: picture to write (.png, .svg, .pdf).
      edits: frames between the knots of the first level, to what the same edit came to with them.
      frame: the edited frame.

    Returns:
      The path.

    Raises:
      OutputError: the picture cannot be written.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    spans = {knots: Span(frame, knots, e.motion.nframe) for knots, e in edits.items()}
    widest = spans[max(spans)]
    low = max(0, int(widest.knots[0]) - widest.frames_per_knot)
    high = min(widest.nframe - 1, int(widest.knots[-1]) + widest.frames_per_knot)
    with rc_context(_STYLE):
        figure = Figure(figsize=(8.4, 0.9 + 1.6 * len(edits)), layout="constrained")
        FigureCanvasAgg(figure)
        rows = figure.subplots(len(edits), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        for axes, (knots, edited) in zip(rows, sorted(edits.items()), strict=True):
            _draw(axes, spans[knots], 100.0 * deformation(edited))
        rows[0].set_xlim(low, high)
        rows[0].set_ylim(bottom=0.0)
        rows[0].legend(fontsize=9, loc="upper left")
        rows[-1].set_xlabel("frame")
        figure.supylabel("largest move of a body [cm]", fontsize=10.5)
        try:
            figure.savefig(path, dpi=130, facecolor="white")
        except OSError as error:
            raise OutputError(f"cannot write '{path}': {error.strerror or error}") from error
    return Path(path)


def _draw(axes: Axes, span: Span, size: np.ndarray) -> None:
    frames = np.arange(span.nframe)
    axes.axvspan(
        span.knots[0], span.knots[-1], color=_RANGE, alpha=0.10, linewidth=0, label="range"
    )
    axes.plot(frames, size, color=_CURVE, marker=".", markersize=4, label="deformation")
    axes.plot(
        span.knots,
        np.zeros(len(span.knots)),
        color=_KNOT,
        marker="|",
        markersize=14,
        markeredgewidth=1.6,
        linestyle="",
        clip_on=False,
        zorder=3,
        label="the seven knots",
    )
    moved = span.frames
    axes.set_title(
        f"a knot every {span.frames_per_knot} frames: {len(moved)} frames change,"
        f" {moved[0]} to {moved[-1]}",
        loc="left",
        fontsize=10,
    )
