"""``mjmotion info``: what is in a file, a name or a folder."""

from __future__ import annotations

import argparse

HELP = "say what is in a clip, scene, model or result folder"
EXAMPLE = "mjmotion info out/walk"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("what", metavar="FILE|NAME|DIR", help="what to describe")


def run(args: argparse.Namespace) -> int:
    """Print what is in a clip, scene, model or result folder."""
    from mjmotion.cli.describe import describe
    from mjmotion.cli.terminal import say

    say(*describe(args.what))
    return 0
