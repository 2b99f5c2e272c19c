"""Mapping files: which joint of a clip plays which role, as a user says (YAML or JSON).

joints:                 # role: joint of the clip; roles left out are found
  pelvis: Root
  left_hip: leg_l_upper
up: z                   # optional: x, y, z, -x, -y or -z; found from the clip otherwise
scale: 0.01             # optional: metres of the humanoid per unit of the file
ignore: [left_wrist]    # optional: roles to leave at rest
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mjmotion.boundary.limits import real_number, shown
from mjmotion.boundary.structured import read_structured
from mjmotion.clips.joint_names import OPTIONAL, ROLES
from mjmotion.exceptions import ClipError, unknown_name

_KEYS = ("joints", "up", "scale", "ignore")


def read_mapping(mapping: str | Path | Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the checked content of a mapping.

    Raises:
      ClipError: the file is missing or malformed, or says something twice.
    """
    if isinstance(mapping, Mapping):
        where, content = "mapping", dict(mapping)
    else:
        where = f"mapping file '{mapping}'"
        content = read_structured(mapping, "mapping file", ClipError)
    if not isinstance(content, dict) or not isinstance(content.get("joints", {}), dict):
        raise ClipError(f"{where}: it needs 'joints:' with lines 'role: joint'")
    extra = set(content) - set(_KEYS)
    if extra:
        raise ClipError(f"{where}: {unknown_name('key', str(sorted(map(str, extra))[0]), _KEYS)}")
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
        if not isinstance(role, str) or not (joint is None or isinstance(joint, str)):
            said = f"{shown(role)}: {shown(joint)}"
            raise ClipError(f"{where}: joints has {said}: write the role and the joint's name")
    ignored = content.get("ignore", [])
    if not isinstance(ignored, list | tuple) or not all(isinstance(r, str) for r in ignored):
        raise ClipError(f"{where}: ignore must be a list of roles")
    return content


def mapping_text(
    name: str, joint_names: Sequence[str], joints: Mapping[str, str], reasons: Mapping[str, str]
) -> str:
    """Return a mapping file (YAML) with what was found, to be filled in.

    Args:
      name: of the clip, for its first line.
      joint_names: of the clip.
      joints: role to joint, as far as found.
      reasons: role to why.
    """
    lines = [
        f"# Which joint of {json.dumps(name, ensure_ascii=False)} plays which role.",
        "# Write a joint behind each role that lacks one; change what is wrong. A role that is",
        "# left empty is found again; one that the skeleton does not have goes to 'ignore'.",
        f"# Joints: {', '.join(json.dumps(joint, ensure_ascii=False) for joint in joint_names)}",
        "joints:",
    ]
    for role in ROLES:
        joint = json.dumps(joints[role], ensure_ascii=False) if role in joints else ""
        need = "optional" if role in OPTIONAL else "NEEDED"
        lines.append(f"  {role}: {joint}".rstrip() + f"  # {reasons.get(role, need)}")
    lines += [
        "# up: y          # the file's vertical axis: x, y, z, -x, -y or -z",
        "# scale: 0.01    # metres of the humanoid per unit of the file",
        "# ignore: [left_hand, right_hand]",
    ]
    return "\n".join(lines) + "\n"
