"""``mjmotion scene KIND``: scenes made by our builders."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mjmotion.cli.arguments import pair, real, whole

HELP = "make a scene"
EXAMPLE = "mjmotion scene stairs --out stairs.xml"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add a parser for every kind of scene, with the options of its builder."""
    kinds = parser.add_subparsers(dest="kind", metavar="KIND", required=True)
    for kind, (text, options) in SCENES.items():
        sub = kinds.add_parser(
            kind, help=text, description=text, epilog=f"example: {_SCENE_EXAMPLES[kind]}"
        )
        if kind == "heights":
            sub.add_argument("source", metavar="FILE", help=".npy, image or mesh file")
        for name, (convert, meaning) in options.items():
            sub.add_argument(
                "--door" if name == "doorways" else f"--{name.replace('_', '-')}",
                dest=name,
                type=convert,
                action="append" if name == "doorways" else "store",
                metavar="DOOR" if name == "doorways" else name.upper(),
                default=argparse.SUPPRESS,  # what is not given is the builder's own default
                help=meaning,
            )
        sub.add_argument(
            "--out", type=Path, required=True, metavar="FILE.xml", help="file to write"
        )
        sub.add_argument("--force", action="store_true", help="replace an existing scene")


def run(args: argparse.Namespace) -> int:
    """Make a scene and write it with its assets."""
    from mjmotion.cli.terminal import Bar, say
    from mjmotion.exceptions import OutputError
    from mjmotion.scene import BUILDERS, Doorway, Scene, save_model

    out = args.out
    if out.suffix.lower() != ".xml":
        raise OutputError(f"'{out}' must end in .xml: a scene is an MJCF file")
    if out.exists() and not args.force:
        raise OutputError(f"'{out}' exists already: give another --out, or --force")
    known = {"command", "kind", "out", "force", "source", "debug"}
    options = {name: value for name, value in vars(args).items() if name not in known}
    if "doorways" in options:
        options["doorways"] = [Doorway(**door) for door in options["doorways"]]
    source = [args.source] if args.kind == "heights" else []
    with Bar() as bar:
        bar("making the scene")
        made = Scene.from_spec(BUILDERS[args.kind](*source, **options), out.stem)
        path = save_model(made.spec, out.parent, out.name)
    say(f"scene   {path}")
    return 0


def _doorway(text: str) -> dict[str, float]:
    try:
        pairs = [part.split("=") for part in text.split(",")]
        door = {name.strip(): real(value) for name, value in pairs}
    except (ValueError, argparse.ArgumentTypeError):
        door = {}
    if "x" not in door or not door.keys() <= {"x", "y", "yaw", "width", "height"}:
        raise argparse.ArgumentTypeError(
            f"'{text}' is not a doorway such as x=2.5,width=0.6,height=1.5 (also y, yaw)"
        )
    return door


_Options = dict[str, tuple[Callable[[str], Any], str]]

_RANGES: _Options = {
    "x_range": (pair, "extent along x [m]: LOW,HIGH (write --x-range=-2,10)"),
    "y_range": (pair, "extent along y [m]: LOW,HIGH"),
}
_SEED: _Options = {"seed": (whole, "seed of the random heights")}

SCENES: dict[str, tuple[str, _Options]] = {
    "flat": ("a level floor", {}),
    "terrain": (
        "the paper's rough terrain, random but seeded",
        {
            **_SEED,
            "spacing": (real, "width of the grid of control heights [m]"),
            "height": (real, "greatest control height [m]"),
            **_RANGES,
            "cell": (real, "distance between samples [m]"),
        },
    ),
    "doors": (
        "rough terrain with doorways",
        {
            **_SEED,
            "doorways": (_doorway, "a doorway: x=2.5,width=0.6,height=1.5; may repeat"),
        },
    ),
    "stairs": (
        "stairs up, a landing, and stairs down",
        {
            "steps": (whole, "number of steps up, and down again"),
            "rise": (real, "height of a step [m]"),
            "tread": (real, "depth of a step [m]"),
            "landing": (real, "depth of the landing [m]"),
            "width": (real, "width of the stairs [m]"),
            "distance": (real, "from the start to the first step [m]"),
        },
    ),
    "slope": (
        "a ramp up, a plateau, and a ramp down",
        {
            "angle": (real, "steepness [degrees]"),
            "length": (real, "length of a ramp [m]"),
            "plateau": (real, "length of the top [m]"),
            "width": (real, "width of the ramps [m]"),
            "distance": (real, "from the start to the ramp [m]"),
        },
    ),
    "blocks": (
        "a pavement of uneven blocks",
        {
            **_SEED,
            "size": (real, "side of a block [m]"),
            "height": (real, "greatest height of a block [m]"),
            **_RANGES,
            "start_radius": (real, "level ground around the start [m]"),
        },
    ),
    "rope": (
        "a rope to climb, hanging from a beam",
        {
            "beam": (real, "height that the rope hangs from [m]"),
            "length": (real, "length of the rope [m]"),
            "radius": (real, "radius of the rope [m]"),
            "edge": (real, "distance of the points that it is made of [m]"),
        },
    ),
    "heights": (
        "ground from an .npy file, an image or a mesh",
        {
            "cell": (real, "distance between samples [m]"),
            "height": (real, "height of white in an image [m]"),
            "scale": (real, "factor on heights of an array or lengths of a mesh"),
            "start": (pair, "where the walk starts, from the low corner [m]: X,Y"),
            "up": (str, "axis of a mesh that points up: y or z"),
        },
    ),
}
"""Kinds of scenes with the options of their builders; a test holds them together."""

_SCENE_EXAMPLES = {
    "flat": "mjmotion scene flat --out flat.xml",
    "terrain": "mjmotion scene terrain --seed 7 --out terrain.xml",
    "doors": "mjmotion scene doors --door x=2.5,height=1.5 --door x=4,width=0.6 --out doors.xml",
    "stairs": "mjmotion scene stairs --steps 4 --rise 0.16 --out stairs.xml",
    "slope": "mjmotion scene slope --angle 12 --out slope.xml",
    "blocks": "mjmotion scene blocks --seed 3 --height 0.2 --out blocks.xml",
    "rope": "mjmotion scene rope --beam 5 --length 4.7 --out rope.xml",
    "heights": "mjmotion scene heights map.png --cell 0.1 --height 0.8 --out ground.xml",
}
