"""The report of an adaptation: ``report.json``, a table as text, and ``report.html``.

report = Report.from_folder("out/walk")     # everything computed again from the files
report.metrics["stance_drift_mm"], report.broken
report.write("out/walk")
"""

from __future__ import annotations

from mjmotion.report.report import BODY, Report, table

__all__ = ["BODY", "Report", "table"]
