"""What a command has written so far, seen in the files themselves: for the line after Ctrl-C."""

from __future__ import annotations

import argparse
from pathlib import Path

_IN_FOLDERS = ("report.json", "report.html", "video.mp4")


class Written:
    """The places that a command may write to, as they were before it began.

    Args:
      args: of the command.
    """

    def __init__(self, args: argparse.Namespace) -> None:
        places: list[Path] = []
        for name in ("out", "folder", "path", "json"):
            given = getattr(args, name, None)
            if isinstance(given, Path):
                # The folder itself is another one when a result is put in its place.
                places += [
                    given,
                    *(given / file for file in _IN_FOLDERS),
                    *([given.with_suffix(".mp4")] if given.name else []),
                ]
        self._before = {place: _state(place) for place in dict.fromkeys(places)}

    def said(self) -> str:
        """Return in words what is there now that was not there before."""
        new = [path for path, before in self._before.items() if _state(path) not in (before, None)]
        inside = [path for path in new if path.parent not in new]
        if not inside:
            return "nothing was written"
        return f"written, each of them whole: {', '.join(map(str, inside))}"


def _state(path: Path) -> tuple[int, ...] | None:
    """Return what tells a file from another in its place; of a folder, only which one it is."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    which = (status.st_dev, status.st_ino)
    return which if path.is_dir() else (*which, status.st_mtime_ns, status.st_size)
