"""Arguments that several commands take, and what turns a word into a value.

A converter raises ``argparse.ArgumentTypeError`` with a line that shows a right value.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mjmotion.boundary.limits import (
    LEAST_KNOT,
    LEAST_PICTURE,
    LEAST_RATE,
    MOST_COUNT,
    MOST_KNOT,
    MOST_LENGTH,
    MOST_LEVELS,
    MOST_PICTURE,
    MOST_RATE,
    MOST_TOLERANCE,
)

MOTION_HELP = "BVH, AMC, GLB, CSV or NPZ file, a built-in name, or a result folder"


def levels(text: str) -> tuple[float, ...]:
    """Return frames a knot of every level from ``16,8,4,2``."""
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if not values or not all(0 < value < float("inf") for value in values):
        raise argparse.ArgumentTypeError(f"'{text}' is not a list of numbers such as 16,8,4,2")
    if len(values) > MOST_LEVELS or not all(LEAST_KNOT <= value <= MOST_KNOT for value in values):
        raise argparse.ArgumentTypeError(
            f"'{text}': at most {MOST_LEVELS} levels,"
            f" of {LEAST_KNOT:g} to {MOST_KNOT:g} frames a knot"
        )
    return values


def positive(text: str) -> float:
    """Return a number above 0."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"'{text}' is not a positive number")
    return value


def rate(text: str) -> float:
    """Return frames a second."""
    value = positive(text)
    if not LEAST_RATE <= value <= MOST_RATE:
        raise argparse.ArgumentTypeError(
            f"'{text}' is not a rate from {LEAST_RATE:g} to {MOST_RATE:g} frames a second"
        )
    return value


def real(text: str) -> float:
    """Return a finite number that is a length, an angle or a factor of something that exists."""
    value = number(text)
    if abs(value) > MOST_LENGTH:
        raise argparse.ArgumentTypeError(f"'{text}' is beyond {MOST_LENGTH:,.0f}")
    return value


def whole(text: str) -> int:
    """Return a whole number of either sign."""
    # The length first: a number of a million digits takes Python minutes.
    if len(text) > 10 or not text.lstrip("+-").isdecimal():
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number")
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number") from None


def millimetres(text: str) -> float:
    """Return a length [m] from a positive number of millimetres."""
    value = positive(text)
    if value > MOST_TOLERANCE:
        raise argparse.ArgumentTypeError(f"'{text}' is more than {MOST_TOLERANCE:g} mm")
    return value / 1000.0


def count(text: str) -> int:
    """Return a whole number above 0."""
    if not (text.isdecimal() and len(text) <= 10 and 0 < int(text) <= MOST_COUNT):
        most = f"{MOST_COUNT:,}"
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number from 1 to {most}")
    return int(text)


def frame(text: str) -> int:
    """Return a frame: a whole number from 0."""
    if not (text.isdecimal() and len(text) <= 10):
        raise argparse.ArgumentTypeError(f"'{text}' is not a frame: frames count from 0")
    return int(text)


