"""The line of a job in the table: what it was, what came of it, every figure, and what it took."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from mjmotion.apps.batch.jobs import Job
from mjmotion.apps.batch.making import Made
from mjmotion.boundary.words import first_line, one_line
from mjmotion.exceptions import MotionError
from mjmotion.validation.result import LABELS

Row = dict[str, Any]

WELL, BROKEN, BAD_INPUT, FAULT = 0, 1, 2, 3
"""What a job may end with: as the exit codes of ``mjmotion adapt``."""
SECONDS = ("load_seconds", "adapt_seconds", "validate_seconds", "write_seconds", "seconds")
TEXTS = ("job", "clip", "scene", "character")
ORIGINS = ("clip_from", "scene_from", "character_from")
COLUMNS: dict[str, type] = {
    **dict.fromkeys(TEXTS, str),
    "exit": int,
    "error": str,
    "broken": str,
    "unmet": int,
    "notes": str,
    "nframe": int,
    "fps": float,
    **dict.fromkeys(LABELS, float),
    **dict.fromkeys(SECONDS, float),
    **dict.fromkeys(ORIGINS, str),
    "shard": str,
    "key": str,
}
"""Columns of the table in order, with their types."""


def row_of(job: Job) -> Row:
    """Return the line of a job of which nothing is known yet: every column, None for no value."""
    row: Row = dict.fromkeys(COLUMNS)
    sources = (job.clip, job.scene, job.character)
    names = (job.name, *(source.name for source in sources))
    origins = (source.origin for source in sources)
    told = zip((*TEXTS, *ORIGINS), (*names, *origins), strict=True)
    return row | dict(told) | {"key": job.key}


def row_of_made(job: Job, made: Made) -> Row:
    """Return the line of a job that was made."""
    broken = made.validation.broken()
    return row_of(job) | {
        "exit": BROKEN if broken else WELL,
        "broken": " ".join(broken),
        "unmet": len(made.result.unmet),
        "notes": one_line("; ".join(made.result.notes)),
        "nframe": made.result.motion.nframe,
        "fps": made.result.motion.fps,
        **{name: made.validation.metrics[name] for name in LABELS},
        **{f"{name}_seconds": seconds for name, seconds in made.seconds.items()},
    }


def row_of_error(job: Job, error: BaseException) -> Row:
    """Return the line of a job that failed: bad input, or a fault of ours."""
    if isinstance(error, MotionError):
        code, said = BAD_INPUT, one_line(str(error))
    elif isinstance(error, MemoryError):
        code, said = BAD_INPUT, "there is not enough memory for this"
    else:
        code, said = FAULT, f"{type(error).__name__}: {first_line(error)}"
    return row_of(job) | {"exit": code, "error": said}


def is_failed(row: Mapping[str, Any]) -> bool:
    """Return whether a job has no result."""
    return row["exit"] not in (WELL, BROKEN)


def as_line(row: Mapping[str, Any]) -> str:
    """Return a line as JSON: no value and NaN are left out, infinity is the word ``inf``."""
    return json.dumps(
        {name: _plain(value) for name, value in row.items() if _is_there(value)},
        ensure_ascii=False,
        allow_nan=False,
    )


def from_lines(text: str | bytes) -> Iterator[Row]:
    """Yield the lines of a file of them.

    Raises:
      ValueError: it is damaged.
    """
    data = text.decode("utf-8") if isinstance(text, bytes) else text
    for line in data.split("\n"):
        if not line:
            continue
        said = json.loads(line)
        if not isinstance(said, dict) or not {"job", "key", "exit"} <= said.keys():
            raise ValueError("a line is of no job")
        row: Row = dict.fromkeys(COLUMNS)
        for name, kind in COLUMNS.items():
            value = said.get(name)
            row[name] = float("nan") if value is None and kind is float else value
            if value is not None:
                row[name] = kind(value)
        yield row


def as_lines(rows: Iterable[Mapping[str, Any]]) -> bytes:
    """Return a file of lines."""
    return "".join(as_line(row) + "\n" for row in rows).encode("utf-8", "backslashreplace")


def _is_there(value: object) -> bool:
    return value is not None and not (isinstance(value, float) and math.isnan(value))


def _plain(value: object) -> object:
    return str(value) if isinstance(value, float) and math.isinf(value) else value
