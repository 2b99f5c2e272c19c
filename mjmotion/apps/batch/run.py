"""A batch is run: what is missing or changed is given out, and what comes back is written down."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
from collections import Counter
from collections.abc import Iterator

from mjmotion.apps.batch.executors import Executor
from mjmotion.apps.batch.jobs import Batch, Job
from mjmotion.apps.batch.record import Record
from mjmotion.apps.batch.rows import Row, row_of_error
from mjmotion.apps.batch.storage import FULL, JOBS, SHARDS, Storage
from mjmotion.apps.batch.table import write_table
from mjmotion.apps.batch.worker import Task
from mjmotion.exceptions import BatchError, OutputError
from mjmotion.numerics.progress import Progress, no_progress


@dataclasses.dataclass(frozen=True)
class Counts:
    """What a batch came to.

    Attributes:
      done: jobs that this run did, whatever came of them.
      total: jobs of which there is a line.
      exits: of all of them, exit code to number.
      errors: what failed jobs said, the commonest first, each with how many said it.
      tables: names of the files of the table.
    """

    done: int
    total: int
    exits: dict[int, int]
    errors: tuple[tuple[str, int], ...]
    tables: tuple[str, ...]


def run_batch(
    batch: Batch,
    storage: Storage,
    executor: Executor,
    *,
    shards: int = 0,
    retry_failed: bool = False,
    progress: Progress = no_progress,
) -> Counts:
    """Run what of a batch is missing or changed.

    Args:
      batch: what is to be done.
      storage: where to; what is there of the same batch counts.
      executor: where it runs; it is closed where the run is cut short.
      shards: jobs that are written into one file; 0 for a folder a job.
      retry_failed: whether failed jobs are tried again though nothing changed.
      progress: called with "jobs", done, of.

    Raises:
      BatchError: another batch is there, or another run is at work on it.
      OutputError: it cannot be written; what is done stays.
    """
    try:
        with storage.alone():
            record = Record(storage)
            _check_same(batch, record, storage)
            record.begin(shards > 0)
            try:
                return _run(batch, record, storage, executor, shards, retry_failed, progress)
            except BaseException:
                executor.close()
                with contextlib.suppress(OSError):
                    record.flush()
                raise
    except OSError as error:
        todo = (
            "what is done stays there: make room and run it again"
            if error.errno in FULL
            else "check --out"
        )
        raise OutputError(
            f"cannot write to '{storage.address}': {error.strerror or error}; {todo}"
        ) from error


def _run(  # seven parameters: what run_batch has
    batch: Batch,
    record: Record,
    storage: Storage,
    executor: Executor,
    shards: int,
    retry_failed: bool,
    progress: Progress,
) -> Counts:
    of = sum(1 for _ in _to_do(batch, record, retry_failed))
    tasks = _tasks(
        # What is known changes while the run goes on; each job is looked at once, before it runs.
        _to_do(batch, record, retry_failed),
        Task((), storage.address, batch.settings, shards > 0, executor.threads, record.run),
        max(1, shards),
        retry_failed,
    )
    done = 0
    progress("jobs", 0, of)
    for task, outcome in executor.run(tasks):
        for row in _rows(task, outcome):
            record.add(row)
            done += 1
        progress("jobs", done, of)
    record.compact()
    _drop_unused(record, storage, shards > 0)
    exits: Counter[int] = Counter()
    errors: Counter[str] = Counter()

    def counted() -> Iterator[Row]:
        for row in record.rows():
            exits[row["exit"]] += 1
            errors.update([row["error"]] if row["error"] else ())
            yield row

    tables = write_table(storage, counted())
    return Counts(done, len(record.known), dict(exits), tuple(errors.most_common()), tuple(tables))


def _rows(task: Task, outcome: list[Row] | Exception) -> list[Row]:
    """Return the lines of a task's jobs.

    Raises:
      BatchError, OutputError, OSError: what no other task would be spared.
    """
    if isinstance(outcome, list):
        return outcome
    if isinstance(outcome, (BatchError, OutputError, OSError)):
        raise outcome
    return [row_of_error(job, outcome) for job in task.jobs]


def _to_do(batch: Batch, record: Record, retry_failed: bool) -> Iterator[Job]:
    """Yield the jobs that are missing, made from something else, or failed and to be retried."""
    for job in batch.jobs():
        known = record.known.get(job.name)
        if known is None or known.key != job.key or (retry_failed and known.failed):
            yield job


def _tasks(jobs: Iterator[Job], like: Task, size: int, again: bool) -> Iterator[Task]:
    """Yield jobs in tasks of a size."""
    attempt = like.attempt if again else 0
    while some := tuple(itertools.islice(jobs, size)):
        yield dataclasses.replace(like, jobs=some, attempt=attempt)


def _check_same(batch: Batch, record: Record, storage: Storage) -> None:
    """Refuse to mix batches: one that goes on has jobs in common with what is there."""
    if record.known and not any(job.name in record.known for job in batch.jobs()):
        raise BatchError(
            f"'{storage.address}' is another batch, of jobs such as '{next(iter(record.known))}':"
            " give another --out"
        )


def _drop_unused(record: Record, storage: Storage, sharded: bool) -> None:
    """Remove shards of which no line holds any more, and folders of jobs that now fail."""
    if sharded:
        used = {row["shard"] for row in record.rows()}
        for name in storage.names(SHARDS):
            if name.partition(".")[0] not in used:
                storage.remove(f"{SHARDS}/{name}")
        return
    failed = {name for name, known in record.known.items() if known.failed}
    for name in failed.intersection(storage.names(JOBS)) if failed else ():
        storage.remove(f"{JOBS}/{name}")
