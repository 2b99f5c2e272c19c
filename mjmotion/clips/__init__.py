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
from mjmotion.clips.floor import FLOORS
from mjmotion.clips.in_place import going
from mjmotion.clips.mapping import Mapped, map_clip, to_motion
from mjmotion.clips.reading import SUFFIXES, is_recording, not_read, read_clip
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
    "map_recording",
    "read_amc",
    "read_bvh",
    "read_clip",
    "read_csv",
    "to_motion",
    "write_csv",
]


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


def map_recording(
    path: str | Path,
    character: CharacterLike = "humanoid",
    *,
    mapping: str | Path | Mapping[str, Any] | None = None,
    fps: float | None = None,
    asf: str | Path | None = None,
    in_place: str | float | None = None,
    loop: int = 1,
    floor: str = "auto",
) -> Mapped:
    """Read a recording and put it on the humanoid, with the notes of what was found on the way.

    Args:
      path: a file for which :func:`is_recording` holds.
      character: the humanoid, with or without a scene, or what names it.
      mapping: mapping file, or its content (see :mod:`mjmotion.clips.rig_file`).
      fps: rate of the frames in place of the file's own.
      asf: for .amc: the skeleton, where it is not found beside the file.
      in_place: for recordings walked in place: ``"travel"`` rebuilds the travel from the standing
        feet, a number does so with this mean speed [m/s], ``"keep"`` leaves it, unsaid.
      loop: for recordings that end as they begin: how often they are repeated.
      floor: of a recording: ``"auto"`` takes out what is a little tilted, and follows what drifts
        where standing feet go along; ``"level"`` does neither, ``"follow"`` goes with the feet.

    Raises:
      ClipError: the file is damaged, or its skeleton cannot be mapped.
    """
    if not (in_place in (None, "keep", "travel") or _is_speed(in_place)):
        raise ClipError(f"in_place is {in_place!r}: give 'travel', 'keep' or a speed in m/s")
    if floor not in FLOORS:
        raise ClipError(unknown_name("floor", str(floor), FLOORS))
    clip = read_clip(path, fps=fps, asf=asf)
    rig = find_rig(clip, mapping)
    return going(clip, character, rig, in_place=in_place, loop=loop, floor=floor)


def _is_speed(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < 100


def load_clip(
    path_or_name: str | Path,
    character: CharacterLike = "humanoid",
    *,
    mapping: str | Path | Mapping[str, Any] | None = None,
    fps: float | None = None,
    asf: str | Path | None = None,
    in_place: str | float | None = None,
    loop: int = 1,
    floor: str = "auto",
) -> Motion:
    """Return a clip as a motion of the humanoid.

    Args:
      path_or_name: a .bvh, .amc, .glb, .gltf, .npz or .csv file, or the name of a built-in clip.
      character: the humanoid, with or without a scene, or what names it; of .npz and .csv files,
        the character that they were made for.
      mapping: for recordings on a skeleton of their own: mapping file, or its content (see
        :mod:`mjmotion.clips.rig_file`).
      fps: rate of the frames in place of the file's own.
      asf: for .amc: the skeleton, where it is not found beside the file.
      in_place: for recordings walked in place: ``"travel"`` rebuilds the travel from the standing
        feet, a number does so with this mean speed [m/s], ``"keep"`` leaves it, unsaid.
      loop: for recordings that end as they begin: how often they are repeated.
      floor: of a recording: ``"auto"`` takes out what is a little tilted, and follows what drifts
        where standing feet go along; ``"level"`` does neither, ``"follow"`` goes with the feet.

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
    if is_recording(path):
        how: dict[str, Any] = {"mapping": mapping, "fps": fps, "asf": asf}
        going_on: dict[str, Any] = {"in_place": in_place, "loop": loop, "floor": floor}
        return map_recording(path, character, **how, **going_on).motion
    suffix = path.suffix.lower()
    if suffix in ("", ".npz", ".csv"):
        _check_no_recording(path, loop, floor, mapping=mapping, asf=asf, in_place=in_place)
    if suffix == "" and not path.exists():
        names = builtin_clips()
        if str(path_or_name) not in names:
            message = unknown_name("clip", str(path_or_name), names)
            raise ClipError(f"{message}; or give a file ({', '.join(SUFFIXES)})")
        motion = names[str(path_or_name)](character)
    elif suffix == ".npz":
        motion = Motion.load(path, character)
    elif suffix == ".csv":
        motion = read_csv(path, character, fps=fps)
    else:
        raise not_read(path, f"it is of no known kind: give one of {', '.join(SUFFIXES)}")
    return motion if fps is None else Motion(character, motion.qpos, fps)


def _check_no_recording(path: Path, loop: int, floor: str, **given: object) -> None:
    """Refuse what is for recordings alone.

    Raises:
      ClipError: by the names of the command line.
    """
    meant = [name for name, value in given.items() if value is not None]
    meant += ["loop"] * (loop != 1) + ["floor"] * (floor != "auto")
    if meant:
        options = ", ".join(f"--{name.replace('_', '-')}" for name in meant)
        raise ClipError(f"'{path}' is no recording on a skeleton of its own: leave {options}")
