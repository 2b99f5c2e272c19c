"""Readers: rates, encodings, skeletons of AMC, AMASS and glTF, whole takes, other formats."""

from __future__ import annotations

import base64
import json
import shutil
import struct
import time
from pathlib import Path
from typing import Any

import command_line
import numpy as np
import pytest
from named_skeletons import bone_errors, walk_on

from mjmotion.body.motion import Motion
from mjmotion.clips import find_rig, load_clip, map_clip, read_clip
from mjmotion.clips.amass import _JOINTS
from mjmotion.clips.skeleton import Clip
from mjmotion.exceptions import ClipError
from mjmotion.numerics import rotations as rot

SHARED = Path(__file__).parents[2] / "shared"
SMALL = """HIERARCHY
ROOT {name}
{{
  OFFSET 0 1 0
  CHANNELS 3 Zrotation Xrotation Yrotation
}}
MOTION
Frames: 2
{time}0 0 0
90 0 0
"""


@pytest.fixture(scope="module")
def walk() -> Motion:
    whole = load_clip("walk")
    return Motion(whole.character, whole.qpos[:60], whole.fps)


def shared(path: str) -> Path:
    if not (SHARED / path).is_file():
        pytest.skip(f"shared/{path} is not here")
    return SHARED / path


def bvh(folder: Path, time: str = "Frame Time: 0.1\n", name: str = "Hips") -> Path:
    path = folder / "clip.bvh"
    path.write_text(SMALL.format(time=time, name=name))
    return path


# --- Rates --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "time", ["Frame Time: 0\n", "Frame Time: -1\n", "Frame Time: nan\n", "Frame Time:\n", ""]
)
def test_fps_stands_for_the_frame_time(time: str, tmp_path: Path) -> None:
    path = bvh(tmp_path, time)
    with pytest.raises(ClipError, match="--fps"):
        read_clip(path)
    clip = read_clip(path, fps=25)
    assert (clip.fps, clip.nframe) == (25, 2)


def test_fps_replaces_a_wrong_frame_time(tmp_path: Path) -> None:
    assert read_clip(bvh(tmp_path)).fps == 10
    assert read_clip(bvh(tmp_path), fps=50).fps == 50


@pytest.mark.parametrize("fps", [0, -1, 1e300, float("nan")])
def test_rates_that_nothing_has(fps: float, tmp_path: Path) -> None:
    with pytest.raises(ClipError, match="frames a second"):
        read_clip(bvh(tmp_path), fps=fps)
    with pytest.raises(ClipError, match="frames a second"):
        read_clip(bvh(tmp_path, "Frame Time: 1e-9\n"))


def test_shared_frame_time_zero() -> None:
    path = shared("faults/frame_time_zero.bvh")
    motion = load_clip(path, fps=30)
    assert (motion.fps, motion.nframe) == (30, 60)
    assert motion.qpos[-1, 0] > 0.5


# --- Encodings ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "encoding"),
    [
        ("Rücken", "utf-8"),
        ("Rücken", "utf-8-sig"),
        ("Rücken", "utf-16"),
        ("Rücken", "latin-1"),
        ("épaule_gauche", "cp1252"),
        ("Wirbelsäule", "cp1252"),
        ("左足", "cp932"),
        ("センター", "cp932"),
        ("上半身", "utf-8"),
    ],
)
def test_names_in_any_encoding(name: str, encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "clip.bvh"
    path.write_bytes(SMALL.format(time="Frame Time: 0.1\n", name=name).encode(encoding))
    assert read_clip(path).joint_names == (name,)


def test_what_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / "clip.bvh"
    path.write_bytes(b"Kaydara FBX Binary  \0\x1a\0")
    with pytest.raises(ClipError, match="is not a BVH file"):
        read_clip(path)


def test_shared_cp1252() -> None:
    assert "Rücken" in read_clip(shared("faults/name_cp1252.bvh")).joint_names
    assert load_clip(shared("faults/name_cp1252.bvh")).qpos[-1, 0] > 0.5


# --- ASF ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("amc", "asf"),
    [
        ("02_01.amc", "02_01.asf"),
        ("02_01.amc", "02.ASF"),
        ("HDM_bd_01-01_120.amc", "HDM_bd.asf"),
        ("walk.amc", "anyone.asf"),
        ("takes/walk.amc", "anyone.asf"),
    ],
)
def test_asf_is_found(amc: str, asf: str, tmp_path: Path) -> None:
    source = shared("mocap/amc/02_01.amc")
    (tmp_path / amc).parent.mkdir(exist_ok=True)
    shutil.copy(source, tmp_path / amc)
    shutil.copy(source.with_name("02.asf"), tmp_path / asf)
    assert read_clip(tmp_path / amc).nframe == 343


