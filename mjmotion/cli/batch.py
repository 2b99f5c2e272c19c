"""``mjmotion batch``: all clips × scenes × characters, resumed, here or on a Dask cluster."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from mjmotion.cli.arguments import (
    add_fitting,
    add_free_footholds,
    add_heading,
    add_recording,
    add_thresholds,
    count,
)

if TYPE_CHECKING:
    from mjmotion.apps.batch import Batch, Counts, Executor

HELP = "adapt all clips to all scenes with all characters; run again to go on"
EXAMPLE = "mjmotion batch 'clips/*.bvh' --scenes stairs slope --terrains 10 --out out/all"
_ERRORS = 5  # that are told one by one


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument(
        "clips", metavar="CLIP", nargs="*", help="files, 'globs', fsspec addresses, built-in names"
    )
    parser.add_argument("--out", metavar="DIR", help="folder or fsspec address of the batch")
    parser.add_argument(
        "--scenes", nargs="+", default=[], metavar="SCENE", help="MJCF files, globs or our names"
    )
    parser.add_argument(
        "--terrains", type=count, default=0, metavar="N", help="the paper's terrain, seeds 1 to N"
    )
    parser.add_argument(
        "--characters",
        nargs="+",
        default=["humanoid"],
        metavar="MODEL",
        help="MJCF files, globs or names of our models: humanoid",
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--workers", type=count, metavar="N", help="processes of this machine: one a core"
    )
    where.add_argument(
        "--dask", metavar="ADDRESS", help="scheduler of a Dask cluster, such as tcp://host:8786"
    )
    parser.add_argument(
        "--threads", type=count, metavar="N", help="threads of each worker: its share of the cores"
    )
    parser.add_argument("--retry", choices=("failed",), help="try what failed again")
    parser.add_argument(
        "--no-report", action="store_true", help="write motions and figures only, no reports"
    )
    parser.add_argument(
        "--shards",
        type=count,
        default=0,
        metavar="N",
        help="write N jobs into one file, in place of a folder a job",
    )
    instead = parser.add_mutually_exclusive_group()
    instead.add_argument(
        "--summary", metavar="DIR", help="of a batch: how its figures spread, and the worst cases"
    )
    instead.add_argument(
        "--extract", metavar="JOB", help="of the batch --out: one job as the folder --to"
    )
    parser.add_argument(
        "--to", type=Path, metavar="DIR", help="with --extract: folder to write: JOB"
    )
    _add_how(parser)


def _add_how(parser: argparse.ArgumentParser) -> None:
    add_fitting(parser)
    add_heading(parser)
    add_free_footholds(parser)
    add_recording(parser)
    add_thresholds(parser)


def run(args: argparse.Namespace) -> int:
    """Run a batch, or what is missing of it; or tell of one that was run."""
    from mjmotion.exceptions import BatchError

    if args.summary or args.extract:
        if args.clips:
            raise BatchError("--summary and --extract are of a batch that was run: leave the clips")
        return _summary(args) if args.summary else _extract(args)
    if not args.clips or not args.out or not (args.scenes or args.terrains):
        raise BatchError("give clips, --scenes or --terrains, and --out")
    return _run(args)


def _run(args: argparse.Namespace) -> int:
    from mjmotion.apps.batch import open_storage, run_batch
    from mjmotion.apps.batch.record import Record
    from mjmotion.cli.terminal import Bar, warn

    storage = open_storage(args.out)
    batch = _batch(args)
    executor = _executor(args)
    try:
        with Bar(rate=True) as bar:
            counts = run_batch(
                batch,
                storage,
                executor,
                shards=args.shards,
                retry_failed=args.retry == "failed",
                progress=bar,
            )
    except KeyboardInterrupt:
        known = len(Record(storage).known)
        warn(f"interrupted: {known} jobs are done and stay; run it again to go on")
        return 130
    finally:
        executor.close()
    return _tell(counts, args.out)


def _batch(args: argparse.Namespace) -> Batch:
    from mjmotion.apps.batch.inputs import make_batch
    from mjmotion.apps.batch.jobs import Settings, as_thresholds
    from mjmotion.validation import THRESHOLDS, read_thresholds

    wanted = read_thresholds(args.threshold)
    changed = {name: bound for name, bound in wanted.items() if bound != THRESHOLDS[name]}
    settings = Settings(
        levels=args.levels,
        tolerance=args.tolerance,
        ik=args.ik,
        heading=args.heading,
        free_footholds=args.free_footholds,
        fps=args.fps,
        mapping=str(args.mapping.absolute()) if args.mapping else None,
        asf=str(args.asf.absolute()) if args.asf else None,
        in_place=args.in_place,
        floor=args.floor,
        loop=args.loop,
        thresholds=as_thresholds(changed),
        report=not args.no_report and not args.shards,
    )
    return make_batch(
        args.clips, args.scenes, args.characters, terrains=args.terrains, settings=settings
    )


def _executor(args: argparse.Namespace) -> Executor:
    if args.dask:
        from mjmotion.apps.batch.cluster import Cluster

        return Cluster(args.dask, threads=args.threads or 1)
    from mjmotion.apps.batch import Processes

    return Processes(args.workers, args.threads)


def _tell(counts: Counts, out: str) -> int:
    from mjmotion.cli.terminal import say, warn

    well, broken = counts.exits.get(0, 0), counts.exits.get(1, 0)
    failed = counts.total - well - broken
    say(
        f"{counts.total} jobs, {counts.done} of them done now:"
        f" {well} within all thresholds, {broken} not, {failed} failed"
    )
    for error, number in counts.errors[:_ERRORS]:
        warn(f"failed: {number} job{'s' * (number != 1)}: {error}")
    if len(counts.errors) > _ERRORS:
        warn(f"failed: {len(counts.errors) - _ERRORS} other errors: see the table")
    say(*(f"table   {out.rstrip('/')}/{name}" for name in counts.tables))
    return 1 if broken or failed else 0


def _summary(args: argparse.Namespace) -> int:
    from mjmotion.apps.batch import open_storage
    from mjmotion.apps.batch.page import write_page
    from mjmotion.apps.batch.summary import summarise
    from mjmotion.cli.terminal import Bar, say

    storage = open_storage(args.summary)
    summary = summarise(storage)
    with Bar() as bar:
        page = write_page(storage, summary, bar)
    say(*summary.lines(), "", f"page    {args.summary.rstrip('/')}/{page}")
    return 0


def _extract(args: argparse.Namespace) -> int:
    from mjmotion.apps.batch import open_storage
    from mjmotion.apps.batch.shards import extract
    from mjmotion.cli.terminal import say
    from mjmotion.exceptions import BatchError

    if not args.out:
        raise BatchError("--extract needs the batch: give its folder as --out")
    folder = extract(open_storage(args.out), args.extract, args.to or Path(args.extract))
    say(f"job     {folder}")
    return 0
