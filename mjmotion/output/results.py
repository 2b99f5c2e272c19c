"""The output folder of an adaptation: written whole or not at all, and read again.

    with result_folder("out/walk") as folder:        # a folder aside, renamed when all went well
        write_results(folder, adaptation, validation)
    results = read_results("out/walk")               # model, source, motion, contacts, report
    motion, contacts, character = read_motion("out/walk")  # or a file, or a built-in name

| file | what it holds |
|---|---|
| motion.npz, source.npz | the adapted motion, and the clip at the scene's start before adaptation |
| model.xml and assets | humanoid and scene in one MJCF |
| contacts.json | who stood where and when |
| body.npz | of a morph: the character's size in every frame |
| report.json, report.html | the figures |
| video.mp4 | source and adapted motion |
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import mujoco

from mjmotion.body.assets import find_asset
from mjmotion.body.morph_body import MorphBody
from mjmotion.body.motion import Motion
from mjmotion.clips import builtin_contacts, load_clip
from mjmotion.exceptions import MotionError, OutputError, RenderError
from mjmotion.footsteps.contacts import Contact, load_contacts, save_contacts
from mjmotion.output.report import BODY, Report
from mjmotion.scene import save_model

if TYPE_CHECKING:
    from mjmotion.constraints import Constraint
    from mjmotion.output.result import Result
    from mjmotion.validation import Validation

MOTION, SOURCE, MODEL, CONTACTS = "motion.npz", "source.npz", "model.xml", "contacts.json"
REPORT, PAGE, VIDEO = "report.json", "report.html", "video.mp4"
SPREAD = 0.5  # how much further apart the poses of a morph stand in its strip [m]
_NEEDED = (MOTION, SOURCE, MODEL, CONTACTS)


@dataclasses.dataclass(frozen=True, eq=False)
class Results:
    """What one run of ``adapt`` left behind.

    Attributes:
      folder: where it is.
      model: the composed model.
      source: the clip at the scene's start, before adaptation.
      motion: the adapted motion, same frames.
      contacts: who stood where and when.
      report: the contents of ``report.json``; empty where there is none.
      body: the character's size in every frame, where that changes.
    """

    folder: Path
    model: mujoco.MjModel
    source: Motion
    motion: Motion
    contacts: tuple[Contact, ...]
    report: dict[str, Any]
    body: MorphBody | None = None


def check_output(out: str | Path, force: bool = False) -> None:
    """Raise OutputError if a result cannot go to ``out``; call it before a long job.

    An empty folder may be filled. A folder with anything in it is only replaced with ``force``, and
    only if it holds earlier results: ``--out ~ --force`` must not cost anyone their home.
    """
    out = Path(out)
    try:
        if not out.exists():
            return
        if not out.is_dir():
            raise OutputError(f"'{out}' is a file, not a folder: give another --out")
        names = {path.name for path in out.iterdir()}
    except OSError as error:
        raise OutputError(f"cannot write to '{out}': {error.strerror}") from error
    if names and not {MOTION, MODEL} <= names:
        raise OutputError(
            f"folder '{out}' holds other files than results of mjmotion: give another --out"
        )
    if names and not force:
        raise OutputError(f"'{out}' holds earlier results: give another --out, or --force")


@contextlib.contextmanager
def result_folder(out: str | Path, force: bool = False) -> Iterator[Path]:
    """Give an empty folder beside ``out`` that becomes ``out`` when the block ends well.

    If the block raises, nothing is left behind and earlier results stay as they were. With
    ``force``, earlier results are replaced as a whole, and only at the end.

    Raises:
      OutputError: ``out`` cannot be written, or holds something already; see check_output.
    """
    check_output(out, force)
    out = Path(out).resolve()
    missing = [parent for parent in out.parents if not parent.exists()]
    aside: Path | None = None
    try:
        try:
            out.parent.mkdir(parents=True, exist_ok=True)
            aside = Path(tempfile.mkdtemp(prefix=f".{out.name}-", dir=out.parent))
            aside.chmod(0o755)
        except OSError as error:
            raise OutputError(
                f"cannot write to '{out}': {error.strerror}: give another --out"
            ) from error
        yield aside
        check_output(out, force)  # again: the work took a while
        _put_in_place(aside, out)
    except BaseException:
        if aside is not None:
            shutil.rmtree(aside, ignore_errors=True)
        for parent in missing:
            with contextlib.suppress(OSError):  # someone else may have filled it by now
                parent.rmdir()
        raise


def check_file(path: str | Path, force: bool = False) -> None:
    """Raise OutputError if a file cannot be made or would replace one without ``force``."""
    path = Path(path)
    if path.is_dir():
        raise OutputError(f"'{path}' is a folder: give the name of a file")
    if path.exists() and not force:
        raise OutputError(f"'{path}' exists already: give another --out, or --force")
    if not path.parent.is_dir():
        raise OutputError(f"folder '{path.parent}' does not exist: make it first")


def write_motions(folder: str | Path, adaptation: Result) -> None:
    """Write everything of an adaptation but report and video into a folder.

    Raises:
      OutputError: a file cannot be written.
    """
    folder = Path(folder)
    try:
        adaptation.motion.save(folder / MOTION)
        adaptation.source.save(folder / SOURCE)
        save_contacts(folder / CONTACTS, adaptation.contacts)
        if (body := adaptation.body) is not None:
            body.save(folder / BODY)
    except OSError as error:
        raise OutputError(f"cannot write into '{folder}': {error.strerror or error}") from error
    save_model(adaptation.motion.character.spec, folder, MODEL)


def write_results(
    folder: str | Path,
    adaptation: Result,
    validation: Validation,
    *,
    constraints: Sequence[Constraint] = (),
    video: bool = True,
    title: str = "Adapted motion",
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write everything of an adaptation into a folder that is there.

    Args:
      folder: where; use :func:`result_folder` to have it appear whole or not at all.
      adaptation: what ``adapt`` returned.
      validation: its figures.
      constraints: the user's own, which ``adapt`` was given: the report lists those not met.
      video: whether to render ``video.mp4`` too.
      title: what the report is called.
      progress: called with frames done and frames in all while the video is rendered.

    Raises:
      OutputError: a file cannot be written.
      RenderError: a video was asked for and there is no offscreen OpenGL.
    """
    folder = Path(folder)
    write_motions(folder, adaptation)
    report = Report.from_result(adaptation, validation, constraints=constraints, title=title)
    write_report(folder, report)
    if video:
        from mjmotion.output.video import render_video

        render_video(
            folder / VIDEO,
            adaptation.motion,
            adaptation.source,
            contacts=adaptation.contacts,
            body=adaptation.body,
            progress=progress,
        )


