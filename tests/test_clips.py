"""Clips: readers against hand-computed positions, mapping onto the humanoid, bad input."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from mjmotion.body.assets import find_asset
from mjmotion.body.character import Character
from mjmotion.body.motion import Motion
from mjmotion.clips import find_rig, load_clip, map_clip, read_clip, write_csv
from mjmotion.clips.bvh import read_bvh
from mjmotion.clips.foot_planting import smooth_correction
from mjmotion.clips.mapping import Mapped, bend_leg
from mjmotion.clips.skeleton import Clip, axis_rotations, pose_skeleton
from mjmotion.clips.upright import drop_rest_frame, mend_glitches
from mjmotion.exceptions import ClipError
from mjmotion.numerics import rotations as rot

MOCAP = Path(__file__).parents[2] / "shared" / "mocap"
BVH = ["02_01", "03_01", "07_01", "12_01_other_rig", "127_29", "14_34"]
BVH += ["16_17", "16_31", "16_34", "16_58", "17_03"]
FLAT = ["02_01", "07_01", "12_01_other_rig", "16_17", "16_31", "16_34", "16_58"]


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(find_asset("model", "humanoid")))


@pytest.fixture(scope="module")
def mapped(model: mujoco.MjModel) -> Callable[[str], Mapped]:
    """Map each recording once."""
    cache: dict[str, Mapped] = {}

    def get(name: str) -> Mapped:
        path = MOCAP / "bvh" / f"{name}.bvh"
        if not path.is_file():
            pytest.skip("the recordings of shared/mocap are not here")
        if name not in cache:
            cache[name] = map_clip(read_bvh(path), model)
        return cache[name]

    return get


def recording(kind: str, name: str) -> Path:
    path = MOCAP / kind / f"{name}.{kind}"
    if not path.is_file():
        pytest.skip("the recordings of shared/mocap are not here")
    return path


def sites(motion: Motion, *names: str) -> np.ndarray:
    """Return (nframe, len(names), 3) positions from MuJoCo itself."""
    data = mujoco.MjData(motion.model)
    ids = [motion.model.site(name).id for name in names]
    out = np.empty((motion.nframe, len(ids), 3))
    for frame, qpos in enumerate(motion.qpos):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(motion.model, data)
        out[frame] = data.site_xpos[ids]
    return out


# --- BVH ---------------------------------------------------------------------------------------

SMALL = """HIERARCHY
ROOT Hips
{
  OFFSET 0 1 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Knee
  {
    OFFSET 0 -2 0
    CHANNELS 3 Xrotation Yrotation Zrotation
    End Site
    {
      OFFSET 0 -3 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.0333333
10 20 30 0 0 0 0 0 0
10 20 30 90 0 0 90 0 0
"""


def write(folder: Path, text: str, name: str = "clip.bvh") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_bvh_positions_by_hand(tmp_path: Path) -> None:
    clip = read_bvh(write(tmp_path, SMALL))
    assert clip.joint_names == ("Hips", "Knee")
    assert clip.fps == 30.0
    np.testing.assert_allclose(clip.positions[0], [[10, 20, 30], [10, 18, 30]])
    # Root turned 90° about z takes -y to +x; the knee's 90° about its x takes -y to -z.
    np.testing.assert_allclose(clip.positions[1], [[10, 20, 30], [12, 20, 30]], atol=1e-12)
    np.testing.assert_allclose(clip.end_positions("Knee"), [[10, 15, 30], [12, 20, 27]], atol=1e-12)


def test_bvh_channel_order_is_the_files(tmp_path: Path) -> None:
    """R = Rx(90°) Ry(90°) takes z to x, R = Ry(90°) Rx(90°) takes z to -y."""
    for order, wanted in (("Xrotation Yrotation", (1, 0, 0)), ("Yrotation Xrotation", (0, -1, 0))):
        text = SMALL.replace("Zrotation Xrotation Yrotation", f"{order} Zrotation")
        text = text.replace("OFFSET 0 -2 0", "OFFSET 0 0 1")
        text = text.replace("30 90 0 0 90 0 0", "30 90 90 0 0 0 0")
        clip = read_bvh(write(tmp_path, text))
        np.testing.assert_allclose(clip.positions[1, 1] - (10, 20, 30), wanted, atol=1e-12)


def test_bvh_position_channels_anywhere(tmp_path: Path) -> None:
    """A joint's position channels replace its offset; rotations may come before positions."""
    text = SMALL.replace(
        "CHANNELS 3 Xrotation Yrotation Zrotation",
        "CHANNELS 4 Zrotation Zposition Yposition Xposition",
    )
    text = text.replace("0 0 0 0 0 0\n", "0 0 0 0 7 6 5\n").replace(
        "90 0 0 90 0 0", "0 0 0 90 7 6 5"
    )
    clip = read_bvh(write(tmp_path, text))
    np.testing.assert_allclose(clip.positions[:, 1], [[15, 26, 37]] * 2)
    np.testing.assert_allclose(clip.end_positions("Knee")[1], [18, 26, 37], atol=1e-12)


def test_bvh_braces_and_spaces_as_they_come(tmp_path: Path) -> None:
    text = SMALL.replace("ROOT Hips\n{", "ROOT Hips {").replace("\n", "\r\n").replace("  ", "\t")
    np.testing.assert_array_equal(
        read_bvh(write(tmp_path, text)).positions,
        read_bvh(write(tmp_path, SMALL, "b.bvh")).positions,
    )


@pytest.mark.parametrize("name", BVH)
def test_bvh_agrees_with_pybvh(name: str) -> None:
    pybvh = pytest.importorskip("pybvh", reason="pybvh, the oracle, is not installed")
    path = recording("bvh", name)
    other = pybvh.read_bvh_file(path, world_up="+y")
    np.testing.assert_allclose(read_bvh(path).positions, other.joint_positions(), atol=1e-9)


CUT = SMALL.index("MOTION")
BAD_BVH = {
    "empty": ("", "empty"),
    "binary": ("\x00PK", "HIERARCHY"),
    "hierarchy cut off": (SMALL[: CUT - 20], "cut off"),
    "no MOTION": (SMALL[:CUT], "before MOTION"),
    "no ROOT": (SMALL.replace("ROOT", "JOINT"), "before any ROOT"),
    "two ROOTs": (SMALL.replace("JOINT", "ROOT"), "second ROOT"),
    "frames cut off": (SMALL.rsplit("10 20", 1)[0], "has 1 of its 2 frames"),
    "row cut off": (SMALL.replace("90 0 0 90 0 0", "90 0"), "frame 1 has 5 values"),
    "channels too few": (SMALL.replace("CHANNELS 3 Xrotation", "CHANNELS 2"), "channels"),
    "channel count wrong": (SMALL.replace("CHANNELS 3", "CHANNELS 4"), "CHANNELS 4"),
    "channel count short": (SMALL.replace("CHANNELS 3", "CHANNELS 2"), "line 9"),
    "channel unknown": (SMALL.replace("CHANNELS 3 X", "CHANNELS 3 W"), "wrotation"),
    "offset": (SMALL.replace("OFFSET 0 -2 0", "OFFSET 0 x 0"), "OFFSET"),
    "NaN": (SMALL.replace("30 90", "nan 90"), "not finite at frames 1"),
    "infinite": (SMALL.replace("30 90", "inf 90"), "not finite at frames 1"),
    "word": (SMALL.replace("30 90", "thirty 90"), "not a number"),
    "no frames": (SMALL.replace("Frames: 2", "Frames: 0"), "no frames"),
    "negative frames": (SMALL.replace("Frames: 2", "Frames: -2"), "no frames"),
    "frame time zero": (SMALL.replace("0.0333333", "0"), "frame time"),
    "frame time NaN": (SMALL.replace("0.0333333", "nan"), "frame time"),
    "frame time lacking": (SMALL.replace("Frame Time: 0.0333333\n", ""), "Frame Time"),
}


@pytest.mark.parametrize("case", BAD_BVH)
def test_bad_bvh(case: str, tmp_path: Path) -> None:
    text, part = BAD_BVH[case]
    with pytest.raises(ClipError) as caught:
        read_bvh(write(tmp_path, text))
    message = str(caught.value)
    assert part in message
    assert "\n" not in message
    assert "clip.bvh" in message


def test_missing_files(tmp_path: Path) -> None:
    for name in ("a.bvh", "a.amc", "a.npz", "a.csv"):
        with pytest.raises(ClipError, match="does not exist"):
            load_clip(tmp_path / name)
    with pytest.raises(ClipError, match="kind"):
        load_clip(write(tmp_path, "x", "a.fbx"))
    with pytest.raises(ClipError, match="unknown clip 'wlak'"):
        load_clip("wlak")


# --- AMC ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["02_01", "17_03"])
def test_amc_is_the_same_take_as_bvh(name: str) -> None:
    """ASF lengths are inches times 0.45; the BVH is in centimetres with three decimals.

    Angles rounded to 0.0005° over a chain 2 m long give 0.002 cm.
    """
    amc, bvh = read_clip(recording("amc", name)), read_clip(recording("bvh", name))
    assert amc.nframe == bvh.nframe
    assert amc.fps == bvh.fps == 120
    order = [amc.index(joint) for joint in bvh.joint_names]
    np.testing.assert_allclose(amc.positions[:, order] / 0.45 * 2.54, bvh.positions, atol=0.004)


def test_amc_and_bvh_map_to_the_same_motion(
    model: mujoco.MjModel, mapped: Callable[[str], Mapped]
) -> None:
    amc = load_clip(recording("amc", "02_01"), model)
    np.testing.assert_allclose(amc.qpos, mapped("02_01").motion.qpos, atol=2e-3)


def test_bad_amc(tmp_path: Path) -> None:
    skeleton, frames = recording("amc", "02_01").with_name("02.asf"), recording("amc", "02_01")
    text = frames.read_text()
    path = write(tmp_path, text[:200000], "02_01.amc")
    with pytest.raises(ClipError, match="needs its skeleton"):
        read_clip(path)
    write(tmp_path, skeleton.read_text(), "02.asf")
    with pytest.raises(ClipError, match="cut off"):
        read_clip(path)
    write(tmp_path, text.replace("rradius 46.2257", "rradius nan"), "02_01.amc")
    with pytest.raises(ClipError, match="not finite at frames 0"):
        read_clip(path)
    write(tmp_path, text.replace("rradius", "rspoke"), "02_01.amc")
    with pytest.raises(ClipError, match="rspoke"):
        read_clip(path)
    write(tmp_path, ":DEGREES\n", "02_01.amc")
    with pytest.raises(ClipError, match="no frames"):
        read_clip(path)
    write(tmp_path, text, "02_01.amc")
    write(tmp_path, skeleton.read_text()[:3000], "02.asf")
    with pytest.raises(ClipError, match=":hierarchy"):
        read_clip(path)


# --- Tables ------------------------------------------------------------------------------------


def test_csv_round_trip(
    model: mujoco.MjModel, mapped: Callable[[str], Mapped], tmp_path: Path
) -> None:
    motion = mapped("02_01").motion
    write_csv(tmp_path / "a.csv", motion)
    again = load_clip(tmp_path / "a.csv", model)
    assert again.fps == motion.fps
    np.testing.assert_allclose(again.qpos, motion.qpos, atol=1e-7)
    motion.save(tmp_path / "a.npz")
    again = load_clip(tmp_path / "a.npz", model)
    np.testing.assert_allclose(again.qpos, motion.qpos, atol=1e-15)


def test_bad_csv(model: mujoco.MjModel, tmp_path: Path) -> None:
    motion = Motion(model, np.tile(model.qpos0, (4, 1)), 50)
    path = tmp_path / "a.csv"
    write_csv(path, motion)
    lines = path.read_text().splitlines()
    bad = {
        "lacks the column root.x": [lines[0].replace("root.x", "foo"), *lines[1:]],
        "no frames": lines[:1],
        "frame 3 has": [*lines[:-1], lines[-1][:40]],
        "not a number": [*lines[:-1], lines[-1].replace("0.06,", "abc,")],
        "not even": [lines[0], lines[1], *lines[3:]],
        "not finite at frames 1": [*lines[:2], lines[2].replace(",0.9275", ",nan"), *lines[3:]],
    }
    for part, content in bad.items():
        path.write_text("\n".join(content))
        with pytest.raises(ClipError, match=part):
            load_clip(path, model)
    path.write_text("\n".join([line.partition(",")[2] for line in lines]))
    with pytest.raises(ClipError, match="rate"):
        load_clip(path, model)
    assert load_clip(path, model, fps=25).fps == 25


# --- Rigs --------------------------------------------------------------------------------------

PARTS = {
    "CMU": "root|lfemur|ltibia|lfoot|ltoes|thorax|lowerneck|head|lhumerus|lradius|lhand",
    "Mixamo": "mixamorig:Hips|mixamorig:LeftUpLeg|mixamorig:LeftLeg|mixamorig:LeftFoot|"
    "mixamorig:LeftToeBase|mixamorig:Spine2|mixamorig:Neck|mixamorig:Head|mixamorig:LeftArm|"
    "mixamorig:LeftForeArm|mixamorig:LeftHand",
    "LAFAN1": "Hips|LeftUpLeg|LeftLeg|LeftFoot|LeftToe|Spine2|Neck|Head|LeftArm|LeftForeArm|"
    "LeftHand",
    "Biped": "Bip01_Pelvis|Bip01_L_Thigh|Bip01_L_Calf|Bip01_L_Foot|Bip01_L_Toe0|Bip01_Spine1|"
    "Bip01_Neck|Bip01_Head|Bip01_L_UpperArm|Bip01_L_Forearm|Bip01_L_Hand",
    "Blender": "hips|thigh.L|shin.L|foot.L|toe.L|chest|neck|head|upper_arm.L|forearm.L|hand.L",
    "SMPL": "Pelvis|L_Hip|L_Knee|L_Ankle|L_Foot|Spine3|Neck|Head|L_Shoulder|L_Elbow|L_Wrist",
}
#         pelvis hip knee ankle toe chest neck head shoulder elbow wrist
PARENT = (-1, 0, 1, 2, 3, 0, 5, 6, 5, 8, 9)
# A person 18 units tall, arms out, facing z, y up.
PLACE = np.array(
    [
        (0, 10, 0),
        (1, 9.5, 0),
        (1, 5, 0),
        (1, 0.8, 0),
        (1, 0.3, 1.4),
        (0, 13, 0),
        (0, 15, 0),
        (0, 16, 0.2),
        (2, 14.5, 0),
        (5, 14.5, 0),
        (7.5, 14.5, 0),
    ]
)


def other_side(name: str) -> str:
    for left, right in (("Left", "Right"), ("_L_", "_R_"), ("L_", "R_"), (".L", ".R")):
        if left in name:
            return name.replace(left, right)
    return "r" + name[1:]


def figure(kind: str, nframe: int = 30, scale: float = 1.0, axes: np.ndarray | None = None) -> Clip:
    """Return a person of a kind of rig who walks along z with straight legs and bent elbows."""
    names = PARTS[kind].split("|")
    places, parents = list(PLACE * scale), list(PARENT)
    for index in (1, 2, 3, 4, 8, 9, 10):
        above = PARENT[index]
        names.append(other_side(names[index]))
        parents.append(names.index(other_side(names[above])) if above in (1, 2, 3, 8, 9) else above)
        places.append(PLACE[index] * scale * (-1, 1, 1))
    place, parent = np.array(places), np.array(parents)
    offsets = place - np.where((parent < 0)[:, None], 0, place[parent])
    shift = np.tile(offsets, (nframe, 1, 1))
    shift[:, 0, 2] += np.linspace(0, 20 * scale, nframe)
    turn = np.tile(np.eye(3), (nframe, len(place), 1, 1))
    swing = 0.3 * np.sin(np.linspace(0, 6, nframe))
    for sign, hip, knee, elbow in ((1, 1, 2, 9), (-1, 11, 12, 16)):
        turn[:, hip] = axis_rotations("x", sign * swing)
        turn[:, knee] = axis_rotations("x", 0.2 + 0.1 * np.abs(swing))
        turn[:, elbow] = axis_rotations("y", np.full(nframe, -0.5 * sign))
    axes = np.eye(3) if axes is None else axes
    offsets, shift = offsets @ axes.T, shift @ axes.T
    turn = axes @ turn @ axes.T
    return pose_skeleton(kind, tuple(names), parent, offsets, shift, turn, 30.0, {})


@pytest.mark.parametrize("kind", PARTS)
def test_rigs_are_found_by_name(kind: str, model: mujoco.MjModel) -> None:
    clip = figure(kind)
    rig = find_rig(clip)
    joints = dict(rig.joints)
    assert joints["left_knee"] == PARTS[kind].split("|")[2]
    assert joints["right_knee"] == other_side(joints["left_knee"])
    assert joints["left_elbow"] == PARTS[kind].split("|")[9]
    motion = map_clip(clip, model).motion
    knee = motion.qpos[:, model.joint("left_knee").qposadr[0]]
    assert knee.min() > 0.1
    assert motion.qpos[-1, 0] > 1.0


def test_units_and_up_axis_do_not_matter(model: mujoco.MjModel) -> None:
    """The same person in metres or inches, Y up, Z up or upside down: the same motion."""
    plain = map_clip(figure("LAFAN1"), model)
    turns = {
        "z": np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]]),
        "x": np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]]),
        "-y": np.diag([-1, -1, 1]),
    }
    for up, axes in turns.items():
        other = map_clip(figure("LAFAN1", scale=0.1, axes=axes.astype(float)), model)
        assert other.up == up
        assert other.scale == pytest.approx(10 * plain.scale)
        np.testing.assert_allclose(other.motion.qpos, plain.motion.qpos, atol=1e-6)


