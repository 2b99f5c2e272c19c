"""The folder of a result: its files by name, and a way to have it appear whole or not at all.

    with result_folder("out/walk") as folder:    # a folder aside, renamed when all went well
        write_results(folder, result, validation)

| file | what it holds |
|---|---|
| motion.npz, source.npz | the motion, and what it came from at the scene's start |
| model.xml and assets | character and scene in one MJCF |
| contacts.json | who stood where and when |
| body.npz | of a morph: the character's size in every frame |
| report.json, report.html | the figures |
| video.mp4 | source and motion |
"""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from mjmotion.exceptions import OutputError

MOTION, SOURCE, MODEL, CONTACTS = "motion.npz", "source.npz", "model.xml", "contacts.json"
BODY, REPORT, PAGE, VIDEO = "body.npz", "report.json", "report.html", "video.mp4"


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
        raise OutputError(
            f"'{out}' holds earlier results: give another folder, or --force (force=True in Python)"
        )


@contextlib.contextmanager
def result_folder(out: str | Path, force: bool = False) -> Iterator[Path]:
    """Give an empty folder next to ``out`` that becomes ``out`` when the block ends well.

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
            # Named before it is made, so that a kill in between leaves nothing behind.
            aside = out.parent / f".{out.name}-{secrets.token_hex(4)}"
            aside.mkdir()
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
