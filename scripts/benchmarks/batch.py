"""A batch: what a second worker gains, what a job costs beside its work, memory, broken inputs.

The work is real: every job is planned, fitted, measured and written. Sizes are arguments, and stand
in the names of the figures.
"""

from __future__ import annotations

import dataclasses
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

from benchmarks.figures import Print, print_figures
from mjmotion.apps.batch import (
    Batch,
    Counts,
    Processes,
    Settings,
    make_batch,
    open_storage,
    run_batch,
)
from mjmotion.apps.batch.executors import Outcome
from mjmotion.apps.batch.record import Record
from mjmotion.apps.batch.rows import Row
from mjmotion.apps.batch.worker import Task, run_task
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.paper.figures import Figure

GAIN, OVERHEAD_MS, SECONDS, GROWTH = 1.8, 10.0, 0.4, 1.05  # targets
TERRAINS, JOBS = 100, 1000  # where nothing else is asked for; the are 1,000 and 10,000
SCALE_JOBS, OVERHEAD_JOBS, TURNS = 8, 30, 3
FRAMES = 40  # of the smallest job that stands on both feet in turn
BROKEN = 100  # one in so many
QUICK = Settings(report=False)


def run(print_line: Print, terrains: int = TERRAINS, jobs: int = JOBS) -> list[Figure]:
    """Return all figures of a batch.

    Args:
      print_line: prints each as it is measured.
      terrains: how many are walked on.
      jobs: how many there are with one in a hundred broken.
    """
    figures = print_figures(overhead(), print_line)
    figures += print_figures(two_workers(), print_line)
    figures += print_figures(many_terrains(terrains), print_line)
    return figures + print_figures(broken_inputs(jobs), print_line)


class Here:
    """An executor of this process, whose clock counts the time of the processor."""

    threads = 1

    def run(self, tasks: Iterable[Task]) -> Iterator[Outcome]:
        """Run them one after another."""
        for task in tasks:
            yield task, run_task(task, time.process_time)

    def close(self) -> None:
        """Nothing runs on."""


def short_clips(folder: Path, count: int, broken: int = 0) -> str:
    """Write clips of a few frames, each another, every so many cut off; return their glob."""
    walk = load_clip("walk")
    spare = walk.nframe - FRAMES
    for index in range(count):
        path = folder / f"c{index:05}.npz"
        first = index % spare
        # The rate makes those differ that begin at the same frame.
        Motion(walk.character, walk.qpos[first : first + FRAMES], 30 + index // spare / 1e3).save(
            path, compressed=False
        )
        if broken and index % broken == broken // 2:
            path.write_bytes(path.read_bytes()[: 1000 + index])
    return str(folder / "*.npz")


def rows_of(out: Path) -> list[Row]:
    return list(Record(open_storage(out)).rows())


def overhead() -> list[Figure]:
    """Return what a job takes of the processor beside planning, fit and validation.

    Clip, scene and character are loaded: one clip, on one scene, under many settings would be one
    job, so each is another clip of the same few frames; what reading it takes is counted.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "clips").mkdir()
        batch = make_batch([short_clips(folder / "clips", OVERHEAD_JOBS)], ["flat"], settings=QUICK)
        first = dataclasses.replace(batch, clips=batch.clips[:1])
        run_batch(first, open_storage(folder / "warm"), Here())
        began = time.process_time()
        run_batch(batch, open_storage(folder / "out"), Here())
        whole = time.process_time() - began
        rows = rows_of(folder / "out")
    work = sum(row["adapt_seconds"] + row["validate_seconds"] for row in rows)
    each = {
        part: 1000 * statistics.mean(row[f"{part}_seconds"] for row in rows)
        for part in ("load", "adapt", "validate", "write")
    }
    note = ", ".join(f"{part} {value:.1f}" for part, value in each.items()) + " ms"
    return [
        Figure(
            "batch",
            "a job beside planning, fit and validation, of the processor",
            1000 * (whole - work) / len(rows),
            "ms",
            most=OVERHEAD_MS,
            note=note,
        )
    ]


def timed(batch: Batch, out: Path, executor: Processes) -> tuple[float, float]:
    """Run a batch; return how long it took, and its workers' time of the processor [s]."""
    before = processor_seconds(executor.pids())
    began = time.perf_counter()
    run_batch(batch, open_storage(out), executor)
    return time.perf_counter() - began, processor_seconds(executor.pids()) - before


