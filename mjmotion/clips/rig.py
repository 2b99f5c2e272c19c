"""Which joint of a clip's skeleton plays which role of the humanoid: by name, or by a mapping file.

A mapping file (YAML or JSON) for a skeleton with names of its own:

    joints:                 # role: joint of the clip; roles left out are found by name
      pelvis: Root
      left_hip: leg_l_upper
    up: z                   # optional: x, y, z, -x, -y or -z; found from the clip otherwise
    scale: 0.01             # optional: metres of the humanoid per unit of the file
    ignore: [left_wrist]    # optional: roles to leave at rest
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mjmotion.boundary.limits import real_number, shown
from mjmotion.boundary.structured import read_structured
from mjmotion.clips.skeleton import Clip
from mjmotion.exceptions import ClipError, unknown_name

SIDES = ("left", "right")
_CENTRE = ("pelvis", "chest", "neck", "head")
_LIMB = ("hip", "knee", "ankle", "toe", "shoulder", "elbow", "wrist", "hand")
ROLES = _CENTRE + tuple(f"{side}_{part}" for side in SIDES for part in _LIMB)
_OPTIONAL = {"chest", "neck", "head"} | {
    f"{side}_{part}" for side in SIDES for part in ("toe", "wrist", "hand")
}
REQUIRED = tuple(role for role in ROLES if role not in _OPTIONAL)

# Role to names, best first, lower case and without separators; {s} stands for the side.
_NAME_SETS: dict[str, dict[str, str]] = {
    "CMU": {
        "pelvis": "root",
        "chest": "thorax",
        "neck": "lowerneck",
        "head": "upperneck head",  # the skull begins there; 'head' is its upper half
        "hip": "{s}femur",
        "knee": "{s}tibia",
        "ankle": "{s}foot",
        "toe": "{s}toes",
        "shoulder": "{s}humerus",
        "elbow": "{s}radius",
        # CMU splits the forearm: 'wrist' is the half that turns, 'hand' begins at the wrist.
        "wrist": "{s}hand {s}wrist",
        "hand": "{s}fingers",
    },
    "CMU under MotionBuilder's names": {
        "pelvis": "hips",
        "chest": "spine1",
        "neck": "neck",
        "head": "neck1",
        "hip": "{s}upleg",
        "knee": "{s}leg",
        "ankle": "{s}foot",
        "toe": "{s}toebase",
        "shoulder": "{s}arm",
        "elbow": "{s}forearm",
        "wrist": "{s}fingerbase",
        "hand": "{s}handindex1",
    },
    "Mixamo, LAFAN1, MotionBuilder": {
        "pelvis": "hips hip pelvis",
        "chest": "",
        "neck": "neck",
        "head": "head",
        "hip": "{s}upleg {s}upperleg {s}thigh",
        "knee": "{s}leg {s}lowleg {s}lowerleg {s}shin {s}calf",
        "ankle": "{s}foot",
        "toe": "{s}toebase {s}toe {s}toes {s}toe0",
        "shoulder": "{s}arm {s}uparm {s}upperarm",
        "elbow": "{s}forearm {s}lowarm {s}lowerarm",
        "wrist": "{s}hand",
        "hand": "{s}handindex1 {s}handmiddle1 {s}finger0",
    },
    "joints by their anatomy": {
        "pelvis": "hips pelvis root hip",
        "chest": "",
        "neck": "neck",
        "head": "head",
        "hip": "{s}hip",
        "knee": "{s}knee",
        "ankle": "{s}ankle",
        "toe": "{s}toe {s}toes {s}toebase {s}foot",
        "shoulder": "{s}shoulder",
        "elbow": "{s}elbow",
        "wrist": "{s}wrist",
        "hand": "{s}hand",
    },
}


@dataclasses.dataclass(frozen=True)
class Rig:
    """The joints of a clip that drive the humanoid.

    Attributes:
      joints: role to joint name; every role of ``REQUIRED`` is there.
      up: the file's vertical axis (``"y"``, ``"-z"``, ...), or None to find it in the clip.
      scale: metres of the humanoid per unit of the file, or None to take it from the legs.
    """

    joints: Mapping[str, str]
    up: str | None = None
    scale: float | None = None


def find_rig(clip: Clip, mapping: str | Path | Mapping[str, Any] | None = None) -> Rig:
    """Find each role's joint, by the names of the common skeletons or as a mapping says.

    Args:
      clip: the clip.
      mapping: a mapping file (module docstring), or its content.

    Raises:
      ClipError: a required role has no joint, or the mapping is malformed or names unknown things.
    """
    content = _read_mapping(mapping) if mapping is not None else {}
    found = _best_names(clip)
    for role, joint in content.get("joints", {}).items():
        if role not in ROLES:
            raise ClipError(f"mapping: {unknown_name('role', str(role), ROLES)}")
        if joint not in clip.joint_names:
            raise ClipError(
                f"mapping of {role}: {unknown_name('joint', str(joint), clip.joint_names)}"
            )
        found[role] = str(joint)
    missing = [role for role in REQUIRED if role not in found]
    if missing:
        raise ClipError(
            f"'{clip.name}': no joint found for {', '.join(missing)} among"
            f" {', '.join(clip.joint_names[:12])}{', …' if len(clip.joint_names) > 12 else ''}:"
            " give a mapping file with lines 'role: joint' under 'joints:'"
        )
    for role in content.get("ignore", ()):
        if role not in _OPTIONAL:
            raise ClipError(f"mapping: ignore: {unknown_name('role', str(role), _OPTIONAL)}")
        found.pop(role, None)
    return Rig(found, content.get("up"), content.get("scale"))


def _best_names(clip: Clip) -> dict[str, str]:
    """Return role to joint from the name set that finds most roles."""
    plain: dict[str, str] = {}
    for name in clip.joint_names:
        plain.setdefault(_simplified(name), name)
    best: dict[str, str] = {}
    for names in _NAME_SETS.values():
        found = {}
        for role in ROLES:
            side, _, part = role.rpartition("_")
            for pattern in names[part].split():
                matches = [name for name in _spellings(pattern, side) if name in plain]
                if matches:
                    found[role] = plain[matches[0]]
                    break
        required = sum(role in found for role in REQUIRED), len(found)
        if required > (sum(role in best for role in REQUIRED), len(best)):
            best = found
    # Only a whole skeleton counts: one lone match may well be a chance.
    return best


def _spellings(pattern: str, side: str) -> list[str]:
    """Return the ways to write a side and a part: leftarm, larm, armleft, arml."""
    if not side:
        return [pattern]
    part = pattern.replace("{s}", "")
    return [side + part, side[0] + part, part + side, part + side[0]]


def _simplified(name: str) -> str:
    """Return a joint name without namespace, common prefix, separators and case."""
    name = re.split(r"[:|]", name)[-1]
    name = re.sub(r"[\s_.\-]", "", name).lower()
    return re.sub(r"^(mixamorig\d*|bip0*1|character\d+|skeleton|skel)(?=.)", "", name)


def _read_mapping(mapping: str | Path | Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the checked content of a mapping."""
    if isinstance(mapping, Mapping):
        where, content = "mapping", dict(mapping)
    else:
        where = f"mapping file '{mapping}'"
        content = read_structured(mapping, "mapping file", ClipError)
    if not isinstance(content, dict) or not isinstance(content.get("joints", {}), dict):
        raise ClipError(f"{where}: it needs 'joints:' with lines 'role: joint'")
    extra = set(content) - {"joints", "up", "scale", "ignore"}
    if extra:
        valid = ("joints", "up", "scale", "ignore")
        raise ClipError(f"{where}: {unknown_name('key', str(sorted(map(str, extra))[0]), valid)}")
    up = content.get("up")
    if up is not None and not (isinstance(up, str) and re.fullmatch(r"[+-]?[xyz]", up)):
        said = up[:20] if isinstance(up, str) else shown(up)
        raise ClipError(f"{where}: up is '{said}': write x, y, z, -x, -y or -z")
    scale = content.get("scale")
    if scale is not None and not 0 < real_number(scale, f"{where}: scale", ClipError) <= 1e6:
        raise ClipError(
            f"{where}: scale is '{shown(scale)}': write the metres per unit of the file"
        )
    for role, joint in content.get("joints", {}).items():
        if not isinstance(role, str) or not isinstance(joint, str):
            said = f"{shown(role)}: {shown(joint)}"
            raise ClipError(f"{where}: joints has {said}: write the role and the joint's name")
    ignore = content.get("ignore", [])
    if not isinstance(ignore, list | tuple) or not all(isinstance(role, str) for role in ignore):
        raise ClipError(f"{where}: ignore must be a list of roles")
    return content
