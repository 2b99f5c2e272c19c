"""How long the command line and the library take to start, and a whole command from the shell."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

from benchmarks.figures import Print, print_figures
from benchmarks.quality import MOCAP
from mjmotion.paper.figures import Figure
from mjmotion.paper.timing import run_in_turns

MOST, MOST_ADAPT = 0.5, 2.0  # [s]
REPEATS, REPEATS_ADAPT = 7, 5
COMMANDS = {
    "import mjmotion": (sys.executable, "-c", "import mjmotion"),
    "mjmotion --help": (sys.executable, "-m", "mjmotion", "--help"),
}
RECORDING = MOCAP / "02_01.bvh"


def run(print_line: Print, repeats: int = REPEATS) -> list[Figure]:
    """Return the best time of several, each in a process of its own."""
    tasks = {
        name: partial(subprocess.run, command, check=True, stdout=subprocess.DEVNULL)
        for name, command in COMMANDS.items()
    }
    runs = run_in_turns(tasks, repeats)
    starts = print_figures(
        [
            Figure("cli", name, min(seconds for seconds, _ in runs[name]), "s", most=MOST)
            for name in COMMANDS
        ],
        print_line,
    )
    return starts + print_figures(whole_command(), print_line)


def whole_command(repeats: int = REPEATS_ADAPT) -> list[Figure]:
    """Return the best time of ``adapt --no-video`` from the shell: read, fit, measure and report.

    The report has its plots, and its strip of poses where there is OpenGL.
    """
    clips = {"walk": "walk"} | ({RECORDING.stem: str(RECORDING)} if RECORDING.is_file() else {})
    with tempfile.TemporaryDirectory() as folder:
        tasks = {
            name: partial(adapt, clip, Path(folder) / name, "terrain_doors")
            for name, clip in clips.items()
        }
        runs = run_in_turns(tasks, repeats)
    return [
        Figure(
            "cli",
            f"adapt --no-video from the shell, terrain_doors: {name}",
            min(seconds for seconds, _ in runs[name]),
            "s",
            most=MOST_ADAPT,
        )
        for name in clips
    ]


def adapt(clip: str, folder: Path, scene: str) -> None:
    """Run the command.

    Raises:
      CalledProcessError: it wrote no result.
    """
    words = ("adapt", clip, "--scene", scene, "--no-video", "--force", "--out", str(folder))
    done = subprocess.run([sys.executable, "-m", "mjmotion", *words], capture_output=True)
    if done.returncode not in (0, 1):  # 1: a threshold is broken, which others look at
        done.check_returncode()