def test_asf_by_option(tmp_path: Path) -> None:
    source = shared("mocap/amc/02_01.amc")
    folder = tmp_path / "a" / "b"
    folder.mkdir(parents=True)
    shutil.copy(source, folder / "02_01.amc")
    for name in ("x.asf", "y.asf"):
        shutil.copy(source.with_name("17.asf"), folder / name)
    with pytest.raises(ClipError, match=r"--asf FILE; there are x.asf, y.asf"):
        read_clip(folder / "02_01.amc")
    right = source.with_name("02.asf")
    assert read_clip(folder / "02_01.amc", asf=right).nframe == 343
    done = command_line.run("info", folder / "02_01.amc", "--asf", right)
    assert done.returncode == 0, done.stderr
    with pytest.raises(ClipError, match="no AMC"):
        load_clip("plain.bvh", asf=right)


# --- AMASS --------------------------------------------------------------------------------------


def amass(walk: Motion, clip: Clip, roles: dict[str, str]) -> dict[str, Any]:
    """The walk as axis-angles: every joint turned so that its bone points where the walk's does."""
    names = [name for name, _, _ in _JOINTS]
    parents = [parent for _, parent, _ in _JOINTS]
    offsets = np.array([offset for _, _, offset in _JOINTS])
    turns = np.tile(np.eye(3), (walk.nframe, len(names), 1, 1))
    ours = dict(roles, spine1="Spine", head="Head", neck="Neck", pelvis="Hips")
    for side in ("left", "right"):
        ours[f"{side}_foot"] = roles[f"{side}_toe"]
    following = {"hip": "knee", "knee": "ankle", "shoulder": "elbow", "elbow": "wrist"}
    for index, name in enumerate(names):
        joint = ours.get(name)
        if joint is None:  # spine2, spine3 and collars turn with what they hang on
            turns[:, index] = turns[:, parents[index]]
            continue
        turn = clip.rotations[:, clip.index(joint)]
        side, _, part = name.rpartition("_")
        if part == "wrist":
            part = "elbow"
        if part in following:
            beyond = f"{side}_{following[part]}"
            at = clip.offsets[clip.index(ours[beyond])]
            swing = rot.between(rot.normalized(offsets[names.index(beyond)]), rot.normalized(at))
            turn = turn @ rot.to_matrix(swing)
        turns[:, index] = turn
    to_z_up = np.array([(0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)])
    local = turns.copy()
    for index, parent in enumerate(parents):
        above = turns[:, parent] if parent >= 0 else np.tile(to_z_up.T, (walk.nframe, 1, 1))
        local[:, index] = np.swapaxes(above, 1, 2) @ turns[:, index]
    poses = np.zeros((walk.nframe, 156))
    poses[:, :66] = rot.log(rot.from_matrix(local)).reshape(walk.nframe, 66)
    return {"poses": poses, "trans": walk.qpos[:, :3], "betas": np.zeros(16)}


