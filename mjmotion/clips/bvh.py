"""Reader for BVH, the Biovision hierarchy: any channel order, position channels on any joint.

``docs/decisions.md`` says why this is the project's own and not one of the readers on PyPI.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mjmotion.boundary.limits import (
    MOST_FRAMES,
    MOST_JOINTS,
    MOST_NAME,
    MOST_POSES,
    MOST_UNITS,
    at_most,
)
from mjmotion.clips.skeleton import (
    Clip,
    axis_rotations,
    check_skeleton_size,
    checked_rate,
    pose_skeleton,
    read_lines,
)
from mjmotion.exceptions import ClipError

_CHANNELS = {f"{axis}{kind}" for axis in "xyz" for kind in ("position", "rotation")}


_COUNTS = tuple("0123456")


class _Hierarchy:
    """What the part of the file before MOTION says."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.parents: list[int] = []
        self.offsets: list[list[float]] = []
        self.channels: list[list[str]] = []
        self.ends: dict[str, NDArray[np.float64]] = {}


def read_bvh(path: str | Path, *, fps: float | None = None) -> Clip:
    """Read a BVH file.

    Args:
      path: the file.
      fps: frames a second in place of the file's frame time, be that right, wrong or missing.

    Returns:
      The clip in the file's own units and axes.

    Raises:
      ClipError: the file is missing, truncated or malformed: one line, with the line number.
    """
    lines = read_lines(path, "BVH")
    at = next((n for n, line in enumerate(lines) if line.strip().upper() == "MOTION"), None)
    check_skeleton_size(path, lines[:at])
    tokens = _tokens(lines[:at])
    if not tokens or tokens[0][0].upper() != "HIERARCHY":
        raise ClipError(f"'{path}' is not a BVH file: it does not begin with HIERARCHY")
    tree = _HierarchyParser(path, tokens).parse()
    if at is None:
        raise ClipError(f"'{path}' ends before MOTION: the file is cut off, export it again")
    nchannel = sum(len(names) for names in tree.channels)
    values, rate = _read_motion(path, lines, at, nchannel, fps)
    at_most(len(values) * len(tree.names), MOST_POSES, f"joints x frames of '{path}'", ClipError)
    offsets = np.array(tree.offsets)
    translations = np.broadcast_to(offsets, (len(values), *offsets.shape)).copy()
    local = np.broadcast_to(np.eye(3), (*translations.shape, 3)).copy()
    column = 0
    for joint, names in enumerate(tree.channels):
        for channel in names:
            data, axis = values[:, column], channel[0]
            if channel.endswith("position"):
                translations[:, joint, "xyz".index(axis)] = data
            else:
                local[:, joint] = local[:, joint] @ axis_rotations(axis, np.radians(data))
            column += 1
    parents = np.array(tree.parents)
    return pose_skeleton(
        str(path), tuple(tree.names), parents, offsets, translations, local, rate, tree.ends
    )


def _tokens(lines: list[str]) -> list[tuple[str, int]]:
    """Return the words of the lines with their line numbers; braces are words of their own."""
    return [
        (word, number)
        for number, line in enumerate(lines, 1)
        for word in line.replace("{", " { ").replace("}", " } ").split()
    ]


