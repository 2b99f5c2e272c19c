"""Which joint is which: the built-in walk under the names and trees of many makers."""

from __future__ import annotations

import dataclasses
import shlex
from pathlib import Path

import command_line
import numpy as np
import pytest
from named_skeletons import NAMINGS, bone_errors, walk_on

from mjmotion.body.motion import Motion
from mjmotion.cli.main import parse
from mjmotion.clips import find_rig, load_clip, map_clip, read_clip
from mjmotion.clips.joint_names import simplified, which_side
from mjmotion.clips.reading import SUFFIXES
from mjmotion.clips.rig import find_roles
from mjmotion.clips.skeleton import Clip
from mjmotion.exceptions import ClipError

SHARED = Path(__file__).parents[2] / "shared"
MEAN_ERROR = 0.5  # of all bones over all frames [degrees]


@pytest.fixture(scope="module")
def walk() -> Motion:
    whole = load_clip("walk")
    return Motion(whole.character, whole.qpos[:100], whole.fps)


def fault(name: str) -> Path:
    path = SHARED / "faults" / name
    if not path.is_file():
        pytest.skip("shared/faults is not here")
    return path


def renamed(clip: Clip, names: list[str]) -> Clip:
    new = dict(zip(clip.joint_names, names, strict=True))
    ends = {new[joint]: end for joint, end in clip.ends.items()}
    return dataclasses.replace(clip, joint_names=tuple(names), ends=ends)


def numbered(clip: Clip) -> tuple[Clip, dict[str, str]]:
    """The clip with numbers for names, and number to name."""
    names = [f"joint_{index:03d}" for index in range(len(clip.joint_names))]
    return renamed(clip, names), dict(zip(names, clip.joint_names, strict=True))


def reordered(clip: Clip, seed: int) -> Clip:
    """The clip with its joints in another order, parents before children as ever."""
    rng = np.random.default_rng(seed)
    order: list[int] = []
    ready = [j for j, parent in enumerate(clip.parents) if parent < 0]
    while ready:
        order.append(ready.pop(int(rng.integers(len(ready)))))
        ready += [j for j, parent in enumerate(clip.parents) if parent == order[-1]]
    new = {old: index for index, old in enumerate(order)}
    parents = np.array([new[clip.parents[j]] if clip.parents[j] >= 0 else -1 for j in order])
    return dataclasses.replace(
        clip,
        joint_names=tuple(clip.joint_names[j] for j in order),
        parents=parents,
        offsets=clip.offsets[order],
        positions=clip.positions[:, order],
        rotations=clip.rotations[:, order],
    )


def mean_error(clip: Clip, walk: Motion) -> float:
    motion = map_clip(clip, walk.character, find_rig(clip)).motion
    return float(np.mean([angles.mean() for angles in bone_errors(motion, walk).values()]))


@pytest.mark.parametrize("naming", NAMINGS)
def test_walk_under_any_names(naming: str, walk: Motion) -> None:
    clip, roles = walk_on(naming, walk)
    found = find_roles(clip).joints
    # Where a maker parts hip and pelvis, the one in which the legs meet drives the pelvis.
    assert {role: found.get(role) for role in roles if role != "pelvis"} == {
        role: joint for role, joint in roles.items() if role != "pelvis"
    }
    assert mean_error(clip, walk) < MEAN_ERROR


@pytest.mark.parametrize("naming", NAMINGS)
def test_tree_alone_tells(naming: str, walk: Motion) -> None:
    """Without any names, and in another order: legs, arms and sides by the tree and the toes."""
    clip, roles = walk_on(naming, walk)
    bare, back = numbered(reordered(clip, seed=len(naming)))
    found = find_roles(bare).joints
    for role, joint in roles.items():
        if role.endswith(("hip", "knee", "ankle", "shoulder", "elbow", "head")):
            assert back[found[role]] == joint, role
    assert mean_error(bare, walk) < MEAN_ERROR