def test_directions_are_kept(model: mujoco.MjModel) -> None:
    """Arms out at rest are arms out on the humanoid; legs swing as recorded."""
    clip = figure("LAFAN1")
    motion = map_clip(clip, model).motion
    data = mujoco.MjData(model)
    data.qpos[:] = motion.qpos[12]
    mujoco.mj_kinematics(model, data)

    def bone(a: str, b: str) -> np.ndarray:
        return rot.normalized(data.body(b).xpos - data.body(a).xpos)

    np.testing.assert_allclose(bone("left_upper_arm", "left_forearm"), (0, 1, 0), atol=1e-6)
    np.testing.assert_allclose(
        bone("left_forearm", "left_hand"), (np.sin(0.5), np.cos(0.5), 0), atol=1e-6
    )
    legs = [clip.index(name) for name in ("LeftUpLeg", "LeftFoot")]
    wanted = rot.normalized(clip.positions[12, legs[1]] - clip.positions[12, legs[0]])[[2, 0, 1]]
    assert np.degrees(np.arccos(bone("left_thigh", "left_foot") @ wanted)) < 6


def test_mapping_file(model: mujoco.MjModel, tmp_path: Path) -> None:
    clip = figure("LAFAN1")
    renamed = Clip(**{**clip.__dict__, "joint_names": tuple(f"j{i}" for i in range(18))})
    legless = {**clip.__dict__, "parents": np.r_[-1, np.zeros(17, int)]}
    with pytest.raises(ClipError, match=r"no joint found for pelvis, left_hip.*mapping file"):
        find_rig(Clip(**{**legless, "joint_names": renamed.joint_names}))
    roles = find_rig(clip).joints
    joints = {role: f"j{clip.index(joint)}" for role, joint in roles.items()}
    lines = "".join(f"  {role}: {joint}\n" for role, joint in joints.items())
    for path, text in (
        (tmp_path / "a.json", json.dumps({"joints": joints, "up": "y"})),
        (
            tmp_path / "a.yaml",
            "up: y\njoints:\n" + lines,
        ),
    ):
        path.write_text(text)
        motion = map_clip(renamed, model, find_rig(renamed, path)).motion
        np.testing.assert_allclose(motion.qpos, map_clip(clip, model).motion.qpos)
    rig = find_rig(clip, {"ignore": ["left_wrist", "right_wrist"], "scale": 0.1})
    assert "left_wrist" not in rig.joints
    assert map_clip(clip, model, rig).scale == 0.1


