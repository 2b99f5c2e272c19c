"""``mjmotion edit-frame``: direct manipulation without a window (Figure 2)."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjmotion.cli.arguments import (
    MOTION_HELP,
    add_fitting,
    add_folder,
    add_reading,
    add_thresholds,
    frame,
    real,
)

if TYPE_CHECKING:
    from mjmotion.output.result import Result
    from mjmotion.validation.thresholds import Threshold

HELP = "change one frame; the frames that seven knots cover follow smoothly"
EXAMPLE = (
    "mjmotion edit-frame walk --frame 60 --site pelvis --by 0 0 -0.15 --levels 12,6,3,1.5"
    " --out out/edit"
)

_ROUNDING = 1e-6  # by which a figure may be worse and still be the same
LEVELS = (12.0, 6.0, 3.0, 1.5)  # those of mjmotion.apps.edit, which is imported late
FIRST = (4, 6, 12)  # frames a knot of the first levels of Figure 2, drawn with the chosen one


class _Move(argparse.Action):
    """``--by`` or ``--to`` of the ``--site`` before it."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: str | Sequence[Any] | None,
        option: str | None = None,
    ) -> None:
        moves = [*(getattr(namespace, "moves", None) or []), (self.dest, tuple(values or ()))]
        namespace.moves = moves


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("motion", metavar="MOTION", help=MOTION_HELP)
    parser.add_argument("--frame", type=frame, required=True, help="frame to change, from 0")
    parser.add_argument(
        "--site",
        action="append",
        required=True,
        help="what to drag, such as pelvis, head_top, left_hand; may repeat, with a --by each",
    )
    for name, text in (
        ("by", "how far to drag the site, along the world's axes [m]"),
        ("to", "where to drag the site [m]"),
    ):
        parser.add_argument(
            f"--{name}",
            action=_Move,
            nargs=3,
            type=real,
            metavar=("X", "Y", "Z"),
            help=text,
            default=argparse.SUPPRESS,
        )
    add_fitting(parser, default=LEVELS, solver=False)
    parser.add_argument(
        "--hold",
        choices=("feet", "contacts", "frame"),
        default="feet",
        help="what stays around the frame: both feet on their paths, what stands while it stands,"
        " or only what stands at the frame itself",
    )
    parser.add_argument(
        "--contacts", type=Path, help="contacts.json to use instead of finding them"
    )
    add_folder(parser)
    add_reading(parser)
    add_thresholds(parser)
    parser.set_defaults(moves=[])


def _not_the_edit_s(
    edited: Result, thresholds: Mapping[str, Threshold], given: Sequence[str]
) -> dict[str, Threshold]:
    """Take off thresholds that the clip breaks by itself, and the edit no worse: none of its doing.

    Such a figure is told without being judged. Where the user gave a threshold, that holds.
    """
    from mjmotion.cli.terminal import warn
    from mjmotion.validation import validate
    from mjmotion.validation.thresholds import AT_LEAST

    before, after = (
        validate(edited.source, motion, edited.contacts, thresholds=thresholds)
        for motion in (edited.source, edited.motion)
    )
    own = {text.partition("=")[0].strip() for text in given}
    left: dict[str, Threshold] = {}
    for name in before.broken():
        worse = after.metrics[name] - before.metrics[name]
        worse = -worse if name in AT_LEAST else worse
        # Of a pair of bounds, which way is worse is not plain: those are judged.
        if isinstance(thresholds[name], float) and name not in own and worse <= _ROUNDING:
            left[name] = None
            warn(
                f"note: the clip itself breaks {name}: {before.metrics[name]:.4g}, and"
                f" {after.metrics[name]:.4g} edited; it is told and not judged"
            )
    return left


def _halved(first: float, count: int) -> tuple[float, ...]:
    """Return so many levels, each with knots half as far apart, none below a frame a knot."""
    halved = (first / 2.0**level for level in range(count))
    return tuple(frames_per_knot for frames_per_knot in halved if frames_per_knot >= 1.0)


def run(args: argparse.Namespace) -> int:
    """Edit a frame, validate the result and write everything into a folder, with a plot."""
    from mjmotion.apps.edit import Span, edit_frame
    from mjmotion.apps.edit.ranges import write_ranges
    from mjmotion.cli.given import read_given
    from mjmotion.cli.run import prepare, tell, write
    from mjmotion.cli.terminal import Bar, say
    from mjmotion.exceptions import ConstraintError
    from mjmotion.footsteps.contacts import load_contacts
    from mjmotion.output.folder import result_folder

    kinds = {kind for kind, _ in args.moves}
    if len(kinds) != 1 or len(args.moves) != len(args.site):
        raise ConstraintError(
            f"--site is given {len(args.site)} times, --by or --to {len(args.moves)}: give a --by"
            " for every --site, or a --to for every --site"
        )
    thresholds = prepare(args)
    with Bar() as bar, result_folder(args.out, args.force) as folder:
        bar("reading the motion")
        motion, contacts = read_given(args, args.motion)
        if args.contacts:
            contacts = load_contacts(args.contacts, motion.model, motion.nframe)
        bar("editing")
        drags: dict[str, Any] = {kinds.pop(): [values for _, values in args.moves]}
        chosen = int(args.levels[0])
        edits = {
            first: edit_frame(
                motion,
                args.frame,
                args.site,
                **drags,
                levels=args.levels if first == chosen else _halved(first, len(args.levels)),
                tolerance=args.tolerance,
                contacts=contacts,
                hold=args.hold,
            )
            for first in sorted({chosen, *FIRST})
        }
        edited = edits[chosen]
        title = f"{Path(args.motion).stem} edited at frame {args.frame}"
        thresholds |= _not_the_edit_s(edited, thresholds, args.threshold)
        validation = write(folder, edited, thresholds, args, bar, title=title)
        write_ranges(folder / "edit.png", edits, args.frame)
    frames = Span(args.frame, chosen, motion.nframe).frames
    say(f"{len(frames)} frames change, {frames[0]} to {frames[-1]}")
    code = tell(args, edited, validation, title=title)
    say(f"plot    {args.out / 'edit.png'}")
    return code
