"""The command line: ``mjmotion demo|adapt|validate|render|info|scene``.

Here are the arguments and the errors; what the commands do is in ``commands.py``, which is only
imported once a command is to run, so that ``--help`` answers at once.

Exit codes: 0 well; 1 a threshold is broken or a constraint of the user's own is not met (the output
is written); 2 bad input (one line on stderr, nothing written).
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from mjmotion import __version__
from mjmotion.exceptions import MotionError

OK, BROKEN, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130  # exit codes

_EXAMPLES = {
    "demo": "mjmotion demo --out out/demo",
    "adapt": "mjmotion adapt walk --scene terrain --out out/walk",
    "validate": "mjmotion validate out/walk --threshold stance_drift_mm=0.5",
    "render": "mjmotion render out/walk --out walk.mp4",
    "info": "mjmotion info out/walk",
    "scene": "mjmotion scene stairs --out stairs.xml",
}


_ADAPT_DEFAULTS: dict[str, Any] = {
    "contacts": None,
    "constraints": None,
    "levels": None,
    "tolerance": 0.1,
    "ik": "hybrid",
    "character": "humanoid",
    "mapping": None,
    "fps": None,
    "threshold": [],
}


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, like every other error of the program."""

    def __init__(self, **settings: Any) -> None:
        # Examples stay on one line, to be copied.
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, **settings)

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"mjmotion: error: {message} (see '{self.prog} --help')\n")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
      argv: the arguments, without the program's name; ``None`` takes those of the process.

    Returns:
      The exit code.
    """
    args = parse(argv)
    # A kill must clean up what is half done, as Ctrl-C does: raise instead of dying on the spot.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    try:
        from mjmotion import commands

        code: int = getattr(commands, args.command)(args)
        sys.stdout.flush()
        return code
    except MotionError as error:
        print("mjmotion: error:", " ".join(str(error).split()), file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("mjmotion: interrupted, nothing was written", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # the reader of our output, such as head, has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return OK


def parse(argv: Sequence[str] | None = None) -> argparse.Namespace:
    """Return the parsed arguments; on an error the program ends with exit code 2."""
    return _parser().parse_args(argv)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="mjmotion",
        description="Adapt recorded walks to new ground: stairs, slopes, rough terrain, doorways.",
        epilog="try: mjmotion demo",
    )
    parser.add_argument("--version", action="version", version=f"mjmotion {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)

    def add(name: str, text: str) -> argparse.ArgumentParser:
        return commands.add_parser(
            name, help=text, description=text, epilog=f"example: {_EXAMPLES[name]}"
        )

    demo = add("demo", "adapt the built-in walk to rough terrain with doorways")
    demo.add_argument("--out", type=Path, default=Path("out/demo"), help="folder to write")
    demo.add_argument("--no-video", action="store_true", help="fit and validate only")
    demo.add_argument("--force", action="store_true", help="replace earlier results in --out")
    demo.set_defaults(clip="walk", scene="terrain_doors", **_ADAPT_DEFAULTS)

    adapt = add("adapt", "adapt a clip to a scene, validate it and make a video")
    adapt.add_argument("clip", metavar="CLIP", help="BVH, AMC, CSV or NPZ file, or a built-in name")
    adapt.add_argument("--scene", required=True, help="MJCF file, or the name of one of our scenes")
    adapt.add_argument("--out", type=Path, required=True, help="folder to write")
    adapt.add_argument("--no-video", action="store_true", help="fit and validate only")
    adapt.add_argument("--force", action="store_true", help="replace earlier results in --out")
    adapt.add_argument("--contacts", type=Path, help="contacts.json to use instead of finding them")
    adapt.add_argument("--constraints", type=Path, help="YAML or JSON file of your own constraints")
    adapt.add_argument("--levels", type=_levels, help="frames a knot per level: 16,8,4,2")
    adapt.add_argument(
        "--tolerance", type=_positive, metavar="MM", help="stop refining at this error [mm]: 0.1"
    )
    adapt.add_argument("--ik", choices=("hybrid", "numeric"), help="IK solver: hybrid")
    adapt.add_argument("--character", help="MJCF file or the name of a model: humanoid")
    adapt.add_argument("--mapping", type=Path, help="YAML file: which joint of the clip is which")
    adapt.add_argument(
        "--fps", type=_positive, help="rate of the clip, where its file tells none or a wrong one"
    )
    _add_thresholds(adapt)
    adapt.set_defaults(**_ADAPT_DEFAULTS)

    validate = add("validate", "measure a result again and rewrite its report")
    validate.add_argument("folder", metavar="DIR", type=Path, help="folder that adapt wrote")
    _add_thresholds(validate)

    render = add("render", "make a video of a result or of a motion file")
    render.add_argument("path", metavar="DIR|MOTION", type=Path, help="result folder or motion.npz")
    render.add_argument("--model", type=Path, help="MJCF model of a motion file")
    render.add_argument("--out", type=Path, help="video to write: DIR/video.mp4")
    render.add_argument("--force", action="store_true", help="replace an existing video")
    render.add_argument(
        "--layout",
        choices=("side-by-side", "ghost", "single"),
        default="side-by-side",
        help="how source and adapted motion are shown",
    )
    render.add_argument("--size", type=_size, default=(1280, 720), help="pixels: 1280x720")

    info = add("info", "say what is in a clip, scene, model or result folder")
    info.add_argument("what", metavar="FILE|NAME|DIR", help="what to describe")

    scene = add("scene", "make a scene")
    _add_scene_arguments(scene)
    return parser


def _add_thresholds(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--threshold",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="change a threshold, such as stance_drift_mm=0.5 or jerk_ratio_rms=none; may repeat",
    )


def _add_scene_arguments(parser: argparse.ArgumentParser) -> None:
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


def _levels(text: str) -> tuple[float, ...]:
    try:
        levels = tuple(float(part) for part in text.split(","))
    except ValueError:
        levels = ()
    if not levels or not all(0 < level < float("inf") for level in levels):
        raise argparse.ArgumentTypeError(f"'{text}' is not a list of numbers such as 16,8,4,2")
    return levels


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"'{text}' is not a positive number")
    return value


def _pair(text: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not two numbers such as 1.5,-2") from None
    return low, high


def _doorway(text: str) -> dict[str, float]:
    try:
        pairs = [part.split("=") for part in text.split(",")]
        door = {name.strip(): float(value) for name, value in pairs}
    except ValueError:
        door = {}
    if "x" not in door or not door.keys() <= {"x", "y", "yaw", "width", "height"}:
        raise argparse.ArgumentTypeError(
            f"'{text}' is not a doorway such as x=2.5,width=0.6,height=1.5 (also y, yaw)"
        )
    return door


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.lower().partition("x")
    if not (width.isdigit() and height.isdigit() and int(width) >= 64 and int(height) >= 64):
        raise argparse.ArgumentTypeError(f"'{text}' is not a size such as 1280x720")
    return int(width), int(height)


_Options = dict[str, tuple[Callable[[str], Any], str]]

_RANGES: _Options = {
    "x_range": (_pair, "extent along x [m]: LOW,HIGH (write --x-range=-2,10)"),
    "y_range": (_pair, "extent along y [m]: LOW,HIGH"),
}
_SEED: _Options = {"seed": (int, "seed of the random heights")}

SCENES: dict[str, tuple[str, _Options]] = {
    "flat": ("a level floor", {}),
    "terrain": (
        "the paper's rough terrain, random but seeded",
        {
            **_SEED,
            "spacing": (float, "width of the grid of control heights [m]"),
            "height": (float, "greatest control height [m]"),
            **_RANGES,
            "cell": (float, "distance between samples [m]"),
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
            "steps": (int, "number of steps up, and down again"),
            "rise": (float, "height of a step [m]"),
            "tread": (float, "depth of a step [m]"),
            "landing": (float, "depth of the landing [m]"),
            "width": (float, "width of the stairs [m]"),
            "distance": (float, "from the start to the first step [m]"),
        },
    ),
    "slope": (
        "a ramp up, a plateau, and a ramp down",
        {
            "angle": (float, "steepness [degrees]"),
            "length": (float, "length of a ramp [m]"),
            "plateau": (float, "length of the top [m]"),
            "width": (float, "width of the ramps [m]"),
            "distance": (float, "from the start to the ramp [m]"),
        },
    ),
    "blocks": (
        "a pavement of uneven blocks",
        {
            **_SEED,
            "size": (float, "side of a block [m]"),
            "height": (float, "greatest height of a block [m]"),
            **_RANGES,
            "start_radius": (float, "level ground around the start [m]"),
        },
    ),
    "heights": (
        "ground from an .npy file, an image or a mesh",
        {
            "cell": (float, "distance between samples [m]"),
            "height": (float, "height of white in an image [m]"),
            "scale": (float, "factor on heights of an array or lengths of a mesh"),
            "start": (_pair, "where the walk starts, from the low corner [m]: X,Y"),
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
    "heights": "mjmotion scene heights map.png --cell 0.1 --height 0.8 --out ground.xml",
}