BAD_MAPPING = {
    "unknown role 'left_knew'": "joints: {left_knew: a}",
    "unknown joint 'LeftLag'. Did you mean 'LeftLeg'": "joints: {left_knee: LeftLag}",
    "unknown key 'jionts'": "jionts: {}",
    "up is 'w'": "up: w",
    "scale is '-1'": "scale: -1",
    "ignore": "ignore: [left_knee]",
    "cannot be read": "a: [",
    "needs 'joints:'": "- 1",
}


@pytest.mark.parametrize("part", BAD_MAPPING)
def test_bad_mapping(part: str, tmp_path: Path) -> None:
    path = write(tmp_path, BAD_MAPPING[part], "map.yaml")
    with pytest.raises(ClipError) as caught:
        find_rig(figure("LAFAN1"), path)
    assert part in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_mapping_file(tmp_path: Path) -> None:
    with pytest.raises(ClipError, match="does not exist"):
        find_rig(figure("LAFAN1"), tmp_path / "no.yaml")


# --- Steps of the mapping ----------------------------------------------------------------------


def test_leg_reaches_its_ankle() -> None:
    """The closed form's thigh and knee bring the ankle exactly where it was asked for."""
    rng = np.random.default_rng(3)
    hip = rng.normal(size=(200, 3))
    ankle = hip + rot.normalized(rng.normal(size=(200, 3))) * rng.uniform(0.1, 0.84, (200, 1))
    normal = rng.normal(size=(200, 3))
    thigh, knee = bend_leg(hip, ankle, normal, 0.43, 0.42)
    assert (knee >= 0).all()
    bend = np.stack([np.cos(knee / 2), 0 * knee, np.sin(knee / 2), 0 * knee], axis=-1)
    middle = hip + rot.rotate(thigh, np.array((0, 0, -0.43)))
    reached = middle + rot.rotate(rot.multiply(thigh, bend), np.array((0, 0, -0.42)))
    np.testing.assert_allclose(reached, ankle, atol=1e-9)
    axis = rot.rotate(thigh, np.array((0.0, 1.0, 0.0)))
    assert (rot.dot(axis, normal) > 0).all()


