"""Kills at random moments of everything that writes: nothing lost, nothing torn, nothing left.

    python tests/kills.py [--kills 200] [--seed 1]

Every job runs in a process of its own, over and over, and is ended with SIGKILL at random moments
from its start to a little beyond its usual end. After each, what stands under its name must be the
whole old or the whole new; after one more run that ends well, nothing else may be there.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import random
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

from mjmotion.apps.session import load_session
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.output.reading import read_results
from mjmotion.output.video import ensure_gl

FRAMES = 40
PLACE = "s.autosave.mjsession"
LATE = 1.15  # of the usual time, within which kills fall

# What the editor does after every edit, over and over: one edit, then two, then one.
AUTOSAVE = """
import sys
from pathlib import Path
from mjmotion.apps.session import Drag, EditSession
from mjmotion.editor.autosave import Autosave
from mjmotion.output.reading import read_motion
clip = read_motion(sys.argv[1]).motion
autosave = Autosave(Path(sys.argv[2]))
session = EditSession(clip, None, name=sys.argv[1], character="humanoid")
x, y, z = (float(one) for one in clip.qpos[9, :3])
drags = [Drag("left_hand", 9, (x + 0.2, y + 0.3, z + by)) for by in (0.1, 0.2)]
session.do(drags[0])
other = EditSession(clip, None, name=sys.argv[1], character="humanoid")
other.restore(session.state)
other.do(drags[1])
for _ in range(400):
    autosave.keep(other)
    autosave.keep(session)
"""


@dataclasses.dataclass(frozen=True)
class Job:
    """Something that writes.

    Attributes:
      words: the command, in its folder.
      place: what it writes.
      whole: raises an error unless what stands there is whole.
    """

    words: list[str]
    place: str
    whole: Callable[[Path], object]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        counts = run(Path(folder), options.kills, random.Random(options.seed))
    columns = ("kills", "old", "new", "lost", "torn", "left after the next")
    print(f"{'job':10}" + "".join(f"{name:>{len(name) + 3}}" for name in columns))
    for job, count in counts.items():
        print(f"{job:10}" + "".join(f"{count[name]:{len(name) + 3}}" for name in columns))
    bad = sum(count[name] for count in counts.values() for name in columns[3:])
    return 1 if bad else 0


def run(folder: Path, kills: int, chance: random.Random) -> dict[str, Counter[str]]:
    """Kill each job its share of times, and count what came of it."""
    clip = load_clip("walk")
    Motion(clip.character, clip.qpos[:FRAMES], clip.fps).save(folder / "walk.npz")
    jobs = made(folder)
    return {
        name: killed(folder / name, job, max(1, kills // len(jobs)), chance)
        for name, job in jobs.items()
    }


def made(folder: Path) -> dict[str, Job]:
    """The jobs, each with a first result that is there before any kill."""
    walk = str(folder / "walk.npz")
    program = [sys.executable, "-m", "mjmotion"]
    adapt = ["adapt", walk, "--scene", "stairs", "--no-video", "--force", "--out"]
    jobs = {
        "adapt": Job([*program, *adapt, "out"], "out", whole_result),
        "scene": Job(
            [*program, *["scene", "terrain", "--cell", "0.2", "--force", "--out", "t.xml"]],
            "t.xml",
            whole_scene,
        ),
        "autosave": Job([sys.executable, "-c", AUTOSAVE, walk, PLACE], PLACE, whole_session),
        "validate": Job([*program, "validate", "out"], "out", whole_result),
    }
    try:
        ensure_gl()
    except Exception as error:
        print(f"render: left out, {error}")
    else:
        words = [*program, *["render", "out", "--size", "64x64", "--force", "--out", "v.mp4"]]
        jobs["render"] = Job(words, "v.mp4", whole_video)
    batch = [*program, "batch", "walk.npz", "--scenes", "flat", "--workers", "1", "--no-report"]
    # Each run does it anew: what an earlier one knows is taken away first.
    again = "rm -rf out/jobs out/rows; " + shlex.join([*batch, "--out", "out"])
    jobs["batch"] = Job(
        ["sh", "-c", f"cp {shlex.quote(walk)} . && {again}", "batch"], "out", whole_batch
    )
    return jobs


def killed(folder: Path, job: Job, kills: int, chance: random.Random) -> Counter[str]:
    """Kill one job again and again."""
    folder.mkdir()
    if job.words[3] in ("render", "validate"):
        walk = str(folder.parent / "walk.npz")
        finish(
            folder,
            [*job.words[:3], "adapt", walk, *["--scene", "flat", "--no-video", "--out", "out"]],
        )
    usual = finish(folder, job.words)
    there = names(folder)
    count: Counter[str] = Counter(kills=kills)
    for _ in range(kills):
        before = state(folder / job.place)
        end_at(folder, job.words, chance.uniform(0.0, LATE * usual))
        if not (folder / job.place).exists():
            count["lost"] += 1
            finish(folder, job.words)
            continue
        count["old" if state(folder / job.place) == before else "new"] += 1
        try:
            job.whole(folder / job.place)
        except Exception as error:
            print(f"torn: {job.place}: {error}")
            count["torn"] += 1
    finish(folder, job.words)
    job.whole(folder / job.place)
    left = names(folder) ^ there
    if left:
        print(f"left: {sorted(left)}")
    count["left after the next"] = len(left)
    return count


def finish(folder: Path, words: list[str]) -> float:
    """Run to the end; return how long it took [s]."""
    started = time.perf_counter()
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True)
    if done.returncode not in (0, 1):
        raise SystemExit(f"{' '.join(words)}: {done.stderr}")
    return time.perf_counter() - started


def end_at(folder: Path, words: list[str], seconds: float) -> None:
    """Run for so long and no longer."""
    quiet = subprocess.DEVNULL
    with subprocess.Popen(
        words, cwd=folder, stdout=quiet, stderr=quiet, start_new_session=True
    ) as process:
        try:
            process.wait(seconds)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)


def names(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def state(place: Path) -> tuple[int, int]:
    """What tells the old from the new under the same name."""
    status = place.stat()
    return status.st_ino, status.st_mtime_ns


def whole_result(place: Path) -> None:
    result = read_results(place)
    assert result.motion.nframe == FRAMES
    assert result.saved_report
    assert "</html>" in (place / "report.html").read_text("utf-8")


def whole_batch(place: Path) -> None:
    for folder in place.glob("jobs/*"):
        assert json.loads((folder / "job.json").read_text("utf-8"))["exit"] in (0, 1)
        assert Motion.load(folder / "motion.npz", "humanoid").nframe == FRAMES


def whole_scene(place: Path) -> None:
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(place))
    assert np.isfinite(model.hfield_data).all()


def whole_session(place: Path) -> None:
    assert len(load_session(place).edits) in (1, 2)


def whole_video(place: Path) -> None:
    import imageio_ffmpeg

    reader = imageio_ffmpeg.read_frames(place)
    seconds = next(reader)["duration"]
    reader.close()
    assert seconds > 0


if __name__ == "__main__":
    sys.exit(main())
