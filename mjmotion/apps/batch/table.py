"""The table of a batch: CSV always, Parquet where pyarrow is installed. Written line by line."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator
from itertools import islice
from typing import Any

from mjmotion.apps.batch.rows import COLUMNS, Row
from mjmotion.apps.batch.storage import TABLE, Storage

_AT_ONCE = 10_000  # lines that are held in memory


def write_table(storage: Storage, rows: Iterable[Row]) -> list[str]:
    """Write the table, whole, over an earlier one.

    Args:
      storage: of the batch.
      rows: its lines, each job once.

    Returns:
      The names of the files.
    """
    names = [f"{TABLE}.csv"]
    with storage.aside() as aside:
        places = [aside / names[0]]
        with places[0].open("w", encoding="utf-8", errors="backslashreplace", newline="") as file:
            text = csv.writer(file, lineterminator="\n")
            text.writerow(COLUMNS)
            arrow = _Arrow.open(aside / f"{TABLE}.parquet")
            for some in _in_pieces(rows):
                text.writerows([_cell(row[name]) for name in COLUMNS] for row in some)
                if arrow is not None:
                    arrow.write(some)
        if arrow is not None:
            arrow.close()
            places.append(aside / f"{TABLE}.parquet")
            names.append(f"{TABLE}.parquet")
        else:  # an older one would say otherwise
            storage.remove(f"{TABLE}.parquet")
        for name, place in zip(names, places, strict=True):
            storage.put(name, place)
    return names


def _in_pieces(rows: Iterable[Row]) -> Iterator[list[Row]]:
    more = iter(rows)
    while some := list(islice(more, _AT_ONCE)):
        yield some


def _cell(value: object) -> object:
    """Return a value for CSV: nothing for none and NaN."""
    return "" if value is None or value != value else value


class _Arrow:
    """A Parquet file that is written piece by piece."""

    def __init__(self, arrow: Any, parquet: Any, path: str) -> None:
        kinds = {str: arrow.string(), int: arrow.int64(), float: arrow.float64()}
        self._arrow = arrow
        self._schema = arrow.schema([(name, kinds[kind]) for name, kind in COLUMNS.items()])
        self._file = parquet.ParquetWriter(path, self._schema)

    @classmethod
    def open(cls, path: Any) -> _Arrow | None:
        """Return a file to be written; None where pyarrow is not installed."""
        try:
            import pyarrow
            import pyarrow.parquet
        except ImportError:
            return None
        return cls(pyarrow, pyarrow.parquet, str(path))

    def write(self, rows: list[Row]) -> None:
        columns = {
            name: [None if row[name] != row[name] else row[name] for row in rows]
            for name in COLUMNS
        }
        self._file.write_table(self._arrow.table(columns, schema=self._schema))

    def close(self) -> None:
        self._file.close()