def test_correction_follows_where_it_counts() -> None:
    time = np.arange(240) / 120
    values = np.stack([np.sin(4 * time), 0 * time + 1], axis=1)
    weight = (time < 0.5).astype(float)
    curve = smooth_correction(values, weight, 120)
    assert np.abs(curve - values)[:40].max() < 1e-3
    assert np.abs(curve[-30:]).max() < 0.05
    assert np.abs(np.diff(curve, 3, axis=0)).max() < 0.01


def test_rest_frame_is_dropped() -> None:
    clip = figure("LAFAN1", nframe=60)
    assert drop_rest_frame(clip) == (clip, None)
    turned = np.array(clip.rotations)
    turned[0, [8, 9, 15, 16]] = axis_rotations("z", np.array(1.2))
    cut, note = drop_rest_frame(Clip(**{**clip.__dict__, "rotations": turned}))
    assert cut.nframe == 59
    assert note is not None


def test_glitch_is_mended() -> None:
    clip = figure("LAFAN1", nframe=120)
    clip = clip.at_rate(120)
    assert mend_glitches(clip)[1] is None
    knee = clip.index("LeftLeg")
    turned = np.array(clip.rotations)
    turned[50, knee] = turned[50, knee] @ axis_rotations("x", np.array(0.6))
    mended, note = mend_glitches(Clip(**{**clip.__dict__, "rotations": turned}))
    assert note is not None
    np.testing.assert_allclose(mended.rotations[:, knee], clip.rotations[:, knee], atol=2e-3)


