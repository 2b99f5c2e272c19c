"""MJCF from outside: judged by its text before MuJoCo compiles it, and the compiled model after.

MuJoCo makes what it is asked for: a heightfield of 100,000 × 100,000, a hundred million copies. It
takes NaN for a size, with a warning in a log file of its own. So the text is read first, with all
that it includes and the heads of the files that it names.
"""

from __future__ import annotations

import math
import re
import struct
import xml.parsers.expat
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np

from mjmotion.boundary.files import check_plain, file_bytes
from mjmotion.boundary.limits import (
    MOST_ASSET,
    MOST_COPIES,
    MOST_COUNT,
    MOST_DEPTH,
    MOST_ELEMENTS,
    MOST_LENGTH,
    MOST_MEMORY,
    MOST_MJCF,
    MOST_PIXELS,
    MOST_SAMPLES,
    MOST_SIDE,
    MOST_UNITS,
    at_most,
)
from mjmotion.boundary.words import first_line, one_line
from mjmotion.exceptions import MotionError

MUJOCO_ERRORS = (ValueError, OSError, RuntimeError, mujoco.FatalError)
"""What MuJoCo raises of a model that it cannot read, compile or write; which of them is its own."""

# Of these attributes the words are names, and may well be "nan".
_NAMES = re.compile(
    r"name|class|childclass|file.*|material|mesh|hfield|texture|site\d?|body\d?|joint\d?|geom\d?"
    r"|tendon\d?|actuator|model|prefix|target|objname|reftype|refname|plugin|instance|value|key"
    r"|.*dir|.*site|flexcomp|node|hclass|slidersite|cranksite|refsite|content_type|element"
)
# These are places or sizes [m]; elements that have other things under these names are left out.
_LENGTHS = ("pos", "fromto", "size", "offset")
_NOT_LENGTHS = ("compiler", "visual", "size", "key", "numeric", "texture", "light", "camera")
_COUNTED = ("count", "nrow", "ncol", "width", "height", "gridsize", "nsample")
_MEMORY = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40, "P": 1 << 50}


def check_mjcf(path: str | Path, error: type[MotionError]) -> None:
    """Refuse an MJCF file that asks for too much or holds numbers that are none.

    What is no XML at all is left to MuJoCo, which says so.

    Raises:
      MotionError: as ``error``: by element and line.
    """
    _Reader(error).read(Path(path), ())


def mjcf_files(path: str | Path, error: type[MotionError]) -> tuple[Path, ...]:
    """Return an MJCF file, and all files that it includes or names, in the order of their paths.

    Raises:
      MotionError: as ``error``: as :func:`check_mjcf`.
    """
    reader = _Reader(error)
    reader.read(Path(path), ())
    return tuple(sorted(reader.files))


class _Reader:
    """Goes through a file and those that it includes, and counts."""

    def __init__(self, error: type[MotionError]) -> None:
        self._error = error
        self._elements = 0
        self._points: Counter[str] = Counter()
        self.files: set[Path] = set()

    def read(self, path: Path, above: tuple[Path, ...]) -> None:
        self.files.add(path.resolve())
        data = file_bytes(path, "MJCF file", MOST_MJCF, self._error)
        if not data.strip():
            raise self._error(f"MJCF file '{path}' is empty")
        try:
            data.decode("utf-8")
        except UnicodeDecodeError as fault:
            line = data.count(b"\n", 0, fault.start) + 1
            raise self._error(
                f"'{path}' line {line}: it is not text in UTF-8: save it so"
            ) from None
        if path in above:
            raise self._error(f"'{path}' includes itself")
        if len(above) > MOST_DEPTH:
            raise self._error(f"'{path}' is included through more than {MOST_DEPTH} files")
        _File(self, path, above, self._error).parse(data)

    def points(self, tag: str, number: float, most: int, fault: str) -> None:
        """Count points of all heightfields, or all textures, of a file and what it includes."""
        self._points[tag] += int(number)
        at_most(self._points[tag], most, f"{fault}: points of every {tag}", self._error)

    def count(self, path: Path) -> None:
        self._elements += 1
        at_most(self._elements, MOST_ELEMENTS, f"'{path}' has too many elements", self._error)


