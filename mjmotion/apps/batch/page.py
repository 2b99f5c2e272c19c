"""The page of a batch: one HTML file; what is drawn is in it."""

from __future__ import annotations

import base64
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mjmotion.apps.batch.jobs import Source
from mjmotion.apps.batch.making import composed_at
from mjmotion.apps.batch.rows import Row
from mjmotion.apps.batch.shards import copy_files
from mjmotion.apps.batch.storage import Storage
from mjmotion.apps.batch.summary import Spread, Summary
from mjmotion.body.character import Character
from mjmotion.body.motion import Motion
from mjmotion.boundary.words import first_line
from mjmotion.exceptions import MotionError
from mjmotion.footsteps.contacts import load_contacts
from mjmotion.numerics.progress import Progress, no_progress
from mjmotion.output.folder import CONTACTS, MODEL, MOTION
from mjmotion.output.report.page import CSS, escape
from mjmotion.output.report.summary import png_bytes
from mjmotion.validation.text import number
from mjmotion.validation.thresholds import THRESHOLDS

PAGE = "summary.html"
STRIPS = 8
"""Strips that are drawn at most: each takes a second."""
_WIDTH, _HEIGHT, _BINS = 360, 90, 36  # of a histogram [px], and its bars
_MOST_ERRORS = 20


def write_page(storage: Storage, summary: Summary, progress: Progress = no_progress) -> str:
    """Write ``summary.html``: one page that needs nothing else; return its name.

    Args:
      storage: of the batch.
      summary: of it.
      progress: told of the strips of poses.

    Raises:
      OSError: it cannot be written.
    """
    strips: dict[str, bytes | str] = {}
    # Those first that miss a threshold, and most of them.
    order = sorted(summary.spreads, key=lambda spread: -spread.broken)
    jobs = list(dict.fromkeys(spread.worst[0][0] for spread in order))[:STRIPS]
    for done, job in enumerate(jobs):
        progress("strips of the worst", done, len(jobs))
        strips[job] = strip_of(storage, summary.worst[job])
    storage.write(PAGE, page(summary, strips).encode("utf-8"))
    return PAGE


def strip_of(storage: Storage, row: Row) -> bytes | str:
    """Return a strip of poses of a job as PNG, or why there is none, as one line."""
    from mjmotion.output.video import render_strip

    try:
        with tempfile.TemporaryDirectory(prefix="mjmotion-") as name:
            folder = Path(name)
            copy_files(storage, row, folder)
            body: str | Path | Character = folder / MODEL
            if not (folder / MODEL).is_file():
                parts = [(row[kind], row[f"{kind}_from"]) for kind in ("character", "scene")]
                body = composed_at(*(Source.at(*part) for part in parts))
            motion = Motion.load(folder / MOTION, body)
            contacts = load_contacts(folder / CONTACTS, motion.model, motion.nframe)
            return png_bytes(render_strip(motion, contacts=contacts))
    except (MotionError, OSError) as error:
        return first_line(error)


def page(summary: Summary, strips: Mapping[str, bytes | str]) -> str:
    """Return the page as text.

    Args:
      summary: what it tells.
      strips: of some jobs a picture as PNG, or why there is none.
    """
    failed = "".join(
        f"<tr><td class=n>{count}</td><td>{escape(error)}</td></tr>"
        for error, count in summary.errors[:_MOST_ERRORS]
    )
    parts = [
        f'<h1>Batch</h1><p class="verdict">{escape(summary.verdict())}</p>',
        f"<h2>Failed</h2><table><tr><th class=n>jobs</th><th>why</th></tr>{failed}</table>"
        if failed
        else "",
        "<h2>Figures</h2>",
        '<p class="soft">Each figure over all jobs that have it; the dashed lines are its'
        " thresholds. What is beyond the ends counts in the outermost bars.</p>",
        f'<div class="pair">{"".join(map(_figure, summary.spreads))}</div>',
        "<h2>Worst cases</h2>",
        *(_case(job, summary, strip) for job, strip in strips.items()),
    ]
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>Batch</title>\n<style>{CSS}</style>\n</head>\n"
        f"<body>\n{chr(10).join(part for part in parts if part)}\n</body>\n</html>\n"
    )


