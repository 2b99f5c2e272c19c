"""The report of an adaptation: ``report.json``, a table as text, and ``report.html``.

report = Report.from_folder("out/walk")     # everything computed again from the files
report.metrics["stance_drift_mm"], report.broken
report.write("out/walk")
"""

from __future__ import annotations

from mjmotion.output.report.facts import Facts, table
from mjmotion.output.report.report import BODY, Report

__all__ = ["BODY", "Facts", "Report", "table"]
