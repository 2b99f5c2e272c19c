"""One report: figures, the trace of the fit, and what they are written to."""

from __future__ import annotations

import dataclasses
import json
import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco

from mjmotion.body.morph_body import MorphBody
from mjmotion.body.motion import Motion
from mjmotion.exceptions import MotionError, OutputError
from mjmotion.footsteps.contacts import load_contacts
from mjmotion.output.report.facts import Facts
from mjmotion.validation import Validation, validate

if TYPE_CHECKING:
    from mjmotion.constraints import Constraint
    from mjmotion.output.report.page import Picture
    from mjmotion.output.result import Result

_JSON, _PAGE = "report.json", "report.html"
BODY = "body.npz"


class Report(Facts):
    """A report: facts that can be measured again, and written as files; see :class:`Facts`."""

    @classmethod
    def from_result(
        cls,
        adaptation: Result,
        validation: Validation | None = None,
        *,
        constraints: Sequence[Constraint] = (),
        title: str = "Adapted motion",
    ) -> Report:
        """Return the report of what ``adapt`` returned, validated here unless it was already.

        Args:
          adaptation: what it is about.
          validation: its figures.
          constraints: the user's own, given to ``adapt``: those not met are listed as theirs.
          title: what the page is called.
        """
        body = adaptation.body
        if validation is None:
            validation = validate(
                adaptation.source, adaptation.motion, adaptation.contacts, body=body
            )
        return cls(
            adaptation.source,
            adaptation.motion,
            tuple(adaptation.contacts),
            validation,
            tuple(_level(level) for level in adaptation.trace.levels),
            float(adaptation.trace.fit_seconds),
            float(adaptation.trace.exact_error_percent),
            tuple(one.as_dict() for one in adaptation.unmet),
            title,
            body,
        )

    @classmethod
    def from_folder(
        cls, folder: str | Path, *, thresholds: Mapping[str, object] | None = None
    ) -> Report:
        """Compute every figure again from the files that ``mjmotion adapt`` wrote.

        Only what cannot be computed again (title, levels and time of the fit, what it could not
        meet) comes from the ``report.json`` that is there, if there is one.

        Args:
          folder: with ``motion.npz``, ``source.npz``, ``model.xml`` and ``contacts.json``.
          thresholds: changes to the default thresholds, by name.

        Raises:
          MotionError: a file is missing or damaged.
        """
        folder = Path(folder)
        path = folder / "model.xml"
        if not folder.is_dir():
            raise MotionError(f"result folder '{folder}' does not exist: run mjmotion adapt first")
        if not path.is_file():
            raise MotionError(f"'{folder}' holds no model.xml: give a folder that adapt wrote")
        try:
            model = mujoco.MjModel.from_xml_path(str(path))
        except (ValueError, mujoco.FatalError) as error:
            reason = " ".join(str(error).split())
            raise MotionError(f"'{path}' does not compile: {reason}") from error
        motion = Motion.load(folder / "motion.npz", model)
        source = Motion.load(folder / "source.npz", model)
        contacts = tuple(load_contacts(folder / "contacts.json", model, motion.nframe))
        body = MorphBody.load(folder / BODY, model) if (folder / BODY).is_file() else None
        return cls(
            source,
            motion,
            contacts,
            validate(source, motion, contacts, thresholds=thresholds, body=body),
            title=folder.resolve().name,
            body=body,
        ).with_earlier(folder)

    def with_earlier(self, folder: str | Path) -> Report:
        """Return the report with what an earlier ``report.json`` in ``folder`` knows of the fit.

        Raises:
          MotionError: that file is damaged.
        """
        path = Path(folder) / _JSON
        if not path.is_file():
            return self
        try:
            earlier = json.loads(path.read_text("utf-8"))
            return dataclasses.replace(
                self,
                levels=tuple(dict(level) for level in earlier.get("levels") or ()),
                fit_seconds=earlier.get("fit_seconds"),
                exact_error_percent=earlier.get("exact_error_percent"),
                unmet=tuple(dict(unmet) for unmet in earlier.get("unmet") or ()),
                title=str(earlier.get("title") or self.title),
            )
        except (OSError, ValueError, TypeError, AttributeError) as error:
            raise MotionError(
                f"'{path}' is not a report of mjmotion ({error}): delete it and validate again"
            ) from error

    def html(self, poses: Sequence[Picture] = (), *, why_no_poses: str = "") -> str:
        """Return the page: one file that needs nothing else.

        Args:
          poses: pictures of poses in order, RGB arrays (height, width, 3) or PNG files as bytes.
          why_no_poses: what the page says where there are none.
        """
        from mjmotion.output.report.page import page  # loads matplotlib

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
        _replace(Path(folder) / _JSON, text)
        _replace(Path(folder) / _PAGE, html)


def _level(level: Any) -> dict[str, Any]:
    return {
        "level": int(level.level),
        "frames_per_knot": float(level.frames_per_knot),
        "seconds": float(level.seconds),
        "max_error_percent": float(level.max_error_percent),
    }


def _replace(path: Path, text: str) -> None:
    """Write a file whole or not at all."""
    try:
        handle, aside = tempfile.mkstemp(prefix=f".{path.name}-", dir=path.parent)
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                file.write(text)
            Path(aside).chmod(0o644)
            Path(aside).replace(path)
        except BaseException:
            Path(aside).unlink(missing_ok=True)
            raise
    except OSError as error:
        raise OutputError(
            f"cannot write '{path}': {error.strerror}: give another folder"
        ) from error
