"""A clip as the user named it, read as the arguments say, with what is odd about it told."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from mjmotion.output.reading import LoadedMotion

READING: dict[str, Any] = {
    "mapping": None,
    "fps": None,
    "asf": None,
    "in_place": None,
    "loop": 1,
    "floor": "auto",
}
"""What :func:`mjmotion.cli.arguments.add_reading` adds beside ``--character``, where not given."""


def how_read(args: argparse.Namespace) -> dict[str, Any]:
    """Return how a clip is to be read, as keywords of ``load_clip``."""
    return {name: getattr(args, name) for name in READING}


class Noted(NamedTuple):
    """A motion that a user named, with what is odd about it.

    Attributes:
      given: the motion and its contacts, as far as they are known.
      odd: notes on a recording, a line each.
    """

    given: LoadedMotion
    odd: tuple[str, ...]


def read_noted(args: argparse.Namespace, what: str, *, folders: bool = True) -> Noted:
    """Return the motion that a user named, and what is odd about it.

    Args:
      args: has what ``add_reading`` added.
      what: a file, a built-in name or, with ``folders``, a result folder.
      folders: whether that may be a folder.

    Raises:
      MotionError: it cannot be read.
    """
    from mjmotion.clips import builtin_contacts, is_recording, load_clip, map_recording
    from mjmotion.output.reading import LoadedMotion, read_motion

    how, character = how_read(args), args.character or "humanoid"
    if is_recording(what):
        mapped = map_recording(what, character, **how)
        return Noted(LoadedMotion(mapped.motion, None), mapped.odd)
    if not folders:
        return Noted(LoadedMotion(load_clip(what, character, **how), builtin_contacts(what)), ())
    return Noted(read_motion(what, args.character, **how), ())


def read_given(args: argparse.Namespace, what: str) -> LoadedMotion:
    """Return the motion that a user named, and say what is odd about a recording.

    Raises:
      MotionError: it cannot be read.
    """
    from mjmotion.cli.terminal import warn

    given, odd = read_noted(args, what)
    for note in odd:
        warn(f"note: {note}")
    return given


@contextlib.contextmanager
def telling(odd: Sequence[str]) -> Iterator[None]:
    """Say what is odd about a recording; where that is why nothing came of it, as the error.

    Raises:
      ContactError: no foot stands because the recording is walked in place.
    """
    from mjmotion.cli.terminal import warn
    from mjmotion.exceptions import ContactError

    try:
        yield
    except ContactError as error:
        why = [note for note in odd if "--in-place" in note]
        raise (ContactError(why[0]) if why else error) from error
    for note in odd:
        warn(f"note: {note}")
