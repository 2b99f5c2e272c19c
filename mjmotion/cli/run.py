"""How a command ends that changes a motion: measured, written into its folder, told.

thresholds = prepare(args)                   # what can be wrong without any work comes first
with Bar() as bar, result_folder(args.out, args.force) as folder:
    ...
    validation = write(folder, adaptation, thresholds, args, bar, title=title)
return tell(args, adaptation, validation, title=title)
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
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
    from mjmotion.constraints import Constraint
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
    from mjmotion.output.results import check_output
    from mjmotion.validation import read_thresholds

    check_output(args.out, args.force)
    thresholds = read_thresholds(args.threshold)
    if not args.no_video and (problem := no_rendering()):
        raise RenderError(f"{problem}; or give --no-video")
    return thresholds


def write(
    folder: Path,
    adaptation: Result,
    thresholds: Mapping[str, Threshold],
    args: argparse.Namespace,
    bar: Bar,
    *,
    title: str,
    constraints: Sequence[Constraint] = (),
) -> Validation:
    """Measure an adaptation and write everything of it into a folder that is there.

    Args:
      folder: where to write: what ``result_folder`` gave.
      adaptation: source and motion.
      thresholds: what :func:`prepare` returned.
      args: has ``no_video``.
      bar: shows the stages.
      title: what the report is called.
      constraints: the user's own.

    Returns:
      The figures.
    """
    from mjmotion.output.results import write_results
    from mjmotion.validation import validate

    bar.stage("measuring")
    validation = validate(
        *(adaptation.source, adaptation.motion, adaptation.contacts),
        thresholds=thresholds,
        body=adaptation.body,
    )
    bar.stage("report and video")
    write_results(
        *(folder, adaptation, validation),
        constraints=constraints,
        video=not args.no_video,
        title=title,
        progress=bar,
    )
    return validation


def tell(
    args: argparse.Namespace,
    adaptation: Result,
    validation: Validation,
    *,
    title: str,
    constraints: Sequence[Constraint] = (),
) -> int:
    """Say what came of it: levels, figures, what is not met, and where the files are.

    Returns:
      The exit code: 1 where a threshold is broken or a constraint of the user's own is not met.
    """
    from mjmotion.output.report import table

    motion = adaptation.motion
    say(f"{title}: {motion.nframe} frames at {motion.fps:g} fps", "")
    say(*level_lines(adaptation.trace), "", table(validation), "")
    for one in adaptation.unmet:
        # What the scene asked has its own figures and thresholds; it is told, and no more.
        warn(
            f"your constraint is not met: {one}"
            if one.source == "user"
            else f"note: not met: {one}"
        )
    broken = tell_broken(validation)
    say(*path_lines(args.out))
    return 1 if broken or any(one.source == "user" for one in adaptation.unmet) else 0
