"""The built-in walk on skeletons of many makers' names and trees, so that its pose is known.

A skeleton is eleven names, from pelvis to toes, and lines ``name place parent`` for what it has
beside them. ``§`` in a name stands for the side. A place is one of ``AT`` (``hip``), a share of the
way between two (``hip>knee*.5``), or so far from one [m; ahead, left, up] (``wrist+.5,0,0``); ``-``
says that a name has another parent. What only looks like a limb (fingers, twists, skirts, hair, a
stick in the hand) turns with what it hangs on.
"""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np

from mjmotion.body.motion import Motion
from mjmotion.clips.skeleton import Clip, pose_skeleton

# Where the humanoid's joints are at rest [m], and which of its bodies turns there; left for both.
AT = {
    "pelvis": ((0.0, 0.0, 0.9275), "pelvis"),
    "spine": ((0.0, 0.0, 1.0725), "torso"),
    "neck": ((-0.015, 0.0, 1.49), "neck"),
    "head": ((0.005, 0.0, 1.6), "head"),
    "top": ((0.005, 0.0, 1.75), "head"),
    "shoulder": ((0.0, 0.18, 1.4325), "left_upper_arm"),
    "elbow": ((0.0, 0.18, 1.107), "left_forearm"),
    "wrist": ((0.0, 0.18, 0.8515), "left_hand"),
    "fingers": ((0.0, 0.18, 0.77), "left_hand"),
    "hip": ((0.0, 0.09, 0.9275), "left_thigh"),
    "knee": ((0.0, 0.09, 0.4987), "left_shank"),
    "ankle": ((0.0, 0.09, 0.0682), "left_foot"),
    "toe": ((0.12, 0.09, 0.0), "left_toes"),
    "tip": ((0.17, 0.09, 0.0), "left_toes"),
}
_BASE = (
    ("pelvis", ""),
    ("spine", "pelvis"),
    ("neck", "spine"),
    ("head", "neck"),
    ("shoulder", "spine"),
    ("elbow", "shoulder"),
    ("wrist", "elbow"),
    ("hip", "pelvis"),
    ("knee", "hip"),
    ("ankle", "knee"),
    ("toe", "ankle"),
)
_ENDS = {"head": "top", "wrist": "fingers", "toe": "tip"}
# The bones whose directions are compared: role of the joint, and of the one it points to.
BONES = {
    "hip": ("thigh", "shank"),
    "knee": ("shank", "foot"),
    "ankle": ("foot", "toes"),
    "shoulder": ("upper_arm", "forearm"),
    "elbow": ("forearm", "hand"),
}

_FINGERS = "".join(
    f"§{name}1 fingers+{x},0,.03 §Hand;§{name}2 fingers+{x},0,0 §{name}1;"
    f"§{name}3 fingers+{x},0,-.02 §{name}2;"
    for name, x in (("Index", 0.03), ("Middle", 0.01), ("Ring", -0.01), ("Pinky", -0.03))
)
_MAKEHUMAN = "root spine05 neck01 head upperarm01.§ lowerarm01.§ wrist.§ upperleg01.§ lowerleg01.§"
_MAKEHUMAN += " foot.§ toe3-1.§"
_XSENS = "Pelvis L5 Neck Head §UpperArm §Forearm §Hand §UpperLeg §LowerLeg §Foot §Toe"
_MIXAMO = "Hips Spine Neck Head §Arm §ForeArm §Hand §UpLeg §Leg §Foot §ToeBase"
_BIPED = "Pelvis Spine Neck Head §_UpperArm §_Forearm §_Hand §_Thigh §_Calf §_Foot §_Toe0"
_SMPL = "Pelvis Spine1 Neck Head §_Shoulder §_Elbow §_Wrist §_Hip §_Knee §_Ankle §_Foot"
_KINECT = "SpineBase SpineMid Neck Head Shoulder§ Elbow§ Wrist§ Hip§ Knee§ Ankle§ Foot§"
_MORE_SPINE = "Spine1 spine>neck*.3 Spine;Spine2 spine>neck*.6 Spine1;Neck - Spine2;"
_COLLAR = "§Shoulder neck+0,.05,-.06 Spine2;§Arm - §Shoulder;"
_HEAD_TOP = "HeadTop_End top Head;"
_VROID = (
    "J_Bip_C_Hips J_Bip_C_Spine J_Bip_C_Neck J_Bip_C_Head J_Bip_§_UpperArm J_Bip_§_LowerArm"
    " J_Bip_§_Hand J_Bip_§_UpperLeg J_Bip_§_LowerLeg J_Bip_§_Foot J_Bip_§_ToeBase"
)
_CC = (
    "CC_Base_Pelvis CC_Base_Waist CC_Base_NeckTwist01 CC_Base_Head CC_Base_§_Upperarm"
    " CC_Base_§_Forearm CC_Base_§_Hand CC_Base_§_Thigh CC_Base_§_Calf CC_Base_§_Foot"
    " CC_Base_§_ToeBase"
)
_DAZ = "hip abdomenLower neckLower head §ShldrBend §ForearmBend §Hand §ThighBend §Shin §Foot §Toe"
_RIGIFY = (
    "spine spine.001 spine.004 spine.006 upper_arm.§ forearm.§ hand.§ thigh.§ shin.§ foot.§ toe.§"
)
_CMU = "root lowerback lowerneck upperneck §humerus §radius §hand §femur §tibia §foot §toes"
_SIDES = ("Left", "Right")