# --- Recordings --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", BVH)
def test_recordings_map(name: str, mapped: Callable[[str], Mapped], model: mujoco.MjModel) -> None:
    result = mapped(name)
    motion = result.motion
    assert result.up == "y"
    assert motion.fps == 120
    np.testing.assert_allclose(motion.qpos[0, :2], 0, atol=1e-9)
    assert Character.of(model).limits.excess(motion.qpos).max() < 1e-9
    # Numbers of neighbouring frames stay near: no quaternion changes its sign.
    assert np.abs(np.diff(motion.qpos, axis=0)).max() < 0.35
    assert motion.nframe == read_bvh(recording("bvh", name)).nframe - (name == "12_01_other_rig")


@pytest.mark.parametrize("name", FLAT)
def test_flat_walks_stand_on_the_ground(name: str, mapped: Callable[[str], Mapped]) -> None:
    motion = mapped(name).motion
    height = sites(motion, "left_heel", "left_toe", "right_heel", "right_toe")[..., 2]
    assert height.min() > -0.006
    # Somewhere in every half second a foot stands flat: both ends of a sole at the ground.
    flat = (np.abs(height).reshape(len(height), 2, 2).max(axis=2) < 0.004).any(axis=1)
    gaps = np.diff(np.flatnonzero(np.r_[True, flat, True]))
    assert gaps.max() < 60
    # Travelling along +x at first.
    far = np.linalg.norm(motion.qpos[:, :2], axis=1) > 1
    assert motion.qpos[np.argmax(far), 0] > 0.99


