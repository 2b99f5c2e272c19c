"""The folder of a result: its files by name, and a way to have it appear whole or not at all.

    with result_folder("out/walk") as folder:    # a folder aside, renamed when all went well
        write_results(folder, result, validation)

| file | what it holds |
|---|---|
| motion.npz, source.npz | the motion, and what it came from at the scene's start |
| recording.npz | the clip as recorded, where the motion has another pace and so other frames |
| model.xml and assets | character and scene in one MJCF |
| contacts.json | who stood where and when |
| plan.json | of a walk on a scene: contacts of the clip, way and footholds, for ``adapt --plan`` |
| body.npz | of a morph: the character's size in every frame |
| report.json, report.html | the figures |
| video.mp4 | source and motion |
"""

from __future__ import annotations

import contextlib
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from xml.sax.saxutils import unescape

from mjmotion.boundary.whole import locked, name_aside, put_in_place, tidy, write_whole
from mjmotion.exceptions import OutputError

MOTION, SOURCE, MODEL, CONTACTS = "motion.npz", "source.npz", "model.xml", "contacts.json"
RECORDING = "recording.npz"
BODY, REPORT, PAGE, VIDEO = "body.npz", "report.json", "report.html", "video.mp4"
PLAN = "plan.json"
FILES = (
    *(MOTION, SOURCE, RECORDING, MODEL, CONTACTS, PLAN, BODY, REPORT, PAGE, VIDEO),
    *("original.npz", "original.xml", "constraints.json"),  # of a rope climb
)
"""Every file of a result but the assets of its models."""

_NAMED = re.compile(r'\bfile\w*="([^"/\\]+)"')  # an asset beside its model
_SHOWN = 5  # names in a message


def check_output(out: str | Path, force: bool = False) -> None:
    """Raise OutputError if a result cannot go to ``out``; call it before a long job.

    An empty folder may be filled. A folder with anything in it is only replaced with ``force``, and
    only if it holds an earlier result and nothing else: ``--out ~ --force`` must not cost anyone
    their home, nor their notes on a result.
    """
    out = Path(out)
    try:
        if not out.exists():
            return
        if not out.is_dir():
            raise OutputError(f"'{out}' is a file, not a folder: give another --out")
        names = {path.name for path in out.iterdir()}
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise OutputError(f"cannot write to '{out}': {why}") from error
    if names and not {MOTION, MODEL} <= names:
        raise OutputError(
            f"folder '{out}' holds other files than results of mjmotion: give another --out"
        )
    if names and not force:
        raise OutputError(
            f"'{out}' holds earlier results: give another folder, or --force (force=True in Python)"
        )
    if own := _not_ours(out):
        shown = ", ".join(own[:_SHOWN]) + (f" and {len(own) - _SHOWN} more" * (len(own) > _SHOWN))
        raise OutputError(
            f"'{out}' holds what mjmotion did not write: {shown}: move it, or give another --out"
        )


def _not_ours(folder: Path) -> list[str]:
    """Return the names in a result's folder that are of no file of a result.

    A result's files are known by name, and its assets are what its models name.
    """
    known = set(FILES)
    for model in (MODEL, "original.xml"):
        with contextlib.suppress(OSError):
            text = (folder / model).read_text("utf-8", "replace")
            known |= {unescape(name, {"&quot;": '"'}) for name in _NAMED.findall(text)}
    return sorted(path.name for path in folder.iterdir() if path.name not in known or path.is_dir())


@contextlib.contextmanager
def result_folder(out: str | Path, force: bool = False) -> Iterator[Path]:
    """Give an empty folder next to ``out`` that becomes ``out`` when the block ends well.

    If the block raises, nothing is left behind and earlier results stay as they were. With
    ``force``, earlier results are replaced as a whole, and only at the end, in one step where the
    system can. What an earlier run left that was killed is tidied, with a warning.

    Raises:
      OutputError: ``out`` cannot be written, or holds something already; see check_output.
    """
    out = Path(out)
    with contextlib.suppress(OSError, ValueError):
        tidy(out.resolve())
    check_output(out, force)
    out = out.resolve()
    missing = [parent for parent in out.parents if not parent.exists()]
    aside: Path | None = None
    held = contextlib.ExitStack()
    try:
        try:
            out.parent.mkdir(parents=True, exist_ok=True)
            # Named before it is made, so that an interrupt in between leaves nothing behind.
            aside = name_aside(out)
            aside.mkdir()
            held.enter_context(locked(aside))
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
    finally:
        held.close()


def check_file(path: str | Path, force: bool = False) -> None:
    """Raise OutputError if a file cannot be made or would replace one without ``force``."""
    path = Path(path)
    if path.is_dir():
        raise OutputError(f"'{path}' is a folder: give the name of a file")
    if path.exists() and not force:
        raise OutputError(
            f"'{path}' exists already: give another name, or --force (force=True in Python)"
        )
    if not path.parent.is_dir():
        raise OutputError(f"folder '{path.parent}' does not exist: make it first")


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all, over what is there.

    Raises:
      OutputError: it cannot be written.
    """
    try:
        write_whole(path, text)
    except OSError as error:
        raise OutputError(
            f"cannot write '{path}': {error.strerror}: give another folder"
        ) from error


def _put_in_place(aside: Path, out: Path) -> None:
    """Rename ``aside`` to ``out``, and remove what was there; it stays if that fails."""
    try:
        old = put_in_place(aside, out)
    except OSError as error:
        raise OutputError(f"cannot write to '{out}': {error.strerror}") from error
    if old is None:
        return
    if own := _not_ours(old):  # put there in the very moment
        put_in_place(old, out)
        raise OutputError(f"'{out}' holds what mjmotion did not write: {own[0]}: move it")
    shutil.rmtree(old, ignore_errors=True)
