"""What a worker does: a task of one job, or of the jobs of a shard, made and written.

It is the same function in a process of this machine and on a Dask cluster. It may be called twice
with one task, after a worker or a scheduler died: what is there already is not made again.
"""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import os
import threading
import time
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import mjmotion
from mjmotion.apps.batch.jobs import Job, Settings, digest
from mjmotion.apps.batch.making import Clock, Loaded, Made, make
from mjmotion.apps.batch.rows import (
    Row,
    as_line,
    as_lines,
    from_lines,
    is_failed,
    row_of_error,
    row_of_made,
)
from mjmotion.apps.batch.storage import FULL, JOBS, MARK, SHARDS, Storage, open_storage
from mjmotion.boundary.quiet import gathered
from mjmotion.exceptions import BatchError, OutputError
from mjmotion.footsteps.contacts import save_contacts
from mjmotion.output.folder import CONTACTS, MOTION
from mjmotion.output.result import write_results

THREADS = (
    *("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS"),
    *("VECLIB_MAXIMUM_THREADS", "NUMEXPR_NUM_THREADS", "LP_NUM_THREADS"),
)
"""What bounds the threads of BLAS, of OpenMP, and of OpenGL without a graphics card (llvmpipe)."""


@dataclasses.dataclass(frozen=True)
class Task:
    """What is given to a worker at once.

    Attributes:
      jobs: one, or those of a shard.
      out: where to: a path or an fsspec address.
      settings: how.
      sharded: whether they are written into one file.
      threads: how many threads the worker may use.
      attempt: number of the run that tries failed jobs again; 0 where nothing was tried.
      version: of mjmotion where the batch was begun.
    """

    jobs: tuple[Job, ...]
    out: str
    settings: Settings
    sharded: bool = False
    threads: int = 1
    attempt: int = 0
    version: str = mjmotion.__version__

    @property
    def key(self) -> str:
        """Hash of what is to be done, the same for the same."""
        jobs = (f"{job.name} {job.key}" for job in self.jobs)
        return digest("\n".join((*jobs, str(self.attempt))))


_STAYS = "what is done stays there: make room and run it again"
GIVE_BACK = 2.0
"""Seconds after which memory that was freed is given back to the system."""


class Heap:
    """The memory of this process, of which what was freed is given back now and then.

    Scenes come and go in another order than they are kept, and glibc's heap would grow by the gaps.
    """

    def __init__(self) -> None:
        self._last = time.monotonic()

    def give_back(self) -> None:
        """Give back what was freed, if that is long ago and the C library can: it takes 4 ms."""
        if time.monotonic() - self._last < GIVE_BACK:
            return
        with contextlib.suppress(AttributeError, OSError, TypeError):
            ctypes.CDLL(None).malloc_trim(0)
        self._last = time.monotonic()


# What this process has read so far. Jobs in one process take turns: what MuJoCo and NumPy say goes
# through hooks that a process has once.
_LOADED = Loaded()
_HEAP = Heap()
_TURN = threading.Lock()


def run_task(task: Task, clock: Clock = time.perf_counter) -> list[Row]:
    """Do the jobs of a task that are not done, and return the lines of all.

    Args:
      task: what is to be done.
      clock: by which times are told [s].

    Raises:
      BatchError: this worker has another version of mjmotion.
      OutputError: it cannot be written, and no other could be either.
    """
    if task.version != mjmotion.__version__:
        raise BatchError(
            f"a worker has mjmotion {mjmotion.__version__}, and this is {task.version}:"
            " install the same everywhere"
        )
    with _TURN, bounded(task.threads), gathered():
        storage = open_storage(task.out)
        try:
            return _run_shard(task, storage) if task.sharded else _run_jobs(task, storage, clock)
        except OutputError as error:
            raise OutputError(f"{error}; {_STAYS}") from error
        except OSError as error:
            if error.errno in FULL:
                raise OutputError(
                    f"cannot write to '{task.out}': {error.strerror}; {_STAYS}"
                ) from error
            raise