@pytest.mark.parametrize("kind", ["SMPL-H", "SMPL-X"])
def test_amass(kind: str, walk: Motion, tmp_path: Path) -> None:
    clip, roles = walk_on("Mixamo with fingers and collars", walk)
    arrays = amass(walk, clip, roles)
    path = tmp_path / "walk_poses.npz"
    if kind == "SMPL-H":
        np.savez(path, **arrays, mocap_framerate=30.0, gender="neutral")
    else:
        poses = arrays["poses"]
        np.savez(
            path,
            root_orient=poses[:, :3],
            pose_body=poses[:, 3:66],
            trans=arrays["trans"],
            mocap_frame_rate=np.array(30),
        )
    motion = load_clip(path)
    assert (motion.fps, motion.nframe) == (30, 60)
    assert motion.qpos[-1, 0] > 0.5
    errors = bone_errors(motion, walk)
    # Feet and trunk of a mean person are drawn otherwise: their directions are not compared.
    limbs = [angles.mean() for bone, angles in errors.items() if bone.endswith(tuple(_LIMBS))]
    assert len(limbs) == 8
    assert np.mean(limbs) < 2


_LIMBS = ("hip", "knee", "shoulder", "elbow")


def test_bad_amass(walk: Motion, tmp_path: Path) -> None:
    clip, roles = walk_on("Mixamo with fingers and collars", walk)
    arrays = amass(walk, clip, roles)
    path = tmp_path / "poses.npz"
    np.savez(path, **arrays)
    with pytest.raises(ClipError, match="no mocap_framerate: give its rate as --fps"):
        load_clip(path)
    assert load_clip(path, fps=60).fps == 60
    for wrong, match in (
        ({"poses": np.zeros((5, 30))}, "66 or more"),
        ({"trans": np.zeros((3, 3))}, "60 frames of 3"),
        ({"poses": np.array(["a"])}, "poses holds text"),
        ({"poses": np.zeros((60, 156), complex)}, "complex"),
        ({"trans": np.full((60, 3), 1e7)}, "beyond 10,000 m"),
        ({"mocap_framerate": np.array(True)}, "booleans"),
        ({"poses": np.full((60, 156), np.nan)}, "not finite"),
        ({"poses": np.zeros((0, 156)), "trans": np.zeros((0, 3))}, "no frames"),
    ):
        np.savez(path, **{**arrays, "mocap_framerate": np.array(30.0), **wrong})
        with pytest.raises(ClipError, match=match):
            load_clip(path)


# --- glTF ---------------------------------------------------------------------------------------


def gltf(clip: Clip, folder: Path, kind: str) -> Path:
    """Write a clip as glTF, under an armature that is turned and in centimetres."""
    content: dict[str, list[Any]] = {
        "accessors": [],
        "bufferViews": [],
        "nodes": [],
        "animations": [{"channels": [], "samplers": []}],
    }
    data = bytearray()

    def put(values: np.ndarray) -> int:
        raw = np.ascontiguousarray(values, "<f4")
        size = 1 if raw.ndim == 1 else raw.shape[1]
        content["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(data), "byteLength": raw.nbytes}
        )
        data.extend(raw.tobytes())
        content["accessors"].append(
            {
                "bufferView": len(content["bufferViews"]) - 1,
                "componentType": 5126,
                "count": len(raw),
                "type": {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[size],
            }
        )
        return len(content["accessors"]) - 1

    times = put(np.arange(clip.nframe) / clip.fps)
    channels, samplers = content["animations"][0]["channels"], content["animations"][0]["samplers"]
    for joint, parent in enumerate(clip.parents):
        above = clip.rotations[:, parent] if parent >= 0 else np.eye(3)
        local = np.swapaxes(above, -1, -2) @ clip.rotations[:, joint]
        quats = np.roll(rot.continuous(rot.from_matrix(local)), -1, axis=1)
        children = [int(c) for c in np.flatnonzero(clip.parents == joint)]
        node: dict[str, object] = {"name": clip.joint_names[joint]}
        node["translation"] = clip.offsets[joint].tolist()
        content["nodes"].append(node | ({"children": children} if children else {}))
        moving = [("rotation", quats)]
        if parent < 0:
            moving.append(("translation", clip.positions[:, joint]))
        for what, values in moving:
            samplers.append({"input": times, "output": put(values)})
            target = {"node": joint, "path": what}
            channels.append({"sampler": len(samplers) - 1, "target": target})
    armature = {"name": "Armature", "children": [0], "scale": [0.01] * 3}
    content["nodes"].append(armature | {"rotation": [0.5, 0.5, 0.5, 0.5]})
    content["skins"] = [{"joints": list(range(len(clip.parents)))}]
    data.extend(b"\0" * (-len(data) % 4))
    buffer: dict[str, object] = {"byteLength": len(data)}
    if kind == "data":
        buffer["uri"] = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    elif kind == "bin":
        (folder / "walk data.bin").write_bytes(data)
        buffer["uri"] = "walk%20data.bin"
    content["buffers"] = [buffer]
    text = json.dumps({"asset": {"version": "2.0"}, **content}).encode()
    if kind != "glb":
        path = folder / "walk.gltf"
        path.write_bytes(text)
        return path
    text += b" " * (-len(text) % 4)
    path = folder / "walk.glb"
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(data), 0x004E4942) + bytes(data)
    path.write_bytes(struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks)
    return path


