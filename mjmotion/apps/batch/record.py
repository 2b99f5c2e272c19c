"""What is known of the jobs of a batch: their lines, written as they come, the last of each holds.

Only who began the run writes here. Lines come in files of their own, each written whole, so that it
works the same on a disk and on an object store, and a kill costs what came in the last seconds;
those jobs' folders are there, and are found when they are given out again.
"""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Iterator
from typing import NamedTuple

from mjmotion.apps.batch.rows import Row, as_lines, from_lines, is_failed
from mjmotion.apps.batch.storage import (
    JOBS,
    ROWS,
    SHARDS,
    STATE,
    TABLE,
    RemoteStorage,
    Storage,
)
from mjmotion.exceptions import BatchError, OutputError

EVERY = 2.0
"""Seconds after which lines are written at the latest."""
ROWS_AT_ONCE = 10_000
"""Lines of a file at most."""
_FORMAT = "mjmotion batch 1"
_OURS = {
    *(STATE, ROWS, JOBS, SHARDS, ".making", ".locks"),
    *(f"{TABLE}.csv", f"{TABLE}.parquet", "summary.html"),
}


class Known(NamedTuple):
    """What is kept in memory of a job.

    Attributes:
      key: hash of what it was made from.
      failed: whether it has no result.
      file, line: where its line is.
    """

    key: str
    failed: bool
    file: int
    line: int


class Record:
    """The lines of a batch.

    Args:
      storage: of the batch.

    Raises:
      BatchError: what is there is no batch.
    """

    def __init__(self, storage: Storage) -> None:
        self._storage = storage
        self.known: dict[str, Known] = {}
        self._new: list[Row] = []
        self._written = time.monotonic()
        self._file = 0
        self.sharded: bool | None = None
        self._check()
        for file in self._files():
            self._file = file
            for line, row in enumerate(self._rows(file)):
                self._know(row, file, line)
        self._file += 1

    @property
    def run(self) -> int:
        """A number that no earlier run had."""
        return self._file

    def begin(self, sharded: bool) -> None:
        """Say that this is a batch, and how it is laid out.

        Raises:
          BatchError: it is laid out otherwise.
        """
        if self.sharded not in (None, sharded):
            raise BatchError(
                f"'{self._storage.address}' is a batch {'with' if self.sharded else 'without'}"
                f" shards: run it {'with --shards' if self.sharded else 'without'}, or give another"
                " --out"
            )
        self.sharded = sharded
        state = {"format": _FORMAT, "sharded": sharded}
        self._storage.write(STATE, (json.dumps(state) + "\n").encode())

    def add(self, row: Row) -> None:
        """Take in what came of a job."""
        self._know(row, self._file, len(self._new))
        self._new.append(row)
        late = time.monotonic() - self._written > EVERY
        if late or len(self._new) >= ROWS_AT_ONCE:
            self.flush()

    def flush(self) -> None:
        """Write the lines that are not written yet."""
        self._written = time.monotonic()
        if self._new:
            self._storage.write(f"{ROWS}/{self._file:06}.jsonl", as_lines(self._new))
            self._new = []
            self._file += 1

    def rows(self) -> Iterator[Row]:
        """Yield the line that holds of every job, in the order in which they came."""
        self.flush()
        for file in self._files():
            for line, row in enumerate(self._rows(file)):
                known = self.known[row["job"]]
                if (known.file, known.line) == (file, line):
                    yield row

    def compact(self) -> None:
        """Write many small files of lines as few, and forget lines that no longer hold."""
        self.flush()
        old = self._files()
        if len(old) <= 2 + len(self.known) // ROWS_AT_ONCE:
            return
        places: list[Known] = []
        for row in self.rows():
            places.append(Known(row["key"], is_failed(row), self._file, len(self._new)))
            self._new.append(row)
            if len(self._new) >= ROWS_AT_ONCE:
                self.flush()
        self.flush()
        for file in old:
            self._storage.remove(f"{ROWS}/{file:06}.jsonl")
        for file in self._files():
            for line, row in enumerate(self._rows(file)):
                self._know(row, file, line)

    def _know(self, row: Row, file: int, line: int) -> None:
        self.known[row["job"]] = Known(row["key"], is_failed(row), file, line)

    def _files(self) -> list[int]:
        names = [name.removesuffix(".jsonl") for name in self._storage.names(ROWS)]
        return sorted(int(name) for name in names if name.isdecimal())

    def _rows(self, file: int) -> Iterator[Row]:
        name = f"{ROWS}/{file:06}.jsonl"
        try:
            yield from from_lines(self._storage.read(name) or b"")
        except (ValueError, TypeError) as error:
            raise BatchError(
                f"'{self._storage.address}/{name}' is damaged ({error}): remove it; its jobs are"
                " then looked for in their folders"
            ) from error

    def _check(self) -> None:
        """Refuse a folder that holds anything but a batch."""
        address = self._storage.address
        try:
            names = self._storage.names()
            said = self._storage.read(STATE)
        except OSError as error:
            raise OutputError(f"cannot read '{address}': {error.strerror or error}") from error
        if said is None:
            if set(names) - {".locks", ".making"}:
                raise BatchError(f"'{address}' holds other files than a batch: give another --out")
            return
        state = None
        with contextlib.suppress(ValueError):
            state = json.loads(said)
        if not isinstance(state, dict) or state.get("format") != _FORMAT:
            raise BatchError(f"'{address}/{STATE}' is not of this version: give another --out")
        self.sharded = bool(state.get("sharded"))
        own = sorted(set(names) - _OURS)
        own = [name for name in own if ".mjmotion-" not in name]  # left aside by a killed run
        if own and not isinstance(self._storage, RemoteStorage):
            raise BatchError(
                f"'{address}' holds what mjmotion did not write: {own[0]}: move it, or give another"
                " --out"
            )
