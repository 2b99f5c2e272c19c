"""What every application returns: a motion, what it came from, and what could not be met.

result = adapt("walk", "stairs")
result.validate().broken()
result.save("out/walk", video=True)
result.render("ghost.mp4", layout="ghost")
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco

from mjmotion.body.morph_body import MorphBody
from mjmotion.body.motion import Motion
from mjmotion.constraints.unmet import Unmet
from mjmotion.exceptions import OutputError, RenderError
from mjmotion.fitting import Trace
from mjmotion.footsteps.contacts import Contact, save_contacts
from mjmotion.footsteps.plan import Plan
from mjmotion.footsteps.plan_file import save_plan
from mjmotion.numerics.progress import Progress, no_progress
from mjmotion.output.folder import (
    BODY,
    CONTACTS,
    JOINTS,
    MODEL,
    MOTION,
    PLAN,
    RECORDING,
    SOURCE,
    VIDEO,
    check_file,
    result_folder,
)
from mjmotion.scene import save_model

if TYPE_CHECKING:
    from mjmotion.output.report import Report
    from mjmotion.output.report.poses import Strip
    from mjmotion.validation import Validation

FIRST_FRAME = "first_frame"
"""Name of the keyframe in a result's model, with which any viewer shows where the motion begins."""


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Result:
    """A motion that was adapted, retargeted, morphed, joined or edited.

    Attributes:
      source: the motion before, on the composed model, placed at the scene's start, at the pace of
        the motion.
      motion: the motion after, the same frames.
      contacts: who stands when.
      trace: what the fit did; None of a result that was read from its folder.
      unmet: constraints that could not be met: the user's, and what the scene asks.
      body: the body of every frame, where that changes (a morph).
      title: what the result is called in its report.
      saved_report: what ``report.json`` says, of a result that was read and has one; else empty.
      notes: what else there is to say, a line each.
      barred: what bars the way that the scene asks for, in a line; empty where nothing does.
      plan: what the scene asked, of a walk that was adapted to one.
      recording: the source in its own time, of other frames, where the motion's is another.
    """

    source: Motion
    motion: Motion
    contacts: tuple[Contact, ...]
    trace: Trace | None
    unmet: tuple[Unmet, ...]
    body: MorphBody | None = None
    title: str = "Adapted motion"
    notes: tuple[str, ...] = ()
    saved_report: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    recording: Motion | None = None
    barred: str = ""
    plan: Plan | None = None

    @property
    def model(self) -> mujoco.MjModel:
        """The composed model: character and scene."""
        return self.motion.model

    def validate(self, thresholds: Mapping[str, object] | None = None) -> Validation:
        """Return the figures of the motion, measured by MuJoCo.

        Args:
          thresholds: changes to the default thresholds, by the figure's name, in its unit.

        Raises:
          MotionError: a threshold that does not exist or a value of the wrong kind.
        """
        from mjmotion.validation import validate

        return validate(
            self.source,
            self.motion,
            self.contacts,
            thresholds=thresholds,
            body=self.body,
            recording=self.recording,
        )

    def report(
        self,
        validation: Validation | None = None,
        *,
        title: str | None = None,
    ) -> Report:
        """Return the report: figures, what the fit did, and what it could not meet.

        Args:
          validation: the figures, if they were measured already.
          title: what the page is called; the result's own title without.
        """
        from mjmotion.output.plan_drawing import plan_svg
        from mjmotion.output.report import Report

        fit: Mapping[str, Any] = self.saved_report
        if self.trace is not None:
            fit = dataclasses.asdict(self.trace)
        return Report(
            source=self.source,
            motion=self.motion,
            contacts=tuple(self.contacts),
            validation=self.validate() if validation is None else validation,
            levels=tuple(dict(level) for level in fit.get("levels", ())),
            fit_seconds=fit.get("fit_seconds"),
            exact_error_percent=fit.get("exact_error_percent"),
            unmet=tuple(one.as_dict() for one in self.unmet),
            title=self.title if title is None else title,
            notes=(self.barred, *self.notes) if self.barred else self.notes,
            body=self.body,
            plan_svg="" if self.plan is None else plan_svg(self.plan),
        )

    def save(
        self,
        folder: str | Path,
        *,
        video: bool = False,
        force: bool = False,
        title: str | None = None,
        thresholds: Mapping[str, object] | None = None,
        progress: Progress = no_progress,
    ) -> Path:
        """Measure the result and write everything of it into a folder, whole or not at all.

        Args:
          folder: where; it is made. See :mod:`mjmotion.output.folder` for what is in it.
          video: whether to render ``video.mp4`` too.
          force: whether earlier results in ``folder`` are replaced.
          title: what the report is called; the result's own title without.
          thresholds: changes to the default thresholds, by name.
          progress: told of measuring, of writing, and of every frame of the video.

        Returns:
          The folder.

        Raises:
          OutputError: the folder holds something already or cannot be written.
          MotionError: a threshold that does not exist or a value of the wrong kind.
          RenderError: a video was asked for and there is no offscreen OpenGL.
        """
        if video:
            from mjmotion.output.video import ensure_gl

            ensure_gl()  # before all the work
        with result_folder(folder, force) as aside:
            measure_and_write(aside, self, thresholds, video=video, title=title, progress=progress)
        return Path(folder)

    def render(self, file: str | Path, *, force: bool = False, **options: Any) -> Path:
        """Render source and motion to a video.

        Args:
          file: the ``.mp4`` file; it appears only when it is complete.
          force: whether an existing file is replaced.
          options: of :func:`mjmotion.render_video`, such as ``layout="ghost"`` or ``width=640``.

        Returns:
          The file.

        Raises:
          OutputError: the file exists and ``force`` was not given, or it cannot be written.
          RenderError: no offscreen OpenGL, or settings that make no sense.
        """
        from mjmotion.output.video import render_video

        check_file(file, force)
        shown = {"contacts": self.contacts, "body": self.body, **options}
        return render_video(file, self.motion, self.source, **shown)

    def __repr__(self) -> str:
        parts = [
            f"{self.motion.nframe} frames at {self.motion.fps:g} fps",
            f"{len(self.contacts)} contact{'s' * (len(self.contacts) != 1)}",
        ]
        if self.body is not None:
            parts.append("a body that changes")
        if (seconds := self._fit_seconds()) is not None:
            parts.append(f"fitted in {1000 * seconds:.0f} ms")
        unmet = len(self.unmet)
        parts.append(f"{unmet} unmet" if unmet else "all met")
        return f"<Result: {', '.join(parts)}>"

    def _repr_html_(self) -> str:
        """Return what a notebook shows: poses and verdict. Measures, and renders if it can."""
        from mjmotion.output.report import summary_html
        from mjmotion.output.video import render_strip

        try:
            strip = render_strip(self.motion, contacts=self.contacts, body=self.body)
        except RenderError as error:
            return summary_html(self.report(), None, str(error))
        return summary_html(self.report(), strip)

    def _fit_seconds(self) -> float | None:
        """Return how long the fit took [s]; None where that is not known."""
        if self.trace is not None:
            return self.trace.fit_seconds
        seconds: float | None = self.saved_report.get("fit_seconds")
        return seconds