def test_wrong_roles_would_be_seen(walk: Motion) -> None:
    """The bar can be missed: legs whose knees are taken one joint too low are far off."""
    clip, roles = walk_on("Mixamo", walk)
    rig = find_rig(clip)
    joints = {**rig.joints, "left_elbow": roles["left_wrist"], "left_wrist": roles["left_elbow"]}
    motion = map_clip(clip, walk.character, dataclasses.replace(rig, joints=joints)).motion
    assert np.mean([angles.mean() for angles in bone_errors(motion, walk).values()]) > 5


@pytest.mark.parametrize("name", ["02_01", "12_01_other_rig", "14_21", "49_02", "91_17"])
def test_people_without_names(name: str) -> None:
    """Recorded people: the same legs and sides with numbers for names as with their names."""
    path = SHARED / "mocap" / "bvh" / f"{name}.bvh"
    if not path.is_file():
        pytest.skip("the recordings of shared/mocap are not here")
    clip = read_clip(path)
    bare, back = numbered(clip)
    named, found = find_roles(clip), find_roles(bare)
    assert not named.notes  # nobody is mirrored
    for role in ("hip", "knee", "ankle", "toe", "shoulder", "elbow"):
        for side in ("left", "right"):
            assert back[found.joints[f"{side}_{role}"]] == named.joints[f"{side}_{role}"]


def test_knees_tell_where_there_are_no_toes(walk: Motion) -> None:
    clip, roles = walk_on("numbers", walk)
    kept = [j for j, name in enumerate(clip.joint_names) if name not in roles_of(roles, "toe")]
    new = {old: index for index, old in enumerate(kept)}
    short = dataclasses.replace(
        clip,
        joint_names=tuple(clip.joint_names[j] for j in kept),
        parents=np.array([new.get(int(clip.parents[j]), -1) for j in kept]),
        offsets=clip.offsets[kept],
        positions=clip.positions[:, kept],
        rotations=clip.rotations[:, kept],
        ends={joint: end for joint, end in clip.ends.items() if joint in roles_of(roles, "wrist")},
    )
    found = find_roles(short)
    assert found.joints["left_knee"] == roles["left_knee"]
    assert "how the knees bend" in found.reasons["left_knee"]


def roles_of(roles: dict[str, str], part: str) -> set[str]:
    return {roles[f"left_{part}"], roles[f"right_{part}"]}


def test_mirrored_names_are_exchanged(walk: Motion) -> None:
    clip, roles = walk_on("Mixamo", walk)
    swap = {"Left": "Right", "Right": "Left"}
    names = []
    for name in clip.joint_names:
        word = next((word for word in swap if word in name), None)
        names.append(name if word is None else name.replace(word, swap[word]))
    swapped = renamed(clip, names)
    rig = find_rig(swapped)
    assert "mirrored" in rig.notes[0]
    assert rig.joints["left_knee"] == roles["right_knee"]
    assert mean_error(swapped, walk) < MEAN_ERROR
    # What a user says counts, be it as wrong as it is.
    given = find_rig(swapped, {"joints": {"left_hip": roles["left_hip"]}})
    assert given.joints["left_knee"] == roles["left_knee"]


def test_common_words_and_sides() -> None:
    assert simplified(["A_B_Hips", "A_B_Neck", "A_B_Head"]) == ["hips", "neck", "head"]
    assert simplified(["Hips_x", "Neck_x", "Head_x"]) == ["hips", "neck", "head"]
    assert which_side("LeftArm", "RightArm") == 1
    assert which_side("upper_arm.R", "upper_arm.L") == -1
    assert which_side("lfemur", "rfemur") == 1
    assert which_side("左足", "右足") == 1
    assert which_side("joint_003", "joint_007") == 0


@pytest.mark.parametrize(
    "name",
    ["prefix_common", "prefix_smpl", "poser_daz", "rigify", "mixed_sets", "leg_shin"],
)
def test_shared_names(name: str) -> None:
    """The same joints under other names, in the same order: the same motion."""
    plain = read_clip(fault("plain_walk.bvh"))
    clip = read_clip(fault(f"names_{name}.bvh"))
    wanted = find_rig(plain).joints
    back = dict(zip(clip.joint_names, plain.joint_names, strict=True))
    assert {role: back[joint] for role, joint in find_rig(clip).joints.items()} == wanted
    assert map_clip(clip, "humanoid").clamped == 0