# Maker: (names, words for the sides, what there is beside).
NAMINGS: dict[str, tuple[str, tuple[str, str], str]] = {
    "Mixamo": (
        " ".join(f"mixamorig:{name}" for name in _MIXAMO.split()),
        _SIDES,
        "",
    ),
    "Mixamo with fingers and collars": (
        _MIXAMO,
        _SIDES,
        _MORE_SPINE + _COLLAR + _FINGERS + _HEAD_TOP,
    ),
    "a prefix common to all": (" ".join(f"Model_{n}" for n in _MIXAMO.split()), _SIDES, ""),
    "a suffix common to all": (" ".join(f"{n}_skin" for n in _MIXAMO.split()), _SIDES, ""),
    "Motive": (
        "Skeleton 001_Hip;Skeleton 001_Ab;Skeleton 001_Neck;Skeleton 001_Head;Skeleton 001_§UArm;"
        "Skeleton 001_§FArm;Skeleton 001_§Hand;Skeleton 001_§Thigh;Skeleton 001_§Shin;"
        "Skeleton 001_§Foot;Skeleton 001_§Toe",
        ("L", "R"),
        "",
    ),
    "SMPL": (" ".join(f"f_avg_{n}" for n in _SMPL.split()), ("L", "R"), ""),
    "SMPL-X": (
        "pelvis spine1 neck head §_shoulder §_elbow §_wrist §_hip §_knee §_ankle §_foot",
        ("left", "right"),
        "spine2 spine>neck*.3 spine1;spine3 spine>neck*.5 spine2;neck - spine3;"
        "jaw head+.05,0,.02 head;"
        "§_eye_smplhf head+.08,.03,.06 head;§_collar neck+0,.07,-.08 spine3;§_shoulder - §_collar;"
        "§_index1 fingers+.02,0,0 §_wrist;§_index2 fingers+.02,0,-.03 §_index1;"
        "§_thumb1 wrist+.03,0,-.03 §_wrist;§_thumb2 wrist+.05,0,-.05 §_thumb1;",
    ),
    "Poser": (
        "hip abdomen neck head §Shldr §ForeArm §Hand §Thigh §Shin §Foot §Toe",
        ("l", "r"),
        "",
    ),
    "DAZ Genesis": (
        _DAZ,
        ("l", "r"),
        "pelvis pelvis+0,0,-.04 hip;§ThighBend - pelvis;§ThighTwist hip>knee*.5 §ThighBend;"
        "§Shin - §ThighTwist;§ShldrTwist shoulder>elbow*.5 §ShldrBend;§ForearmBend - §ShldrTwist;"
        "§ForearmTwist elbow>wrist*.5 §ForearmBend;§Hand - §ForearmTwist;"
        "§Collar neck+0,.04,-.06 abdomenLower;§ShldrBend - §Collar;"
        "neckUpper neck>head*.5 neckLower;"
        "head - neckUpper;§Pectoral spine+.1,.08,.22 abdomenLower;",
    ),
    "VRoid": (
        _VROID,
        ("L", "R"),
        "".join(
            f"J_Sec_§_Skirt{n}_0 hip+{x},.05,-.05 J_Bip_C_Hips;"
            f"J_Sec_§_Skirt{n}_1 hip+{x},.07,-.25 J_Sec_§_Skirt{n}_0;"
            f"J_Sec_§_Skirt{n}_2 hip+{x},.09,-.45 J_Sec_§_Skirt{n}_1;"
            for n, x in ((1, 0.1), (2, -0.1))
        )
        + "J_Sec_Hair1 head+-.1,0,.1 J_Bip_C_Head;J_Sec_Hair2 head+-.15,0,-.2 J_Sec_Hair1;"
        "J_Sec_Hair3 head+-.15,0,-.5 J_Sec_Hair2;",
    ),
    "Rigify": (_RIGIFY, ("L", "R"), "heel.02.§ ankle+-.05,0,-.05 foot.§;"),
    "Rigify, deform bones": (
        " ".join(f"DEF-{name}" for name in _RIGIFY.split()),
        ("L", "R"),
        "DEF-thigh.§.001 hip>knee*.5 DEF-thigh.§;DEF-shin.§ - DEF-thigh.§.001;"
        "DEF-shin.§.001 knee>ankle*.5 DEF-shin.§;DEF-foot.§ - DEF-shin.§.001;"
        "DEF-upper_arm.§.001 shoulder>elbow*.5 DEF-upper_arm.§;"
        "DEF-forearm.§ - DEF-upper_arm.§.001;",
    ),
    "MakeHuman": (
        _MAKEHUMAN,
        ("L", "R"),
        "pelvis.§ pelvis+0,.04,.02 root;upperleg01.§ - pelvis.§;"
        "upperleg02.§ hip>knee*.5 upperleg01.§;"
        "lowerleg01.§ - upperleg02.§;lowerleg02.§ knee>ankle*.5 lowerleg01.§;foot.§ - lowerleg02.§;"
        "upperarm02.§ shoulder>elbow*.5 upperarm01.§;lowerarm01.§ - upperarm02.§;"
        "lowerarm02.§ elbow>wrist*.5 lowerarm01.§;wrist.§ - lowerarm02.§;"
        "toe1-1.§ toe+.01,-.03,0 foot.§;toe5-1.§ toe+-.01,.03,0 foot.§;",
    ),
    "Character Creator": (
        _CC,
        ("L", "R"),
        "CC_Base_Hip pelvis+0,0,.02 ;CC_Base_Pelvis - CC_Base_Hip;CC_Base_Waist - CC_Base_Hip;"
        "CC_Base_§_ThighTwist01 hip>knee*.3 CC_Base_§_Thigh;CC_Base_§_ThighTwist02 hip>knee*.6"
        " CC_Base_§_Thigh;CC_Base_§_UpperarmTwist01 shoulder>elbow*.5 CC_Base_§_Upperarm;",
    ),
    "DeepMotion": (
        "hips_JNT spine_JNT neck_JNT head_JNT §_arm_JNT §_forearm_JNT §_hand_JNT §_upleg_JNT"
        " §_leg_JNT"
        " §_foot_JNT §_toebase_JNT",
        ("l", "r"),
        "spine1_JNT spine>neck*.4 spine_JNT;neck_JNT - spine1_JNT;§_shoulder_JNT neck+0,.05,-.06"
        " spine1_JNT;§_arm_JNT - §_shoulder_JNT;",
    ),
    "SOMA": (
        "Hips Spine1 Neck1 Head §Arm §ForeArm §Hand §Leg §Shin §Foot §ToeBase",
        _SIDES,
        "Root pelvis+0,0,-.9275 ;Hips - Root;Jaw head+.04,0,.02 Head;§Eye head+.08,.03,.06 Head;",
    ),
    "iPi": (
        "Hip LowerSpine Neck Head §Shoulder §Forearm §Hand §Thigh §Shin §Foot §Toe",
        ("L", "R"),
        "MiddleSpine spine>neck*.3 LowerSpine;Chest spine>neck*.6 MiddleSpine;Neck - Chest;"
        "§Clavicle neck+0,.05,-.06 Chest;§Shoulder - §Clavicle;",
    ),
    "Kinect": (_KINECT, _SIDES, "HandTip§ fingers Wrist§;Thumb§ wrist+.04,0,-.04 Wrist§;"),
    "Xsens": (
        _XSENS,
        _SIDES,
        "L3 spine>neck*.2 L5;T12 spine>neck*.4 L3;T8 spine>neck*.6 T12;Neck - T8;"
        "§Shoulder neck+0,.04,-.06 T8;§UpperArm - §Shoulder;",
    ),
    "Biped": (" ".join(f"Bip01 {n}".replace(" ", "_") for n in _BIPED.split()), ("L", "R"), ""),
    "Biped, legs on the spine": (
        _BIPED,
        ("L", "R"),
        "Bip01 pelvis ;Pelvis - Bip01;Stick wrist+.5,0,0 R_Hand;Tip wrist+1.2,0,0 Stick;",
    ),
    "CMU": (
        _CMU,
        ("l", "r"),
        "§hipjoint pelvis root;§femur - §hipjoint;thorax spine>neck*.5 lowerback;"
        "lowerneck - thorax;"
        "§clavicle neck thorax;§humerus - §clavicle;§fingers fingers §hand;"
        "§thumb wrist+.03,0,-.03 §hand;",
    ),
    "German": (
        "Becken Wirbelsäule Hals Kopf Oberarm_§ Unterarm_§ Hand_§ Oberschenkel_§"
        " Unterschenkel_§ Fuß_§"
        " Zehen_§",
        ("links", "rechts"),
        "",
    ),
    "French": (
        "Bassin Colonne Cou Tete Bras§ AvantBras§ Main§ Cuisse§ Jambe§ Pied§ Orteils§",
        ("Gauche", "Droite"),
        "",
    ),
    "Spanish": (
        "Cadera Columna Cuello Cabeza Brazo§ Antebrazo§ Mano§ Muslo§ Pierna§ Pie§ Dedos§",
        ("Izq", "Der"),
        "",
    ),
    "MikuMikuDance": (
        "センター 上半身 首 頭 §腕 §ひじ §手首 §足 §ひざ §足首 §つま先",
        ("左", "右"),
        "",
    ),
    "Russian": (
        "Таз Спина Шея Голова §Плечо §Локоть §Кисть §Бедро §Колено §Стопа §Носок",
        ("Лев", "Прав"),
        "",
    ),
    "mixed sets": (
        "Hip LowerSpine Neck Head §Shoulder §Forearm §Hand §Thigh §Shin §Foot §Toe",
        ("L", "R"),
        "",
    ),
    "the thigh is called Leg": (
        "Hips Spine1 Neck1 Head §Arm §ForeArm §Hand §Leg §Shin §Foot §ToeBase",
        _SIDES,
        "",
    ),
    "numbers": (
        "joint_000 joint_001 joint_002 joint_003 joint_1§4 joint_1§5 joint_1§6 joint_2§0 joint_2§1"
        " joint_2§2 joint_2§3",
        ("3", "7"),
        "",
    ),
    "numbers, many joints": (
        "j0 j1 j2 j3 j1§4 j1§5 j1§6 j2§0 j2§1 j2§2 j2§3",
        ("8", "4"),
        "j7 spine>neck*.3 j1;j8 spine>neck*.7 j7;j2 - j8;j3§1 neck+0,.05,-.06 j8;j1§4 - j3§1;"
        "j3§2 fingers+.03,0,0 j1§6;j3§3 fingers+.03,0,-.03 j3§2;j3§4 fingers+-.01,0,0 j1§6;"
        "j3§5 fingers+-.01,0,-.03 j3§4;j4§0 shoulder>elbow*.5 j1§4;j4§1 hip>knee*.5 j2§0;"
        "j9 head+.09,0,.05 j3;j10 pelvis+0,0,-.9 ;j0 - j10;",
    ),
}


