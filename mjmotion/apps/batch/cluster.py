"""A Dask cluster as an executor. Dask gives tasks out, and again where a worker died."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Iterable, Iterator
from typing import Any

from mjmotion.apps.batch.executors import DIED, TRIES, Outcome, WorkerDied
from mjmotion.apps.batch.rows import Row
from mjmotion.apps.batch.worker import Task, run_task
from mjmotion.exceptions import BatchError

CONNECT = 10.0
"""How long a scheduler may take to answer when the run begins [s]."""
PATIENCE = 600.0
"""How long a scheduler that went away may take to come back [s]."""
_AHEAD = 2  # tasks for each thread of the cluster that are given to the scheduler
_POLL = 0.5  # [s]
# They would write to the terminal about what is dealt with here.
_LOUD = ("distributed.client", "distributed.core", "distributed.comm", "distributed.utils")


class Cluster:
    """The workers of a Dask cluster.

    Give each worker one thread (``dask worker --nthreads 1``): in one process jobs take turns.

    Args:
      address: of the scheduler, such as ``tcp://host:8786``.
      threads: of BLAS and OpenGL that each worker may use.
      patience: how long a scheduler that went away is waited for [s].

    Raises:
      BatchError: distributed is not installed, or there is no such scheduler.
    """

    def __init__(self, address: str, threads: int = 1, patience: float = PATIENCE) -> None:
        self._address, self._patience = address, patience
        self.threads = threads
        self._runs = 0
        self._client = self._connect(CONNECT)

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _workers(self) -> int:
        """Return how many tasks run at once, as far as is known now."""
        try:
            return max(1, sum(self._client.nthreads().values()))
        except Exception:  # the scheduler is away: any error of Dask's, Tornado's or the system's
            return 1

    def run(self, tasks: Iterable[Task]) -> Iterator[Outcome]:
        """See :class:`mjmotion.apps.batch.executors.Executor`."""
        more = iter(tasks)
        waiting: list[Task] = []
        given: dict[Any, Task] = {}
        while True:
            room = _AHEAD * self._workers() - len(given)
            while room > 0 and (task := waiting.pop() if waiting else next(more, None)):
                future = self._submit(task)
                if future is None:
                    waiting.append(task)
                    break
                given[future] = task
                room -= 1
            if not given and not waiting:
                return
            lost = False
            for future in self._ended(given):
                outcome = _outcome(future)
                if outcome is None:
                    lost = True
                else:
                    yield given.pop(future), outcome
            if lost or self._client.status != "running":
                # The scheduler is new and knows of nothing: all is given out again. What workers
                # have written meanwhile is found by those that come to it.
                waiting += given.values()
                given.clear()
                self._come_back()

    def close(self) -> None:
        """See :class:`mjmotion.apps.batch.executors.Executor`."""
        self._client.close(timeout=2)

    def _submit(self, task: Task) -> Any:
        """Return a future; None where the scheduler is away."""
        # Another key after every loss: under the old one the client remembers what was lost.
        key = f"mjmotion-{task.key}-{self._runs}"
        try:
            return self._client.submit(run_task, task, key=key, pure=False)
        except Exception:  # Dask's own, or Tornado's
            if self._client.status == "running":
                raise
            return None

    def _ended(self, given: dict[Any, Task]) -> list[Any]:
        """Return futures that have ended, after a while at the latest."""
        until = time.monotonic() + _POLL
        pause = 0.002
        while not (ended := [future for future in given if future.done()]):
            if time.monotonic() > until:
                break
            time.sleep(pause)
            pause = min(2 * pause, 0.05)
        return ended

    def _come_back(self) -> None:
        """Connect to the scheduler anew."""
        self._runs += 1
        self.close()
        until = time.monotonic() + self._patience
        while True:
            try:
                self._client = self._connect(min(CONNECT, self._patience))
                return
            except BatchError as error:
                if time.monotonic() > until:
                    raise BatchError(
                        f"{error}; what is done stays there: run it again once there is one"
                    ) from error
                time.sleep(1.0)

    def _connect(self, timeout: float) -> Any:
        try:
            import distributed
        except ImportError as error:
            raise BatchError(f"--dask needs {error.name}: pip install 'mjmotion[batch]'") from error
        for name in _LOUD:
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
        try:
            return distributed.Client(
                self._address, timeout=timeout, set_as_default=False, heartbeat_interval=1000
            )
        except (OSError, ValueError, TimeoutError) as error:
            raise BatchError(
                f"no Dask scheduler answers at '{self._address}': start one with 'dask scheduler',"
                " and workers with 'dask worker ADDRESS --nthreads 1'"
            ) from error


def _outcome(future: Any) -> list[Row] | Exception | None:
    """Return what a task came to that has ended: lines, an error, or None where it was lost."""
    import distributed

    status = future.status
    try:
        if status == "finished":
            rows: list[Row] = future.result(timeout=CONNECT)
            return rows
        error = future.exception(timeout=CONNECT) if status == "error" else None
    except (Exception, asyncio.CancelledError):  # not the task's: it could not be asked for
        return None
    if isinstance(error, distributed.scheduler.KilledWorker):
        return WorkerDied(DIED.format(TRIES))
    return error if isinstance(error, Exception) else None