class _File:
    """One file: a handler of its elements."""

    def __init__(
        self, reader: _Reader, path: Path, above: tuple[Path, ...], error: type[MotionError]
    ) -> None:
        self._reader, self._path, self._above, self._error = reader, path, above, error
        self._copies: list[float] = []
        self._folders: dict[str, Path] = {}
        self._xml = xml.parsers.expat.ParserCreate()
        self._xml.StartElementHandler = self._start
        self._xml.EndElementHandler = self._end
        self._xml.EntityDeclHandler = self._entity

    def parse(self, data: bytes) -> None:
        try:
            self._xml.Parse(data, True)
        except xml.parsers.expat.ExpatError as fault:
            if self._above:  # of what is included, MuJoCo does not say where it cannot be read
                why = xml.parsers.expat.ErrorString(fault.code)
                raise self._fault(f"it is not well-formed XML: {why}") from None
            return  # MuJoCo reads XML in its own way, and says where it cannot
        except (ValueError, LookupError):  # an encoding that is none
            return

    def _entity(self, name: str, *_: object) -> None:
        raise self._fault(f"declares the entity '{name}': MJCF has none")

    def _fault(self, what: str) -> MotionError:
        line = self._xml.CurrentLineNumber
        return self._error(one_line(f"'{self._path}' line {line}: {what}"))

    def _start(self, tag: str, attributes: Mapping[str, str]) -> None:
        self._reader.count(self._path)
        # How many times this element is there, through all replicates around it.
        around = self._copies[-1] if self._copies else 1.0
        own = math.prod(self._counts(tag, attributes)) if tag in _MAKING else 1.0
        self._copies.append(around * max(own, 1.0))
        if self._copies[-1] > MOST_COPIES:
            raise self._fault(
                f"{tag} makes {self._copies[-1]:,.0f} copies, at most {MOST_COPIES:,}"
            )
        if len(self._copies) > 8 * MOST_DEPTH:
            raise self._fault(f"elements within elements, more than {8 * MOST_DEPTH} deep")
        for name, text in attributes.items():
            self._check_numbers(tag, name, text)
        if tag == "compiler":
            for name in ("assetdir", "meshdir", "texturedir"):
                if name in attributes:
                    self._folders[name] = self._path.parent / attributes[name]
        if tag == "hfield":
            self._check_grid(tag, attributes, ("nrow", "ncol"), MOST_SAMPLES)
        if tag == "texture":
            self._check_grid(tag, attributes, ("width", "height"), MOST_PIXELS)
        if tag == "size":
            self._check_sizes(attributes)
        for name, file in attributes.items():
            if name.startswith("file") and file:
                self._check_file(tag, file)

    def _end(self, _: str) -> None:
        self._copies.pop()

    def _counts(self, tag: str, attributes: Mapping[str, str]) -> list[float]:
        found = []
        for word in attributes.get("count", "1").split():
            try:
                found.append(abs(float(word)))
            except ValueError:
                raise self._fault(f"{tag} has count '{word}', which is no number") from None
        return found

    def _check_numbers(self, tag: str, name: str, text: str) -> None:
        """Refuse NaN, infinity, and lengths or counts beyond their bounds."""
        words = str(self._fault(f"words in {name} of {tag}"))
        at_most(text.count(" "), MOST_SAMPLES, words, self._error)
        if _NAMES.fullmatch(name):
            return
        try:
            values = np.array(text.split(), dtype=np.float64)
        except (ValueError, OverflowError):
            return  # words, or something that MuJoCo refuses
        if not np.isfinite(values).all():
            raise self._fault(f"{name} of {tag} is '{text[:60]}': numbers must be finite")
        largest = float(np.abs(values).max(initial=0.0))
        if name in _LENGTHS and tag not in _NOT_LENGTHS:
            at_most(largest, MOST_LENGTH, str(self._fault(f"{name} of {tag} in m")), self._error)
        if name == "vertex":  # of a mesh, in its own unit
            at_most(largest, MOST_UNITS, str(self._fault(f"vertex of {tag}")), self._error)
        if name in _COUNTED:
            at_most(largest, MOST_COUNT, str(self._fault(f"{name} of {tag}")), self._error)

    def _check_grid(
        self, tag: str, attributes: Mapping[str, str], sides: tuple[str, str], most: int
    ) -> None:
        try:
            rows, columns = (float(attributes.get(name, "0")) for name in sides)
        except ValueError:
            return
        if tag == "texture" and max(rows, columns) > MOST_SIDE:
            raise self._fault(f"{tag} of {rows:.0f} x {columns:.0f}: at most {MOST_SIDE:,} a side")
        # A cube has six faces of the width given; MuJoCo does not ask for its height.
        cube = tag == "texture" and attributes.get("type", "cube") != "2d"
        number = 6 * rows * rows if cube else rows * columns
        if number > most:
            raise self._fault(
                f"{tag} of {rows:.0f} x {columns:.0f}: at most {most:,} points can be"
            )
        self._reader.points(tag, max(number, 0.0), most, str(self._fault(tag)))

    def _check_sizes(self, attributes: Mapping[str, str]) -> None:
        for name, text in attributes.items():
            match = re.fullmatch(r"\s*(-?\d{1,30})\s*([KMGTP]?)\s*", text, re.IGNORECASE)
            if match is None:
                continue
            value = int(match[1]) * _MEMORY[match[2].upper()]
            most = MOST_MEMORY if name in ("memory", "nstack") else MOST_COUNT
            at_most(value, most, str(self._fault(f"{name} of size")), self._error)

    def _check_file(self, tag: str, file: str) -> None:
        """Judge a file that is named by its size and head, wherever it is among the folders."""
        folder = self._path.parent
        places = [folder / file, *(place / file for place in self._folders.values())]
        for place in places:
            try:
                if not place.exists():
                    continue  # it may be in another of them; where it is in none, MuJoCo says so
                size = check_plain(place, "file", self._error)
                with place.open("rb") as opened:
                    head = opened.read(32)
            except (OSError, ValueError) as error:
                raise self._fault(f"'{file}' cannot be read: {first_line(error)}") from None
            except self._error as error:
                raise self._fault(str(error)) from None
            self._reader.files.add(place.resolve())
            if size > MOST_ASSET:
                raise self._fault(
                    f"'{file}' has {size:,} bytes: at most {MOST_ASSET:,} can be read"
                )
            if tag in ("include", "model", "attach"):
                self._reader.read(place.resolve(), (*self._above, self._path.resolve()))
            elif head.startswith(b"\x89PNG") and len(head) >= 24:
                width, height = struct.unpack(">II", head[16:24])
                most = MOST_SAMPLES if tag == "hfield" else MOST_PIXELS
                if width * height > most:
                    raise self._fault(f"'{file}' is {width} x {height}: at most {most:,} pixels")
                if tag == "texture" and max(width, height) > MOST_SIDE:
                    raise self._fault(
                        f"'{file}' is {width} x {height}: at most {MOST_SIDE:,} a side"
                    )
                self._reader.points(tag, width * height, most, str(self._fault(tag)))
            elif tag == "hfield" and len(head) >= 8:
                self._check_heights(file, head, size, place)

    def _check_heights(self, file: str, head: bytes, size: int, place: Path) -> None:
        rows, columns = struct.unpack("<ii", head[:8])
        if rows < 1 or columns < 1 or size != 8 + 4 * rows * columns:
            raise self._fault(
                f"'{file}' has {size:,} bytes, not those of {rows} x {columns} heights"
            )
        at_most(rows * columns, MOST_SAMPLES, str(self._fault(f"heights of '{file}'")), self._error)
        self._reader.points("hfield", rows * columns, MOST_SAMPLES, str(self._fault("hfield")))
        heights = np.fromfile(place, dtype="<f4", offset=8)
        if len(bad := np.flatnonzero(~np.isfinite(heights))):
            where = f"row {bad[0] // columns}, column {bad[0] % columns}"
            raise self._fault(f"'{file}' is not finite at {where}: fill the gaps")