@dataclasses.dataclass(frozen=True)
class _Joint:
    name: str
    parent: str
    at: np.ndarray
    body: str


def walk_on(naming: str, motion: Motion) -> tuple[Clip, dict[str, str]]:
    """Return a motion of the humanoid on a maker's skeleton, and role to joint as is right.

    Centimetres, y up, z ahead, as most files are.
    """
    text, sides, more = NAMINGS[naming]
    names = text.split(";") if ";" in text else text.split()
    joints = _joints(names, sides, more)
    roles = {}
    for (place, _), name in zip(_BASE, names, strict=True):
        if "§" in name:
            for side, word in zip(("left", "right"), sides, strict=True):
                roles[f"{side}_{place}"] = name.replace("§", word)
        elif place != "spine":
            roles[place] = name
    axes = np.array([(0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)])
    model, data = motion.model, mujoco.MjData(motion.model)
    turns = np.empty((motion.nframe, len(joints), 3, 3))
    ids = [model.body(joint.body).id for joint in joints]
    root = np.empty((motion.nframe, 3))
    for frame, qpos in enumerate(motion.qpos):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        turns[frame] = axes @ data.xmat[ids].reshape(-1, 3, 3) @ axes.T
        pelvis = data.body("pelvis")
        shift = joints[0].at - np.array(AT["pelvis"][0])
        root[frame] = 100 * axes @ (pelvis.xpos + pelvis.xmat.reshape(3, 3) @ shift)
    order = [joint.name for joint in joints]
    parents = np.array([order.index(joint.parent) if joint.parent else -1 for joint in joints])
    place = 100 * np.array([joint.at for joint in joints]) @ axes.T
    offsets = place - np.where((parents < 0)[:, None], place, place[parents])
    local = turns.copy()
    for index, parent in enumerate(parents):
        if parent >= 0:
            local[:, index] = np.swapaxes(turns[:, parent], 1, 2) @ turns[:, index]
    shifts = np.tile(offsets, (motion.nframe, 1, 1))
    shifts[:, 0] = root
    ends = {}
    for place_name, end in _ENDS.items():
        for side in ("left", "right") if place_name != "head" else ("",):
            joint = roles[f"{side}_{place_name}".strip("_")]
            if order.index(joint) not in parents:
                ends[joint] = 100 * axes @ (np.array(AT[end][0]) - np.array(AT[place_name][0]))
    clip = pose_skeleton(naming, tuple(order), parents, offsets, shifts, local, motion.fps, ends)
    return clip, roles


