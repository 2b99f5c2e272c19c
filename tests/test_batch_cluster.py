"""A batch on a real Dask cluster of this machine, of which everything is killed once."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from mjmotion.apps.batch.record import Record
from mjmotion.apps.batch.storage import LocalStorage
from mjmotion.clips import load_clip

pytest.importorskip("distributed")

LATE = 240.0  # by when something must have happened, on a machine that is busy [s]
FRAMES, TERRAINS = 40, 11


class Local:
    """A scheduler and workers, each a process of its own."""

    def __init__(self, folder: Path) -> None:
        with socket.socket() as found:
            found.bind(("127.0.0.1", 0))
            self._port = found.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self._port}"
        self._folder = folder
        self._all: list[subprocess.Popen[bytes]] = []
        self.start_scheduler()
        self.workers = [self.start_worker() for _ in range(2)]

    def _start(self, *words: str) -> subprocess.Popen[bytes]:
        with (self._folder / "dask.log").open("ab") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", *words], cwd=self._folder, stdout=log, stderr=log
            )
        self._all.append(process)
        return process

    def start_scheduler(self) -> None:
        words = ("--host", "127.0.0.1", "--port", str(self._port), "--no-dashboard")
        self.scheduler = self._start("distributed.cli.dask_scheduler", *words)

    def start_worker(self) -> subprocess.Popen[bytes]:
        words = (self.address, "--nthreads", "1", "--no-nanny", "--no-dashboard")
        return self._start("distributed.cli.dask_worker", *words)

    def run(self, clips: Path, out: Path) -> subprocess.Popen[bytes]:
        """The command in a process of its own."""
        words = ["mjmotion", "batch", str(clips / "*.npz"), "--scenes", "flat"]
        words += ["--terrains", str(TERRAINS), "--no-report", "--out", str(out)]
        return self._start(*words, "--dask", self.address)

    def close(self) -> None:
        for process in self._all:
            with contextlib.suppress(OSError):
                process.kill()
            process.wait()


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Local]:
    local = Local(tmp_path)
    yield local
    local.close()


def done(out: Path) -> dict[str, int]:
    """Jobs whose results are there, and which file says so."""
    return {path.parent.name: path.stat().st_ino for path in out.glob("jobs/*/job.json")}


def until(out: Path, count: int, command: subprocess.Popen[bytes]) -> None:
    end = time.monotonic() + LATE
    while len(done(out)) < count:
        assert command.poll() is None, (out.parent / "dask.log").read_text("utf-8")[-3000:]
        assert time.monotonic() < end, (out.parent / "dask.log").read_text("utf-8")[-3000:]
        time.sleep(0.02)


def test_nothing_is_lost_or_done_twice_whatever_is_killed(cluster: Local, tmp_path: Path) -> None:
    clip = load_clip("walk")
    clips, out = tmp_path / "clips", tmp_path / "out"
    clips.mkdir()
    for name in "ab":
        clip.replace(clip.qpos[: FRAMES + ord(name)]).save(clips / f"{name}.npz")
    (clips / "broken.npz").write_bytes(b"PK")
    total = 3 * (1 + TERRAINS)
    seen: dict[str, int] = {}

    command = cluster.run(clips, out)
    until(out, 2, command)
    os.kill(cluster.workers[0].pid, signal.SIGKILL)  # a worker, at its work
    cluster.workers[0] = cluster.start_worker()
    until(out, 6, command)
    seen |= done(out)
    cluster.scheduler.kill()  # the scheduler, with all that it knew
    cluster.scheduler.wait()
    for worker in cluster.workers:  # they leave with it, as Dask's do
        worker.kill()
        worker.wait()
    cluster.start_scheduler()
    cluster.workers = [cluster.start_worker() for _ in range(2)]
    until(out, 11, command)
    command.kill()  # and the command, while both work
    command.wait()
    seen |= done(out)
    assert len(seen) < total * 2 // 3

    command = cluster.run(clips, out)
    assert command.wait(LATE) == 1  # the broken clip
    now = done(out)
    assert len(now) == total * 2 // 3
    assert seen.items() <= now.items()  # what was done then is what is there now
    rows = {row["job"]: row for row in Record(LocalStorage(out)).rows()}
    assert len(rows) == total
    assert {row["clip"] for row in rows.values() if row["exit"] == 2} == {"broken"}
    assert all(row["exit"] in (0, 1) for row in rows.values() if row["clip"] != "broken")
    assert not (out / ".making").exists()
