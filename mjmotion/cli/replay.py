"""``mjmotion replay``: the motion of a saved editing session, without the editor."""

from __future__ import annotations

import argparse
from pathlib import Path

from mjmotion.cli.arguments import add_folder, add_thresholds

HELP = "make the motion of a saved editing session again, bit for bit"
EXAMPLE = "mjmotion replay lift.mjsession --out out/lift"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument(
        "session", metavar="SESSION", type=Path, help="what the editor saved (.mjsession)"
    )
    parser.add_argument("--clip", help="the clip, where it is not any more where it was")
    add_folder(parser)
    add_thresholds(parser)


def run(args: argparse.Namespace) -> int:
    """Make a session's edits, validate the result and write everything into a folder."""
    from mjmotion.apps.session import load_session
    from mjmotion.cli.run import prepare, tell, write
    from mjmotion.cli.terminal import Bar
    from mjmotion.output.folder import result_folder

    thresholds = prepare(args)
    with Bar() as bar, result_folder(args.out, args.force) as folder:
        bar("making the edits")
        result = load_session(args.session, args.clip).result()
        validation = write(folder, result, thresholds, args, bar, title=result.title)
    return tell(args, result, validation, title=result.title)
