"""``mjmotion view``: a result or a motion in the browser, to look at."""

from __future__ import annotations

import argparse
from pathlib import Path

from mjmotion.cli.arguments import add_reading
from mjmotion.cli.given import how_read
from mjmotion.cli.serving import add_serving, serve_page

HELP = "look at a result or a motion in the browser"
EXAMPLE = "mjmotion view out/walk"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument(
        "what",
        metavar="WHAT",
        help="a result folder, or a motion: BVH, AMC, CSV or NPZ file, or a built-in name",
    )
    parser.add_argument("--scene", help="MJCF file or the name of a scene to show a motion in")
    add_reading(parser)
    add_serving(parser)


def run(args: argparse.Namespace) -> int:
    """Serve the page until it is ended."""
    from mjmotion.editor.intents import Intents
    from mjmotion.editor.opening import open_view

    shown = open_view(args.what, args.scene, args.character, **how_read(args))
    return serve_page(args, Intents(None, shown), f"{Path(args.what).stem}-seen")
