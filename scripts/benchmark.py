"""The project's figures beside their targets; exits 1 where one is missed.

python scripts/benchmark.py --json figures.json
python scripts/benchmark.py --only quality --clips walk 02_01 --scenes stairs
python scripts/benchmark.py --readme figures.json     # rewrites the table of README.md

The comparison with mink needs the extra: pip install 'mjmotion[benchmark]'.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks import levels, paper, quality, readme, spacetime, speed, startup
from benchmarks.figures import Figure, machine
from benchmarks.job import make_job

from mjmotion.exceptions import MotionError

README = Path(__file__).parents[1] / "README.md"
PARTS = ("quality", "levels", "speed", "paper", "spacetime", "cli")


def say(line: str) -> None:
    print(line, flush=True)


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the same as data")
    parser.add_argument("--only", choices=PARTS, help="one part")
    parser.add_argument(
        "--clips", nargs="+", default=quality.WALKS, help="for quality: names or files"
    )
    parser.add_argument(
        "--scenes", nargs="+", default=quality.SCENES, help="for quality: names or files"
    )
    parser.add_argument(
        "--readme", type=Path, metavar="FILE.json", help="only rewrite README.md's table"
    )
    return parser.parse_args(argv)


def measure(args: argparse.Namespace) -> dict[str, Any]:
    """Run the parts that are asked for and return everything as data."""
    wanted = PARTS if args.only is None else (args.only,)
    facts, figures = machine(), []
    data: dict[str, Any] = {"machine": facts}
    for name, fact in facts.items():
        say(f"{name:10} {fact}")
    if "quality" in wanted:
        say("\nquality")
        pairs, skipped = quality.run(args.clips, args.scenes, say)
        found = quality.summary(pairs) if pairs else []
        say("\nquality, the worst of all")
        for figure in found:
            say(figure.line())
        figures += found
        data |= {"pairs": [pair.as_dict() for pair in pairs], "skipped": skipped}
    if "levels" in wanted or "speed" in wanted:
        job = make_job()
        if "levels" in wanted:
            say("\nlevels of the terrain job: largest error [% of height]")
            figures += levels.run(job, say)
        if "speed" in wanted:
            say("\nspeed")
            figures += speed.run(job, say)
    if "paper" in wanted:
        say("\nthe paper's other results: Table 1, rope, retargeting, joining")
        figures += paper.run(say)
    if "spacetime" in wanted:
        say(
            "\none large optimisation against many small: the terrain job, footholds fixed and free"
        )
        figures += spacetime.run(spacetime.make_jobs(), say)
    if "cli" in wanted:
        say("\nstart")
        figures += startup.run(say)
    tell_missed(figures)
    return {**data, "figures": [figure.as_dict() for figure in figures]}


def tell_missed(figures: Sequence[Figure]) -> None:
    missed = [figure for figure in figures if figure.ok is False]
    aimed = [figure for figure in figures if figure.target and figure.ok is not None]
    say(f"\n{len(aimed) - len(missed)} of {len(aimed)} targets reached")
    for figure in missed:
        say(f"MISSED {figure.group}: {figure.name}: {figure.measured}, wanted {figure.target}")


def main(argv: Sequence[str] | None = None) -> int:
    args = parse(argv)
    try:
        if args.readme is not None:
            readme.rewrite(README, args.readme)
            return 0
        data = measure(args)
    except (MotionError, readme.ReadmeError) as error:
        print(f"benchmark: error: {error}", file=sys.stderr)
        return 2
    if args.json is not None:
        args.json.write_text(json.dumps(data, indent=1, allow_nan=False) + "\n", "utf-8")
    return 1 if any(figure["ok"] is False for figure in data["figures"]) else 0


if __name__ == "__main__":
    sys.exit(main())