@pytest.mark.parametrize("name", FLAT)
def test_stance_does_not_slide(name: str, mapped: Callable[[str], Mapped]) -> None:
    """Soles slide less in flat stance than the recorded feet do, and never by 2 mm."""
    result = mapped(name)
    motion = result.motion
    clip = read_bvh(recording("bvh", name))
    clip = clip.cut(clip.nframe - motion.nframe, clip.nframe)
    rig = find_rig(clip)
    for side in ("left", "right"):
        points = sites(motion, f"{side}_heel", f"{side}_toe")
        flat = (np.abs(points[..., 2]) < 0.002).all(axis=1)
        ball = clip.positions[:, clip.index(rig.joints[f"{side}_toe"])] * result.scale
        flat &= np.linalg.norm(np.gradient(ball, axis=0), axis=1) * clip.fps < 0.2
        edges = np.flatnonzero(np.diff(np.r_[False, flat, False].astype(int))).reshape(-1, 2)
        runs = [run for run in edges if run[1] - run[0] >= 20]
        assert runs
        for start, end in runs:
            part = points[start + 5 : end - 5]
            drift = np.linalg.norm(part - part.mean(axis=0), axis=-1).max()
            own = ball[start + 5 : end - 5]
            assert drift < max(0.002, np.linalg.norm(own - own.mean(axis=0), axis=-1).max())


