"""The project's figures beside their targets; exits 1 where one is missed.

python scripts/benchmark.py --write                   # and the table of docs/results.md
python scripts/benchmark.py --json figures.json       # and everything as data
python scripts/benchmark.py --only quality --clips walk 02_01 --scenes stairs

The comparison with mink needs the extra: pip install 'mjmotion[benchmark]'.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import results_page
from benchmarks import (
    batch,
    editing,
    footing,
    levels,
    paper,
    planning,
    quality,
    rough,
    spacetime,
    speed,
    startup,
    ways,
)
from benchmarks.figures import markdown, print_figures

from mjmotion.exceptions import MotionError
from mjmotion.paper.figures import Figure
from mjmotion.paper.terrain import make_job
from mjmotion.paper.timing import machine

PARTS = (
    *("quality", "rough", "footing", "ways", "levels", "speed", "planning", "editing"),
    *("paper", "spacetime", "batch", "cli"),
)
PACKAGES = ("mujoco", "numpy", "mink")  # whose versions the page names


def print_line(line: str) -> None:
    print(line, flush=True)


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the same as data")
    parser.add_argument("--write", action="store_true", help="write the table to docs/results.md")
    parser.add_argument("--only", choices=PARTS, help="one part")
    parser.add_argument(
        "--clips",
        nargs="+",
        help="for quality and rough: names or files; those held back are left out",
    )
    parser.add_argument(
        "--scenes", nargs="+", default=quality.SCENES, help="for quality: names or files"
    )
    parser.add_argument(
        "--terrains", type=int, default=batch.TERRAINS, help="for batch: how many are walked on"
    )
    parser.add_argument("--jobs", type=int, default=batch.JOBS, help="for batch: of 1 % broken")
    args = parser.parse_args(argv)
    if args.write and (args.only or args.clips or args.scenes != quality.SCENES):
        parser.error("--write replaces the whole table: it needs all parts, clips and scenes")
    return args


def measure_quality(
    clips: Sequence[str] | None, scenes: Sequence[str]
) -> tuple[list[Figure], dict[str, Any]]:
    """Measure the walks tuned on and those held back, or given ones: the figures, and all pairs."""
    print_line("\nquality" if clips else "\nquality: walks that were tuned on")
    pairs, skipped = quality.run(clips or quality.TUNED, scenes, print_line)
    figures = quality.summary(pairs) if pairs else []
    data: dict[str, Any] = {"pairs": [pair.as_dict() for pair in pairs], "skipped": skipped}
    if not clips:
        figures.insert(0, quality.share_summary("tuned on", pairs, least=quality.SHARE))
        data["held_back"] = []
        for what, others, where in (
            ("other people", quality.HELD_BACK, scenes),
            ("other scenes", quality.TUNED, tuple(quality.OTHER_SCENES)),
            ("other people on other scenes", quality.HELD_BACK, tuple(quality.OTHER_SCENES)),
        ):
            print_line(f"\nquality, held back: {what}")
            held_back, missing = quality.run(others, where, print_line)
            if held_back:
                row = quality.share_summary(f"held back, {what}", held_back, least=quality.SHARE)
                figures.append(row)
            data["held_back"] += [pair.as_dict() for pair in held_back]
            data["skipped"] += missing
    print_line("\nquality, the worst of all")
    return print_figures(figures, print_line), data


def measure(
    parts: Sequence[str],
    clips: Sequence[str] | None,
    scenes: Sequence[str],
    batches: tuple[int, int] = (batch.TERRAINS, batch.JOBS),
) -> tuple[list[Figure], dict[str, Any]]:
    """Run parts of the benchmark and print their figures.

    Returns:
      the figures, and what else the data of ``--json`` hold.
    """
    figures: list[Figure] = []
    data: dict[str, Any] = {"machine": machine()}
    for name, fact in data["machine"].items():
        print_line(f"{name:10} {fact}")
    if "quality" in parts:
        figures, pairs = measure_quality(clips, scenes)
        data |= pairs
    if "rough" in parts:
        print_line("\nrough ground: bumps, small boxes and rods underfoot")
        figures += rough.run(print_line, clips)
    if "footing" in parts:
        for what, seeds in (("tuned on", footing.TUNED), ("held back", footing.HELD_BACK)):
            print_line(f"\nstairs and stones by seed, {what}")
            found = footing.run(footing.CLIPS, seeds, print_line)
            figures += print_figures(footing.summary(what, found), print_line)
    if "levels" in parts:
        print_line("\nlevels of the terrain job: largest error [% of height]")
        figures += levels.run(make_job(), print_line)
    if "speed" in parts:
        print_line("\nspeed")
        figures += speed.run(make_job(), print_line)
    if "planning" in parts:
        print_line("\nplanning")
        figures += planning.run(make_job(), print_line)
    if "editing" in parts:
        print_line("\nediting")
        figures += editing.run(make_job(), print_line)
    if "paper" in parts:
        print_line("\nthe paper's other results: Table 1, rope, retargeting, joining")
        figures += paper.run(print_line)
    if "spacetime" in parts:
        print_line(
            "\none large optimisation against many small: the terrain job, footholds fixed and free"
        )
        figures += spacetime.run(spacetime.make_jobs(), print_line)
    if "ways" in parts:
        for what, seeds in (("tuned on", ways.TUNED), ("held back", ways.HELD_BACK)):
            print_line(f"\nways by seed, {what}: doors aside, corners, clutter, posts, mazes")
            figures += ways.run(seeds, print_line, what)
    if "batch" in parts:
        print_line("\nbatch")
        figures += batch.run(print_line, *batches)
    if "cli" in parts:
        print_line("\nstart")
        figures += startup.run(print_line)
    return figures, data


def print_missed(figures: Sequence[Figure]) -> None:
    missed = [figure for figure in figures if figure.ok is False]
    judged = [figure for figure in figures if figure.target and figure.ok is not None]
    print_line(f"\n{len(judged) - len(missed)} of {len(judged)} targets reached")
    for figure in missed:
        print_line(f"MISSED {figure.group}: {figure.miss}")


def main(argv: Sequence[str] | None = None) -> int:
    args = parse(argv)
    try:
        parts = [args.only] if args.only else PARTS
        sizes = (args.terrains, args.jobs)
        figures, data = measure(parts, args.clips, args.scenes, sizes)
        print_missed(figures)
        if args.write:
            results_page.write("benchmark", markdown(figures), data["machine"], PACKAGES)
    except MotionError as error:
        print(f"benchmark: error: {error}", file=sys.stderr)
        return 2
    if args.json is not None:
        data["figures"] = [figure.as_dict() for figure in figures]
        args.json.write_text(json.dumps(data, indent=1, allow_nan=False) + "\n", "utf-8")
    return 1 if any(figure.ok is False for figure in figures) else 0


if __name__ == "__main__":
    sys.exit(main())
