"""``mjmotion validate``: the figures of a result once more."""

from __future__ import annotations

import argparse
from pathlib import Path

from mjmotion.cli.arguments import add_thresholds

HELP = "measure a result again and rewrite its report"
EXAMPLE = "mjmotion validate out/walk --threshold stance_drift_mm=0.5"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("folder", metavar="DIR", type=Path, help="folder that adapt wrote")
    add_thresholds(parser)


def run(args: argparse.Namespace) -> int:
    """Measure a result again, rewrite its report and print the figures."""
    from mjmotion.apps.rope.result import ORIGINAL_MOTION
    from mjmotion.cli.terminal import Bar, path_lines, say, tell_broken
    from mjmotion.exceptions import MotionError
    from mjmotion.output.reading import read_results
    from mjmotion.output.report import write_report
    from mjmotion.validation import read_thresholds

    thresholds = read_thresholds(args.threshold)
    if (args.folder / ORIGINAL_MOTION).is_file():
        raise MotionError(
            f"'{args.folder}' is a rope climb: its figures are not about ground; make it again with"
            " mjmotion rope to measure it again"
        )
    with Bar() as bar:
        bar("measuring")
        result = read_results(args.folder)
        report = result.report(result.validate(thresholds))
        bar("report")
        write_report(args.folder, report)
    say(report.table(), "")
    broken = tell_broken(report.validation)
    say(*path_lines(args.folder))
    return 1 if broken else 0