@pytest.mark.parametrize("name", BVH)
def test_bones_keep_their_directions(name: str, mapped: Callable[[str], Mapped]) -> None:
    """Upper arms and thighs point where the recorded ones do, in the frame of the walk."""
    result = mapped(name)
    motion, clip = result.motion, read_bvh(recording("bvh", name))
    clip, _ = mend_glitches(clip.cut(clip.nframe - motion.nframe, clip.nframe))
    rig = find_rig(clip)
    data = mujoco.MjData(motion.model)
    ours: dict[str, list[np.ndarray]] = {"arm": [], "thigh": []}
    pairs = {"arm": ("left_upper_arm", "left_forearm"), "thigh": ("left_thigh", "left_shank")}
    for qpos in motion.qpos:
        data.qpos[:] = qpos
        mujoco.mj_kinematics(motion.model, data)
        for key, (first, second) in pairs.items():
            ours[key].append(data.body(second).xpos - data.body(first).xpos)
    roles = {"arm": ("left_shoulder", "left_elbow"), "thigh": ("left_hip", "left_knee")}
    for key, (first, second) in roles.items():
        line = (
            clip.positions[:, clip.index(rig.joints[second])]
            - clip.positions[:, clip.index(rig.joints[first])]
        )[:, [2, 0, 1]]
        theirs, mine = rot.normalized(line), rot.normalized(np.array(ours[key]))
        # The clip was turned about the vertical: find that turn from all bones, then compare.
        yaw = np.angle(((mine[:, 0] + 1j * mine[:, 1]) * (theirs[:, 0] - 1j * theirs[:, 1])).sum())
        theirs = rot.rotate(rot.yaw_quat(np.array(yaw)), theirs)
        angle = np.degrees(np.arccos(np.clip(rot.dot(mine, theirs), -1, 1)))
        assert np.median(angle) < {"arm": 1.0, "thigh": 6.0}[key]


def test_load_clip_uses_the_humanoid_and_fps(mapped: Callable[[str], Mapped]) -> None:
    path = recording("bvh", "02_01")
    motion = load_clip(path, fps=60)
    assert motion.fps == 60
    assert motion.nframe == 343
