"""``mjmotion transition``: from one clip into another (Figure 5e)."""

from __future__ import annotations

import argparse

from mjmotion.cli.arguments import MOTION_HELP
from mjmotion.cli.join import add_joining, join_clips

HELP = "go over from one clip into another, contacts kept, no foot sliding"
EXAMPLE = "mjmotion transition walk sneak --out out/transition"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("first", metavar="A", help=f"the clip that is left: {MOTION_HELP}")
    parser.add_argument("second", metavar="B", help="the clip that is gone into, likewise")
    parser.add_argument(
        "--overlap",
        type=_overlap,
        metavar="A,B,FRAMES",
        help="where: a frame of A, the frame of B that belongs there, and how many frames it"
        " lasts, at A's rate; the best place without",
    )
    add_joining(parser)


def _overlap(text: str) -> tuple[int, int, int]:
    parts = text.split(",")
    if len(parts) != 3 or not all(part.strip().isdecimal() for part in parts):
        raise argparse.ArgumentTypeError(
            f"'{text}' is not an overlap such as 76,2,21: frame of A, frame of B, frames it lasts"
        )
    first, second, length = (int(part) for part in parts)
    return first, second, length


def run(args: argparse.Namespace) -> int:
    """Go over from one clip into another and write everything into a folder."""
    return join_clips(args, [args.first, args.second], [args.overlap])
