"""How long the command line and the library take to be there."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Callable

from benchmarks.figures import Figure, seconds

MOST = 0.5  # [s]
REPEATS = 7


def run(say: Callable[[str], None], repeats: int = REPEATS) -> list[Figure]:
    """Return the best time of several, each in a process of its own."""
    commands = {
        "import mjmotion": [sys.executable, "-c", "import mjmotion"],
        "mjmotion --help": [sys.executable, "-m", "mjmotion", "--help"],
    }
    figures = []
    for name, command in commands.items():
        best = math.inf
        for _ in range(repeats):
            best = min(best, seconds(lambda words=command: _call(words)))  # type: ignore[misc]
        figures.append(Figure("cli", name, best, "s", most=MOST))
        say(figures[-1].line())
    return figures


def _call(command: list[str]) -> None:
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
