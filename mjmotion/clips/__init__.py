"""Clips: recorded motions from files, and how they are put on the humanoid.

motion = load_clip("walk.bvh")
mapped = map_clip(read_clip("walk.bvh"), "humanoid")   # with the scale and notes
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from mjmotion.body.character import Character, CharacterLike
from mjmotion.body.motion import Motion
from mjmotion.clips.asf import read_amc
from mjmotion.clips.bvh import read_bvh
from mjmotion.clips.mapping import Mapped, map_clip, to_motion
from mjmotion.clips.rig import ROLES, Rig, find_rig
from mjmotion.clips.skeleton import Clip
from mjmotion.clips.table import read_csv, write_csv
from mjmotion.exceptions import ClipError, unknown_name, wrong_type
from mjmotion.footsteps.contacts import Contact

__all__ = [
    "ROLES",
    "Clip",
    "Mapped",
    "Rig",
    "builtin_clips",
    "builtin_contacts",
    "find_rig",
    "is_recording",
    "load_clip",
    "map_clip",
    "read_amc",
    "read_bvh",
    "read_clip",
    "read_csv",
    "to_motion",
    "write_csv",
]

SUFFIXES = (".bvh", ".amc", ".npz", ".csv")


def is_recording(what: str | Path) -> bool:
    """Return whether this names a file of motion on a skeleton of its own, by its ending."""
    return Path(what).suffix.lower() in (".bvh", ".amc")


def builtin_clips() -> dict[str, Callable[[Character], Motion]]:
    """Return the clips that need no file: name to a function that makes the motion on a model."""
    from mjmotion.clips.climb import make_climb
    from mjmotion.clips.gait import BUILTIN
    from mjmotion.clips.sneak import make_sneak

    return {**BUILTIN, "sneak": make_sneak, "climb": make_climb}


def builtin_contacts(name: str) -> tuple[Contact, ...] | None:
    """Return who holds on to what and when in a built-in clip, where that cannot be seen in it.

    The climb's hands and feet hold a rope; heels and toes that stand are found in a motion.
    """
    if name != "climb":
        return None
    from mjmotion.clips.climb import climb_contacts

    return climb_contacts()


def read_clip(path: str | Path, *, fps: float | None = None) -> Clip:
    """Read a BVH or AMC file as a clip on its own skeleton.

    Args:
      path: the file.
      fps: rate to take in place of the file's, such as for an AMC that is not at 120.

    Raises:
      ClipError: the file is missing, damaged, or of another kind.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".bvh":
        clip = read_bvh(path)
        return clip if fps is None else clip.at_rate(fps)
    if suffix == ".amc":
        return read_amc(path) if fps is None else read_amc(path, fps=fps)
    raise ClipError(f"'{path}' is not a recording on a skeleton: give a .bvh or .amc file")


def load_clip(
    path_or_name: str | Path,
    character: CharacterLike = "humanoid",
    *,
    mapping: str | Path | Mapping[str, Any] | None = None,
    fps: float | None = None,
) -> Motion:
    """Return a clip as a motion of the humanoid.

    Args:
      path_or_name: a .bvh, .amc, .npz or .csv file, or the name of a built-in clip.
      character: the humanoid, with or without a scene, or what names it; of .npz and .csv files,
        the character that they were made for.
      mapping: for .bvh and .amc: mapping file, or its content (see :mod:`mjmotion.clips.rig`).
      fps: rate of the frames in place of the file's own.

    Raises:
      ClipError: no such file or name, a damaged file, a skeleton that cannot be mapped.
    """
    if not isinstance(path_or_name, (str, Path)):
        raise ClipError(wrong_type("clip", path_or_name, "a file, a built-in name or a Motion"))
    character = Character.of(character)
    path = Path(path_or_name)
    if path.is_dir():
        raise ClipError(
            f"'{path}' is a folder: give a file of it, such as motion.npz, and the character it is"
            " for"
        )
    suffix = path.suffix.lower()
    if suffix == "" and not path.exists():
        names = builtin_clips()
        if str(path_or_name) not in names:
            message = unknown_name("clip", str(path_or_name), names)
            raise ClipError(f"{message}; or give a file ({', '.join(SUFFIXES)})")
        motion = names[str(path_or_name)](character)
    elif suffix in (".bvh", ".amc"):
        clip = read_clip(path, fps=fps)
        return to_motion(clip, character, find_rig(clip, mapping))
    elif suffix == ".npz":
        motion = Motion.load(path, character)
    elif suffix == ".csv":
        motion = read_csv(path, character, fps=fps)
    else:
        raise ClipError(f"'{path}' is of no known kind: give one of {', '.join(SUFFIXES)}")
    return motion if fps is None else Motion(character, motion.qpos, fps)
