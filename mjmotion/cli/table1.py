"""``mjmotion table1``: the paper's table, measured here, with what §5 and §7 compare."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from mjmotion.cli.arguments import count

if TYPE_CHECKING:
    from mjmotion.paper.table1 import Table1

HELP = "run the paper's four jobs and print its Table 1 next to ours"
EXAMPLE = "mjmotion table1 --repeats 5 --json table1.json"

JOBS = ("terrain", "rope", "morph", "transition")


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the same as data")
    parser.add_argument(
        "--repeats", type=count, default=9, help="times are medians of so many runs: 9"
    )
    parser.add_argument("--jobs", nargs="+", choices=JOBS, default=JOBS, help="which: all four")
    parser.add_argument(
        "--no-ablations",
        action="store_true",
        help="without the comparisons of §7, which take the longest",
    )
    parser.add_argument("--force", action="store_true", help="replace an existing --json")


def run(args: argparse.Namespace) -> int:
    """Run the jobs and print the tables; exit 1 where a figure of the paper is not reached."""
    return 1 if measure(args).missed() else 0


def measure(args: argparse.Namespace) -> Table1:
    """Run the jobs, print the tables and what is not reached, and write the data if asked to."""
    import json

    from mjmotion.cli.terminal import Bar, say, warn
    from mjmotion.output.folder import check_file, write_text
    from mjmotion.paper import table1
    from mjmotion.paper.print_table1 import lines

    if args.json:
        check_file(args.json, args.force)
    names = list(dict.fromkeys(args.jobs))
    with Bar() as bar:
        table = table1.run(names, args.repeats, ablations=not args.no_ablations, progress=bar)
    say(*lines(table))
    if args.json:
        write_text(args.json, json.dumps(table.as_dict(), indent=1, allow_nan=False) + "\n")
        say("", f"data    {args.json}")
    for miss in table.missed():
        warn(f"not reached: {miss}")
    return table
