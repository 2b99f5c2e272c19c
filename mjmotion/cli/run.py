"""How a command ends that changes a motion: measured, written into its folder, told.

thresholds = prepare(args)                   # what can be wrong without any work comes first
with Bar() as bar, result_folder(args.out, args.force) as folder:
    ...
    validation = write(folder, result, thresholds, args, bar, title=title)
return tell(args, result, validation, title=title)
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from mjmotion.cli.terminal import (
    Bar,
    level_lines,
    no_rendering,
    path_lines,
    say,
    tell_broken,
    warn,
)

if TYPE_CHECKING:
    from mjmotion.output.result import Result
    from mjmotion.validation import Validation
    from mjmotion.validation.thresholds import Threshold


def prepare(args: argparse.Namespace) -> dict[str, Threshold]:
    """Check ``--out``, ``--threshold`` and whether a video can be made, before any work.

    Raises:
      OutputError: ``--out`` cannot be written, or holds something already.
      MotionError: a threshold that does not exist.
      RenderError: a video is wanted and there is no offscreen OpenGL.
    """
    from mjmotion.exceptions import RenderError
    from mjmotion.output.folder import check_output
    from mjmotion.validation import read_thresholds

    check_output(args.out, args.force)
    thresholds = read_thresholds(args.threshold)
    if not args.no_video and (problem := no_rendering()):
        raise RenderError(f"{problem}; or give --no-video")
    return thresholds


def write(
    folder: Path,
    result: Result,
    thresholds: Mapping[str, Threshold],
    args: argparse.Namespace,
    bar: Bar,
    *,
    title: str,
) -> Validation:
    """Measure a result and write everything of it into a folder that is there.

    Args:
      folder: where to write: what ``result_folder`` gave.
      result: what an application returned.
      thresholds: what :func:`prepare` returned.
      args: has ``no_video``.
      bar: shows the stages.
      title: what the report is called.

    Returns:
      The figures.
    """
    from mjmotion.output.result import measure_and_write

    return measure_and_write(
        folder, result, thresholds, video=not args.no_video, title=title, progress=bar
    )


def tell(
    args: argparse.Namespace,
    result: Result,
    validation: Validation,
    *,
    title: str,
) -> int:
    """Say what came of it: levels, figures, what is not met, and where the files are.

    Returns:
      The exit code: 1 where a threshold is broken, a way barred, or a constraint of the user's own
      not met.
    """
    motion = result.motion
    say(f"{title}: {motion.nframe} frames at {motion.fps:g} fps", "")
    if result.trace is not None:
        say(*level_lines(result.trace), "")
    say(validation.table(), "")
    for one in result.unmet:
        # What the scene asked has its own figures and thresholds; it is told, and no more.
        mine = one.source == "user"
        warn(f"your constraint is not met: {one}" if mine else f"note: not met: {one}")
    if result.barred:
        warn(result.barred)
    for note in result.notes:
        warn(f"note: {note}")
    broken = tell_broken(validation)
    say(*path_lines(args.out))
    unmet = result.barred or any(one.source == "user" for one in result.unmet)
    return 1 if broken or unmet else 0
