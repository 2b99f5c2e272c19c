"""A batch: every job done once, whatever fails, changes or is killed; nothing of it mixed up."""

from __future__ import annotations

import csv
import dataclasses
import errno
import json
import math
import os
import shlex
import signal
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest
from command_line import run as command

from mjmotion.apps.adaptation import adapt
from mjmotion.apps.batch import (
    Batch,
    Processes,
    Settings,
    make_batch,
    making,
    open_storage,
    run_batch,
    worker,
)
from mjmotion.apps.batch.cluster import Cluster
from mjmotion.apps.batch.executors import Outcome
from mjmotion.apps.batch.page import page
from mjmotion.apps.batch.record import Record
from mjmotion.apps.batch.rows import COLUMNS, Row, as_lines, from_lines
from mjmotion.apps.batch.shards import extract
from mjmotion.apps.batch.storage import LocalStorage
from mjmotion.apps.batch.summary import summarise
from mjmotion.apps.batch.worker import THREADS, Task, environment, run_task
from mjmotion.body.motion import Motion
from mjmotion.cli.main import parse
from mjmotion.clips import load_clip
from mjmotion.exceptions import BatchError, OutputError
from mjmotion.output.reading import read_results

FRAMES = 40
QUICK = Settings(report=False)


class Here:
    """An executor of this very process, which keeps what it was given."""

    threads = 1

    def __init__(self, stop_after: int | None = None) -> None:
        self.done: list[str] = []
        self._stop_after = stop_after

    def run(self, tasks: Iterable[Task]) -> Iterator[Outcome]:
        for task in tasks:
            if self._stop_after is not None and len(self.done) >= self._stop_after:
                raise KeyboardInterrupt
            self.done += [job.name for job in task.jobs]
            try:
                yield task, run_task(task)
            except Exception as error:
                yield task, error

    def close(self) -> None:
        pass


@pytest.fixture(scope="module")
def short() -> Motion:
    clip = load_clip("walk")
    return clip.replace(clip.qpos[:FRAMES])


@pytest.fixture
def clips(tmp_path: Path, short: Motion) -> Path:
    """A folder of two clips and one that is broken."""
    folder = tmp_path / "clips"
    folder.mkdir()
    for name, count in (("a", FRAMES), ("b", FRAMES - 5)):
        short.replace(short.qpos[:count]).save(folder / f"{name}.npz")
    (folder / "cut.bvh").write_text("HIERARCHY\nROOT Hips\n{", "utf-8")
    return folder


def of(clips: Path, what: str = "*", settings: Settings = QUICK) -> Batch:
    return make_batch([str(clips / what)], ["flat", "slope"], settings=settings)


def lines(storage: LocalStorage) -> dict[str, Row]:
    return {row["job"]: row for row in Record(storage).rows()}


def ran(batch: Batch, out: Path, **how: bool | int) -> list[str]:
    """Run a batch here; the names of the jobs that were given out."""
    executor = Here()
    run_batch(batch, LocalStorage(out), executor, **how)  # type: ignore[arg-type]
    return executor.done


