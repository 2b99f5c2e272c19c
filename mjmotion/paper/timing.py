"""How long things take, side by side in one process, and on what machine."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import statistics
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")

PACKAGES = ("mjmotion", "mujoco", "numpy", "scipy", "mink", "daqp")


def run_in_turns(
    tasks: Mapping[str, Callable[[], T]], repeats: int, *, warm: bool = True
) -> dict[str, list[tuple[float, T]]]:
    """Return the time [s] and the result of every run of every task.

    The tasks take turns, so that a slow spell of the machine falls on all of them.

    Args:
      tasks: what to run.
      repeats: how often.
      warm: run each once before, which does not count.
    """
    if warm:
        for task in tasks.values():
            task()
    runs: dict[str, list[tuple[float, T]]] = {name: [] for name in tasks}
    for _ in range(repeats):
        for name, task in tasks.items():
            start = time.perf_counter()
            result = task()
            runs[name].append((time.perf_counter() - start, result))
    return runs


def median_seconds(tasks: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Return the median time of every task [s]; see :func:`run_in_turns`."""
    runs = run_in_turns(tasks, repeats)
    return {name: statistics.median(seconds for seconds, _ in runs[name]) for name in runs}


def machine() -> dict[str, str]:
    """Return what the figures were measured on: processor, system, versions; no names or paths."""
    facts = {
        "processor": _processor(),
        "cores": str(os.cpu_count()),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
    }
    for name in PACKAGES:
        try:
            facts[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            facts[name] = "not installed"
    return facts


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
