"""What MuJoCo and NumPy would write to the terminal or a log file in the current folder, gathered.

with gathered() as notes:
    ...                 # nothing reaches stderr, and there is no MUJOCO_LOG.TXT
notes                   # each warning once
"""

from __future__ import annotations

import contextlib
import os
import sys
import warnings
from collections.abc import Iterator

from mjmotion.boundary.words import one_line

_MOST_KEPT = 1 << 16  # of what C says [bytes]
_OURS = (RuntimeWarning, UserWarning)


@contextlib.contextmanager
def gathered() -> Iterator[list[str]]:
    """Gather warnings of MuJoCo and Python while the block runs; not for several threads at once.

    Returns:
      A list of lines, filled as they come, each once. Those about the code and not about what is
      computed, such as of names that are to go, are left out.
    """
    import mujoco

    notes: list[str] = []

    def note(text: str) -> None:
        if (line := one_line(text)) and line not in notes:
            notes.append(line)

    def show(message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
        if issubclass(category, _OURS):
            note(str(message))

    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda text: note(f"MuJoCo: {_text(text)}"))
    try:
        with warnings.catch_warnings():
            warnings.showwarning = show
            yield notes
    finally:
        mujoco.set_mju_user_warning(before)


@contextlib.contextmanager
def c_errors_kept() -> Iterator[list[str]]:
    """Keep what C writes to stderr, such as Qhull's pages about a mesh that it cannot take.

    For a program, not a library: the process has but one stderr. Python's own ``sys.stderr`` goes
    where it went.

    Returns:
      A list, filled with the lines when the block ends, each once.
    """
    lines: list[str] = []
    try:
        sys.stderr.flush()
        kept = os.dup(2)
    except (OSError, ValueError):  # it is closed
        yield lines
        return
    ours = sys.stderr
    memory = hasattr(os, "memfd_create")
    sink = os.memfd_create("stderr") if memory else os.open(os.devnull, os.O_RDWR)
    if _at(2, ours):
        sys.stderr = os.fdopen(os.dup(kept), "w", 1, ours.encoding, "backslashreplace")
    os.dup2(sink, 2)
    try:
        yield lines
    finally:
        sys.stderr.flush()
        os.dup2(kept, 2)
        sys.stderr = ours
        said = os.pread(sink, _MOST_KEPT, 0) if memory else b""
        os.close(kept)
        os.close(sink)
        texts = said.decode("utf-8", "replace").splitlines()
        lines += dict.fromkeys(line for text in texts if (line := one_line(text)))


def _at(number: int, stream: object) -> bool:
    """Return whether a stream of Python's writes to a file descriptor."""
    try:
        return bool(stream.fileno() == number)  # type: ignore[attr-defined]
    except (AttributeError, OSError, ValueError):
        return False


def _text(said: str | bytes) -> str:
    return said.decode("utf-8", "replace") if isinstance(said, bytes) else said
