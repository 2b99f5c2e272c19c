"""A report in a few lines of HTML, for a notebook: poses, verdict, and what is wrong."""

from __future__ import annotations

import base64
import io

import numpy as np
from numpy.typing import NDArray

from mjmotion.output.report.data import ReportData, residual_text
from mjmotion.output.report.page import escape
from mjmotion.validation.text import number


def summary_html(
    report: ReportData, poses: NDArray[np.uint8] | None, why_no_poses: str = ""
) -> str:
    """Return a part of a page that needs nothing else.

    Args:
      report: what it is about.
      poses: a picture of poses, RGB (height, width, 3), or None.
      why_no_poses: what is written where there is no picture.
    """
    judged, broken = len(report.judged), set(report.broken)
    lines = [
        f"{row.label}: {number(row.value)} {row.unit}, wanted {row.threshold}"
        + (f" ({row.where})" if row.where else "")
        for row in report.validation.summary()
        if row.figure in broken
    ]
    lines += [
        f"not met: {entry['constraint']} at {len(entry['frames'])} frames, off by"
        f" {residual_text(entry)}"
        for entry in report.unmet
    ]
    picture = (
        f"<p>No picture of poses: {escape(why_no_poses)}</p>"
        if poses is None
        else f'<img alt="poses" style="max-width: 100%" src="{_png_url(poses)}">'
    )
    listed = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return (
        f"<div><p><b>{escape(report.title)}</b>:"
        f" {judged - len(broken)} of {judged} figures within thresholds</p>"
        + (f"<ul>{listed}</ul>" if listed else "")
        + f"{picture}</div>"
    )


def png_bytes(picture: NDArray[np.uint8]) -> bytes:
    """Return a picture (height, width, 3) as a PNG file."""
    from PIL import Image  # only where there are pictures

    stream = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(picture, dtype=np.uint8)).save(stream, "PNG")
    return stream.getvalue()


def _png_url(picture: NDArray[np.uint8]) -> str:
    """Return a picture as a URL that holds all of it."""
    return "data:image/png;base64," + base64.b64encode(png_bytes(picture)).decode("ascii")
