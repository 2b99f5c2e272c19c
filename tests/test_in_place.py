"""Clips walked in place are recognised and set going; loops are repeated without a seam."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import command_line
import numpy as np
import pytest
from named_skeletons import walk_on

from mjmotion.body.motion import Motion
from mjmotion.clips import find_rig, load_clip, map_recording, read_clip
from mjmotion.clips.in_place import glide_speed, going, rebuild_travel, repeat
from mjmotion.clips.skeleton import Clip
from mjmotion.exceptions import ClipError
from mjmotion.footsteps.contacts import detect_contacts

SHARED = Path(__file__).parents[2] / "shared"
LEG = 0.8593  # of the humanoid, hip to ankle [m]
PERIOD = 67  # two cycles of the built-in walk on its straight way [frames]


@pytest.fixture(scope="module")
def walk() -> Clip:
    """The built-in walk, steady and straight, four cycles and a frame."""
    whole = load_clip("walk")
    qpos = whole.qpos[60 : 60 + 2 * PERIOD + 1]
    return walk_on("Mixamo", Motion(whole.character, qpos, whole.fps))[0]


def in_place(clip: Clip) -> Clip:
    """The clip with its pelvis kept where it is (y is up)."""
    pelvis = clip.positions[:, :1] * (1.0, 0.0, 1.0)
    return dataclasses.replace(clip, positions=clip.positions - pelvis)


def travel(clip: Clip) -> float:
    """Of the pelvis over the ground, start to end [m]."""
    way = (clip.positions[-1, 0] - clip.positions[0, 0])[[0, 2]]
    return float(np.linalg.norm(way)) / 100


def test_in_place_is_recognised(walk: Clip) -> None:
    rig = find_rig(walk)
    assert glide_speed(walk, rig, LEG) is None
    speed = glide_speed(in_place(walk), rig, LEG)
    wanted = travel(walk) / (2 * PERIOD / 30)
    assert speed == pytest.approx(wanted, rel=0.15)
    mapped = going(in_place(walk), "humanoid", rig)
    assert "--in-place travel" in mapped.odd[-1]
    assert not going(in_place(walk), "humanoid", rig, in_place="keep").odd
    assert not going(walk, "humanoid", rig).odd


def test_standing_is_not_walking_in_place(walk: Clip) -> None:
    still = dataclasses.replace(
        walk,
        positions=np.tile(walk.positions[:1], (50, 1, 1)),
        rotations=np.tile(walk.rotations[:1], (50, 1, 1, 1)),
    )
    assert glide_speed(still, find_rig(walk), LEG) is None


def test_travel_is_rebuilt(walk: Clip) -> None:
    rig = find_rig(walk)
    rebuilt = rebuild_travel(in_place(walk), rig, LEG)
    assert travel(rebuilt) == pytest.approx(travel(walk), rel=0.05)
    given = rebuild_travel(in_place(walk), rig, LEG, speed=2.0)
    path = np.linalg.norm(np.diff(given.positions[:, 0] * (1, 0, 1), axis=0), axis=1).sum() / 100
    assert path == pytest.approx(2.0 * (walk.nframe - 1) / 30, rel=0.02)
    # Feet stand again: the same contacts as of the walk that was never stopped.
    motions = [going(clip, "humanoid", rig).motion for clip in (walk, rebuilt)]
    count, again = (len(detect_contacts(motion)) for motion in motions)
    assert again >= count - 2 > 4


@pytest.mark.parametrize("kept", [True, False])
def test_loop_has_no_seam(kept: bool, walk: Clip) -> None:
    """Two cycles three times is as long a walk, as steady, be its last frame its first or not."""
    rig = find_rig(walk)
    cycle = walk.cut(0, PERIOD + (1 if kept else 0))
    three = repeat(cycle, rig, LEG, 3)
    assert three.nframe == pytest.approx(3 * PERIOD, abs=3)
    assert travel(three) == pytest.approx(1.5 * travel(walk), rel=0.03)
    local = np.swapaxes(three.rotations[:-1], -1, -2) @ three.rotations[1:]
    cosine = (np.trace(local, axis1=-2, axis2=-1) - 1) / 2
    turns = np.arccos(np.clip(cosine, -1, 1)).max(axis=1)
    steps = np.linalg.norm(np.diff(three.positions[:, 0], axis=0), axis=1)
    for seam in (PERIOD - 2, PERIOD - 1, PERIOD, 2 * PERIOD - 1, 2 * PERIOD):
        assert turns[seam] < 1.2 * np.delete(turns, seam).max()
        assert steps[seam] == pytest.approx(np.median(steps), rel=0.25)


def test_what_is_no_loop(walk: Clip) -> None:
    with pytest.raises(ClipError, match="it is no loop"):
        repeat(walk.cut(0, PERIOD // 4), find_rig(walk), LEG, 2)


def test_shared_inplace_loop() -> None:
    path = SHARED / "faults" / "inplace_loop.bvh"
    if not path.is_file():
        pytest.skip("shared/faults is not here")
    assert "--in-place travel" in map_recording(path).odd[-1]
    motion = load_clip(path, in_place="travel", loop=3)
    assert motion.nframe > 2.4 * read_clip(path).nframe
    assert motion.qpos[-1, 0] > 7
    assert len(detect_contacts(motion)) > 20
    assert load_clip(path, in_place=0.8).qpos[-1, 0] == pytest.approx(0.8 * 79 / 30, rel=0.05)


def test_wrong_options(tmp_path: Path) -> None:
    done = command_line.run(
        "adapt", "walk", "--scene", "flat", "--in-place", "run", "--out", tmp_path / "o"
    )
    assert done.returncode == 2
    assert "travel, keep or a speed" in done.stderr
    for wrong in ("run", -1.0, True):
        with pytest.raises(ClipError, match="in_place"):
            map_recording("walk.bvh", in_place=wrong)
    with pytest.raises(ClipError):
        load_clip("walk", loop=3)
