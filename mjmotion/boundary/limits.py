"""Every bound on what comes in, by name: beyond it, an input is nonsense and not merely large.

Each is well beyond what motions and scenes are, and low enough that nothing takes more than about
5 s or 1 GB before it is refused.
"""

from __future__ import annotations

import math
import numbers
from typing import TYPE_CHECKING, Any

from mjmotion.exceptions import MotionError

if TYPE_CHECKING:  # the command line reads the bounds for its help, which needs no numpy
    import numpy as np
    from numpy.typing import NDArray

LEAST_RATE, MOST_RATE = 1.0, 1000.0
"""Frames a second."""
MOST_FRAMES = 200_000
"""Frames of a motion: half an hour at 120 a second."""
MOST_JOINTS = 2_000
"""Joints of a recorded skeleton."""
MOST_POSES = 10_000_000
"""Joints times frames of a recording: each takes 200 bytes while it is read."""
MOST_LENGTH = 1e4
"""Where anything may be, and how large [m]."""
MOST_UNITS = 1e8
"""Lengths in a recording's own unit, which may be a tenth of a millimetre."""
MOST_ANGLE = 1e4
"""Of a joint [rad]; a recording's may be in degrees, and wind up."""
MOST_TEXT = 128 << 20
"""Of a recording as text [bytes]."""
MOST_LINES = 3_000_000
"""Of a recording as text: an AMC file has one a bone and frame."""
MOST_LINE = 1 << 20
"""Letters of one line of a recording: all channels of a frame."""
MOST_SKELETON = 4 << 20
"""Letters of what tells a recording's skeleton."""
MOST_NAME = 256
"""Letters of a joint's name."""
MOST_BINARY = 256 << 20
"""Of a recording that is no text [bytes]."""
MOST_MESH = 64 << 20
"""Of a mesh that a ground is made of [bytes]."""
MOST_DIRECTORY = 1 << 20
"""Of the list of what is in an archive [bytes]."""
MOST_STRUCTURED = 16 << 20
"""Of a JSON file [bytes]."""
MOST_YAML = 512 << 10
"""Of a YAML file [bytes]: its reader takes seconds for a million."""
MOST_VALUES = 2_000_000
"""Of a JSON file."""
MOST_MJCF = 32 << 20
"""Of an MJCF file [bytes]."""
MOST_ASSET = 512 << 20
"""Of one file that an MJCF file names [bytes]."""
MOST_DEPTH = 64
"""Lists within lists, or elements within elements."""
MOST_NODES = 1_000_000
"""Values of a structured file, its aliases followed."""
MOST_DIGITS = 400
"""Of one number; the largest double has 309."""
MOST_UNPACKED = 256 << 20
"""Of an archive's arrays, unpacked [bytes]."""
MOST_SAMPLES = 4_000_000
"""Of a heightfield, and of all that a scene has."""
MOST_PIXELS = 64_000_000
"""Of an image, and of all textures of a scene."""
MOST_SIDE = 16_384
"""Of a texture [pixels]: graphics cards take no larger one."""
MOST_COPIES = 10_000
"""Elements that one replicate or composite of a scene makes, those within each other multiplied."""
MOST_ELEMENTS = 20_000
"""Of an MJCF file with all that it includes."""
MOST_COUNT = 1_000_000
"""Of anything else that a file counts."""
MOST_MEMORY = 1 << 30
"""That a scene may reserve for the engine [bytes]."""
LEAST_PICTURE, MOST_PICTURE = 64, 7680
"""Width and height of a video [pixels]."""
MOST_LEVELS = 16
"""Levels of a fit."""
LEAST_KNOT, MOST_KNOT = 0.5, 1e5
"""Frames a knot."""
MOST_TOLERANCE = 1000.0
"""Of a fit [mm]."""
MOST_RIGIDITY = 1e6
"""How much more a joint resists than by itself."""
MOST_EDITS = 1_000
"""Of a session: each takes a fit to make again."""
MOST_PAUSE = 60.0
"""Between two keys of an animation [s]."""
MOST_SCENE_PARTS = 2_000
"""Steps, blocks or doorways of a scene that we build."""


def real_number(value: object, what: str, error: type[MotionError] = MotionError) -> float:
    """Return a number as float.

    Raises:
      MotionError: as ``error``: it is text, a boolean, complex, empty, or not finite.
    """
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise error(f"{what} is {shown(value)}: it must be a number")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise error(f"{what} is {shown(value)}: it must be a finite number")
    return number


def rate(value: object, what: str, error: type[MotionError] = MotionError) -> float:
    """Return a rate [frames a second].

    Raises:
      MotionError: as ``error``: it is no number, not positive, or not of a motion.
    """
    fps = real_number(value, what, error)
    if not fps > 0:
        raise error(f"{what} is {fps:g}: it must be a positive number")
    if not LEAST_RATE <= fps <= MOST_RATE:
        raise error(
            f"{what} is {fps:.6g} frames a second: from {LEAST_RATE:g} to {MOST_RATE:g} can be read"
        )
    return fps


def at_most(value: float, most: float, what: str, error: type[MotionError] = MotionError) -> None:
    """Refuse what is larger than a bound.

    Raises:
      MotionError: as ``error``: by name, with the bound.
    """
    if not value <= most:
        raise error(f"{what}: {value:,.10g}, and at most {most:,.10g} can be")


def real_array(
    value: object, what: str, error: type[MotionError] = MotionError
) -> NDArray[np.float64]:
    """Return an array of real numbers as float64.

    Raises:
      MotionError: as ``error``: it holds text, booleans, complex numbers, records or objects.
    """
    import numpy as np

    try:
        array = np.asarray(value)
    except ValueError:
        raise error(f"{what} has rows of different lengths") from None
    if array.dtype.kind not in "fiu":
        kinds = {"b": "booleans", "c": "complex numbers", "U": "text", "S": "text", "V": "records"}
        held = kinds.get(array.dtype.kind, "other things")
        raise error(f"{what} holds {held}: it must hold real numbers")
    with np.errstate(over="ignore"):
        return array.astype(np.float64)


def whole_number(value: object, what: str, error: type[MotionError] = MotionError) -> int:
    """Return a whole number.

    Raises:
      MotionError: as ``error``: it is anything else, or beyond :data:`MOST_COUNT`.
    """
    if type(value) is not int:
        raise error(f"{what} is {shown(value)}: it must be a whole number")
    if abs(value) > MOST_COUNT:
        raise error(f"{what} is {shown(value)}: at most {MOST_COUNT:,} can be")
    return value


def shown(value: Any, most: int = 40) -> str:
    """Return a value as short text for a message, however large it is."""
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "nothing"}[value]
    if isinstance(value, int):
        if value.bit_length() > 128:
            return f"a number of about {int(value.bit_length() * 0.30103) + 1} digits"
        return str(value)
    if isinstance(value, numbers.Number):
        return str(value)
    if isinstance(value, (str, bytes)):
        text = repr(value[: most + 1])
        return text if len(value) <= most else text[:most] + "…'"
    if isinstance(value, (list, tuple)):
        return "a list"
    return "a mapping" if isinstance(value, dict) else f"a {type(value).__name__}"
