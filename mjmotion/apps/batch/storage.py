"""Where a batch is written: a folder of this machine or of a shared disk, or any fsspec address.

| name | what it holds |
|---|---|
| batch.json | that this is a batch, and how it is laid out |
| rows/*.jsonl | what came of jobs, a line each; of two lines on a job the last holds |
| jobs/NAME/ | a result; job.json in it says from what it was made, and is written last |
| shards/HASH.zip, .jsonl | with shards: folders of N jobs, and their lines |
| table.csv, table.parquet | all lines as a table, made at the end |

Files and folders appear whole or not at all. On a local disk they are made in ``.making`` and then
renamed; elsewhere a folder's ``job.json`` comes last, and what lacks it is not there.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import struct
import tempfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

from mjmotion.boundary.whole import locked, name_aside, put_in_place, write_whole
from mjmotion.exceptions import BatchError, OutputError

try:
    import fcntl
except ImportError:  # Windows has no locks of this kind
    fcntl = None  # type: ignore[assignment]

STATE, ROWS, JOBS, SHARDS, TABLE = "batch.json", "rows", "jobs", "shards", "table"
MARK = "job.json"
"""Of a job's folder: its line of the table. A folder that has it is whole."""
_MAKING, _LOCKS = ".making", ".locks"
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EROFS)
"""Errors of a disk that no other job would be spared."""


class Storage(Protocol):
    """What a batch asks of the place it is written to; names are relative, with ``/``."""

    address: str

    def read(self, name: str) -> bytes | None:
        """Return a file's content; None if it is not there."""

    def write(self, name: str, data: bytes) -> None:
        """Write a file whole or not at all, over what is there."""

    def names(self, folder: str = "") -> list[str]:
        """Return what is in a folder, sorted; nothing if it is not there."""

    def remove(self, name: str) -> None:
        """Remove a file or a folder; it need not be there."""

    def fetch(self, name: str, to: Path) -> bool:
        """Copy a file or a folder to a local place; return whether it is there."""

    def put(self, name: str, made: Path) -> None:
        """Have a folder or file of :meth:`aside` be ``name``, whole, in place of what is there."""

    def aside(self) -> contextlib.AbstractContextManager[Path]:
        """Give an empty local folder in which something is made."""

    def claim(self, name: str) -> contextlib.AbstractContextManager[None]:
        """Wait until nobody else makes ``name``, and keep others from it meanwhile."""

    def alone(self) -> contextlib.AbstractContextManager[None]:
        """Keep other runs from this batch, and tidy what a killed one left."""


class LocalStorage:
    """A folder.

    Args:
      root: where; it is made when something is written.
    """

    def __init__(self, root: str | Path) -> None:
        self.root = Path(root).absolute()
        self.address = str(self.root)

    def read(self, name: str) -> bytes | None:
        """See :class:`Storage`."""
        try:
            return (self.root / name).read_bytes()
        except (FileNotFoundError, NotADirectoryError):
            return None

    def write(self, name: str, data: bytes) -> None:
        """See :class:`Storage`."""
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, data)

    def names(self, folder: str = "") -> list[str]:
        """See :class:`Storage`."""
        try:
            return sorted(entry.name for entry in os.scandir(self.root / folder))
        except FileNotFoundError:
            return []

    def remove(self, name: str) -> None:
        """See :class:`Storage`."""
        path = self.root / name
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)

    def fetch(self, name: str, to: Path) -> bool:
        """See :class:`Storage`."""
        path = self.root / name
        if not path.exists():
            return False
        if path.is_dir():
            shutil.copytree(path, to, dirs_exist_ok=True)
        else:
            shutil.copyfile(path, to)
        return True

    def put(self, name: str, made: Path) -> None:
        """See :class:`Storage`."""
        place = self.root / name
        place.parent.mkdir(parents=True, exist_ok=True)
        if made.is_dir():
            old = put_in_place(made, place)
            if old is not None:
                shutil.rmtree(old, ignore_errors=True)
        else:
            made.replace(place)

    @contextlib.contextmanager
    def aside(self) -> Iterator[Path]:
        """See :class:`Storage`."""
        # In a folder of its own: among a million results, what was left could not be looked for.
        making = self.root / _MAKING
        making.mkdir(parents=True, exist_ok=True)
        folder = name_aside(making / "job")
        folder.mkdir()
        try:
            with locked(folder):
                yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    @contextlib.contextmanager
    def claim(self, name: str) -> Iterator[None]:
        """See :class:`Storage`."""
        # A byte of one file for each name: nothing is left of it, however its holder ends. Two
        # names on one byte wait for each other, and that is all.
        with _byte_locked(self.root / _LOCKS, zlib.crc32(name.encode()), wait=True):
            yield

    @contextlib.contextmanager
    def alone(self) -> Iterator[None]:
        """See :class:`Storage`."""
        self.root.mkdir(parents=True, exist_ok=True)
        with _byte_locked(self.root / _LOCKS, 1 << 40, wait=False):
            self._tidy()
            try:
                yield
            finally:
                self._tidy()

    def _tidy(self) -> None:
        """Remove what killed workers left; what a living one makes is locked and stays."""
        for name in self.names(_MAKING):
            folder = self.root / _MAKING / name
            with contextlib.suppress(OSError), _free(folder):
                shutil.rmtree(folder, ignore_errors=True)
        with contextlib.suppress(OSError):
            (self.root / _MAKING).rmdir()