def write_report(folder: str | Path, report: Report) -> None:
    """Write ``report.json`` and ``report.html`` with a strip of poses, if there is OpenGL for it.

    Raises:
      OutputError: a file cannot be written.
    """
    from mjmotion.output.video import render_strip

    body = report.body
    # Bodies that change are hard to tell apart where they overlap.
    apart = 0.0 if body is None else SPREAD
    try:
        strip = render_strip(report.motion, contacts=report.contacts, body=body, spread=apart)
        poses, why = [strip], ""
    except RenderError as error:
        poses, why = [], str(error)
    report.write(folder, poses, why_no_poses=why)


def read_results(folder: str | Path) -> Results:
    """Read an output folder.

    Raises:
      MotionError: the folder or a file of it is missing or damaged.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise MotionError(f"result folder '{folder}' does not exist: run mjmotion adapt first")
    lacking = [name for name in _NEEDED if not (folder / name).is_file()]
    if lacking:
        raise MotionError(
            f"'{folder}' is not a result of mjmotion adapt: it lacks {', '.join(lacking)}"
        )
    model = load_model(folder / MODEL)
    motion = Motion.load(folder / MOTION, model)
    source = Motion.load(folder / SOURCE, model)
    if source.nframe != motion.nframe:
        raise MotionError(
            f"'{folder}': source.npz has {source.nframe} frames and motion.npz {motion.nframe}:"
            " they must be of the same run"
        )
    contacts = load_contacts(folder / CONTACTS, model, motion.nframe)
    body = MorphBody.load(folder / BODY, model) if (folder / BODY).is_file() else None
    if body is not None and body.nframe != motion.nframe:
        raise MotionError(
            f"'{folder}': {BODY} has {body.nframe} frames and motion.npz {motion.nframe}: they must"
            " be of the same run"
        )
    return Results(folder, model, source, motion, contacts, read_report(folder), body)


class Given(NamedTuple):
    """A motion as a user names one.

    Attributes:
      motion: on the character's model; on character and scene in one for a result folder.
      contacts: those of a result folder; None where nobody has said who stands when.
      character: the MJCF file of that model; see :func:`mjmotion.scene.with_ground`.
    """

    motion: Motion
    contacts: tuple[Contact, ...] | None
    character: Path


def read_motion(
    what: str | Path,
    character: str | Path | None = None,
    *,
    mapping: str | Path | None = None,
    fps: float | None = None,
) -> Given:
    """Return a motion that a user named: a file, a built-in clip, or a result folder.

    Args:
      what: BVH, AMC, CSV or NPZ file, built-in name, or folder (its ``motion.npz``).
      character: MJCF file or name of a model that a file's frames are for; ours without.
      mapping: for a recording: which of its joints is which.
      fps: rate of a clip in place of its file's own.

    Raises:
      ClipError: no such file or name, a damaged file, a skeleton that cannot be mapped.
      ModelError: no such character.
      MotionError: a folder without results, or one together with what is for files only.
    """
    path = Path(what)
    if path.is_dir():
        for option, value in (("character", character), ("mapping", mapping), ("fps", fps)):
            if value is not None:
                raise MotionError(f"'{path}' is a result folder and has its own {option}: leave it")
        results = read_results(path)
        if results.body is not None:
            raise MotionError(
                f"'{path}' holds a morph, whose body changes: give a motion of one body"
            )
        return Given(results.motion, results.contacts, path / MODEL)
    file = find_asset("model", character or "humanoid")
    motion = load_clip(what, load_model(file), mapping=mapping, fps=fps)
    return Given(motion, builtin_contacts(str(what)), file)


def load_model(path: str | Path) -> mujoco.MjModel:
    """Compile an MJCF file.

    Raises:
      MotionError: it is missing or MuJoCo cannot compile it.
    """
    path = Path(path)
    if not path.is_file():
        raise MotionError(f"model file '{path}' does not exist: check the path")
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split())
        raise MotionError(f"model '{path}' does not compile: {reason}") from error


def read_report(folder: str | Path) -> dict[str, Any]:
    """Return what ``report.json`` of a folder says, or an empty dict if there is none.

    Raises:
      MotionError: it is damaged.
    """
    path = Path(folder) / REPORT
    if not path.is_file():
        return {}
    try:
        report = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise MotionError(f"'{path}' is damaged ({error}): remove it and validate again") from error
    if not isinstance(report, dict):
        raise MotionError(f"'{path}' is not a report: remove it and validate again")
    return report


def _put_in_place(aside: Path, out: Path) -> None:
    """Rename ``aside`` to ``out``; what was there goes away last, and comes back if that fails."""
    old = None
    try:
        if out.exists():
            old = Path(tempfile.mkdtemp(prefix=f".{out.name}-old-", dir=out.parent))
            out.replace(old)
        aside.replace(out)
    except OSError as error:
        if old is not None and not out.exists():
            old.replace(out)
        raise OutputError(f"cannot write to '{out}': {error.strerror}") from error
    if old is not None:
        shutil.rmtree(old, ignore_errors=True)
