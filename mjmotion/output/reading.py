"""What a user names, read: a result's folder, or a motion as a file, a built-in name or a folder.

result = read_results("out/walk")            # a Result, as adapt returned it
motion, contacts = read_motion("out/walk")
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import mujoco

from mjmotion.body.character import Character, CharacterLike
from mjmotion.body.morph_body import MorphBody
from mjmotion.body.motion import Motion
from mjmotion.body.recording import Recording
from mjmotion.boundary.limits import MOST_COUNT, at_most, real_number, shown, whole_number
from mjmotion.boundary.mjcf import MUJOCO_ERRORS, check_mjcf, check_model
from mjmotion.boundary.structured import read_json
from mjmotion.boundary.words import first_line
from mjmotion.clips import builtin_contacts, load_clip
from mjmotion.constraints.unmet import Unmet
from mjmotion.exceptions import MotionError, mujoco_message
from mjmotion.footsteps.contacts import Contact, load_contacts
from mjmotion.output.folder import (
    BODY,
    CONTACTS,
    JOINTS,
    MODEL,
    MOTION,
    RECORDING,
    REPORT,
    SOURCE,
)
from mjmotion.output.result import Result

_NEEDED = (MOTION, SOURCE, MODEL, CONTACTS)
_OPTIONS = {"asf": "skeleton", "in_place": "travel", "loop": "length"}
_OF_A_LEVEL = ("level", "frames_per_knot", "seconds", "max_error_percent")


def read_results(folder: str | Path) -> Result:
    """Read an output folder.

    Its figures are not read but measured: by :meth:`Result.validate` or :meth:`Result.report`. What
    cannot be measured again (title, levels and time of the fit, what it could not meet) is known
    from ``report.json``, if there is one.

    Returns:
      The result; without ``trace``, which no file holds.

    Raises:
      MotionError: the folder or a file of it is missing or damaged.
    """
    folder = Path(folder)
    if folder.is_file():
        raise MotionError(f"'{folder}' is a file: give the folder of a result")
    if not folder.is_dir():
        raise MotionError(f"result folder '{folder}' does not exist: run mjmotion adapt first")
    lacking = [name for name in _NEEDED if not (folder / name).is_file()]
    if lacking:
        raise MotionError(
            f"'{folder}' is not a result of mjmotion adapt: it lacks {', '.join(lacking)}"
        )
    character = Character.load(folder / MODEL)
    model = character.model
    motion = Motion.load(folder / MOTION, character)
    source = Motion.load(folder / SOURCE, character)
    body = MorphBody.load(folder / BODY, model) if (folder / BODY).is_file() else None
    own = folder / RECORDING
    recording = Motion.load(own, character) if own.is_file() else None
    if (folder / JOINTS).is_file():
        if recording is None:
            source = _with_joints(source, folder / JOINTS)
        else:
            recording = _with_joints(recording, folder / JOINTS)
    for name, other in ((SOURCE, source), (BODY, body)):
        if other is not None and other.nframe != motion.nframe:
            raise MotionError(
                f"'{folder}': {name} has {other.nframe} frames and {MOTION} {motion.nframe}:"
                " they must be of the same run"
            )
    report, unmet = _read_report(folder / REPORT)
    return Result(
        source,
        motion,
        load_contacts(folder / CONTACTS, model, motion.nframe),
        trace=None,
        unmet=unmet,
        body=body,
        title=str(report.get("title") or folder.resolve().name),
        saved_report=report,
        notes=tuple(report.get("notes", ())),
        recording=recording,
    )


def _with_joints(motion: Motion, path: Path) -> Motion:
    """Return a motion with the recorded joints of a file."""
    joints = Recording.load(path, motion.nframe)
    return Motion(motion.character, motion.qpos, motion.fps, joints)


class LoadedMotion(NamedTuple):
    """A motion that a user named, with what is known of it.

    Attributes:
      motion: on the character's model; on character and scene in one for a result folder.
      contacts: those of a result folder; None where nobody has said who stands when.
    """

    motion: Motion
    contacts: tuple[Contact, ...] | None


def read_motion(
    what: str | Path,
    character: CharacterLike | None = None,
    *,
    mapping: str | Path | None = None,
    fps: float | None = None,
    asf: str | Path | None = None,
    in_place: str | float | None = None,
    loop: int = 1,
    floor: str = "auto",
) -> LoadedMotion:
    """Return a motion that a user named: a file, a built-in clip, or a result folder.

    Args:
      what: BVH, AMC, CSV or NPZ file, built-in name, or folder (its ``motion.npz``).
      character: the character that a file's frames are for, or what names one; ours without.
      mapping: for a recording: which of its joints is which.
      fps: rate of a clip in place of its file's own.
      asf: of an AMC file, its skeleton.
      in_place: of a recording, as :func:`mjmotion.load_clip` takes it, like the next two.
      loop: how often it is repeated.
      floor: what its ground is.

    Raises:
      ClipError: no such file or name, a damaged file, a skeleton that cannot be mapped.
      ModelError: no such character.
      MotionError: a folder without results, or one together with what is for files only.
    """
    path = Path(what)
    if path.is_dir():
        given = {"character": character, "mapping": mapping, "fps": fps, "asf": asf}
        going = {"in_place": in_place, "loop": loop, "floor": floor}
        check_folder_alone(path, {**given, **going})
        result = read_results(path)
        if result.body is not None:
            raise MotionError(
                f"'{path}' holds a morph, whose body changes: give a motion of one body"
            )
        return LoadedMotion(result.motion, result.contacts)
    motion = load_clip(
        what,
        character or "humanoid",
        mapping=mapping,
        fps=fps,
        asf=asf,
        in_place=in_place,
        loop=loop,
        floor=floor,
    )
    return LoadedMotion(motion, builtin_contacts(str(what)))


def check_folder_alone(path: str | Path, reading: Mapping[str, Any]) -> None:
    """Raise MotionError where a result folder comes together with how a file is to be read."""
    plain = {"loop": 1, "floor": "auto"}
    for option, value in reading.items():
        if value != plain.get(option):
            what = _OPTIONS.get(option, option)
            raise MotionError(f"'{path}' is a result folder and has its own {what}: leave it")


def load_model(path: str | Path) -> mujoco.MjModel:
    """Compile an MJCF file.

    Raises:
      MotionError: it is missing or MuJoCo cannot compile it.
    """
    path = Path(path)
    check_mjcf(path, MotionError)
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except MUJOCO_ERRORS as error:
        raise MotionError(f"model '{path}' does not compile: {mujoco_message(error)}") from error
    check_model(model, f"model '{path}'", MotionError)
    return model


def _read_report(path: Path) -> tuple[dict[str, Any], tuple[Unmet, ...]]:
    """Return what ``report.json`` says, {} if it is not there, and what it lists as unmet.

    Raises:
      MotionError: it is damaged.
    """
    if not path.is_file():
        return {}, ()
    report = read_json(path, "report")
    try:
        if not isinstance(report, dict):
            raise TypeError("not an object")
        for name in ("levels", "unmet"):
            report[name] = _entries(report.get(name) or [], name)
            at_most(len(report[name]), MOST_COUNT, name)
        for level in report["levels"]:
            for name in _OF_A_LEVEL:
                level[name] = real_number(level[name], name)
        for name in ("fit_seconds", "exact_error_percent"):
            if report.get(name) is not None:
                real_number(report[name], name)
        if not isinstance(report.get("title") or "", str):
            raise TypeError(f"title is {shown(report['title'])}")
        notes = report.get("notes") or []
        if not isinstance(notes, list) or not all(isinstance(note, str) for note in notes):
            raise TypeError(f"notes are {shown(notes)}, no list of text")
        report["notes"] = notes
        unmet = tuple(_unmet(entry) for entry in report["unmet"])
    except KeyError as error:
        raise _no_report(path, f"it lacks {error}") from error
    except (ValueError, TypeError, MotionError) as error:
        raise _no_report(path, first_line(error)) from error
    return report, unmet


def _entries(value: Any, name: str) -> list[dict[str, Any]]:
    """Return copies of a list of objects."""
    if not isinstance(value, list):
        raise TypeError(f"{name} is {shown(value)}, no list of objects")
    for entry in value:
        if not isinstance(entry, dict):
            raise TypeError(f"{name} holds {shown(entry)}, no object")
    return [dict(entry) for entry in value]


def _no_report(path: Path, why: str) -> MotionError:
    return MotionError(f"'{path}' is not a report of mjmotion ({why}): remove it, validate again")


def _unmet(entry: dict[str, Any]) -> Unmet:
    """Return an entry of ``unmet``, as :meth:`Unmet.as_dict` wrote it."""
    millimetres, degrees = (
        None if entry.get(name) is None else real_number(entry[name], name)
        for name in ("residual_mm", "residual_deg")
    )
    words = entry["constraint"], entry.get("source", "scene")
    if not all(isinstance(word, str) for word in words) or not isinstance(entry["frames"], list):
        raise TypeError("an entry of unmet has no words for its constraint, or no list of frames")
    if not entry["frames"] or (millimetres is None and degrees is None):
        raise TypeError("an entry of unmet has no frames, or no residual")
    return Unmet(
        words[0],
        tuple(whole_number(frame, "a frame of unmet") for frame in entry["frames"]),
        millimetres,
        degrees,
        whole_number(entry.get("index", 0), "index"),
        words[1],
    )
