"""The page: one HTML file with its plots and pictures inside, on a light or a dark screen."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from html import escape as _escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjmotion.boundary.words import harmless
from mjmotion.output.report import plots
from mjmotion.output.report.data import ReportData, residual_text
from mjmotion.validation.text import number


def escape(text: str) -> str:
    """Return a text for the page: neither its marks nor its invisible letters do anything."""
    return _escape(harmless(str(text)))


Picture = NDArray[np.uint8] | bytes

CSS = """
:root { color-scheme: light dark; --ink: #1d2127; --soft: #5d6570; --line: #dde1e6;
  --paper: #ffffff; --panel: #f6f7f9; --good: #26794a; --bad: #b93333; }
@media (prefers-color-scheme: dark) { :root { --ink: #e4e7eb; --soft: #9aa3ae; --line: #343a43;
  --paper: #14171b; --panel: #1b1f25; --good: #63c08a; --bad: #f08080; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 64rem; padding: 2.5rem 1.25rem 4rem; background: var(--paper);
  color: var(--ink); font: 16px/1.5 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .25rem; font-weight: 650; }
h2 { font-size: 1.1rem; margin: 2.5rem 0 .5rem; font-weight: 650; }
p { margin: .25rem 0 .75rem; max-width: 46rem; } .soft { color: var(--soft); }
.verdict { font-weight: 600; } .good { color: var(--good); } .bad { color: var(--bad); }
table { border-collapse: collapse; width: 100%; font-size: .9rem;
  font-variant-numeric: tabular-nums; }
th { text-align: left; font-weight: 600; color: var(--soft); }
th, td { padding: .35rem .8rem .35rem 0; border-bottom: 1px solid var(--line);
  vertical-align: baseline; }
td.n, th.n { text-align: right; white-space: nowrap; } td.w { white-space: nowrap; }
.wide { overflow-x: auto; }
.strip { display: flex; gap: 3px; border-radius: 6px; overflow: hidden; background: var(--panel); }
.strip img { flex: 1 1 0; min-width: 0; width: 100%; display: block; }
.strip.many { flex-wrap: wrap; } .strip.many img { flex-basis: 15%; }
.note { background: var(--panel); border-radius: 6px; padding: .9rem 1.1rem; color: var(--soft); }
.pair { display: grid; grid-template-columns: repeat(auto-fit, minmax(24rem, 1fr)); gap: 0 2rem; }
svg { display: block; color: var(--ink); height: auto; } svg text { font-family: inherit; }
details { margin-top: .75rem; } summary { cursor: pointer; color: var(--soft); }
"""
"""How all pages of the project look."""


def page(report: ReportData, poses: Sequence[Picture] = (), why_no_poses: str = "") -> str:
    """Return the page as text.

    Args:
      report: what it is about.
      poses: pictures in order, RGB arrays (height, width, 3) or PNG files as bytes.
      why_no_poses: what it says where there are none.
    """
    parts = [
        _header(report),
        _strip(poses, why_no_poses),
        "<h2>Figures</h2>",
        _figure_table(report),
        _unmet(report),
        *(f'<p class="note">Note: {escape(note)}.</p>' for note in report.notes),
        _section(
            "The plan from above",
            "The clip's own way and the way taken, footsteps, and what is near them.",
            report.plan_svg,
        ),
        _section(
            "Feet against the ground",
            "Heights of heel and toe, solid, and of the ground below, dashed. Shaded: contact.",
            plots.foot_heights(report),
        ),
        _section(
            "Penetration over time",
            "How deep the deepest point of the soles, and of any other body, is in the scene.",
            plots.penetrations(report),
        ),
        _section(
            "Drift per contact",
            "The largest distance of a site from its mean place while it stands.",
            plots.drifts(report),
        ),
        '<div class="pair">',
        _section(
            "Residual per level",
            "Greatest position error over all constraints after each level of the fit. The paper's"
            " figures are of its own terrain job.",
            plots.residuals(report),
        ),
        _section(
            "Jerk per joint",
            "Third derivative of the joint angles, before and after.",
            plots.jerks(report),
        ),
        "</div>",
        _contact_table(report),
    ]
    body = "\n".join(part for part in parts if part)
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(report.title)}</title>\n<style>{CSS}</style>\n</head>\n"
        f"<body>\n{body}\n</body>\n</html>\n"
    )


def _header(report: ReportData) -> str:
    """Return title, verdict, and a line of what the report is about."""
    figures = report.validation
    seconds = (figures.nframe - 1) / figures.fps
    about = [f"{figures.nframe} frames at {figures.fps:g} fps, {seconds:.1f} s"]
    about.append(f"{len(report.contacts)} contacts")
    if report.fit_seconds is not None:
        about.append(f"fitted in {1000 * report.fit_seconds:.0f} ms")
    return (
        f"<header>\n<h1>{escape(report.title)}</h1>\n"
        f'<p class="soft">{escape(" · ".join(about))}</p>\n{_verdict(report)}\n</header>'
    )


def _verdict(report: ReportData) -> str:
    count, held = len(report.broken), len(report.judged)
    if count == 0:
        return f'<p class="verdict good">✓ All {held} thresholds hold.</p>'
    return f'<p class="verdict bad">✗ {count} of {held} thresholds broken.</p>'


def _figure_table(report: ReportData) -> str:
    mark = {
        True: '<span class="good">✓ holds</span>',
        False: '<span class="bad">✗ broken</span>',
        None: "",
    }
    rows = [
        f'<tr title="{escape(row.figure)}"><td>{escape(row.label)}</td>'
        f'<td class="n">{number(row.value)}</td><td>{escape(row.unit)}</td>'
        f'<td class="n">{escape(row.threshold)}</td><td class="w">{mark[row.ok]}</td>'
        f'<td class="soft">{escape(row.where)}</td></tr>'
        for row in report.validation.summary()
    ]
    head = (
        '<tr><th>figure</th><th class="n">value</th><th></th><th class="n">threshold</th>'
        "<th></th><th>worst</th></tr>"
    )
    return f'<div class="wide"><table>{head}{"".join(rows)}</table></div>'


def _unmet(report: ReportData) -> str:
    if not report.unmet:
        return ""
    rows = []
    for unmet in report.unmet:
        frames = list(unmet["frames"])
        shown = ", ".join(str(frame) for frame in frames[:8]) + (", …" if len(frames) > 8 else "")
        whose = "your own" if unmet.get("source") == "user" else "the scene's"
        rows.append(
            f"<tr><td>{escape(str(unmet['constraint']))}</td><td>{whose}</td>"
            f"<td class='n'>{len(frames)}</td><td>{escape(shown)}</td>"
            f"<td class='n'>{escape(residual_text(unmet))}</td></tr>"
        )
    head = (
        "<tr><th>constraint</th><th>whose</th><th class='n'>frames</th><th></th>"
        "<th class='n'>off by</th></tr>"
    )
    return (
        "<h2>Constraints that could not be met</h2>"
        f'<div class="wide"><table>{head}{"".join(rows)}</table></div>'
    )


def _contact_table(report: ReportData) -> str:
    entries = report.validation.per_contact
    if not entries:
        return ""
    rows = [
        f'<tr><td>{escape(entry["site"])}</td><td class="n">{entry["start"]} – '
        f'{entry["end"] - 1}</td><td class="n">{number(entry["drift_mm"])}</td>'
        f'<td class="n">{number(entry["gap_mm"])}</td>'
        f'<td class="n">{number(entry["skate_mm_s"])}</td><td>{escape(entry["ground"])}</td></tr>'
        for entry in entries
    ]
    head = (
        '<tr><th>site</th><th class="n">frames</th><th class="n">drift [mm]</th>'
        '<th class="n">gap [mm]</th><th class="n">speed [mm/s]</th><th>stands on</th></tr>'
    )
    return (
        f"<h2>Contacts</h2><details><summary>All {len(entries)} contacts</summary>"
        f'<div class="wide"><table>{head}{"".join(rows)}</table></div></details>'
    )


def _section(title: str, caption: str, svg: str) -> str:
    if not svg:
        return ""
    return (
        f'<section><h2>{escape(title)}</h2><p class="soft">{escape(caption)}</p>'
        f'<div class="wide" role="img" aria-label="{escape(title)}">{svg}</div></section>'
    )


def _strip(poses: Sequence[Picture], why_no_poses: str) -> str:
    if len(poses) == 0:
        reason = why_no_poses or "Nothing was rendered for this report."
        return f'<h2>Poses</h2><p class="note">No pictures of poses: {escape(reason)}</p>'
    many = " many" if len(poses) > 8 else ""
    images = "".join(
        f'<img alt="pose {i + 1} of {len(poses)}" src="{_data_url(picture)}">'
        for i, picture in enumerate(poses)
    )
    return f'<h2>Poses</h2><div class="strip{many}">{images}</div>'


def _data_url(picture: Any) -> str:
    if isinstance(picture, bytes):
        return "data:image/png;base64," + base64.b64encode(picture).decode("ascii")
    from PIL import Image  # only where there are pictures

    stream = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(picture, dtype=np.uint8)).save(stream, "JPEG", quality=88)
    return "data:image/jpeg;base64," + base64.b64encode(stream.getvalue()).decode("ascii")
