"""How long the command line and the library take to start."""

from __future__ import annotations

import subprocess
import sys
from functools import partial

from benchmarks.figures import Print, print_figures
from mjmotion.paper.figures import Figure
from mjmotion.paper.timing import run_in_turns

MOST = 0.5  # [s]
REPEATS = 7
COMMANDS = {
    "import mjmotion": (sys.executable, "-c", "import mjmotion"),
    "mjmotion --help": (sys.executable, "-m", "mjmotion", "--help"),
}


def run(print_line: Print, repeats: int = REPEATS) -> list[Figure]:
    """Return the best time of several, each in a process of its own."""
    tasks = {
        name: partial(subprocess.run, command, check=True, stdout=subprocess.DEVNULL)
        for name, command in COMMANDS.items()
    }
    runs = run_in_turns(tasks, repeats)
    return print_figures(
        [
            Figure("cli", name, min(seconds for seconds, _ in runs[name]), "s", most=MOST)
            for name in COMMANDS
        ],
        print_line,
    )
