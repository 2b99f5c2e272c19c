"""``mjmotion info``: what is in a file, a name or a folder."""

from __future__ import annotations

import argparse
from pathlib import Path

from mjmotion.cli.arguments import add_recording
from mjmotion.cli.given import READING, how_read

HELP = "say what is in a clip, scene, model or result folder"
EXAMPLE = "mjmotion info out/walk"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("what", metavar="FILE|NAME|DIR", help="what to describe")
    add_recording(parser)
    parser.add_argument(
        "--write-mapping",
        type=Path,
        metavar="FILE",
        help="of a recording: write which joint was taken for which, as a mapping to fill in",
    )


def run(args: argparse.Namespace) -> int:
    """Print what is in a clip, scene, model or result folder."""
    from mjmotion.cli.describe import describe
    from mjmotion.cli.describe_rig import describe_recording
    from mjmotion.cli.terminal import say
    from mjmotion.clips import is_recording, read_clip
    from mjmotion.exceptions import MotionError

    if is_recording(args.what):
        clip = read_clip(args.what, fps=args.fps, asf=args.asf)
        say(*describe_recording(clip, args.what, how_read(args), args.write_mapping))
        return 0
    if how_read(args) != READING or args.write_mapping:
        raise MotionError(
            f"'{args.what}' is no recording: leave --mapping, --fps, --asf, --in-place, --loop,"
            " --floor and --write-mapping"
        )
    say(*describe(args.what))
    return 0