def _figure(spread: Spread) -> str:
    """Return one figure: its histogram, and its worst jobs."""
    bound = THRESHOLDS.get(spread.name)
    missed = "" if bound is None else f" · {spread.broken} of {len(spread.values)} miss it"
    worst = "".join(
        f"<tr><td class=n>{number(value)}</td><td>{escape(job)}</td></tr>"
        for job, value in spread.worst
    )
    return (
        f"<section><h3>{escape(spread.label)}</h3>{histogram(spread)}"
        f'<p class="soft">{escape(spread.name)}: median {number(spread.percentile(50))},'
        f" p5 {number(spread.percentile(5))}, p95 {number(spread.percentile(95))}{missed}</p>"
        f"<details><summary>worst</summary><table>{worst}</table></details></section>"
    )


def histogram(spread: Spread) -> str:
    """Return a histogram as SVG; its ends hold 98 % of the values and the thresholds."""
    finite = spread.values[np.isfinite(spread.values)]
    if len(finite) == 0:
        return '<p class="note">Infinite everywhere.</p>'
    bound = THRESHOLDS.get(spread.name)
    marks = [] if bound is None else list(bound) if isinstance(bound, tuple) else [bound]
    low = min([float(np.percentile(finite, 1)), *marks])
    high = max([float(np.percentile(finite, 99)), *marks])
    # A little around, so that one value alone and thresholds at the ends can be seen.
    around = 0.03 * (high - low) or max(abs(high) * 0.05, 1e-6)
    low, high = low - around, high + around
    inside = np.clip(np.nan_to_num(spread.values, posinf=high, neginf=low), low, high)
    counts, _ = np.histogram(inside, bins=_BINS, range=(low, high))
    step = _WIDTH / _BINS
    bars = "".join(
        f'<rect x="{index * step:.1f}" y="{_HEIGHT - tall:.1f}" width="{step - 1:.1f}"'
        f' height="{tall:.1f}" fill="currentColor" opacity="0.55"/>'
        for index, tall in enumerate(counts / counts.max() * (_HEIGHT - 4))
        if tall > 0
    )
    lines = "".join(
        f'<line x1="{x:.1f}" x2="{x:.1f}" y1="0" y2="{_HEIGHT}" stroke="var(--bad)"'
        ' stroke-dasharray="4 3"/>'
        for x in ((mark - low) / (high - low) * _WIDTH for mark in marks)
    )
    ends = "".join(
        f'<text x="{x}" y="{_HEIGHT + 14}" font-size="11" fill="currentColor"'
        f' text-anchor="{anchor}">{number(value)}</text>'
        for x, anchor, value in ((0, "start", low), (_WIDTH, "end", high))
    )
    return (
        f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT + 18}" width="{_WIDTH}" role="img"'
        f' aria-label="{escape(spread.label)}">{bars}{lines}{ends}</svg>'
    )


def _case(job: str, summary: Summary, strip: bytes | str) -> str:
    """Return one of the worst jobs: what it is worst in, and its strip of poses."""
    figures = "; ".join(
        f"{spread.label} {number(spread.worst[0][1])}"
        for spread in summary.spreads
        if spread.worst[0][0] == job
    )
    if isinstance(strip, str):
        picture = f'<p class="note">No picture of poses: {escape(strip)}</p>'
    else:
        data = base64.b64encode(strip).decode("ascii")
        picture = f'<div class="strip"><img alt="poses" src="data:image/png;base64,{data}"></div>'
    broken = summary.worst[job]["broken"] or ""
    said = f" · missed: {broken}" if broken else ""
    return (
        f"<section><h3>{escape(job)}</h3><p>Worst in: {escape(figures + said)}</p>"
        f"{picture}</section>"
    )