def _joints(names: list[str], sides: tuple[str, str], more: str) -> list[_Joint]:
    """Return the joints of both sides, parents first."""
    named = dict(zip((place for place, _ in _BASE), names, strict=True))
    rows = {
        named[place]: (named.get(above, ""), *(np.array(AT[place][0]), AT[place][1]))
        for place, above in _BASE
    }
    for line in more.split(";"):
        if not line:
            continue
        name, place, parent = line.split(" ")
        if place == "-":
            rows[name] = (parent, *rows[name][1:])
        else:
            rows[name] = (parent, *_place(place))
    both = []
    for name, (parent, at, body) in rows.items():
        if "§" not in name:
            both.append(_Joint(name, parent, at, body))
            continue
        for side, word, sign in zip(("left", "right"), sides, (1.0, -1.0), strict=True):
            both.append(
                _Joint(
                    name.replace("§", word),
                    parent.replace("§", word),
                    at * (1.0, sign, 1.0),
                    body.replace("left", side),
                )
            )
    done: list[_Joint] = []
    while both:
        known = {joint.name for joint in done} | {""}
        ready = [joint for joint in both if joint.parent in known]
        assert ready, f"no parents for {[joint.name for joint in both]}"
        done += ready
        both = [joint for joint in both if joint not in ready]
    return done


