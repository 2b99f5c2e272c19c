"""A command in a process of its own, its time and memory measured."""

from __future__ import annotations

import dataclasses
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SECONDS, BYTES = 5.0, 1 << 30  # what a refusal may take


@dataclasses.dataclass(frozen=True)
class Done:
    """How a command ended.

    Attributes:
      code: its exit code; -9 if it was ended because it took too long.
      stdout, stderr: what it wrote.
      seconds: how long it took.
      bytes: how much memory it took.
    """

    code: int
    stdout: str
    stderr: str
    seconds: float
    bytes: int


def run(folder: Path, *words: object, seconds: float = 60.0) -> Done:
    """Run ``mjmotion`` with these words in a folder, to its end or for so long.

    Not a fork of this process: pytest's has threads by then, which a child would wait for.
    """
    command = [sys.executable, "-m", "mjmotion", *map(str, words)]
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as error:
        started = time.perf_counter()
        child = subprocess.Popen(command, cwd=folder, stdout=out, stderr=error)
        status, most = _wait(child.pid, started + seconds)
        took = time.perf_counter() - started
        child.returncode = os.waitstatus_to_exitcode(status)
        texts = []
        for file in (out, error):
            file.seek(0)
            texts.append(file.read().decode("utf-8", "replace"))
    return Done(child.returncode, texts[0], texts[1], took, most)


def _wait(child: int, until: float) -> tuple[int, int]:
    """Return how a process ended, and the most memory that it had [bytes]."""
    most = 0
    while True:
        most = max(most, _peak(child))
        pid, status = os.waitpid(child, os.WNOHANG)
        if pid:
            return status, most
        if time.perf_counter() > until:
            os.kill(child, signal.SIGKILL)
            _, status = os.waitpid(child, 0)
            return status, most
        time.sleep(0.005)


def _peak(process: int) -> int:
    """Return the most memory of a process so far [bytes]; 0 of one that has ended.

    Not what ``wait4`` tells: that begins with what this process had.
    """
    try:
        text = Path(f"/proc/{process}/status").read_text("utf-8")
    except OSError:
        return 0
    sizes = [line.split()[1] for line in text.splitlines() if line.startswith("VmHWM:")]
    return 1024 * int(sizes[0]) if sizes else 0