def test_one_bad_clip_stops_nothing_and_figures_are_those_of_adapt(
    clips: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    counts = run_batch(of(clips), LocalStorage(out), Here())
    rows = lines(LocalStorage(out))
    assert counts.total == counts.done == 6 and counts.exits[2] == 2
    assert {name for name, row in rows.items() if row["exit"] == 2} == {
        "cut@flat@humanoid",
        "cut@slope@humanoid",
    }
    assert "cut.bvh" in rows["cut@flat@humanoid"]["error"]
    assert sorted(path.name for path in (out / "jobs").iterdir()) == [
        f"{clip}@{scene}@humanoid" for clip in "ab" for scene in ("flat", "slope")
    ]
    assert not list(out.glob(".making"))

    result = adapt(load_clip(clips / "a.npz"), "slope")
    own = Motion.load(out / "jobs/a@slope@humanoid/motion.npz", result.motion.character)
    np.testing.assert_array_equal(own.qpos, result.motion.qpos)
    for name, value in result.validate().metrics.items():
        assert rows["a@slope@humanoid"][name] == pytest.approx(value, nan_ok=True), name


def test_the_table_has_every_figure_as_csv_and_parquet(clips: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    ran(of(clips), tmp_path / "out")
    with (tmp_path / "out/table.csv").open(encoding="utf-8", newline="") as file:
        told = {row["job"]: row for row in csv.DictReader(file)}
    arrow = {
        row["job"]: row for row in parquet.read_table(tmp_path / "out/table.parquet").to_pylist()
    }
    rows = lines(LocalStorage(tmp_path / "out"))
    assert told.keys() == arrow.keys() == rows.keys() and len(rows) == 6
    for job, row in rows.items():
        assert list(told[job]) == list(arrow[job]) == list(COLUMNS)
        for name, kind in COLUMNS.items():
            value = row[name]
            if value is None or value != value:
                assert told[job][name] == "" and arrow[job][name] is None
            else:
                assert kind(told[job][name]) == value == arrow[job][name]


def test_only_what_is_missing_or_changed_is_done_again(
    clips: Path, tmp_path: Path, short: Motion
) -> None:
    out = tmp_path / "out"
    ran(of(clips), out)
    before = lines(LocalStorage(out))
    assert ran(of(clips), out) == []
    assert ran(of(clips), out, retry_failed=True) == ["cut@flat@humanoid", "cut@slope@humanoid"]

    short.replace(short.qpos[3:]).save(clips / "b.npz")
    short.save(clips / "c.npz")
    new = [f"{clip}@{scene}@humanoid" for clip in "bc" for scene in ("flat", "slope")]
    assert ran(of(clips), out) == new
    after = lines(LocalStorage(out))
    assert after["a@flat@humanoid"] == pytest.approx(before["a@flat@humanoid"], nan_ok=True)
    assert after["b@flat@humanoid"]["nframe"] == FRAMES - 3

    changed = dataclasses.replace(QUICK, tolerance=1e-3)
    assert len(ran(of(clips, settings=changed), out)) == 8
    assert ran(of(clips, settings=changed), out) == []


def test_a_file_that_a_scene_names_counts(clips: Path, tmp_path: Path) -> None:
    heights = tmp_path / "h.bin"
    scene = tmp_path / "field.xml"
    scene.write_text(
        '<mujoco><asset><hfield name="h" file="h.bin" size="20 20 1 1"/></asset>'
        '<worldbody><geom type="hfield" hfield="h"/></worldbody></mujoco>',
        "utf-8",
    )

    def keys(value: float) -> list[str]:
        head = np.array([3, 3], "<i4").tobytes()
        heights.write_bytes(head + np.full(9, value, "<f4").tobytes())
        return [job.key for job in make_batch([clips / "a.npz"], [scene]).jobs()]

    assert keys(0.0) == keys(0.0) != keys(1.0)


def test_an_interrupted_run_goes_on_and_does_nothing_twice(clips: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    batch = of(clips, "[ab]*")
    first = Here(stop_after=2)
    with pytest.raises(KeyboardInterrupt):
        run_batch(batch, LocalStorage(out), first)
    rest = ran(batch, out)
    assert len(first.done) == 2 and sorted(first.done + rest) == [job.name for job in batch.jobs()]
    # As after a kill: what is done is known by its folder alone.
    kept = lines(LocalStorage(out))
    for path in (out / "rows").iterdir():
        path.unlink()
    assert len(ran(batch, out)) == 4
    again = lines(LocalStorage(out))
    assert {job: row["seconds"] for job, row in again.items()} == {
        job: row["seconds"] for job, row in kept.items()
    }


def test_shards_hold_jobs_and_rows_and_give_them_back(clips: Path, tmp_path: Path) -> None:
    out, folders = tmp_path / "out", tmp_path / "folders"
    ran(of(clips), folders)
    assert len(ran(of(clips), out, shards=4)) == 6
    files = sorted(path.suffix for path in (out / "shards").iterdir())
    assert files == [".jsonl", ".jsonl", ".zip", ".zip"] and not (out / "jobs").exists()
    assert ran(of(clips), out, shards=4) == []
    to = extract(LocalStorage(out), "a@slope@humanoid", tmp_path / "one")
    own = folders / "jobs/a@slope@humanoid"
    assert {path.name for path in to.iterdir()} == {path.name for path in own.iterdir()}
    assert (to / "motion.npz").read_bytes() == (own / "motion.npz").read_bytes()
    with pytest.raises(BatchError, match="no result"):
        extract(LocalStorage(out), "cut@flat@humanoid", tmp_path / "two")
    with pytest.raises(BatchError, match="Did you mean"):
        extract(LocalStorage(out), "a@slop@humanoid", tmp_path / "two")
    assert not (tmp_path / "two").exists()
    # Failed jobs that are tried again come into a shard of their own; the others stay.
    assert len(ran(of(clips), out, shards=2, retry_failed=True)) == 2
    with pytest.raises(BatchError, match="with shards"):
        ran(of(clips), out)
    for path in (out / "shards").glob("*.zip"):
        path.write_bytes(b"PK")
    with pytest.raises(BatchError, match="damaged"):
        extract(LocalStorage(out), "a@slope@humanoid", tmp_path / "two")


def test_a_shard_is_whole(clips: Path, tmp_path: Path) -> None:
    ran(of(clips, "[ab]*"), tmp_path / "out", shards=9)
    (shard,) = (tmp_path / "out/shards").glob("*.zip")
    with zipfile.ZipFile(shard) as file:
        assert file.testzip() is None
        assert {name.partition("/")[0] for name in file.namelist()} == set(
            lines(LocalStorage(tmp_path / "out"))
        )


def test_scene_character_and_clip_are_loaded_once(
    clips: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[str] = []

    def counted(name: str) -> None:
        own = getattr(making, name)

        def call(*args: object, **named: object) -> object:
            calls.append(name)
            return own(*args, **named)

        monkeypatch.setattr(making, name, call)

    monkeypatch.setattr(worker, "_LOADED", making.Loaded())
    for name in ("load_scene", "load_clip", "compose"):
        counted(name)
    ran(of(clips, "[ab]*"), tmp_path / "out")
    assert sorted(calls) == ["compose"] * 2 + ["load_clip"] * 2 + ["load_scene"] * 2


def test_terrains_are_made_by_their_seeds(clips: Path, tmp_path: Path) -> None:
    batch = make_batch([clips / "a.npz"], terrains=2, settings=QUICK)
    ran(batch, tmp_path / "out")
    rows = lines(LocalStorage(tmp_path / "out"))
    assert [row["scene_from"] for row in rows.values()] == ["seed=1", "seed=2"]
    gaps = {row["stance_gap_hfield_p95_mm"] for row in rows.values()}
    assert len(gaps) == 2 and all(math.isfinite(gap) for gap in gaps)


def test_another_body_takes_a_clip_as_the_humanoid_or_by_retargeting(tmp_path: Path) -> None:
    batch = make_batch(["start"], ["flat"], ["humanoid", "climber"], settings=QUICK)
    counts = run_batch(batch, LocalStorage(tmp_path / "out"), Here())
    assert counts.errors == ()


# --- bad input ------------------------------------------------------------------------------------


def test_names_that_clash_globs_without_files_and_other_folders_are_refused(
    clips: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other"
    other.mkdir()
    (other / "a.npz").write_bytes((clips / "a.npz").read_bytes())
    with pytest.raises(BatchError, match=r"two jobs of one name.*'a'"):
        make_batch([clips / "a.npz", other / "a.npz"], ["flat"])
    # The same file twice is one clip.
    assert len(make_batch([clips / "a.npz", str(clips / "a*")], ["flat"])) == 1
    for words, said in (
        ([str(clips / "*.fbx")], "no file matches"),
        ([str(clips)], "is a folder"),
        (["wlak"], "Did you mean 'walk'"),
        ([str(clips / "none.bvh")], "does not exist"),
    ):
        with pytest.raises(BatchError, match=said):
            make_batch(words, ["flat"])
    out = tmp_path / "out"
    ran(of(clips, "a*"), out)
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*")}
    with pytest.raises(BatchError, match="another batch"):
        ran(of(clips, "b*"), out)
    with pytest.raises(BatchError, match="other files"):
        ran(of(clips), clips)
    (out / "notes.txt").write_text("mine", "utf-8")
    with pytest.raises(BatchError, match=r"notes\.txt"):
        ran(of(clips, "a*"), out)
    (out / "notes.txt").unlink()
    assert before.keys() == {path: 0 for path in out.rglob("*")}.keys()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("nothing*.bvh", "--scenes", "flat", "--out", "out"), "no file matches"),
        (("walk", "--scenes", "flat", "--out", "out", "--dask", "tcp://127.0.0.1:1"), "scheduler"),
        (("walk", "--scenes", "flat", "--out", "out", "--dask", "nonsense"), "scheduler"),
        (("walk", "--scenes", "flat"), "--out"),
        (("walk", "--out", "out"), "--scenes"),
        (("walk", "--scenes", "nowhere", "--out", "out"), "unknown scene"),
        (("--summary", "out"), "no batch"),
        (("--extract", "a@b@c", "--out", "out"), "no batch"),
        (("--extract", "a@b@c"), "--out"),
        (("walk", "--scenes", "flat", "--out", "unknown://x/y"), "unknown"),
    ],
)
def test_the_command_refuses_in_one_line(
    words: tuple[str, ...], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("mjmotion.apps.batch.cluster.CONNECT", 1.0)
    done = command("batch", *words)
    assert done.returncode == 2 and said in done.stderr, done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("report", [False, True])
def test_a_full_disk_ends_the_run_and_loses_nothing(
    clips: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, report: bool
) -> None:
    out = tmp_path / "out"
    monkeypatch.setenv("MUJOCO_GL", "off")
    batch = of(clips, "[ab]*", dataclasses.replace(QUICK, report=report))
    own, saved = Motion.save, []

    def save(self: Motion, path: Path, **how: bool) -> None:
        saved.append(path)
        if len(saved) == (5 if report else 3):  # with the report the source is saved, too
            raise OSError(errno.ENOSPC, "No space left on device")
        own(self, path, **how)

    with monkeypatch.context() as patch:
        patch.setattr(Motion, "save", save)
        with pytest.raises(OutputError, match=r"No space left.*run it again"):
            ran(batch, out)
    assert len(lines(LocalStorage(out))) == 2 and not (out / ".making").exists()
    assert len(ran(batch, out)) == 2
    if report:  # a folder as adapt writes it
        assert read_results(out / "jobs/b@slope@humanoid").report().metrics


def test_extras_that_are_not_installed_are_named(
    clips: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("distributed", "pyarrow", "fsspec", "threadpoolctl"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(BatchError, match=r"distributed.*mjmotion\[batch\]"):
        Cluster("tcp://127.0.0.1:1")
    with pytest.raises(OutputError, match=r"fsspec.*mjmotion\[batch\]"):
        open_storage("s3://bucket/out")
    counts = run_batch(of(clips, "a*"), LocalStorage(tmp_path / "out"), Here())
    assert counts.tables == ("table.csv",) and counts.done == 2


def test_what_cannot_be_written_is_told_in_one_line(clips: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", "utf-8")
    with pytest.raises(OutputError, match="cannot"):
        ran(of(clips, "a*"), tmp_path / "file")
    with pytest.raises(OutputError, match="cannot"):
        ran(of(clips, "a*"), tmp_path / "file" / "out")


def test_two_runs_at_once_are_refused(clips: Path, tmp_path: Path) -> None:
    storage = LocalStorage(tmp_path / "out")
    with storage.alone(), pytest.raises(BatchError, match="another run"):
        ran(of(clips), tmp_path / "out")


def test_damaged_rows_are_told(clips: Path, tmp_path: Path) -> None:
    ran(of(clips, "a*"), tmp_path / "out")
    (path,) = (tmp_path / "out/rows").iterdir()
    path.write_text('{"job": "a"}\n', "utf-8")
    with pytest.raises(BatchError, match="damaged"):
        Record(LocalStorage(tmp_path / "out"))


def test_a_worker_of_another_version_is_refused(clips: Path, tmp_path: Path) -> None:
    task = Task(tuple(of(clips).jobs()), str(tmp_path), QUICK, version="0.0.0")
    with pytest.raises(BatchError, match=r"0\.0\.0"):
        run_task(task)


def test_what_the_page_shows_is_taken() -> None:
    text = (Path(__file__).parents[1] / "docs" / "batch.md").read_text("utf-8")
    shown = [line for line in text.splitlines() if line.startswith("mjmotion batch ")]
    assert len(shown) > 5
    for line in shown:
        assert parse(shlex.split(line)[1:]).command == "batch"


# --- what is elsewhere ----------------------------------------------------------------------------


def test_a_batch_at_an_fsspec_address(clips: Path, tmp_path: Path) -> None:
    pytest.importorskip("fsspec")
    # "local://" is fsspec's own way to a disk: no rename, no locks, as at a bucket.
    batch = make_batch([f"local://{clips}/[ab]*.npz"], ["flat"], settings=QUICK)
    storage = open_storage(f"local://{tmp_path}/out")
    counts = run_batch(batch, storage, Here())
    assert counts.exits.keys() <= {0, 1} and counts.done == 2
    assert (tmp_path / "out/jobs/a@flat@humanoid/motion.npz").is_file()
    assert (tmp_path / "out/table.csv").is_file()
    again = Here()
    run_batch(batch, open_storage(f"local://{tmp_path}/out"), again)
    assert again.done == []
    to = extract(storage, "b@flat@humanoid", tmp_path / "one")
    assert (to / "motion.npz").is_file()
    # What lacks its mark was cut off and is not there.
    task = Task(tuple(batch.jobs())[:1], storage.address, QUICK)
    (tmp_path / "out/jobs/a@flat@humanoid/job.json").unlink()
    seconds = lines(LocalStorage(tmp_path / "out"))["a@flat@humanoid"]["seconds"]
    assert run_task(task)[0]["seconds"] != seconds
    assert open_storage(f"file://{tmp_path}").address == str(tmp_path)


def test_remote_storage_in_memory(tmp_path: Path) -> None:
    pytest.importorskip("fsspec")
    storage = open_storage("memory://batch-test")
    made = tmp_path / "made"
    made.mkdir()
    (made / "job.json").write_text("{}", "utf-8")
    (made / "x").write_text("1", "utf-8")
    assert storage.read("jobs/a/job.json") is None and storage.names("jobs") == []
    storage.put("jobs/a", made)
    (made / "x").unlink()
    storage.put("jobs/a", made)
    assert storage.names("jobs/a") == ["job.json"] and storage.names("jobs") == ["a"]
    storage.write("rows/1", b"x")
    assert storage.read("rows/1") == b"x"
    assert storage.fetch("jobs/a", tmp_path / "back") and not storage.fetch("b", tmp_path / "c")
    assert (tmp_path / "back/job.json").read_text("utf-8") == "{}"
    storage.remove("jobs/a")
    assert storage.read("jobs/a/job.json") is None


# --- rows and summary -----------------------------------------------------------------------------


def made_up(tmp_path: Path, drifts: list[float]) -> LocalStorage:
    storage = LocalStorage(tmp_path / "made")
    record = Record(storage)
    record.begin(sharded=False)
    for index, drift in enumerate(drifts):
        row: Row = dict.fromkeys(COLUMNS)
        texts = {name: f"{name}{index}" for name, kind in COLUMNS.items() if kind is str}
        row |= texts | {"exit": int(drift > 1), "seconds": 1.0, "nframe": 1, "error": None}
        row |= {"stance_drift_mm": drift, "broken": "stance_drift_mm" if drift > 1 else ""}
        row |= {"swing_clearance_mm": 10.0 + index, "root_travel_ratio": 1.0 - index / 100}
        record.add(row)
    record.add(row | {"job": "<bad>", "exit": 2, "error": "no 'feet' <b>"})
    record.flush()
    return storage


def test_rows_come_back_as_they_were(tmp_path: Path) -> None:
    row: Row = dict.fromkeys(COLUMNS) | {"job": "ä\u2028b", "key": "k", "exit": 0, "fps": math.inf}
    (back,) = from_lines(as_lines([row]))
    assert back["job"] == row["job"] and back["fps"] == math.inf and math.isnan(back["seconds"])
    json.loads(as_lines([row]))


def test_summary_tells_spread_and_worst(tmp_path: Path) -> None:
    drifts = [0.1, 0.2, 0.3, 5.0, 0.4]
    summary = summarise(made_up(tmp_path, drifts))
    assert summary.exits == {0: 4, 1: 1, 2: 1}
    spread = {one.name: one for one in summary.spreads}
    drift = spread["stance_drift_mm"]
    assert drift.percentile(50) == 0.3 and drift.worst[0] == ("job3", 5.0) and drift.broken == 1
    assert spread["swing_clearance_mm"].worst[0] == ("job0", 10.0)
    assert spread["root_travel_ratio"].worst[0][0] == "job4"
    assert "jerk_ratio_rms" not in spread
    assert any("job3" in line for line in summary.lines())
    text = page(summary, {"job3": b"PNG", "job0": "no OpenGL"})
    assert "no &#x27;feet&#x27; &lt;b&gt;" in text and "<b>" not in text
    assert "://" not in text and "<svg" in text and "data:image/png;base64" in text


def test_summary_of_the_command_writes_a_page(
    clips: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", "off")
    ran(of(clips), tmp_path / "out")
    done = command("batch", "--summary", tmp_path / "out")
    assert done.returncode == 0 and "6 jobs" in done.stdout, done.stderr
    assert "No picture of poses" in (tmp_path / "out/summary.html").read_text("utf-8")
    # The page is a part of the batch, which goes on.
    assert ran(of(clips), tmp_path / "out") == []


# --- processes ------------------------------------------------------------------------------------


def test_threads_are_bounded_in_a_worker() -> None:
    pytest.importorskip("threadpoolctl")
    before = {name: os.environ.get(name) for name in THREADS}
    code = (
        "import numpy, scipy.linalg, threadpoolctl\n"
        "print(max((p['num_threads'] for p in threadpoolctl.threadpool_info()), default=1))"
    )
    with environment(1):
        said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert said.stdout.strip() == "1", said.stderr
    assert {name: os.environ.get(name) for name in THREADS} == before
    assert Processes(10_000).threads == 1


def children(pid: int) -> list[int]:
    """Processes that a process has started, which are Python's."""
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def begun(clips: Path, out: Path) -> subprocess.Popen[bytes]:
    """The command in a process of its own, with two workers, once two jobs are done."""
    words = [
        "batch",
        str(clips / "*.npz"),
        "--scenes",
        "flat",
        "slope",
        "stairs",
        "--terrains",
        "2",
    ]
    words += ["--no-report", "--workers", "2", "--out", str(out)]
    process = subprocess.Popen([sys.executable, "-W", "ignore", "-m", "mjmotion", *words])
    until = time.monotonic() + 120
    while len(list(out.glob("jobs/*"))) < 2:
        assert process.poll() is None and time.monotonic() < until
        time.sleep(0.05)
    return process


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks into /proc")
def test_a_killed_worker_and_a_killed_command_lose_nothing(clips: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    process = begun(clips, out)
    workers = [pid for pid in children(process.pid) if b"spawn_main" in cmdline(pid)]
    os.kill(workers[0], signal.SIGKILL)
    time.sleep(1.0)
    process.kill()
    process.wait()
    until = time.monotonic() + 20
    while any(Path(f"/proc/{pid}").exists() for pid in workers):  # they end with the command
        assert time.monotonic() < until
        time.sleep(0.05)
    kept = {path.parent.name: path.stat().st_ino for path in out.glob("jobs/*/job.json")}
    assert 2 <= len(kept) < 10
    batch = make_batch(
        [str(clips / "*.npz")], ["flat", "slope", "stairs"], terrains=2, settings=QUICK
    )
    with Processes(2) as executor:
        counts = run_batch(batch, LocalStorage(out), executor)
    assert counts.total == 10 and set(counts.exits) <= {0, 1}
    now = {path.parent.name: path.stat().st_ino for path in out.glob("jobs/*/job.json")}
    assert len(now) == 10 and kept.items() <= now.items()
    assert not (out / ".making").exists()


def cmdline(pid: int) -> bytes:
    return Path(f"/proc/{pid}/cmdline").read_bytes()


def deadly(task: Task) -> list[Row]:
    """What a worker does whose first clip crashes it and whose second meets a fault."""
    (job,) = task.jobs
    if job.clip.name == "a":
        os.kill(os.getpid(), signal.SIGKILL)
    if job.clip.name == "b" and job.scene.name == "flat":
        raise ZeroDivisionError("a fault")
    return run_task(task)


def test_a_job_that_kills_its_worker_fails_alone(clips: Path, tmp_path: Path) -> None:
    out = LocalStorage(tmp_path / "out")
    with Processes(2, call=deadly) as executor:
        run_batch(of(clips, "[ab]*"), out, executor)
    rows = lines(out)
    failed = ["a@flat@humanoid", "a@slope@humanoid", "b@flat@humanoid"]
    assert sorted(name for name, row in rows.items() if row["exit"] == 3) == failed
    assert rows["b@slope@humanoid"]["exit"] in (0, 1)
    assert "its worker died 3 times" in rows["a@flat@humanoid"]["error"]
    assert rows["b@flat@humanoid"]["error"] == "ZeroDivisionError: a fault"
    # With a sound program they are done as soon as it is asked for.
    assert ran(of(clips, "[ab]*"), tmp_path / "out") == []
    assert len(ran(of(clips, "[ab]*"), tmp_path / "out", retry_failed=True)) == 3
    assert {row["exit"] for row in lines(out).values()} <= {0, 1}
