"""The report of a result: ``report.json``, a table as text, and ``report.html``.

report = read_results("out/walk").report()     # everything measured again from the files
report.metrics["stance_drift_mm"], report.broken
report.write("out/walk")
"""

from __future__ import annotations

from mjmotion.output.report.poses import strip_ahead
from mjmotion.output.report.report import Report, write_report
from mjmotion.output.report.summary import summary_html

__all__ = ["Report", "strip_ahead", "summary_html", "write_report"]
