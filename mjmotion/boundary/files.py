"""Files as bytes: plain ones of a bounded size, so that no pipe hangs and no device floods.

A pipe without a writer waits for ever, ``/dev/zero`` never ends, and neither tells a size.
"""

from __future__ import annotations

import stat
from pathlib import Path

from mjmotion.boundary.words import first_line
from mjmotion.exceptions import MotionError


def check_plain(path: str | Path, what: str, error: type[MotionError] = MotionError) -> int:
    """Return the size of a plain file [bytes].

    Args:
      path: the file.
      what: what it is called in messages, such as ``"contacts file"``.
      error: what is raised.

    Raises:
      MotionError: as ``error``: it is not there, cannot be looked at, or is a folder, a pipe or a
        device.
    """
    try:
        status = Path(path).stat()
    except (FileNotFoundError, NotADirectoryError):
        raise error(f"{what} '{path}' does not exist: check the path") from None
    except (OSError, ValueError) as fault:
        raise error(f"{what} '{path}' cannot be read: {_why(fault)}") from None
    if stat.S_ISDIR(status.st_mode):
        raise error(f"{what} '{path}' is a folder: give a file")
    if not stat.S_ISREG(status.st_mode):
        raise error(f"{what} '{path}' is a pipe or a device: save it as a file first")
    return status.st_size


def file_bytes(
    path: str | Path, what: str, most: int, error: type[MotionError] = MotionError
) -> bytes:
    """Return what is in a plain file; arguments as of :func:`check_plain`.

    Args:
      path: the file.
      what: what it is called in messages.
      most: how large it may be [bytes].
      error: what is raised.

    Raises:
      MotionError: as ``error``: it is not there, no plain file, larger, or cannot be read.
    """
    size = check_plain(path, what, error)
    if size <= most:
        try:
            with Path(path).open("rb") as file:
                data = file.read(most + 1)  # what the system makes up, as in /proc, tells no size
        except OSError as fault:
            raise error(f"{what} '{path}' cannot be read: {_why(fault)}") from None
        if len(data) <= most:
            return data
        size = len(data)
    raise error(f"{what} '{path}' has {size:,} bytes or more: at most {most:,} can be read")


def _why(fault: OSError | ValueError) -> str:
    return getattr(fault, "strerror", None) or first_line(fault)
