"""Bows under what is low: forwards, in good time, no more than needed; arches of one mesh."""

from __future__ import annotations

import functools

import mujoco
import numpy as np
import pytest
from made_up import mixed

from mjmotion.apps.adaptation import adapt
from mjmotion.apps.clearing import STUCK, FitSettings, what_bars
from mjmotion.body.character import Character
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.exceptions import SceneError
from mjmotion.fitting import Fit
from mjmotion.footsteps import obstacles as obstacles_module
from mjmotion.footsteps.bow import bow
from mjmotion.footsteps.obstacles import ObstacleClearance, find_obstacles
from mjmotion.footsteps.plan import make_plan
from mjmotion.footsteps.settings import PlanSettings
from mjmotion.ik.solver import Inequalities
from mjmotion.output.result import Result
from mjmotion.scene import Doorway, Scene, doors, flat
from mjmotion.validation import validate

DOOR, LOW = 1.8, 1.5  # where the way is low, and how low [m]
FAR = 1.0  # what is passed so long before or after is passed as if it were not there [s]
SAME = 0.005  # of the root there [m]; of joints seven times as much [rad]


@functools.cache
def clip() -> Motion:
    motion = load_clip("walk")
    return motion.replace(motion.qpos[:200])


def arch_spec(low: float = LOW) -> mujoco.MjSpec:
    """Two posts and a lintel in one closed mesh that no convex shape is."""
    outline = np.array(
        [(-0.8, 0), (-0.6, 0), (-0.6, low), (0.6, low)]
        + [(0.6, 0), (0.8, 0), (0.8, low + 0.2), (-0.8, low + 0.2)]
    )
    quads = ((0, 1, 2, 7), (2, 3, 6, 7), (3, 4, 5, 6))
    front = [(q[0], q[i], q[i + 1]) for q in quads for i in (1, 2)]
    faces = [(a + 8, b + 8, c + 8) for a, b, c in front] + [(a, c, b) for a, b, c in front]
    for i in range(8):
        j = (i + 1) % 8
        faces += [(i, j, j + 8), (i, j + 8, i + 8)]
    vertices = [(x, y, z) for x in (-0.06, 0.06) for y, z in outline.tolist()]
    spec = flat()
    spec.add_mesh(
        name="arch",
        uservert=np.ravel(vertices).tolist(),
        userface=np.ravel(faces).tolist(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    geom = spec.worldbody.add_geom(name="arch", meshname="arch", pos=(DOOR, 0.0, 0.0))
    geom.type = mujoco.mjtGeom.mjGEOM_MESH
    return spec


@functools.cache
def scene(name: str) -> Scene:
    door = doors((Doorway(x=DOOR, height=LOW, width=1.2),), base=flat())
    return Scene.from_spec({"level": flat, "door": lambda: door, "arch": arch_spec}[name]())


@functools.cache
def adapted(name: str) -> Result:
    return adapt(clip(), scene(name))


def near(result: Result, seconds: float) -> np.ndarray:
    """Frames in which a bowed body, its head first, is under the door, or will be or was lately."""
    ahead = DOOR - result.source.qpos[:, 0]
    inside = np.flatnonzero((ahead > -0.15) & (ahead < 0.75))
    margin, frames = round(seconds * result.motion.fps), np.arange(len(ahead))
    return np.asarray((frames > inside[0] - margin) & (frames < inside[-1] + margin))


@pytest.mark.parametrize("name", ["door", "arch"])
def test_a_person_bows_forwards(name: str) -> None:
    result = adapted(name)
    figures = result.validate()
    assert figures.metrics["obstacle_penetration_mm"] <= 0.01
    assert figures.metrics["trunk_back_deg"] <= 5.0 and figures.metrics["head_back_deg"] <= 15.0
    bent = figures.per_frame["trunk_pitch_deg"] - figures.per_frame["source_trunk_pitch_deg"]
    assert bent.max() >= 15.0 and bent.min() > -5.0
    # Bent where head or hips are under it, and the hips do not sink by all that is low.
    assert not (bent > 20.0)[~near(result, 0.7)].any()
    sunk = result.source.qpos[:, 2] - result.motion.qpos[:, 2]
    assert sunk.max() < 0.12


@pytest.mark.parametrize("name", ["door", "arch"])
def test_away_from_the_door_nothing_changes(name: str) -> None:
    result, level = adapted(name), adapted("level")
    far = ~near(result, FAR)
    assert far.sum() > 60
    off = np.abs(result.motion.qpos - level.motion.qpos)[far]
    assert off[:, :3].max() < SAME and off.max() < 7.0 * SAME


def test_a_body_bows_over_its_feet() -> None:
    """Hips go back as the trunk comes forwards: most of the body's weight stays where it was."""
    motion = clip()
    found = find_obstacles(scene("door").model, motion.qpos[:, :3], ())
    bowed = bow(motion, ObstacleClearance(motion.character, found, motion.nframe).overhead())
    data, ahead = mujoco.MjData(motion.model), np.zeros(motion.nframe)
    for one, sign in ((bowed, 1.0), (motion, -1.0)):
        for frame, pose in enumerate(one.qpos):
            data.qpos[:] = pose
            mujoco.mj_kinematics(one.model, data)
            mujoco.mj_comPos(one.model, data)
            ahead[frame] += sign * data.subtree_com[0, 0]
    back = motion.qpos[:, 0] - bowed.qpos[:, 0]
    assert back.max() > 0.06 and ahead.min() > -0.01 and ahead.max() < 0.05


def test_nothing_overhead_nothing_bowed() -> None:
    motion = clip()
    high = doors((Doorway(x=DOOR, height=2.2, width=1.2),), base=flat())
    found = find_obstacles(high.compile(), motion.qpos[:, :3], ())
    assert any(obstacle.overhead for obstacle in found)
    clearance = ObstacleClearance(motion.character, found, motion.nframe)
    assert bow(motion, clearance.overhead()) is motion
    assert bow(motion, ObstacleClearance(motion.character, (), motion.nframe)) is motion


def test_what_is_not_overhead_is_not_bowed_under() -> None:
    """A wall that is grazed lacks a distance, but not overhead."""
    motion = clip()
    spec = flat()
    wall = spec.worldbody.add_geom(name="wall", size=(0.1, 0.1, 1.0), pos=(DOOR, 0.3, 1.0))
    wall.type = mujoco.mjtGeom.mjGEOM_BOX
    found = find_obstacles(spec.compile(), motion.qpos[:, :3], ())
    clearance = ObstacleClearance(motion.character, found, motion.nframe)
    assert len(clearance(motion.qpos, np.arange(motion.nframe)).frame)
    assert bow(motion, clearance.overhead()) is motion


def test_a_body_without_a_trunk_does_not_bow() -> None:
    model = mixed()
    motion = Motion(Character.of(model), np.tile(model.qpos0, (30, 1)), 30.0)

    def low(qpos: np.ndarray, frames: np.ndarray) -> Inequalities:
        count = len(qpos)
        rows = np.zeros((count, model.nv))
        rows[:, 2] = -1.0
        return Inequalities(np.arange(count), rows, np.full(count, 0.1), np.full(count, -0.1))

    assert bow(motion, low) is motion


def test_an_arch_is_seen_piece_by_piece(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the mesh as MuJoCo takes it, or not at all, the head goes through the lintel."""
    found = find_obstacles(scene("arch").model, clip().qpos[:, :3], ())
    assert {obstacle.name for obstacle in found} == {"arch"} and len(found) >= 3
    over = [obstacle for obstacle in found if obstacle.overhead]
    assert over and min(o.points[:, 2].min() for o in over) == pytest.approx(LOW, abs=0.01)
    monkeypatch.setattr(obstacles_module, "mesh_pieces", lambda *_: [])
    blind = adapt(clip(), scene("arch"))
    assert (
        validate(blind.source, blind.motion, blind.contacts).metrics["obstacle_penetration_mm"]
        > 50.0
    )


def test_a_way_that_is_barred_is_told() -> None:
    """What is still well inside is an error, with where; what only touches is none."""
    result = adapted("level")
    alone = clip()
    door = find_obstacles(scene("door").model, alone.qpos[:, :3], ())
    clearance = ObstacleClearance(alone.character, door, alone.nframe)
    through = Fit(alone, result.trace, (), np.zeros((0, 4)), None)  # type: ignore[arg-type]
    plan = make_plan(alone, scene("door"), settings=PlanSettings(path="keep"))
    barred = what_bars(clearance, through, plan, scene("door").model, FitSettings())
    assert barred is not None and barred.what == "lintel 'door1_lintel'"
    assert barred.place[0] == pytest.approx(DOOR, abs=0.4) and barred.short > STUCK
    error = barred.error()
    assert isinstance(error, SceneError) and error.frames == barred.frames
    assert np.abs(alone.qpos[list(error.frames), 0] - DOOR).max() < 0.4
    assert what_bars(None, through, plan, scene("door").model, FitSettings()) is None
