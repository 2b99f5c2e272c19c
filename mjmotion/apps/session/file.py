"""A session as one file: the clip's name and hash, scene, contacts, settings and edits.

save_session("lift.mjsession", session)
session = load_session("lift.mjsession")

JSON, whose numbers read back as the same bits: the motion of a saved session is bit-identical.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from mjmotion.apps.session.edits import Vector, from_json, settings_from_json, to_json, vector
from mjmotion.apps.session.history import State
from mjmotion.apps.session.session import EditSession
from mjmotion.body.assets import asset_names, find_asset
from mjmotion.body.motion import Motion
from mjmotion.boundary.limits import MOST_EDITS, at_most, shown, whole_number
from mjmotion.boundary.structured import read_json
from mjmotion.boundary.whole import write_whole
from mjmotion.exceptions import MotionError, SessionError, unknown_name
from mjmotion.footsteps.contacts import Contact, check_contacts
from mjmotion.output.reading import read_motion

FORMAT, VERSION = "mjmotion session", 1


def clip_hash(motion: Motion) -> str:
    """Return what tells a clip from every other: of its joints, rate and poses."""
    names = [motion.model.joint(i).name for i in range(motion.model.njnt)]
    seen = hashlib.sha256(json.dumps([names, motion.fps, motion.nframe]).encode())
    seen.update(np.ascontiguousarray(motion.qpos).tobytes())
    return seen.hexdigest()


def session_json(session: EditSession) -> dict[str, Any]:
    """Return a session as its file holds it."""
    state = session.state
    return {
        "format": FORMAT,
        "version": VERSION,
        "clip": {
            "name": session.name,
            "character": session.character,
            "sha256": clip_hash(session.clip),
            "nframe": session.clip.nframe,
            "fps": session.clip.fps,
        },
        "scene": session.scene_name,
        "scene_moves": [[name, list(by)] for name, by in state.scene_moves],
        "contacts": None
        if state.contacts is None
        else [[one.site, one.start, one.end] for one in state.contacts],
        "settings": dataclasses.asdict(state.settings),
        "edits": [to_json(edit) for edit in state.edits],
    }


def save_session(path: str | Path, session: EditSession) -> Path:
    """Write a session, whole or not at all; an earlier file of that name is replaced.

    Raises:
      OutputError: it cannot be written.
    """
    from mjmotion.exceptions import OutputError

    path = Path(path)
    text = json.dumps(session_json(session), indent=1, allow_nan=False)
    try:
        write_whole(path, text)
    except OSError as error:
        raise OutputError(f"cannot write '{path}': {error.strerror or error}") from error
    return path


def load_session(path: str | Path, clip: Motion | str | Path | None = None) -> EditSession:
    """Read a session and make its edits.

    Args:
      path: the file, or the name of one of ours.
      clip: the clip, where it is not any more what the file names.

    Raises:
      SessionError: no such file, a damaged one, one of another version or of another clip.
      MotionError: the clip or the scene cannot be read, or does not take the edits.
    """
    path = Path(path)
    if not path.exists() and path.name in asset_names("session"):
        path = find_asset("session", path)
    value = _read(path)
    where = f"session '{path}'"
    name, character, digest = _named(value, where)
    scene = value.get("scene")
    if scene is not None and not isinstance(scene, str):
        raise SessionError(f"{where}: scene must be a name or a file")
    state = _state(value, where)
    if isinstance(clip, Motion):
        motion = clip
    else:
        motion = _clip(where, _beside(path, name) if clip is None else clip, character)
    if clip_hash(motion) != digest:
        raise SessionError(
            f"{where} is of another clip than '{clip or name}': its hash is another; give the clip"
            " that it was made with"
        )
    found = None if scene is None else _beside(path, scene)
    try:
        session = EditSession(motion, found, name=name, character=character)
        check_contacts(state.contacts or (), motion.model, motion.nframe)
        _check_joints(state, motion)
        session.restore(state)
    except MotionError as error:
        raise SessionError(f"{where}: {error}", error.frames) from error
    return session


def _named(value: dict[str, Any], where: str) -> tuple[str, str, str]:
    """Return the clip's name, its character and its hash."""
    named = value.get("clip")
    if not isinstance(named, dict):
        raise SessionError(f"{where}: clip is {shown(named)}: it must be an object")
    words = [named.get(key) for key in ("name", "character", "sha256")]
    if not all(isinstance(word, str) for word in words):
        raise SessionError(f"{where}: clip must tell its name, character and sha256 as text")
    name, character, digest = map(str, words)
    return name, character, digest