def number(text: str) -> float:
    """Return a finite number."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) < float("inf"):
        raise argparse.ArgumentTypeError(f"'{text}' is not a number")
    return value


def pair(text: str) -> tuple[float, float]:
    """Return two numbers from ``1.5,-2``."""
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not two numbers such as 1.5,-2") from None
    for value in (low, high):
        real(str(value))
    return low, high


def size(text: str) -> tuple[int, int]:
    """Return width and height from ``1280x720`` [pixels]."""
    width, _, height = text.lower().partition("x")
    sides = [int(side) for side in (width, height) if side.isdecimal() and len(side) <= 6]
    if len(sides) < 2 or min(sides) < LEAST_PICTURE or max(sides) > MOST_PICTURE:
        raise argparse.ArgumentTypeError(f"'{text}' is not a size such as 1280x720")
    return sides[0], sides[1]


def add_thresholds(parser: argparse.ArgumentParser) -> None:
    """Add ``--threshold NAME=VALUE``, which may repeat."""
    parser.add_argument(
        "--threshold",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="change a threshold, such as stance_drift_mm=0.5 or jerk_ratio_rms=none; may repeat",
    )


def add_folder(parser: argparse.ArgumentParser, default: str | None = None) -> None:
    """Add what every command takes that writes a result folder: where to, and whether a video.

    :func:`mjmotion.cli.run.prepare` and ``write`` act on them.
    """
    parser.add_argument(
        "--out",
        type=Path,
        required=default is None,
        default=None if default is None else Path(default),
        metavar="DIR",
        help="folder to write",
    )
    parser.add_argument("--no-video", action="store_true", help="fit and validate only")
    parser.add_argument("--force", action="store_true", help="replace earlier results in --out")


def add_keyframe(parser: argparse.ArgumentParser) -> None:
    """Add ``--keyframe``: where what could move in a scene stands."""
    parser.add_argument(
        "--keyframe",
        metavar="NAME",
        help="keyframe of the scene that tells where what can move in it stands: its rest pose",
    )


def add_fitting(
    parser: argparse.ArgumentParser, default: tuple[float, ...] | None = None, solver: bool = True
) -> None:
    """Add how a fit is done: ``--levels``, ``--tolerance`` [m] and, if asked, ``--ik``."""
    text = ",".join(f"{number:g}" for number in default or (16, 8, 4, 2))
    parser.add_argument(
        "--levels", type=levels, default=default, help=f"frames a knot of each level: {text}"
    )
    parser.add_argument(
        "--tolerance",
        type=millimetres,
        default=1e-4,
        metavar="MM",
        help="stop refining at this error [mm]: 0.1",
    )
    if solver:
        parser.add_argument(
            "--ik", choices=("hybrid", "numeric"), default="hybrid", help="IK solver: hybrid"
        )


def add_heading(parser: argparse.ArgumentParser) -> None:
    """Add ``--heading``: which way a walk sets off."""
    parser.add_argument(
        "--heading",
        choices=("start", "keep"),
        default="start",
        help="set off along the start's x-axis, or keep the clip's own way: start",
    )


def add_free_footholds(parser: argparse.ArgumentParser) -> None:
    """Add ``--free-footholds`` (§7)."""
    parser.add_argument(
        "--free-footholds",
        action="store_true",
        help="let each foothold move as a whole to where the walk changes least",
    )


def add_reading(parser: argparse.ArgumentParser) -> None:
    """Add how a clip is read: ``--character`` and what :func:`add_recording` adds."""
    parser.add_argument("--character", help="MJCF file or the name of a model: humanoid")
    add_recording(parser)


def add_recording(parser: argparse.ArgumentParser) -> None:
    """Add how a recording is read, and what sets it going.

    They are ``--mapping``, ``--fps``, ``--asf``, ``--in-place``, ``--loop`` and ``--floor``.
    """
    parser.add_argument("--mapping", type=Path, help="YAML file: which joint of the clip is which")
    parser.add_argument(
        "--fps", type=rate, help="rate of the clip, where its file tells none or a wrong one"
    )
    parser.add_argument("--asf", type=Path, help="skeleton of an AMC file: the one beside it")
    parser.add_argument(
        "--in-place",
        type=travel,
        metavar="travel|keep|SPEED",
        help="of a clip walked in place: rebuild its travel from the feet, at this speed [m/s]",
    )
    parser.add_argument("--loop", type=count, default=1, metavar="N", help="repeat a loop N times")
    parser.add_argument(
        "--floor",
        choices=("auto", "level", "follow"),
        default="auto",
        help="floor of a recording: as its feet say, level, or drifting along with them: auto",
    )


def travel(text: str) -> str | float:
    """Return ``travel``, ``keep`` or a speed [m/s]."""
    if text in ("travel", "keep"):
        return text
    try:
        return positive(text)
    except argparse.ArgumentTypeError:
        raise argparse.ArgumentTypeError(
            f"'{text}' is not travel, keep or a speed in m/s such as 1.2"
        ) from None
