"""``mjmotion join``: clips, one after the other, in one motion."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from mjmotion.cli.arguments import (
    MOTION_HELP,
    add_fitting,
    add_folder,
    add_reading,
    add_thresholds,
    count,
)

if TYPE_CHECKING:
    from mjmotion.apps.transition import Joined, Place

HELP = "join clips by transitions, contacts kept, no foot sliding"
EXAMPLE = "mjmotion join walk sneak walk --out out/sneak"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("clips", metavar="CLIP", nargs="+", help=f"two or more: {MOTION_HELP}")
    add_joining(parser)


def add_joining(parser: argparse.ArgumentParser) -> None:
    """Add what tells how clips are joined, and where the result goes."""
    parser.add_argument(
        "--length",
        type=count,
        metavar="FRAMES",
        help="how long a transition lasts whose place is found; 0.7 s without",
    )
    add_fitting(parser)
    add_folder(parser)
    add_reading(parser)
    add_thresholds(parser)


def run(args: argparse.Namespace) -> int:
    """Join clips, validate the result and write everything into a folder."""
    return join_clips(args, args.clips, None)


def join_clips(
    args: argparse.Namespace, names: Sequence[str], places: Sequence[Place | None] | None
) -> int:
    """Join the clips of those names and write everything into a folder.

    Args:
      args: what :func:`add_joining` added.
      names: clips as the user named them.
      places: where each goes over into the next; None to find that.

    Returns:
      The exit code.
    """
    from mjmotion.apps.clearing import FitSettings
    from mjmotion.apps.transition import blend_clips, keep_contacts
    from mjmotion.cli.given import read_given
    from mjmotion.cli.run import prepare, tell, write
    from mjmotion.cli.terminal import Bar, say, warn
    from mjmotion.output.folder import result_folder
    from mjmotion.validation.figures import joint_jerk_ratio
    from mjmotion.validation.text import number

    thresholds = prepare(args)
    with Bar() as bar, result_folder(args.out, args.force) as folder:
        bar("reading clips")
        given = [read_given(args, name) for name in names]
        clips = [one.motion for one in given]
        bar("overlaps and blends")
        joined = blend_clips(
            clips, overlaps=places, contacts=[one.contacts for one in given], length=args.length
        )
        settings = FitSettings(args.levels, args.tolerance, args.ik, bar)
        result = keep_contacts(joined, settings)
        title = " to ".join(Path(name).stem for name in names)
        validation = write(folder, result, thresholds, args, bar, title=title)
    for name, clip in zip(names, clips, strict=True):
        if clip.fps != joined.motion.fps:
            warn(
                f"note: {name} was resampled from {clip.fps:g} to {joined.motion.fps:g} frames a"
                " second, the rate of the first clip"
            )
    largest = joint_jerk_ratio(result.motion, joined.clips)
    say(
        *_place_lines(names, joined),
        f"joint jerk over that of the clip with most: {number(largest)}",
    )
    say("")
    return tell(args, result, validation, title=title)


def _place_lines(names: Sequence[str], joined: Joined) -> list[str]:
    """Say where each clip goes over into the next: to be given again, or changed."""
    lines = []
    for number, place in enumerate(joined.places):
        start, end = joined.overlaps[number]
        one, other = (Path(name).stem for name in names[number : number + 2])
        lines.append(
            f"{one}, frame {place.first}, to {other}, frame {place.second}, over {place.length}"
            f" frames: {start} to {end} of the result"
        )
    return lines
