"""A clip as the user named it, read as the arguments say, with what is odd about it told."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

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


def read_given(args: argparse.Namespace, what: str, *, folders: bool = True) -> LoadedMotion:
    """Return the motion that a user named, and say what is odd about a recording.

    Args:
      args: has what ``add_reading`` added.
      what: a file, a built-in name or, with ``folders``, a result folder.
      folders: whether that may be a folder.

    Raises:
      MotionError: it cannot be read.
    """
    from mjmotion.cli.terminal import warn
    from mjmotion.clips import builtin_contacts, is_recording, load_clip, map_recording
    from mjmotion.output.reading import LoadedMotion, read_motion

    how, character = how_read(args), args.character or "humanoid"
    if is_recording(what):
        mapped = map_recording(what, character, **how)
        for note in mapped.odd:
            warn(f"note: {note}")
        return LoadedMotion(mapped.motion, None)
    if not folders:
        return LoadedMotion(load_clip(what, character, **how), builtin_contacts(what))
    return read_motion(what, args.character, **how)
