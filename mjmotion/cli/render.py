"""``mjmotion render``: a video of what is there already."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from mjmotion.cli.arguments import size

HELP = "make a video of a result or of a motion file"
EXAMPLE = "mjmotion render out/walk --out walk.mp4"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("path", metavar="DIR|MOTION", type=Path, help="result folder or motion.npz")
    parser.add_argument("--model", type=Path, help="MJCF model of a motion file")
    parser.add_argument("--out", type=Path, help="video to write: DIR/video.mp4")
    parser.add_argument("--force", action="store_true", help="replace an existing video")
    parser.add_argument(
        "--layout",
        choices=("side-by-side", "ghost", "single"),
        default="side-by-side",
        help="how source and adapted motion are shown",
    )
    parser.add_argument("--size", type=size, default=(1280, 720), help="pixels: 1280x720")


def run(args: argparse.Namespace) -> int:
    """Make a video of a result folder, or of a motion file on a model."""
    from mjmotion.body.motion import Motion
    from mjmotion.cli.terminal import Bar, say
    from mjmotion.exceptions import MotionError
    from mjmotion.output.folder import VIDEO, check_file
    from mjmotion.output.reading import load_model, read_results
    from mjmotion.output.video import render_video

    width, height = args.size
    options: dict[str, Any] = {"layout": args.layout, "width": width, "height": height}
    folder = args.path.is_dir()
    if not args.path.exists():
        raise MotionError(f"'{args.path}' does not exist: give a result folder or a motion file")
    if not folder and args.model is None:
        raise MotionError(f"'{args.path}' is not a result folder: a motion file needs --model")
    out = args.out or (args.path / VIDEO if folder else args.path.with_suffix(".mp4"))
    check_file(out, args.force)
    with Bar() as bar:
        bar("reading")
        if folder:
            result = read_results(args.path)
            path = result.render(out, force=args.force, progress=bar, **options)
        else:
            motion = Motion.load(args.path, load_model(args.model))
            path = render_video(out, motion, progress=bar, **options)
    say(f"video   {path}")
    return 0