def _check_joints(state: State, motion: Motion) -> None:
    """Refuse settings of joints that the clip's character does not have."""
    for settings in (state.settings, *(edit.settings for edit in state.edits)):
        for joint, _ in settings.rigidity:
            if joint not in motion.joint_names:
                raise SessionError(unknown_name("joint", joint, motion.joint_names))


def _clip(where: str, name: str | Path, character: str) -> Motion:
    try:
        return read_motion(name, None if Path(name).is_dir() else character).motion
    except MotionError as error:
        raise SessionError(f"{where}: its clip cannot be read: {error}") from error


def _beside(path: Path, name: str) -> str:
    """Return a file that a session names: as it is named, or next to the session."""
    if not Path(name).exists() and (path.parent / Path(name).name).exists():
        return str(path.parent / Path(name).name)
    return name


def _read(path: Path) -> dict[str, Any]:
    value = read_json(path, "session", SessionError)
    if not isinstance(value, dict) or value.get("format") != FORMAT:
        raise SessionError(f"'{path}' is no session of mjmotion: 'format' is not '{FORMAT}'")
    if value.get("version") != VERSION:
        raise SessionError(
            f"session '{path}' is of version {str(value.get('version'))[:20]}, and this is"
            f" mjmotion with version {VERSION}: open it with the one that wrote it"
        )
    return value


def _state(value: dict[str, Any], where: str) -> State:
    edits = value.get("edits", [])
    if not isinstance(edits, list):
        raise SessionError(f"{where}: edits must be a list")
    at_most(len(edits), MOST_EDITS, f"edits of {where}", SessionError)
    contacts = value.get("contacts")
    return State(
        edits=tuple(from_json(one, f"{where}, edit {i}") for i, one in enumerate(edits)),
        contacts=None if contacts is None else _contacts(contacts, where),
        scene_moves=_moves(value.get("scene_moves", []), where),
        settings=settings_from_json(value.get("settings", {}), f"{where}, settings"),
    )


def _contacts(value: Any, where: str) -> tuple[Contact, ...]:
    found = []
    for number, row in enumerate(_rows(value, 3, f"{where}: contacts", "site, start and end")):
        site, start, end = row
        what = f"{where}, contact {number}"
        if not isinstance(site, str):
            raise SessionError(f"{what}: site is {shown(site)}: it must be a name")
        span = (whole_number(frame, f"{what}: a frame", SessionError) for frame in (start, end))
        found.append(Contact(site, *span))
    return tuple(found)


def _moves(value: Any, where: str) -> tuple[tuple[str, Vector], ...]:
    found = []
    for name, by in _rows(value, 2, f"{where}: scene_moves", "a name and how far"):
        if not isinstance(name, str):
            raise SessionError(f"{where}: scene_moves has {shown(name)} for a name")
        found.append((name, vector(by, f"{where}: the move of '{name}'")))
    return tuple(found)


def _rows(value: Any, width: int, what: str, of: str) -> list[list[Any]]:
    """Return a list of lists of some width."""
    rows: list[Any] = value if isinstance(value, list) else [None]
    if not all(isinstance(row, list) and len(row) == width for row in rows):
        raise SessionError(f"{what} must be a list of lists, each with {of}")
    return rows
