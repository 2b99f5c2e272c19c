"""What MuJoCo and NumPy would write to the terminal or a log file in the current folder, gathered.

with gathered() as notes:
    ...                 # nothing reaches stderr, and there is no MUJOCO_LOG.TXT
notes                   # each warning once
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator

from mjmotion.boundary.words import one_line

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


def _text(said: str | bytes) -> str:
    return said.decode("utf-8", "replace") if isinstance(said, bytes) else said