@pytest.mark.parametrize("kind", ["glb", "data", "bin"])
def test_gltf(kind: str, walk: Motion, tmp_path: Path) -> None:
    clip, roles = walk_on("Mixamo with fingers and collars", walk)
    path = gltf(clip, tmp_path, kind)
    read = read_clip(path)
    assert (read.nframe, read.fps) == (walk.nframe, 30)
    turn = rot.to_matrix(np.array((0.5, 0.5, 0.5, 0.5)))
    order = [read.index(name) for name in clip.joint_names]
    np.testing.assert_allclose(read.positions[:, order], 0.01 * clip.positions @ turn.T, atol=1e-5)
    rig = find_rig(read)
    assert {role: rig.joints[role] for role in roles} == roles
    wanted = map_clip(clip, walk.character).motion
    errors = bone_errors(map_clip(read, walk.character, rig).motion, wanted)
    assert max(angles.max() for angles in errors.values()) < 0.1
    assert read_clip(path, fps=60).nframe == 2 * walk.nframe - 1


def test_bad_gltf(walk: Motion, tmp_path: Path) -> None:
    clip, _ = walk_on("Mixamo", walk)
    path = gltf(clip, tmp_path, "glb")
    whole = path.read_bytes()
    for cut in (0, 3, 20, 200, len(whole) // 2, len(whole) - 8):
        path.write_bytes(whole[:cut])
        with pytest.raises(ClipError) as caught:
            read_clip(path)
        assert "\n" not in str(caught.value)
    other = tmp_path / "still.gltf"
    other.write_text('{"asset": {"version": "2.0"}, "nodes": [{"name": "box"}]}')
    with pytest.raises(ClipError, match="no animation of a skeleton"):
        read_clip(other)
    other.write_text('{"nodes": [{"children": [0]}], "animations": 3}')
    with pytest.raises(ClipError, match="not a sound glTF"):
        read_clip(other)


def test_other_formats_say_how_to_get_there(tmp_path: Path) -> None:
    for suffix, way in ((".fbx", "Blender"), (".c3d", "markers"), (".pkl", "savez"), (".xyz", "")):
        path = tmp_path / f"clip{suffix}"
        path.write_bytes(b"\0")
        with pytest.raises(ClipError) as caught:
            load_clip(path)
        assert way in str(caught.value)
        assert ".bvh" in str(caught.value) or suffix == ".pkl"


# --- Whole takes --------------------------------------------------------------------------------


def test_whole_takes_are_read_in_time(walk: Motion, tmp_path: Path) -> None:
    """8000 frames of 22 joints, as takes of LAFAN1 and 100STYLE have, in seconds."""
    source = shared("faults/plain_walk.bvh").read_text().splitlines()
    at = next(n for n, line in enumerate(source) if line.startswith("Frames:"))
    rows = source[at + 2 :]
    there = rows + rows[::-1]
    count = 8000
    source[at] = f"Frames: {count}"
    path = tmp_path / "long.bvh"
    path.write_text("\n".join(source[: at + 2] + (there * (count // len(there) + 1))[:count]))
    begin = time.perf_counter()
    motion = load_clip(path)
    assert motion.nframe == count
    assert time.perf_counter() - begin < 30
