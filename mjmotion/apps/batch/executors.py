"""Where tasks run. An executor takes tasks as it can do them, and yields each as it ends."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait as wait_for
from typing import Protocol

from mjmotion.apps.batch.rows import Row
from mjmotion.apps.batch.worker import Task, environment, run_task

TRIES = 3
"""Times that a task is begun before it counts as one that kills its worker."""
DIED = "its worker died {} times: killed, out of memory, or a crash"


class WorkerDied(Exception):
    """A task whose worker died each time that it was tried."""


Outcome = tuple[Task, list[Row] | Exception]


class Executor(Protocol):
    """Something that runs tasks."""

    @property
    def threads(self) -> int:
        """Threads that each worker may use."""

    def run(self, tasks: Iterable[Task]) -> Iterator[Outcome]:
        """Run tasks, which are taken from the iterable only as they can be run.

        Yields:
          A task with the lines of its jobs, or with the error that it ended with; in any order.
        """

    def close(self) -> None:
        """End all that still runs."""


class Processes:
    """Processes of this machine, each with its share of the cores.

    A pool of one process for each worker: if one dies, it is known which task it was at, and the
    others go on.

    Args:
      workers: how many; one a core without.
      threads: of each; without, the cores are shared out.
      call: what they do with a task; a function of a module.
    """

    def __init__(
        self,
        workers: int | None = None,
        threads: int | None = None,
        call: Callable[[Task], list[Row]] = run_task,
    ) -> None:
        self._call = call
        cores = available_cores()
        self.workers = max(1, cores if workers is None else workers)
        self._threads = max(1, cores // self.workers) if threads is None else threads
        self._pools: dict[int, ProcessPoolExecutor] = {}
        self._running: dict[int, Future[int]] = {}

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def threads(self) -> int:
        """See :class:`Executor`."""
        return self._threads

    def run(self, tasks: Iterable[Task]) -> Iterator[Outcome]:
        """See :class:`Executor`."""
        more = iter(tasks)
        idle = list(range(self.workers))
        again: list[tuple[Task, int]] = []
        at_work: dict[Future[list[Row]], tuple[int, Task, int]] = {}
        while True:
            while idle:
                task, tried = again.pop() if again else (next(more, None), 0)
                if task is None:
                    break
                slot = idle.pop()
                at_work[self._submit(slot, task)] = (slot, task, tried + 1)
            if not at_work:
                return
            for future in wait(at_work, return_when=FIRST_COMPLETED).done:
                slot, task, tried = at_work.pop(future)
                idle.append(slot)
                try:
                    rows = future.result()
                except BrokenProcessPool:
                    self._drop(slot)
                    if tried < TRIES:
                        again.append((task, tried))
                    else:
                        yield task, WorkerDied(DIED.format(tried))
                except Exception as error:
                    yield task, error
                else:
                    yield task, rows

    def pids(self) -> list[int]:
        """Return the numbers of the processes that have started."""
        return [known.result() for known in self._running.values() if _succeeded(known)]

    def close(self) -> None:
        """See :class:`Executor`."""
        for slot in list(self._pools):
            self._drop(slot)

    def _submit(self, slot: int, task: Task) -> Future[list[Row]]:
        # A process starts when the first task comes, and takes over the environment.
        with environment(self._threads):
            if slot not in self._pools:
                self._pools[slot] = ProcessPoolExecutor(
                    1, multiprocessing.get_context("spawn"), initializer=begin
                )
                self._running[slot] = self._pools[slot].submit(os.getpid)
            try:
                return self._pools[slot].submit(self._call, task)
            except BrokenProcessPool as error:  # it died since it was last asked
                broken: Future[list[Row]] = Future()
                broken.set_exception(error)
                return broken

    def _drop(self, slot: int) -> None:
        """End a worker at once; what it was making is not there."""
        pool, known = self._pools.pop(slot), self._running.pop(slot)
        if _succeeded(known):
            with contextlib.suppress(OSError):
                os.kill(known.result(), signal.SIGTERM)
        pool.shutdown(cancel_futures=True)  # waits for it, so that what it held is free


def _succeeded(future: Future[int]) -> bool:
    return future.done() and not future.cancelled() and future.exception() is None


def begin() -> None:
    """Begin as a worker: Ctrl-C is for who started it, and with them it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def end_with_parent() -> None:
        wait_for([parent.sentinel])
        os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()


def available_cores() -> int:
    """Return how many cores this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on every system
        return os.cpu_count() or 1