class RemoteStorage:
    """An fsspec address, such as of a bucket.

    There are no locks there: nothing keeps two runs of one batch from doing a job twice.

    Args:
      address: such as ``s3://bucket/batch``.
    """

    def __init__(self, address: str) -> None:
        self.address = address.rstrip("/")
        self._system, self._root = remote(self.address)

    def _place(self, name: str) -> str:
        return f"{self._root}/{name}" if name else self._root

    def read(self, name: str) -> bytes | None:
        """See :class:`Storage`."""
        try:
            return bytes(self._system.cat_file(self._place(name)))
        except FileNotFoundError:
            return None

    def write(self, name: str, data: bytes) -> None:
        """See :class:`Storage`."""
        place = self._place(name)
        self._system.makedirs(place.rpartition("/")[0], exist_ok=True)
        self._system.pipe_file(place, data)

    def names(self, folder: str = "") -> list[str]:
        """See :class:`Storage`."""
        self._system.invalidate_cache()
        try:
            found = self._system.ls(self._place(folder), detail=False)
        except FileNotFoundError:
            return []
        return sorted(str(name).rstrip("/").rpartition("/")[2] for name in found)

    def remove(self, name: str) -> None:
        """See :class:`Storage`."""
        with contextlib.suppress(FileNotFoundError):
            self._system.rm(self._place(name), recursive=True)

    def fetch(self, name: str, to: Path) -> bool:
        """See :class:`Storage`."""
        place = self._place(name)
        if not self._system.exists(place):
            return False
        if not self._system.isdir(place):
            self._system.get_file(place, str(to))
            return True
        for inside in self._system.find(place):
            target = to / str(inside)[len(place) :].lstrip("/")
            target.parent.mkdir(parents=True, exist_ok=True)
            self._system.get_file(inside, str(target))
        return True

    def put(self, name: str, made: Path) -> None:
        """See :class:`Storage`."""
        place = self._place(name)
        if made.is_file():
            self._system.makedirs(place.rpartition("/")[0], exist_ok=True)
            self._system.put_file(str(made), place)
            return
        self.remove(name)  # its mark goes first of all that is read
        self._system.makedirs(place, exist_ok=True)
        files = sorted(path for path in made.rglob("*") if path.is_file())
        for path in sorted(files, key=lambda path: path.name == MARK):
            inside = path.relative_to(made).as_posix()
            if "/" in inside:
                self._system.makedirs(f"{place}/{inside}".rpartition("/")[0], exist_ok=True)
            self._system.put_file(str(path), f"{place}/{inside}")

    @contextlib.contextmanager
    def aside(self) -> Iterator[Path]:
        """See :class:`Storage`."""
        with tempfile.TemporaryDirectory(prefix="mjmotion-") as folder:
            yield Path(folder)

    @contextlib.contextmanager
    def claim(self, name: str) -> Iterator[None]:
        """See :class:`Storage`."""
        yield

    @contextlib.contextmanager
    def alone(self) -> Iterator[None]:
        """See :class:`Storage`."""
        yield


def open_storage(where: str | Path) -> Storage:
    """Return the place that a path or an fsspec address means.

    Raises:
      OutputError: fsspec, or what it needs for such an address, is not installed.
    """
    text = plain_path(str(where))
    return RemoteStorage(text) if is_address(text) else LocalStorage(text)


def is_address(where: str) -> bool:
    """Return whether this is an fsspec address and no path."""
    return "://" in where


def plain_path(where: str) -> str:
    """Return the path that a ``file://`` address means, or what was given."""
    return where.removeprefix("file://") if where.startswith("file:///") else where


def remote(where: str) -> tuple[Any, str]:
    """Return the file system of an fsspec address, and the path in it.

    Raises:
      OutputError: fsspec, or what it needs for such an address, is not installed.
    """
    try:
        import fsspec

        system, inside = fsspec.core.url_to_fs(where)
    except ImportError as error:
        lacking = f"needs {error.name}" if error.name else f"cannot be reached ({error})"
        raise OutputError(
            f"'{where}' {lacking}: pip install 'mjmotion[batch]', and what fsspec needs for such"
            " addresses"
        ) from error
    except (ValueError, OSError) as error:
        raise OutputError(f"'{where}' is no address that fsspec knows: {error}") from error
    return system, str(inside).rstrip("/")


@contextlib.contextmanager
def _byte_locked(path: Path, byte: int, wait: bool) -> Iterator[None]:
    """Hold the lock of one byte of a file, which goes with whoever holds it."""
    command = getattr(fcntl, "F_OFD_SETLKW" if wait else "F_OFD_SETLK", None)
    if command is None:  # such locks are Linux's
        yield
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        # struct flock: type, whence, start, length, pid.
        asked = struct.pack("hhqqi4x", fcntl.F_WRLCK, os.SEEK_SET, byte, 1, 0)
        try:
            fcntl.fcntl(handle, command, asked)
        except OSError as error:
            if error.errno in (errno.EAGAIN, errno.EACCES):
                raise BatchError(
                    f"another run is at work on '{path.parent}': wait for it, or end it"
                ) from error
            # Some network disks have no locks: two runs at once may then do a job twice.
        yield
    finally:
        os.close(handle)


@contextlib.contextmanager
def _free(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder, or raise OSError because another holds it."""
    if fcntl is None:
        raise OSError
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(handle)
