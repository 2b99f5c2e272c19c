"""Where the project's own models, scenes and sessions are, in a checkout and in a wheel."""

from __future__ import annotations

from pathlib import Path

from mjmotion.boundary.files import check_plain
from mjmotion.exceptions import ModelError, SceneError, SessionError, unknown_name, wrong_type

_FOLDERS = {
    "model": Path("models") / "mjcf",
    "scene": Path("scenes"),
    "session": Path("sessions"),
}
_SUFFIX = {"model": ".xml", "scene": ".xml", "session": ".mjsession"}
_WHAT = {"model": "an MJCF file", "scene": "an MJCF file", "session": "a session's file"}
_ERRORS = {"model": ModelError, "scene": SceneError, "session": SessionError}


def asset_folder(kind: str) -> Path:
    """Return the folder of the project's own ``"model"``, ``"scene"`` or ``"session"`` files.

    A wheel carries the folders inside the package; in a checkout they stand beside it.
    """
    package = Path(__file__).resolve().parents[1]
    for base in (package, package.parent):
        folder = base / _FOLDERS[kind]
        if folder.is_dir():
            return folder
    raise _ERRORS[kind](f"this installation lacks its {_FOLDERS[kind]} folder: reinstall mjmotion")


def asset_names(kind: str) -> list[str]:
    """Return the names of the project's own files of a kind, without their suffix."""
    return sorted(path.stem for path in asset_folder(kind).glob(f"*{_SUFFIX[kind]}"))


def find_asset(kind: str, name: str | Path) -> Path:
    """Return the file that ``name`` means: an existing file, or the name of one of ours.

    Args:
      kind: ``"model"``, ``"scene"`` or ``"session"``.
      name: a path, or a name out of :func:`asset_names`.

    Raises:
      ModelError, SceneError, SessionError: there is no such file and no such name.
    """
    if not isinstance(name, (str, Path)):
        raise _ERRORS[kind](wrong_type(kind, name, f"{_WHAT[kind]}, a built-in name or an MjSpec"))
    path = Path(name)
    if path.is_dir() and path.suffix == "" and path != Path(path.name):
        raise _ERRORS[kind](f"{kind} file '{path}' is a folder: give {_WHAT[kind]} of it")
    if path.is_file():
        return path
    if path.suffix == "" and path.parent == Path():
        ours = asset_folder(kind) / f"{name}{_SUFFIX[kind]}"
        if ours.is_file():
            return ours
        if path.is_dir():
            raise _ERRORS[kind](f"{kind} file '{path}' is a folder: give {_WHAT[kind]} of it")
        raise _ERRORS[kind](unknown_name(kind, str(name), asset_names(kind)))
    check_plain(path, f"{kind} file", _ERRORS[kind])
    return path