def two_workers() -> list[Figure]:
    """Return how much faster two workers are than one, once they run, in turns."""
    ratios, seconds, plain, used = [], [], [], []
    with (
        tempfile.TemporaryDirectory() as name,
        Processes(1, threads=1) as one,
        Processes(2, threads=1) as two,
    ):
        batch = make_batch(["walk"], terrains=SCALE_JOBS, settings=QUICK)
        first = dataclasses.replace(batch, scenes=batch.scenes[:2])
        for number, executor in enumerate((one, two)):  # the workers start
            timed(first, Path(name) / f"warm-{number}", executor)
        for turn in range(TURNS):
            took = [
                timed(batch, Path(name) / f"{turn}-{number}", executor)
                for number, executor in enumerate((one, two))
            ]
            (one_took, one_used), (two_took, two_used) = took
            ratios.append(one_took / two_took)
            used.append(2 * one_used / two_used if two_used else math.nan)
            seconds.append(two_took)
            plain.append(2 * loops(1) / loops(2))
    return [
        Figure(
            "batch",
            "two workers over one",
            statistics.median(ratios),
            "x",
            least=GAIN,
            note=f"bare loops on this machine meanwhile: {statistics.median(plain):.2f}",
        ),
        Figure("batch", "two workers over one, were cores free", statistics.median(used), "x"),
        Figure("batch", f"{SCALE_JOBS} terrains with two workers", statistics.median(seconds), "s"),
    ]


def processor_seconds(pids: Iterable[int]) -> float:
    """Return what processes have used of the processor [s]; 0 where the system does not tell."""
    ticks = 0
    for pid in pids:
        try:
            text = Path(f"/proc/{pid}/stat").read_text("utf-8", "replace")
        except OSError:
            continue
        ticks += sum(int(word) for word in text.rpartition(")")[2].split()[11:13])
    return ticks / os.sysconf("SC_CLK_TCK")


def loops(count: int) -> float:
    """Return how long so many processes take that only count, at once [s]: what cores there are."""
    code = "for _ in range(30_000_000): pass"
    began = time.perf_counter()
    started = [subprocess.Popen([sys.executable, "-c", code]) for _ in range(count)]
    for process in started:
        process.wait()
    return time.perf_counter() - began


def many_terrains(terrains: int) -> list[Figure]:
    """Return time and memory of one clip on many terrains that are made meanwhile."""
    memory: list[int] = []
    with tempfile.TemporaryDirectory() as name, Processes(threads=1) as executor:
        out = Path(name) / "out"
        batch = make_batch(["walk"], terrains=terrains, settings=QUICK)

        def look(stage: str, done: int, of: int) -> None:
            memory.append(resident_bytes(executor.pids()))

        began = time.perf_counter()
        run_batch(batch, open_storage(out), executor, progress=look)
        took = time.perf_counter() - began
        rows = rows_of(out)
    half = len(memory) // 2
    return [
        Figure(
            "batch",
            f"{terrains} terrains × 464 frames, a job and core",
            took * executor.workers / len(rows),
            "s",
            most=SECONDS,
            note=f"adapt {statistics.median(row['adapt_seconds'] for row in rows):.2f} s",
            failed=any(row["exit"] > 1 for row in rows),
        ),
        Figure(
            "batch",
            f"memory of workers, second half of {terrains} jobs over first",
            max(memory[half:]) / max(memory[:half]),
            "x",
            most=GROWTH,
            note=f"{max(memory) / 2**20:.0f} MB together",
        ),
    ]


def resident_bytes(pids: Iterable[int]) -> int:
    """Return the memory that processes hold [bytes]; 0 where the system does not tell."""
    total = 0
    for pid in pids:
        try:
            text = Path(f"/proc/{pid}/status").read_text("utf-8")
        except OSError:
            continue
        total += sum(
            1024 * int(line.split()[1]) for line in text.splitlines() if line.startswith("VmRSS")
        )
    return total


def broken_inputs(jobs: int) -> list[Figure]:
    """Return how many of many jobs are done where one in a hundred clips is cut off."""
    with tempfile.TemporaryDirectory() as name, Processes(threads=1) as executor:
        folder = Path(name)
        (folder / "clips").mkdir()
        batch = make_batch([short_clips(folder / "clips", jobs, BROKEN)], ["flat"], settings=QUICK)
        began = time.perf_counter()
        counts: Counts = run_batch(batch, open_storage(folder / "out"), executor)
        took = time.perf_counter() - began
    bad = sum(1 for index in range(jobs) if index % BROKEN == BROKEN // 2)
    done = counts.exits.get(0, 0) + counts.exits.get(1, 0)
    return [
        Figure(
            "batch",
            f"{jobs} jobs of {FRAMES} frames, {bad} of them broken: others done",
            100.0 * done / (jobs - bad),
            "%",
            least=100.0,
            note=f"{jobs / took:.2f} a second",
            failed=counts.exits.get(2, 0) != bad,
        )
    ]
