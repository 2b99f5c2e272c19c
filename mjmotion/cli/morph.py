"""``mjmotion morph``: a walk whose character changes its size."""

from __future__ import annotations

import argparse
from pathlib import Path

from mjmotion.cli.arguments import MOTION_HELP, add_fitting, add_folder, add_reading, add_thresholds

HELP = "change the size of a walk's character from frame to frame, its stride as it was"
EXAMPLE = "mjmotion morph walk --key 120:legs=1.4,torso=0.7 --key 300:legs=0.7 --out out/morph"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument(
        "clip", metavar="CLIP", nargs="?", help=f"{MOTION_HELP}; the paper's walk without"
    )
    parser.add_argument(
        "--key",
        dest="keys",
        type=key,
        action="append",
        metavar="FRAME:PART=FACTOR,…",
        help="the body at a frame, such as 20:legs=1.6,torso=0.6 (also arms, head, feet, hands,"
        " width, size); may repeat; the paper's two without",
    )
    add_folder(parser)
    parser.add_argument(
        "--contacts", type=Path, help="contacts.json to use instead of finding them"
    )
    add_fitting(parser)
    add_reading(parser)
    add_thresholds(parser)


def key(text: str) -> tuple[int, dict[str, float]]:
    """Return a frame and proportions from ``20:legs=1.6,torso=0.6``."""
    frame, colon, rest = text.partition(":")
    try:
        pairs = [part.split("=") for part in rest.split(",")]
        factors = {name.strip(): float(value) for name, value in pairs}
        number = int(frame)
    except ValueError:
        factors, number = {}, -1
    if not colon or not factors or number < 0 or len(factors) != len(pairs):
        raise argparse.ArgumentTypeError(
            f"'{text}' is not a frame and its proportions, such as 20:legs=1.6,torso=0.6"
        )
    return number, factors


def run(args: argparse.Namespace) -> int:
    """Morph a walk, validate the result and write everything into a folder."""
    from mjmotion.apps.morph import morph
    from mjmotion.body.proportions import Proportions, make_character
    from mjmotion.cli.given import read_given
    from mjmotion.cli.run import prepare, tell, write
    from mjmotion.cli.terminal import Bar
    from mjmotion.exceptions import MotionError, unknown_name
    from mjmotion.footsteps.contacts import load_contacts
    from mjmotion.output.folder import result_folder
    from mjmotion.paper.morph import KEYS, paper_walk
    from mjmotion.scene import without_scene

    thresholds = prepare(args)
    asked = args.keys if args.keys is not None else KEYS
    if args.clip is not None and args.keys is None:
        raise MotionError("a clip of your own needs --key: the frames and what the body is then")
    parts = [field for field in Proportions.__dataclass_fields__]
    for _, factors in asked:
        for name in factors:
            if name not in parts:
                raise MotionError(unknown_name("proportion", name, parts))
    with Bar() as bar, result_folder(args.out, args.force) as folder:
        bar("reading the clip and making the bodies")
        motion, contacts = (
            paper_walk(args.character or "humanoid")
            if args.clip is None
            else read_given(args, args.clip)
        )
        if args.contacts:
            contacts = load_contacts(args.contacts, motion.model, motion.nframe)
        body = without_scene(motion.character)
        keys = [(frame, make_character(body, Proportions(**factors))) for frame, factors in asked]
        result = morph(
            motion,
            keys,
            contacts=contacts,
            levels=args.levels,
            tolerance=args.tolerance,
            ik=args.ik,
            progress=bar,
        )
        title = f"{Path(args.clip).stem if args.clip else 'A walk'}, morphing"
        validation = write(folder, result, thresholds, args, bar, title=title)
    return tell(args, result, validation, title=title)