_MAKING = ("replicate", "composite", "flexcomp")

# What of a compiled model must be finite, and within MOST_LENGTH where it is a length.
_PLACES = ("body_pos", "geom_pos", "site_pos", "jnt_pos", "geom_size", "site_size", "hfield_size")
_FINITE = ("geom_quat", "body_quat", "site_quat", "jnt_axis", "jnt_range", "hfield_data", "qpos0")


def check_model(model: mujoco.MjModel, what: str, error: type[MotionError]) -> None:
    """Refuse a compiled model whose places and sizes are not finite or beyond all bounds.

    Raises:
      MotionError: as ``error``: by the kind of the element and its name.
    """
    for field in (*_PLACES, *_FINITE):
        values = np.asarray(getattr(model, field))
        bad = ~np.isfinite(values)
        if field in _PLACES:
            bad |= np.abs(values) > MOST_LENGTH
        if bad.any():
            index = int(np.argwhere(bad)[0][0])
            kind, _, part = field.partition("_")
            of = {"jnt": "joint"}.get(kind, kind)
            named = _name(model, of, index) if field not in ("hfield_data", "qpos0") else ""
            raise error(
                f"{what}: {part or field} of {of}{named} is not finite or beyond"
                f" {MOST_LENGTH:,.0f} m: mend it"
            )


def _name(model: mujoco.MjModel, kind: str, index: int) -> str:
    name = getattr(model, kind)(index).name
    return f" '{name}'" if name else f" {index}"
