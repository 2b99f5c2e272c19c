"""``mjmotion character``: a humanoid of other proportions."""

from __future__ import annotations

import argparse
from pathlib import Path

from mjmotion.cli.arguments import number

HELP = "make a humanoid of other proportions"
EXAMPLE = "mjmotion character --legs 1.25 --torso 0.8 --arms 0.85 --out climber.xml"

FACTORS = {
    "legs": "factor on the legs' length, hip to ankle",
    "torso": "factor on the trunk's length, hips to shoulders",
    "arms": "factor on the arms' length, shoulder to wrist",
    "head": "factor on neck and head, in every direction",
    "feet": "factor on the feet, in every direction",
    "hands": "factor on the hands, in every direction",
    "width": "factor on the thickness of limbs and trunk",
    "size": "factor on all of that once more",
}
"""Every field of Proportions, with what it means; a test holds them together."""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add a factor for every part of the body."""
    for name, meaning in FACTORS.items():
        parser.add_argument(
            f"--{name}", type=number, default=1.0, metavar="FACTOR", help=f"{meaning}: 1"
        )
    parser.add_argument(
        "--from",
        dest="source",
        default="humanoid",
        metavar="MODEL",
        help="MJCF file of any humanoid, or the name of one of our models: humanoid",
    )
    parser.add_argument(
        "--flexible-spine",
        action="store_true",
        help="also divide the torso into three segments that share the spine's turn",
    )
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.xml", help="file to write")
    parser.add_argument("--force", action="store_true", help="replace an existing file")


def run(args: argparse.Namespace) -> int:
    """Make a character and write it with its assets."""
    from mjmotion.body.proportions import Proportions, flexible_spine, make_character
    from mjmotion.cli.terminal import Bar, say
    from mjmotion.exceptions import OutputError
    from mjmotion.scene import save_model

    out = args.out
    if out.suffix.lower() != ".xml":
        raise OutputError(f"'{out}' must end in .xml: a character is an MJCF file")
    if out.exists() and not args.force:
        raise OutputError(f"'{out}' exists already: give another --out, or --force")
    proportions = Proportions(**{name: getattr(args, name) for name in FACTORS})
    with Bar() as bar:
        bar("making the character")
        character = make_character(args.source, proportions)
        if args.flexible_spine:
            character = flexible_spine(character)
        spec = character.spec.copy()
        spec.modelname = out.stem
        path = save_model(spec, out.parent, out.name)
    model = character.model
    mass = float(model.body_subtreemass[model.jnt_bodyid[0]])
    say(f"model   {path}", f"{character.height:.2f} m, {mass:.1f} kg, {model.nv} DOFs")
    return 0