def test_shared_mirrored() -> None:
    clip = read_clip(fault("mirrored_sides.bvh"))
    mapped = map_clip(clip, "humanoid")
    assert any("mirrored" in note for note in mapped.notes)
    hips = [mapped.motion.model.joint(f"{side}_hip").qposadr[0] for side in ("left", "right")]
    twist = [2 * np.arccos(np.abs(mapped.motion.qpos[:, at])).max() for at in hips]
    assert max(np.degrees(twist)) < 60  # legs swing, and none is turned about


# --- Mapping files ------------------------------------------------------------------------------


def test_role_twice_is_an_error(walk: Motion, tmp_path: Path) -> None:
    clip, roles = walk_on("Mixamo", walk)
    with pytest.raises(ClipError, match=r"LeftLeg' has two roles, left_hip.*left_knee"):
        find_rig(clip, {"joints": {"left_hip": roles["left_knee"]}})
    path = tmp_path / "twice.yaml"
    path.write_text("joints:\n  left_hip: a\n  left_hip: b\n")
    with pytest.raises(ClipError, match=r"'left_hip' (stands )?twice"):
        find_rig(clip, path)
    path = tmp_path / "twice.json"
    path.write_text('{"joints": {"left_hip": "a", "left_hip": "b"}}')
    with pytest.raises(ClipError, match=r"'left_hip' (stands )?twice"):
        find_rig(clip, path)


def test_bad_ignore_is_one_line(walk: Motion) -> None:
    clip, _ = walk_on("Mixamo", walk)
    with pytest.raises(ClipError, match="ignore must be a list of roles"):
        find_rig(clip, {"ignore": [["left_wrist"]]})


def test_info_shows_tree_and_writes_mapping(tmp_path: Path) -> None:
    file, written = fault("names_rigify.bvh"), tmp_path / "map.yaml"
    done = command_line.run("info", file, "--write-mapping", written)
    assert done.returncode == 0, done.stderr
    joints = read_clip(file).joint_names
    for joint in joints:
        assert joint in done.stdout
    assert "left_knee (middle of the leg; left by the names, and its name)" in done.stdout
    assert "frames" in done.stdout
    assert find_rig(read_clip(file), written).joints == find_rig(read_clip(file)).joints
    again = command_line.run("info", file, "--write-mapping", written)
    assert again.returncode == 2
    assert "is there already" in again.stderr


def test_info_of_what_is_no_body(tmp_path: Path) -> None:
    file, written = tmp_path / "arm.bvh", tmp_path / "map.yaml"
    file.write_text(
        "HIERARCHY\nROOT base {\nOFFSET 0 0 0\nCHANNELS 3 Xrotation Yrotation Zrotation\n"
        "JOINT tip {\nOFFSET 0 1 0\nCHANNELS 3 Xrotation Yrotation Zrotation\n} }\n"
        "MOTION\nFrames: 1\nFrame Time: 0.1\n0 0 0 0 0 0\n"
    )
    done = command_line.run("info", file, "--write-mapping", written)
    assert done.returncode == 0, done.stderr
    assert "missing     pelvis, left_hip" in done.stdout
    assert "  left_hip:  # NEEDED" in written.read_text()
    with pytest.raises(ClipError, match="no joint found for pelvis"):
        find_rig(read_clip(file), written)  # not filled in


def test_info_has_no_mapping_of_other_things(tmp_path: Path) -> None:
    done = command_line.run("info", "walk", "--write-mapping", tmp_path / "map.yaml")
    assert done.returncode == 2
    assert "no recording" in done.stderr


# --- The page for people with a file ------------------------------------------------------------

PAGE = (Path(__file__).parents[1] / "docs" / "recording.md").read_text("utf-8")


def test_commands_of_the_page_parse() -> None:
    lines = [line for line in PAGE.splitlines() if line.startswith("mjmotion ")]
    assert len(lines) >= 6
    for line in lines:
        parse(shlex.split(line)[1:])
    for option in ("--mapping", "--write-mapping", "--fps", "--in-place", "--loop"):
        assert any(option in line for line in lines)


def test_formats_of_the_page_are_read() -> None:
    for suffix in SUFFIXES:
        assert f"`{suffix}`" in PAGE