class _HierarchyParser:
    """Reads the tree of joints, keyword by keyword.

    Args:
      path: the file, for messages.
      tokens: the words before MOTION with their line numbers, HIERARCHY first.
    """

    def __init__(self, path: str | Path, tokens: list[tuple[str, int]]) -> None:
        self._path, self._tokens = path, tokens
        self._at = 1  # the next word
        self._open: list[int] = []  # joints whose braces are open; -1 stands for an End Site
        self._tree = _Hierarchy()
        self._seen: set[str] = set()  # names of joints

    def parse(self) -> _Hierarchy:
        """Return the tree."""
        while self._at < len(self._tokens):
            word = self._take(1)[0]
            match word.upper():
                case "ROOT" | "JOINT":
                    self._joint(word)
                case "END":
                    self._end_site()
                case "OFFSET":
                    self._offset()
                case "CHANNELS":
                    self._channels()
                case "}":
                    self._close()
                case _:
                    raise self._error(f"'{word}' is not expected here (a wrong channel count?)")
        if not self._tree.names:
            raise ClipError(f"'{self._path}' has no ROOT: it is not a complete BVH file")
        if self._open:
            raise self._cut_off()
        return self._tree

    def _joint(self, word: str) -> None:
        tree, root = self._tree, word.upper() == "ROOT"
        if root == bool(tree.names):
            raise self._error("a second ROOT" if root else f"'{word}' comes before any ROOT")
        if not root and not self._in_joint():
            raise self._error("a JOINT outside its parent")
        at_most(len(tree.names), MOST_JOINTS, f"joints of '{self._path}'", ClipError)
        tree.parents.append(self._open[-1] if self._open else -1)
        name = self._name()
        if name in self._seen:
            raise self._error(f"a second joint '{name[:MOST_NAME]}'")
        self._seen.add(name)
        tree.names.append(name)
        tree.offsets.append([0.0, 0.0, 0.0])
        tree.channels.append([])
        self._open.append(len(tree.names) - 1)

    def _end_site(self) -> None:
        self._name()
        if not self._in_joint():
            raise self._error("an End Site outside a joint")
        self._open.append(-1)

    def _offset(self) -> None:
        try:
            offset = [float(number) for number in self._take(3)]
        except ValueError:
            raise self._error("OFFSET needs three numbers") from None
        if not self._open or not np.isfinite(offset).all():
            raise self._error("an OFFSET that is not finite or belongs to no joint")
        if max(map(abs, offset)) > MOST_UNITS:
            raise self._error(f"an OFFSET beyond {MOST_UNITS:g} units")
        if self._in_joint():
            self._tree.offsets[self._open[-1]] = offset
        else:
            parent = self._tree.names[self._open[-2]]
            self._tree.ends[parent] = np.array(offset)

    def _channels(self) -> None:
        count = self._take(1)[0]
        if count not in _COUNTS or not self._in_joint():
            raise self._error("CHANNELS needs a count from 0 to 6 and a joint")
        if self._tree.channels[self._open[-1]]:
            raise self._error("a second CHANNELS of one joint")
        names = [name.lower() for name in self._take(int(count))]
        if not set(names) <= _CHANNELS or len(set(names)) < len(names):
            raise self._error(
                f"CHANNELS {count} is followed by {' '.join(names)}, not {count} channels"
            )
        self._tree.channels[self._open[-1]] = names

    def _close(self) -> None:
        if not self._open:
            raise self._error("a } too many")
        self._open.pop()

    def _in_joint(self) -> bool:
        """Return whether the innermost open braces are a joint's, not an End Site's."""
        return bool(self._open) and self._open[-1] >= 0

    def _name(self) -> str:
        """Take the words up to the next brace, and the brace."""
        words = []
        while self._at < len(self._tokens) and self._tokens[self._at][0] != "{":
            words += self._take(1)
        self._take(1)
        return " ".join(words)

    def _take(self, count: int) -> list[str]:
        """Return the next words and go past them."""
        start = self._at
        if start + count > len(self._tokens):
            raise self._cut_off()
        self._at += count
        return [word for word, _ in self._tokens[start : self._at]]

    def _error(self, what: str) -> ClipError:
        """Return an error at the word last taken."""
        line = self._tokens[self._at - 1][1]
        return ClipError(f"'{self._path}' line {line}: {what}: mend the file or export it again")

    def _cut_off(self) -> ClipError:
        return ClipError(
            f"'{self._path}' ends inside its HIERARCHY: the file is cut off, export it again"
        )


def _read_motion(
    path: str | Path, lines: list[str], at: int, nchannel: int, fps: float | None
) -> tuple[NDArray[np.float64], float]:
    """Return the values (nframe, nchannel) and the rate from the lines after MOTION."""
    body = [(n, line.split()) for n, line in enumerate(lines[at + 1 : at + 20], at + 2)]
    body = [(n, words) for n, words in body if words][:2]
    try:
        start, frames = body[0]
        if frames[0].lower() != "frames:":
            raise ValueError
        nframe, frame_time = int(frames[1]), float("nan")
        if len(body) > 1 and [word.lower() for word in body[1][1][:2]] == ["frame", "time:"]:
            start, rate = body[1]
            frame_time = float(rate[2]) if fps is None else frame_time
        elif fps is None:
            raise ValueError
        at_most(nframe, MOST_FRAMES, f"frames of '{path}'", ClipError)
    except (ValueError, IndexError):
        raise ClipError(
            f"'{path}' line {at + 1}: MOTION needs 'Frames: N' and 'Frame Time: S': mend the file,"
            " or give the rate as --fps"
        ) from None
    if nframe <= 0:
        raise ClipError(f"'{path}' has no frames: export the clip again with its motion")
    if fps is None and not (np.isfinite(frame_time) and frame_time > 0):
        raise ClipError(
            f"'{path}' has a frame time of {frame_time} s: it must be positive; give the rate as"
            " --fps"
        )
    rows = [line for line in lines[start:] if line.strip()]
    if len(rows) < nframe:
        raise ClipError(
            f"'{path}' has {len(rows)} of its {nframe} frames: the file is cut off, export it again"
        )
    if len(rows) > nframe:
        raise ClipError(
            f"'{path}' says 'Frames: {nframe}' and has {len(rows)}: correct the number or the rows"
        )
    try:
        values = np.loadtxt(rows[:nframe], ndmin=2, comments=None)
        wrong = None if values.shape[1] == nchannel else 0
    except ValueError:
        values = np.zeros((0, 0))
        wrong = next((n for n, row in enumerate(rows) if len(row.split()) != nchannel), -1)
    if wrong == -1:
        raise ClipError(f"'{path}' has a value in its frames that is not a number: mend the file")
    if wrong is not None:
        raise ClipError(
            f"'{path}' frame {wrong} has {len(rows[wrong].split())} values, its joints have"
            f" {nchannel} channels: mend the file or export it again",
            (wrong,),
        )
    if fps is not None:
        return values, fps
    # A frame time is written with few digits (0.0083333): snap to the whole rate it stands for.
    rate_said = checked_rate(str(path), 1 / frame_time)
    whole = abs(rate_said - round(rate_said)) < 1e-4 * rate_said
    return values, float(round(rate_said)) if whole else rate_said