def measure_and_write(
    folder: str | Path,
    result: Result,
    thresholds: Mapping[str, object] | None = None,
    *,
    video: bool = True,
    title: str | None = None,
    progress: Progress = no_progress,
) -> Validation:
    """Measure a result and write everything of it into a folder that is there.

    The strip of poses is drawn meanwhile.

    Args:
      folder: as :func:`write_results` takes it, like all that follows.
      result: what is measured and written.
      thresholds: changes to the default thresholds, by name.
      video: whether to render ``video.mp4`` too.
      title: what the report is called.
      progress: told of measuring too.

    Returns:
      The figures.

    Raises:
      OutputError: a file cannot be written.
      MotionError: a threshold that does not exist or a value of the wrong kind.
      RenderError: a video was asked for and there is no offscreen OpenGL.
    """
    from mjmotion.output.report import strip_ahead

    progress("measuring", 0, 0)
    with strip_ahead(result.motion, contacts=result.contacts, body=result.body) as strip:
        validation = result.validate(thresholds)
        write_results(
            folder, result, validation, video=video, title=title, strip=strip, progress=progress
        )
    return validation


def write_results(
    folder: str | Path,
    result: Result,
    validation: Validation,
    *,
    video: bool = True,
    title: str | None = None,
    strip: Strip | None = None,
    progress: Progress = no_progress,
) -> None:
    """Write everything of a result into a folder that is there.

    Args:
      folder: where; use :func:`mjmotion.result_folder` to have it appear whole or not at all, or
        :meth:`Result.save`, which does.
      result: what an application returned.
      validation: its figures.
      video: whether to render ``video.mp4`` too.
      title: what the report is called; the result's own title without.
      strip: returns the strip of poses where it is being drawn already.
      progress: told of the report and of every frame of the video.

    Raises:
      OutputError: a file cannot be written.
      RenderError: a video was asked for and there is no offscreen OpenGL.
    """
    from mjmotion.output.report import write_report

    folder = Path(folder)
    progress("report", 0, 0)
    write_motions(folder, result)
    write_report(folder, result.report(validation, title=title), strip)
    if video:
        result.render(folder / VIDEO, force=True, progress=progress)


def write_motions(folder: str | Path, result: Result) -> None:
    """Write everything of a result but report and video into a folder.

    Raises:
      OutputError: a file cannot be written.
    """
    folder = Path(folder)
    try:
        result.motion.save(folder / MOTION)
        result.source.save(folder / SOURCE)
        save_contacts(folder / CONTACTS, result.contacts)
        if result.plan is not None:
            save_plan(folder / PLAN, result.plan)
        if result.body is not None:
            result.body.save(folder / BODY)
        if result.recording is not None:
            result.recording.save(folder / RECORDING)
        own = result.source if result.recording is None else result.recording
        if own.recording is not None:
            own.recording.save(folder / JOINTS)
    except OSError as error:
        raise OutputError(f"cannot write the result: {error.strerror or error}") from error
    spec = result.motion.character.spec.copy()
    for key in list(spec.keys):
        spec.delete(key)
    spec.add_key(name=FIRST_FRAME, qpos=result.motion.qpos[0])
    save_model(spec, folder, MODEL)
