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
from typing import TYPE_CHECKING, Any

from mjmotion.clips.joint_names import OPTIONAL, ROLES
from mjmotion.exceptions import ClipError, unknown_name

if TYPE_CHECKING:
    import yaml

_KEYS = ("joints", "up", "scale", "ignore")


def read_mapping(mapping: str | Path | Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the checked content of a mapping.

    Raises:
      ClipError: the file is missing or malformed, or says something twice.
    """
    if isinstance(mapping, Mapping):
        where, content = "mapping", dict(mapping)
    else:
        where, content = f"mapping file '{mapping}'", _load(Path(mapping))
    if not isinstance(content, dict) or not isinstance(content.get("joints", {}), dict):
        raise ClipError(f"{where}: it needs 'joints:' with lines 'role: joint'")
    extra = set(content) - set(_KEYS)
    if extra:
        raise ClipError(f"{where}: {unknown_name('key', str(sorted(map(str, extra))[0]), _KEYS)}")
    if content.get("up") is not None and not re.fullmatch(r"[+-]?[xyz]", str(content["up"])):
        raise ClipError(f"{where}: up is '{content['up']}': write x, y, z, -x, -y or -z")
    scale = content.get("scale")
    if scale is not None and not (isinstance(scale, int | float) and 0 < scale < float("inf")):
        raise ClipError(f"{where}: scale is '{scale}': write the metres per unit of the file")
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


def _load(path: Path) -> Any:
    """Return what a YAML or JSON file holds."""
    import yaml

    try:
        text = path.read_text(encoding="utf-8-sig")
        if path.suffix.lower() == ".json":
            return json.loads(text, object_pairs_hook=_once)
        return yaml.load(text, _loader())
    except FileNotFoundError:
        raise ClipError(f"mapping file '{path}' does not exist: check the path") from None
    except (OSError, UnicodeDecodeError, ValueError, RecursionError, yaml.YAMLError) as error:
        reason = " ".join(str(error).split())
        raise ClipError(f"mapping file '{path}' cannot be read: {reason}") from None


def _once(pairs: Sequence[tuple[Any, Any]]) -> dict[Any, Any]:
    """Return pairs as a dict; ValueError where a key is there twice."""
    result: dict[Any, Any] = {}
    for key, value in pairs:
        if key in result:
            raise ValueError(f"'{key}' is there twice")
        result[key] = value
    return result


def _loader() -> type[yaml.SafeLoader]:
    """Return a YAML loader that refuses a key that is there twice."""
    import yaml

    class Loader(yaml.SafeLoader):
        pass

    def mapping(loader: yaml.SafeLoader, node: yaml.MappingNode) -> dict[Any, Any]:
        return _once(
            [
                (loader.construct_object(k, True), loader.construct_object(v, True))
                for k, v in node.value
            ]
        )

    Loader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, mapping)
    return Loader
