"""What the commands say: results on stdout, progress and warnings on stderr."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjmotion.boundary.words import harmless, one_line

if TYPE_CHECKING:
    from mjmotion.fitting import Trace
    from mjmotion.validation import Validation


def say(*lines: str) -> None:
    """Write lines to stdout."""
    for line in lines:
        sys.stdout.write(harmless(line, keep="\n") + "\n")


def warn(line: str) -> None:
    """Write one line to stderr."""
    sys.stderr.write(f"mjmotion: {one_line(line)}\n")


class Bar:
    """What is being done, and how far it is, on stderr; nothing where that is no terminal.

    A :data:`mjmotion.numerics.progress.Progress`, to be given to whatever takes one.

    Args:
      rate: whether it says how many of what it counts are done in a second.
    """

    def __init__(self, rate: bool = False) -> None:
        from tqdm import tqdm

        self._counted = _COUNTED.replace("]", ", {rate_fmt}]") if rate else _COUNTED

        self._make = partial(tqdm, leave=False, disable=None, file=sys.stderr)
        self._bar: Any = None
        self._shown: tuple[str, int] | None = None

    def __call__(self, stage: str, done: int = 0, of: int = 0) -> None:
        """Show what is being done and, where ``of`` is above 0, how much of it is."""
        if self._shown != (stage, of):
            self.__exit__()
            self._shown = (stage, of)
            self._bar = (
                self._make(desc=stage, total=of, bar_format=self._counted, unit=f" {stage}")
                if of
                else self._make(desc=f"{stage} …", total=1, bar_format="{desc}")
            )
        if of:
            self._bar.update(done - self._bar.n)

    def __enter__(self) -> Bar:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()


_COUNTED = "{desc}: {percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} [{elapsed}<{remaining}]"


def no_rendering() -> str:
    """Return why there can be no picture on this machine; "" if there can."""
    from mjmotion.exceptions import RenderError
    from mjmotion.output.video import ensure_gl

    try:
        ensure_gl()
    except RenderError as error:
        return str(error)
    return ""


def level_lines(trace: Trace) -> list[str]:
    """Return the table of the fit: the paper's error after every level."""
    lines = ["level   frames a knot   time [ms]   greatest error [% of height]"]
    for level in trace.levels:
        lines.append(
            f"{level.level:5d}   {level.frames_per_knot:13g}   {1000 * level.seconds:9.1f}"
            f"   {level.max_error_percent:.4f}"
        )
    took = f"{1000 * trace.fit_seconds:9.1f}"
    return [
        *lines,
        f"exact   {'':13}   {took}   {trace.exact_error_percent:.4f}   (time of the whole fit)",
    ]


def tell_broken(validation: Validation) -> bool:
    """Warn of broken thresholds, with the worst frame and body; return whether there are any."""
    rows = [row for row in validation.summary() if row.ok is False]
    for row in rows:
        warn(
            f"threshold broken: {row.figure} is {row.value:.4g}, wanted {row.threshold}"
            + (f" ({row.where})" if row.where else "")
        )
    return bool(rows)


def path_lines(folder: Path) -> list[str]:
    """Return the paths that a person wants to open next."""
    from mjmotion.output.folder import PAGE, VIDEO

    names = [("report", PAGE), ("video", VIDEO)]
    return [f"{what:7} {folder / name}" for what, name in names if (folder / name).is_file()]
