"""Small files that are as they should be, of kinds that take more than a few lines to write."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.session import Drag, EditSession
from mjmotion.apps.session.file import session_json
from mjmotion.body.morph_body import MorphBody
from mjmotion.body.motion import Motion

Bone = tuple[str, str, str]  # name, parent, offset in centimetres


def gltf(bones: Sequence[Bone], nframe: int, *, binary: bool) -> bytes:
    """A skeleton that goes ahead: a .glb file, or a .gltf with its buffer inside."""
    times = np.arange(nframe, dtype="<f4") / 30
    turns = np.tile(np.array([0, 0, 0, 1], "<f4"), (nframe, 1))
    places = np.stack([0 * times, 0 * times + 0.935, times], axis=1)
    buffer = b"".join(array.tobytes() for array in (times, turns, places))
    content: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "nodes": [_node(bone, bones) for bone in bones],
        "skins": [{"joints": list(range(len(bones)))}],
        "accessors": _accessors([(times, "SCALAR"), (turns, "VEC4"), (places, "VEC3")]),
        "bufferViews": [{"buffer": 0, "byteLength": len(buffer)}],
        "buffers": [{"byteLength": len(buffer)}],
        "animations": [
            {
                "samplers": [{"input": 0, "output": 1}, {"input": 0, "output": 2}],
                "channels": [
                    *({"sampler": 0, "target": {"node": n, "path": "rotation"}} for n in range(3)),
                    {"sampler": 1, "target": {"node": 0, "path": "translation"}},
                ],
            }
        ],
    }
    if not binary:
        uri = base64.b64encode(buffer).decode()
        content["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{uri}"
        return json.dumps(content).encode()
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(buffer), 0x004E4942) + buffer
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def _node(bone: Bone, bones: Sequence[Bone]) -> dict[str, Any]:
    name, _, offset = bone
    node: dict[str, Any] = {"name": name, "translation": [float(x) / 100 for x in offset.split()]}
    if children := [n for n, (_, parent, _) in enumerate(bones) if parent == name]:
        node["children"] = children
    return node


def _accessors(arrays: Sequence[tuple[NDArray[Any], str]]) -> list[dict[str, Any]]:
    found, at = [], 0
    for array, kind in arrays:
        found.append(
            {"bufferView": 0, "byteOffset": at, "componentType": 5126}
            | {"count": len(array), "type": kind}
        )
        at += array.nbytes
    return found


def amass(nframe: int) -> dict[str, Any]:
    """Someone who stands, z up."""
    poses = np.zeros((nframe, 156))
    poses[:, 0] = np.pi / 2
    trans = np.stack([np.zeros(nframe), np.zeros(nframe), np.full(nframe, 0.95)], axis=1)
    return {"poses": poses, "trans": trans, "mocap_framerate": np.array(30.0)}


def session(clip: Motion, name: str) -> str:
    """A session of the editor with a drag, of a clip that is in a file beside it."""
    made = EditSession(clip, "flat", name=name)
    hand = tuple(float(x) for x in clip.qpos[5, :3] + [0.2, 0.3, 0.2])
    made.do(Drag("left_hand", 5, hand))  # type: ignore[arg-type]
    content = session_json(made)
    content["contacts"] = [["left_heel", 0, 4]]
    content["settings"]["rigidity"] = [["spine", 2.0]]
    return json.dumps(content)


def body(clip: Motion) -> dict[str, Any]:
    """What ``body.npz`` of a morph holds, of a body that stays as it is."""
    still = MorphBody.between(clip.model, [(0, clip.model)], clip.nframe)
    return dict(still.fields)


def mesh(kind: str) -> bytes:
    """A small uneven ground as a mesh."""
    import trimesh

    grid = np.arange(4.0)
    x, y = (side.ravel() for side in np.meshgrid(grid, grid))
    corner = [n for n in range(12) if n % 4 < 3]
    faces = [[n, n + 1, n + 5] for n in corner] + [[n, n + 5, n + 4] for n in corner]
    ground = trimesh.Trimesh(np.stack([x, y, 0.1 * np.sin(x + y)], axis=1), faces)
    data = ground.export(file_type=kind)
    return data if isinstance(data, bytes) else str(data).encode()


BONES = (
    *(("Hips", "", "0 0 0"), ("Spine", "Hips", "0 20 0"), ("Neck", "Spine", "0 30 0")),
    *(
        ("Head", "Neck", "0 10 0"),
        ("LeftArm", "Spine", "18 25 0"),
        ("LeftForeArm", "LeftArm", "28 0 0"),
    ),
    *(("LeftHand", "LeftForeArm", "25 0 0"), ("RightArm", "Spine", "-18 25 0")),
    *(("RightForeArm", "RightArm", "-28 0 0"), ("RightHand", "RightForeArm", "-25 0 0")),
    *(("LeftUpLeg", "Hips", "9 -5 0"), ("LeftLeg", "LeftUpLeg", "0 -42 0")),
    *(("LeftFoot", "LeftLeg", "0 -40 0"), ("LeftToeBase", "LeftFoot", "0 -6 14")),
    *(("RightUpLeg", "Hips", "-9 -5 0"), ("RightLeg", "RightUpLeg", "0 -42 0")),
    *(("RightFoot", "RightLeg", "0 -40 0"), ("RightToeBase", "RightFoot", "0 -6 14")),
)


def bvh(nframe: int) -> str:
    """Someone who goes ahead, y up, in centimetres."""

    def joint(name: str, offset: str, root: bool) -> str:
        children = [joint(n, o, False) for n, parent, o in BONES if parent == name]
        place = "6 Xposition Yposition Zposition" if root else "3"
        inside = "\n".join(children) or "End Site\n{\nOFFSET 0 3 0\n}"
        return (
            f"{'ROOT' if root else 'JOINT'} {name}\n{{\nOFFSET {offset}\n"
            f"CHANNELS {place} Zrotation Xrotation Yrotation\n{inside}\n}}"
        )

    rows = [
        " ".join(["0", "93.5", f"{0.5 * n:g}", *["0.5"] * 3, *["1.5"] * (3 * len(BONES) - 3)])
        for n in range(nframe)
    ]
    head = f"HIERARCHY\n{joint('Hips', '0 0 0', True)}\nMOTION\nFrames: {nframe}\n"
    return head + "Frame Time: 0.0333333\n" + "\n".join(rows) + "\n"


def asf(nframe: int) -> tuple[str, str]:
    """A skeleton of the same bones under their names in such files, and its frames."""
    bones = [":bonedata"]
    named = [(_acclaim(name), _acclaim(parent), offset) for name, parent, offset in BONES[1:]]
    for number, (name, _, offset) in enumerate(named, 1):
        x, y, z = (float(part) for part in offset.split())
        length = (x * x + y * y + z * z) ** 0.5
        bones.append(
            f"begin\nid {number}\nname {name}\ndirection {x / length:.5f} {y / length:.5f}"
            f" {z / length:.5f}\nlength {length:.4f}\naxis 0 0 0 XYZ\ndof rx ry rz\nend"
        )
    tree = [f"{parent} {name}" for name, parent, _ in named]
    asf = (
        ":version 1.10\n:name x\n:units\nmass 1\nlength 1\nangle deg\n:root\n"
        "order TX TY TZ RX RY RZ\naxis XYZ\nposition 0 0 0\norientation 0 0 0\n"
        + "\n".join(bones)
        + "\n:hierarchy\nbegin\n"
        + "\n".join(tree)
        + "\nend\n"
    )
    frames = [":FULLY-SPECIFIED", ":DEGREES"]
    for number in range(1, nframe + 1):
        frames += [str(number), f"root 0 93.5 {0.5 * number:g} 0 0 0"]
        frames += [f"{name} 1.5 1.5 1.5" for name, _, _ in named]
    return asf, "\n".join(frames) + "\n"


def _acclaim(name: str) -> str:
    """The name of a bone in the CMU library: lfemur of LeftUpLeg."""
    if name in _ACCLAIM:
        return _ACCLAIM[name]
    side = "Left" if name.startswith("Left") else "Right"
    return side[0].lower() + _ACCLAIM[name.removeprefix(side)]


_ACCLAIM = {
    **{"Hips": "root", "Spine": "lowerback", "Neck": "lowerneck", "Head": "head"},
    **{"Arm": "humerus", "ForeArm": "radius", "Hand": "wrist"},
    **{"UpLeg": "femur", "Leg": "tibia", "Foot": "foot", "ToeBase": "toes"},
}
