"""What takes long, in a thread of its own: previews of which the newest wins, and changes.

    worker = Worker()
    worker.latest(lambda: session.preview(edit), show)
    worker.job(lambda: session.undo(), refresh, complain)
    worker.poll()                        # in the page's loop: calls show, refresh, complain there

One thread does all of it, one after another: while a change is made nothing else touches the
session, and a preview that was not begun when the next came is never made.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

Done = Callable[[Any], None]
_Task = tuple[Callable[[], Any], Done, Done]

_COUNTED = 1.0  # edits are counted over this time [s]


class Worker:
    """One thread, a slot for the newest preview, and a line of changes.

    Attributes:
      previews: how many previews were made.
    """

    def __init__(self, name: str = "editor") -> None:
        self.previews = 0
        self._lock = threading.Condition()
        self._latest: _Task | None = None
        self._jobs: deque[_Task] = deque()
        self._working = False
        self._occupied = False
        self._closed = False
        self._finished: deque[Callable[[], None]] = deque()
        self._times: deque[float] = deque()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def busy(self) -> bool:
        """Whether a change waits, is made, or was made and not yet told by :meth:`poll`."""
        with self._lock:
            return bool(self._jobs) or self._working

    @property
    def rate(self) -> int:
        """Previews made in the last second."""
        now = time.monotonic()
        while self._times and now - self._times[0] > _COUNTED:
            self._times.popleft()
        return len(self._times)

    def latest(self, call: Callable[[], Any], done: Done, failed: Done) -> None:
        """Have a preview made, in place of one that waits."""
        with self._lock:
            self._latest = (call, done, failed)
            self._lock.notify()

    def forget(self) -> None:
        """Drop the preview that waits."""
        with self._lock:
            self._latest = None

    def job(self, call: Callable[[], Any], done: Done, failed: Done) -> None:
        """Have a change made, after those that wait; the preview that waits is dropped."""
        with self._lock:
            self._latest = None
            self._jobs.append((call, done, failed))
            self._lock.notify()

    def poll(self) -> None:
        """Tell what was finished, in the caller's thread."""
        while True:
            with self._lock:
                if not self._finished:
                    return
                tell = self._finished.popleft()
            tell()

    def wait(self, seconds: float = 60.0) -> bool:
        """Wait until nothing is left to do, and tell it; False if it took longer."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.poll()
            with self._lock:
                left = self._jobs or self._latest or self._finished
                if not (left or self._working or self._occupied):
                    return True
            time.sleep(0.002)
        return False

    def close(self) -> None:
        """End the thread when it is done with what it does."""
        with self._lock:
            self._closed = True
            self._jobs.clear()
            self._latest = None
            self._lock.notify()
        self._thread.join(timeout=10.0)

    def _run(self) -> None:
        while True:
            with self._lock:
                while not (self._jobs or self._latest or self._closed):
                    self._lock.wait()
                if self._closed:
                    return
                self._occupied = True
                if self._jobs:
                    task, preview = self._jobs.popleft(), False
                    self._working = True
                else:
                    assert self._latest is not None
                    task, preview = self._latest, True
                    self._latest = None
            self._carry_out(task, preview)

    def _carry_out(self, task: _Task, preview: bool) -> None:
        call, done, failed = task
        try:
            value, tell = call(), done
        except Exception as error:
            value, tell = error, failed

        def told() -> None:
            if not preview:
                with self._lock:
                    self._working = False
            tell(value)

        if preview:
            self.previews += 1
            self._times.append(time.monotonic())
        with self._lock:
            self._finished.append(told)
            self._occupied = False


class Cancelled(Exception):
    """Raised by the progress of a task that was cancelled."""


class Task:
    """One long job aside, such as a video, which may be cancelled.

    Attributes:
      label: what it is.
      stage: what it is doing.
      share: how much of that is done, from 0 to 1.
      error: what went wrong; None while nothing did.
      value: what the job returned.
    """

    def __init__(self, label: str, call: Callable[[Callable[[str, int, int], None]], Any]) -> None:
        self.label, self.stage, self.share = label, "", 0.0
        self.error: Exception | None = None
        self.value: Any = None
        self._call = call
        self._cancelled = False
        self._thread = threading.Thread(target=self._run, name=label, daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether it is not done yet."""
        return self._thread.is_alive()

    @property
    def cancelled(self) -> bool:
        """Whether it was told to stop."""
        return self._cancelled

    def cancel(self) -> None:
        """Stop at the next step; what was half written goes."""
        self._cancelled = True

    def join(self, seconds: float) -> None:
        """Wait until it is done."""
        self._thread.join(seconds)

    def _progress(self, stage: str, done: int = 0, of: int = 0) -> None:
        if self._cancelled:
            raise Cancelled
        self.stage, self.share = stage, done / of if of else 0.0

    def _run(self) -> None:
        try:
            self.value = self._call(self._progress)
        except Cancelled:
            pass
        except Exception as error:
            self.error = error
