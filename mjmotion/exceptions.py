"""Errors: one line that says what is wrong, where, and what to do about it.

Everything mjmotion raises on purpose is a :class:`MotionError`; the command line turns it into one
line and exit code 2. Errors about frames carry them in ``frames``, so a caller can act on them.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable

_MOST_LETTERS, _LAST = 1500, 300  # of a message, and of its end where it is cut


class MotionError(Exception):
    """Base of every error mjmotion raises on purpose.

    Args:
      message: one line: what, where, what to do.
      frames: the frames that failed, if the error is about frames.
    """

    def __init__(self, message: str, frames: Iterable[int] = ()) -> None:
        if len(message) > _MOST_LETTERS:  # a name in a file may be of any length
            message = f"{message[: _MOST_LETTERS - _LAST]} … {message[-_LAST:]}"
        super().__init__(message)
        self.frames: tuple[int, ...] = tuple(int(frame) for frame in frames)


class ClipError(MotionError):
    """A clip cannot be read, is damaged, or does not fit the character."""


class ModelError(MotionError):
    """A model lacks what the work needs: a free root, a site, a joint of a kind."""


class SceneError(MotionError):
    """A scene does not compile, has no ground under the walk, or cannot be passed."""


class ContactError(MotionError):
    """A contact names an unknown site or frames that the motion does not have."""


class ConstraintError(MotionError):
    """A constraint is malformed or names what does not exist."""


class FitError(MotionError):
    """A fit was asked for with settings that make no sense."""


class SessionError(MotionError):
    """A session of the editor is damaged, of another clip or version, or asks for nonsense."""


class EditorError(MotionError):
    """The editor's page cannot be served: no Studio, a port in use, an address that is not here."""


class BatchError(MotionError):
    """A batch cannot begin or go on: no clips, two jobs of one name, no scheduler."""


class OutputError(MotionError):
    """A result cannot be written, or would overwrite an earlier one."""


class RenderError(MotionError):
    """Offscreen rendering is not possible on this machine."""


_LONG = 100  # letters of a name that a message shows; a file may hold one of millions


def unknown_name(kind: str, name: str, valid: Iterable[str]) -> str:
    """Return the message for a name that does not exist: what was meant, and the valid names."""
    names = sorted(valid)
    if len(name) > _LONG:
        name = name[:_LONG] + "…"
    close = difflib.get_close_matches(name, names, n=1)
    hint = f" Did you mean '{close[0]}'?" if close else ""
    return f"unknown {kind} '{name}'.{hint} Valid names: {', '.join(names) or '(none)'}"


def wrong_type(what: str, value: object, wanted: str) -> str:
    """Return the message for an argument of another type: what it is, and what to give."""
    kind = value.__name__ if isinstance(value, type) else type(value).__name__
    hint = ", or its .motion" if hasattr(value, "motion") else ""
    return f"{what} is of type {kind}: give {wanted}{hint}"


def frame_list(frames: Iterable[int], limit: int = 5) -> str:
    """Return frames as short text: ``3, 4, 5, 6, 7, … (12 frames)``."""
    numbers = [int(frame) for frame in frames]
    shown = ", ".join(str(number) for number in numbers[:limit])
    return shown if len(numbers) <= limit else f"{shown}, … ({len(numbers)} frames)"


def mujoco_message(error: BaseException) -> str:
    """Return MuJoCo's message as one line: what went wrong and, if it says so, in which element."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    if not lines:
        return type(error).__name__
    text = lines[0].removeprefix("Error: ").removeprefix("XML Error: ")
    if text.startswith("XML parse error"):
        return "it is not well-formed XML" + _line_of(lines)
    element = next((line for line in lines[1:] if line.startswith("Element")), "")
    return f"{text} ({element})" if element else text


def _line_of(lines: list[str]) -> str:
    """Return `` (line n)`` where TinyXML's message tells the line."""
    text = " ".join(lines)
    mark = "Line number="
    if mark not in text:
        return ""
    number = text.split(mark, 1)[1].split(":", 1)[0].split()[0]
    return f" (line {number})"