def _run_jobs(task: Task, storage: Storage, clock: Clock) -> list[Row]:
    """Do jobs, each into a folder of its own."""
    rows = []
    for job in task.jobs:
        rows.append(_run_job(job, task.settings, storage, clock))
        _HEAP.give_back()
    return rows


def _run_job(job: Job, settings: Settings, storage: Storage, clock: Clock) -> Row:
    name = f"{JOBS}/{job.name}"
    with storage.claim(name):
        if (there := done_row(storage, job)) is not None:
            return there
        began = clock()
        with storage.aside() as aside:
            # An interrupt goes through; all else is this job's alone, but for a disk that is full.
            try:
                made = make(job, settings, _LOADED, clock)
                row = _written(aside, job, made, settings, began, clock)
            except OutputError:
                raise
            except OSError as error:
                if error.errno in FULL:
                    raise
                return row_of_error(job, error) | {"seconds": clock() - began}
            except Exception as error:
                return row_of_error(job, error) | {"seconds": clock() - began}
            storage.put(name, aside)
    return row


def done_row(storage: Storage, job: Job) -> Row | None:
    """Return the line of a job whose folder is there and made from the same; else None."""
    said = storage.read(f"{JOBS}/{job.name}/{MARK}")
    if said is None:
        return None
    with contextlib.suppress(ValueError, TypeError):
        row = next(from_lines(said))
        if row["key"] == job.key:
            return row
    return None


def _written(
    folder: Path, job: Job, made: Made, settings: Settings, began: float, clock: Clock
) -> Row:
    """Write a job's files into a folder that is there; return its line, which is one of them."""
    start = clock()
    row = row_of_made(job, made)
    if settings.report:
        write_results(folder, made.result, made.validation, video=False, title=job.name)
    else:
        made.result.motion.save(folder / MOTION, compressed=False)
        save_contacts(folder / CONTACTS, made.result.contacts)
    now = clock()
    row |= {"write_seconds": now - start, "seconds": now - began}
    (folder / MARK).write_text(as_line(row) + "\n", "utf-8", "backslashreplace")
    return row


def _run_shard(task: Task, storage: Storage) -> list[Row]:
    """Do jobs into one file, whole or not at all; another holds their lines, and comes last."""
    name = f"{SHARDS}/{task.key}"
    with storage.claim(name):
        said = storage.read(f"{name}.jsonl")
        if said is not None:
            return list(from_lines(said))
        rows = []
        with storage.aside() as aside:
            whole = aside / "shard.zip"
            with zipfile.ZipFile(whole, "w", zipfile.ZIP_STORED) as file:
                for job in task.jobs:
                    row = _into_shard(file, aside / "job", job, task.settings)
                    rows.append(row | {"shard": task.key})
                    _HEAP.give_back()
            storage.put(f"{name}.zip", whole)
        storage.write(f"{name}.jsonl", as_lines(rows))
    return rows


def _into_shard(file: zipfile.ZipFile, folder: Path, job: Job, settings: Settings) -> Row:
    began = time.perf_counter()
    folder.mkdir()
    try:
        made = make(job, settings, _LOADED)
        row = _written(folder, job, made, settings, began, time.perf_counter)
    except OutputError:
        raise
    except OSError as error:
        if error.errno in FULL:
            raise
        row = row_of_error(job, error)
    except Exception as error:
        row = row_of_error(job, error)
    for path in sorted(folder.iterdir()):
        if not is_failed(row):
            file.write(path, f"{job.name}/{path.name}")
        path.unlink()
    folder.rmdir()
    return row


@contextlib.contextmanager
def bounded(threads: int) -> Iterator[None]:
    """Keep the thread pools of this process to its share while the block runs.

    Pools read the environment when they start. Those that run already, such as in a Dask worker,
    are bounded where threadpoolctl is installed.
    """
    with environment(threads), contextlib.ExitStack() as stack:
        with contextlib.suppress(ImportError):
            from threadpoolctl import threadpool_limits

            stack.enter_context(threadpool_limits(threads))
        yield


@contextlib.contextmanager
def environment(threads: int) -> Iterator[None]:
    """Set what bounds thread pools in the environment, for what starts in the block."""
    before: Mapping[str, str | None] = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, str(threads)))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
