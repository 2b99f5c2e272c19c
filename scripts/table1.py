"""The paper's Table 1 measured here, as ``mjmotion table1``, and its table on docs/results.md.

python scripts/table1.py --no-ablations --write
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import results_page

from mjmotion.cli import table1
from mjmotion.exceptions import MotionError
from mjmotion.paper.print_table1 import markdown
from mjmotion.paper.timing import machine


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    table1.arguments(parser)
    parser.add_argument("--write", action="store_true", help="write the table to docs/results.md")
    args = parser.parse_args(argv)
    if args.write and set(args.jobs) != set(table1.JOBS):
        parser.error("--write replaces the whole table: it needs all four jobs")
    try:
        table = table1.measure(args)
        if args.write:
            results_page.write("table1", markdown(table), machine(), ("mujoco", "numpy"))
    except MotionError as error:
        print(f"table1: error: {error}", file=sys.stderr)
        return 2
    return 1 if table.missed() else 0


if __name__ == "__main__":
    sys.exit(main())
