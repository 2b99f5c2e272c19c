"""How long jobs tell what they are doing: one type for every ``progress`` argument.

def show(stage: str, done: int, of: int) -> None:
    print(stage, f"{done} of {of}" if of else "")

result.save("out/walk", video=True, progress=show)
"""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, int, int], None]
"""Called with (stage, done, of): what is being done, how much of it is, and how much there is.

Once as a stage begins, with ``of`` 0 where the amount is not known, and again as it goes on.
"""


def no_progress(stage: str, done: int, of: int) -> None:
    """Tell nobody: what stands in for a ``progress`` that was not given."""
