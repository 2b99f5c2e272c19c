"""The paper's Table 1 measured here, as `mjmotion table1`, and the README's table made from it.

python scripts/table1.py --repeats 9 --json table1.json
python scripts/table1.py --readme table1.json          # rewrites the table of README.md
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from mjmotion.cli import table1
from mjmotion.exceptions import MotionError, OutputError
from mjmotion.paper.print_table1 import markdown, put_between
from mjmotion.paper.table1 import Table1

README = Path(__file__).parents[1] / "README.md"


def rewrite(page: Path, results: Path) -> None:
    """Replace what stands between the page's markers by the table of what ``--json`` wrote."""
    try:
        content = markdown(Table1.from_dict(json.loads(results.read_text("utf-8"))))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise OutputError(f"'{results}' is not what --json writes: {error}") from error
    page.write_text(put_between(page.read_text("utf-8"), content), "utf-8")


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    table1.arguments(parser)
    parser.add_argument(
        "--readme", type=Path, metavar="FILE.json", help="only rewrite README.md's table"
    )
    args = parser.parse_args(argv)
    try:
        if args.readme is None:
            return table1.run(args)
        rewrite(README, args.readme)
    except MotionError as error:
        print(f"table1: error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
