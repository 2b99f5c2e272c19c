"""A motion as a user names it: a file, a built-in clip, a result folder; on the ground it has."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from mjmotion.body.character import Character
from mjmotion.body.kinematics import character_geoms
from mjmotion.clips import load_clip
from mjmotion.exceptions import ClipError, ModelError, MotionError
from mjmotion.fitting import Trace
from mjmotion.footsteps.contacts import Contact
from mjmotion.output.reading import read_motion
from mjmotion.output.result import Result, write_motions
from mjmotion.scene import compose, with_ground

FRAMES = 12


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result folder of the walk's first frames on stairs."""
    path = tmp_path_factory.mktemp("result")
    composed = compose("humanoid", "stairs")
    walk = load_clip("walk")
    motion = walk.replace(walk.qpos[:FRAMES]).on(composed)
    trace = Trace((), 0.0, 0.0, 0.0, 0)
    contacts = (Contact("left_heel", 2, 9),)
    write_motions(path, Result(motion, motion, contacts, trace, ()))
    return path


def test_a_name_and_a_file_are_the_same_motion(tmp_path: Path) -> None:
    named = read_motion("walk")
    named.motion.save(tmp_path / "walk.npz")
    motion, contacts = read_motion(tmp_path / "walk.npz", "humanoid")
    assert np.array_equal(motion.qpos, named.motion.qpos)
    assert contacts is None and named.contacts is None
    assert motion.character.name == named.motion.character.name == "humanoid"
    assert not motion.character.different_from(named.motion.character)
    assert read_motion("walk", fps=60).motion.fps == 60


def test_a_folder_brings_its_contacts_and_its_model(folder: Path) -> None:
    motion, contacts = read_motion(folder)
    assert motion.nframe == FRAMES
    assert contacts == (Contact("left_heel", 2, 9),)
    assert motion.character.has_spec and not motion.character.alone
    assert motion.model.ngeom == Character.load(folder / "model.xml").model.ngeom


def test_what_is_no_motion_is_refused(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ClipError, match="'walk'"):
        read_motion("wakl")
    with pytest.raises(MotionError, match="lacks motion"):
        read_motion(tmp_path)
    with pytest.raises(ModelError, match="humanoid"):
        read_motion("walk", "hunanoid")
    with pytest.raises(MotionError, match="its own character"):
        read_motion(folder, "humanoid")
    with pytest.raises(MotionError, match="its own fps"):
        read_motion(folder, fps=30)


def test_a_character_alone_gets_a_floor_and_one_in_a_scene_keeps_it(folder: Path) -> None:
    alone = with_ground("humanoid").model
    assert (alone.geom_type == mujoco.mjtGeom.mjGEOM_PLANE).sum() == 1
    assert alone.ngeom == len(character_geoms(alone)) + 1
    there = with_ground(folder / "model.xml").model
    assert there.ngeom == Character.of(folder / "model.xml").model.ngeom
    assert (there.geom_type == mujoco.mjtGeom.mjGEOM_BOX).any()
    with pytest.raises(ModelError, match="hunanoid"):
        with_ground("hunanoid")
