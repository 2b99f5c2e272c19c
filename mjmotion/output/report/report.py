"""A report as files: the page and the numbers."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from mjmotion.exceptions import RenderError
from mjmotion.output.folder import PAGE, REPORT, write_text
from mjmotion.output.report.data import ReportData

if TYPE_CHECKING:
    from mjmotion.output.report.page import Picture
    from mjmotion.output.report.poses import Strip


class Report(ReportData):
    """A report that can be written; :meth:`mjmotion.output.result.Result.report` makes one."""

    def __repr__(self) -> str:
        within = f"{len(self.judged) - len(self.broken)} of {len(self.judged)} figures"
        unmet = f", {len(self.unmet)} unmet" if self.unmet else ""
        return f"<Report {self.title!r}: {within} within thresholds{unmet}>"

    def html(self, poses: Sequence[Picture] = (), *, why_no_poses: str = "") -> str:
        """Return the page: one file that needs nothing else.

        Args:
          poses: pictures of poses in order, RGB arrays (height, width, 3) or PNG files as bytes.
          why_no_poses: what the page says where there are none.
        """
        from mjmotion.output.report.page import page

        return page(self, poses, why_no_poses)

    def write(
        self, folder: str | Path, poses: Sequence[Picture] = (), *, why_no_poses: str = ""
    ) -> None:
        """Write ``report.json`` and ``report.html`` into a folder, over what is there.

        Args:
          folder: where; it must exist.
          poses: as in :meth:`html`.
          why_no_poses: as in :meth:`html`.

        Raises:
          OutputError: the folder cannot be written to.
        """
        text = json.dumps(self.as_dict(), indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        html = self.html(poses, why_no_poses=why_no_poses)
        write_text(Path(folder) / REPORT, text)
        write_text(Path(folder) / PAGE, html)


def write_report(folder: str | Path, report: Report, strip: Strip | None = None) -> None:
    """Write ``report.json`` and ``report.html`` with a strip of poses, if there is OpenGL for it.

    Args:
      folder: where; it must exist.
      report: what is written.
      strip: returns the strip if it is being drawn already: what ``strip_ahead`` gave.

    Raises:
      OutputError: a file cannot be written.
    """
    from mjmotion.output.video import render_strip

    try:
        if strip is None:
            picture = render_strip(report.motion, contacts=report.contacts, body=report.body)
        else:
            import PIL.Image  # noqa: F401  # for the page: loads while the strip is drawn

            picture = strip()
    except RenderError as error:
        report.write(folder, why_no_poses=str(error))
    else:
        report.write(folder, [picture])
