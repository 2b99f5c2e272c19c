"""A command in a child of this process: no start of Python, and its time and memory measured."""

from __future__ import annotations

import dataclasses
import os
import resource
import signal
import sys
import tempfile
import time
from pathlib import Path

import command_line

SECONDS, BYTES = 5.0, 1 << 30  # what a refusal may take


@dataclasses.dataclass(frozen=True)
class Done:
    """How a command ended.

    Attributes:
      code: its exit code; -9 if it was ended because it took too long.
      stdout, stderr: what it wrote.
      seconds: how long it took.
      bytes: how much memory it took, beyond what this process had.
    """

    code: int
    stdout: str
    stderr: str
    seconds: float
    bytes: int


def run(folder: Path, *words: object, seconds: float = 60.0) -> Done:
    """Run ``mjmotion`` with these words in a folder, to its end or for so long."""
    had = _peak()
    with tempfile.TemporaryDirectory() as aside:
        told = Path(aside)
        started = time.perf_counter()
        child = os.fork()
        if child == 0:
            _child(folder, told, [str(word) for word in words])
        status, usage = _wait(child, started + seconds)
        took = time.perf_counter() - started
        texts = [
            (told / name).read_text("utf-8", "replace") if (told / name).exists() else ""
            for name in ("out", "err")
        ]
    code = os.waitstatus_to_exitcode(status)
    return Done(code, texts[0], texts[1], took, max(0, usage.ru_maxrss * 1024 - had))


def _peak() -> int:
    """This process's own memory now [bytes]: a child begins with it."""
    pages = int(Path("/proc/self/statm").read_text("utf-8").split()[1])
    return pages * resource.getpagesize()


def _child(folder: Path, told: Path, words: list[str]) -> None:
    code = 99
    try:
        os.chdir(folder)
        done = command_line.run(*words)
        (told / "out").write_text(done.stdout, "utf-8", "replace")
        (told / "err").write_text(done.stderr, "utf-8", "replace")
        code = done.returncode
    finally:
        sys.stdout = sys.stderr = None  # nothing of the parent's is written twice
        os._exit(code)


def _wait(child: int, until: float) -> tuple[int, resource.struct_rusage]:
    while True:
        pid, status, usage = os.wait4(child, os.WNOHANG)
        if pid:
            return status, usage
        if time.perf_counter() > until:
            os.kill(child, signal.SIGKILL)
            _, status, usage = os.wait4(child, 0)
            return status, usage
        time.sleep(0.005)
