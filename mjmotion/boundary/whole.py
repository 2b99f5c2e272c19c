"""Files and folders that appear whole or not at all, and what a killed run left of them.

    with whole_file("report.json") as aside:     # written aside, then renamed
        aside.write_text(text)

Whatever is made aside is named ``.NAME.mjmotion-…``, locked by the run that makes it. One that is
killed loses its lock; the next that writes the same name finds what it left, tidies it and warns.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import re
import secrets
import shutil
import warnings
from collections.abc import Iterator
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows has no locks of this kind: leftovers stay there
    fcntl = None  # type: ignore[assignment]

_MARK = ".mjmotion-"
_OLD = ".old"  # what was there, while the new takes its place where names cannot be exchanged
_AT_CWD, _EXCHANGE = -100, 2  # of Linux' renameat2


def name_aside(place: Path, ending: str = "") -> Path:
    """Return a free name next to a file or folder for what is to become it."""
    return place.with_name(f".{place.name}{_MARK}{secrets.token_hex(4)}{ending}")


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold the lock of a file or folder that is there: it is being worked on."""
    handle = os.open(path, os.O_RDONLY)
    try:
        if fcntl is not None:
            with contextlib.suppress(OSError):  # some network disks have no locks
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(handle)


@contextlib.contextmanager
def whole_file(path: str | Path, ending: str = "") -> Iterator[Path]:
    """Give an empty file next to ``path`` that becomes ``path`` when the block ends well.

    It has the rights that the user's umask gives. If the block raises, it is removed.

    Args:
      path: the file to be.
      ending: of the name of the file aside, for programs that judge by it.

    Raises:
      OSError: it cannot be written.
    """
    path = Path(path)
    if path.is_symlink():  # what it leads to is written, and the link stays
        with contextlib.suppress(OSError, RuntimeError):
            path = path.resolve()
    tidy(path)
    aside = name_aside(path, ending)
    try:
        aside.touch(exist_ok=False)
        with locked(aside):
            yield aside
            _sync(aside)
            aside.replace(path)
    except BaseException:
        aside.unlink(missing_ok=True)
        raise


def write_whole(path: str | Path, content: str | bytes) -> None:
    """Write a file whole or not at all, over what is there; text as UTF-8.

    Raises:
      OSError: it cannot be written.
    """
    data = content if isinstance(content, bytes) else content.encode("utf-8", "backslashreplace")
    with whole_file(path) as aside:
        aside.write_bytes(data)


def put_in_place(aside: Path, place: Path) -> Path | None:
    """Give a folder the name of another, which is taken away: a kill leaves one of them there.

    Returns:
      Where what was there is now, to be removed; None where nothing was.

    Raises:
      OSError: it cannot be renamed; what was there is there still.
    """
    if not place.exists():
        aside.rename(place)
        return None
    if exchange(aside, place):
        return aside
    old = aside.with_name(aside.name + _OLD)
    try:
        place.rename(old)
        aside.rename(place)
    except BaseException:
        if not place.exists() and old.exists():
            old.rename(place)
        raise
    return old


def exchange(one: Path, other: Path) -> bool:
    """Exchange two names in one step; return False where the system or the disk cannot."""
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):
        return False
    first, second = os.fsencode(one), os.fsencode(other)
    return int(rename(_AT_CWD, first, _AT_CWD, second, ctypes.c_uint(_EXCHANGE))) == 0


def tidy(place: Path) -> None:
    """Remove what killed runs left of a file or folder, and put back one that was taken away.

    Warns of what was done, in one line. What a living run works on stays.
    """
    left = leftovers(place)
    done = []
    for path in sorted(left, key=lambda path: not path.name.endswith(_OLD)):
        with contextlib.suppress(OSError):
            if path.name.endswith(_OLD) and not place.exists():
                path.rename(place)
                warnings.warn(
                    f"'{place}' was put back, which a killed run left aside", stacklevel=3
                )
                continue
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink()
            done.append(path.name)
    if done:
        said = f"tidied what a killed run left beside '{place}': {', '.join(done)}"
        warnings.warn(said, stacklevel=3)


def leftovers(place: Path) -> list[Path]:
    """Return what killed runs left of a file or folder, next to it."""
    # What has the form of our names, and nothing else.
    form = re.compile(re.escape(f".{place.name}{_MARK}") + r"[0-9a-f]{8}(\.\w+)?")
    try:
        near = [path for path in place.parent.iterdir() if form.fullmatch(path.name)]
    except OSError:
        return []
    return [path for path in near if not path.is_symlink() and not _worked_on(path)]


def _worked_on(path: Path) -> bool:
    """Return whether a run that lives holds the lock; also where that cannot be known."""
    if fcntl is None:
        return True
    try:
        handle = os.open(path, os.O_RDONLY)
    except OSError:
        return True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(handle)
    return False


def _sync(path: Path) -> None:
    """Have what was written on the disk before its name says that it is whole."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