def _place(text: str) -> tuple[np.ndarray, str]:
    """Return where a place is, and the body there."""
    if ">" in text:
        (start, end), share = text.split("*")[0].split(">"), float(text.split("*")[1])
        a, b = (np.array(AT[name][0]) for name in (start, end))
        return (1 - share) * a + share * b, AT[start][1]
    name, _, shift = text.partition("+")
    at = np.array(AT[name][0]) + [float(x) for x in shift.split(",")] if shift else AT[name][0]
    return np.array(at), AT[name][1]


def bone_errors(motion: Motion, wanted: Motion) -> dict[str, np.ndarray]:
    """Return bone to (nframe,) angles [degrees] between two motions that set off alike."""
    directions = [_directions(one) for one in (motion, wanted)]
    errors = {}
    for bone in directions[0]:
        cosine = (directions[0][bone] * directions[1][bone]).sum(axis=1)
        errors[bone] = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return errors


def _directions(motion: Motion) -> dict[str, np.ndarray]:
    """Return bone to (nframe, 3) unit directions in the pelvis' frame at the first frame."""
    model, data = motion.model, mujoco.MjData(motion.model)
    pairs = {
        f"{side}_{part}": (f"{side}_{a}", f"{side}_{b}")
        for side in ("left", "right")
        for part, (a, b) in BONES.items()
    }
    found: dict[str, list[np.ndarray]] = {bone: [] for bone in (*pairs, "trunk", "head", "pelvis")}
    for qpos in motion.qpos:
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        for bone, (a, b) in pairs.items():
            line = data.body(b).xpos - data.body(a).xpos
            found[bone].append(line / np.linalg.norm(line))
        for bone, body in (("trunk", "torso"), ("head", "head")):
            found[bone].append(data.body(body).xmat.reshape(3, 3)[:, 2].copy())
        found["pelvis"].append(data.body("pelvis").xmat.reshape(3, 3)[:, 0].copy())
    return {bone: np.array(rows) for bone, rows in found.items()}
