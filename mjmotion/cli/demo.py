"""``mjmotion demo``: the main job, with nothing to choose."""

from __future__ import annotations

import argparse

from mjmotion.cli import adapt
from mjmotion.cli.arguments import add_folder

HELP = "adapt the built-in walk to rough terrain with doorways"
EXAMPLE = "mjmotion demo --out out/demo"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_folder(parser, default="out/demo")
    parser.set_defaults(clip="walk", scene="terrain_doors", **adapt.DEFAULTS)


def run(args: argparse.Namespace) -> int:
    """Run the main job: the built-in walk over rough terrain with doorways."""
    from mjmotion.cli.terminal import no_rendering, warn

    if not args.no_video and (problem := no_rendering()):
        # The report is worth having without a video.
        warn(f"warning: there will be no video: {problem}")
        args = argparse.Namespace(**{**vars(args), "no_video": True})
    return adapt.run(args)
