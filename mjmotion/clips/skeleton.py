"""A clip: a recorded motion on its own skeleton, in its file's own units and axes."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mjmotion.boundary.files import file_bytes
from mjmotion.boundary.limits import (
    LEAST_RATE,
    MOST_FRAMES,
    MOST_LINE,
    MOST_LINES,
    MOST_NAME,
    MOST_RATE,
    MOST_SKELETON,
    MOST_TEXT,
    MOST_UNITS,
    at_most,
)
from mjmotion.exceptions import ClipError, frame_list

# Bytes that are letters of Shift-JIS and rare signs of Western texts.
_KANA = range(0x81, 0xA0)


@dataclasses.dataclass(frozen=True, eq=False)
class Clip:
    """Frames of a skeleton as read from a file; nothing is scaled or turned.

    Attributes:
      name: where the clip came from, for messages.
      joint_names: (njoint) names, parents before children.
      parents: (njoint,) index of each joint's parent, -1 for the root.
      offsets: (njoint, 3) each joint's rest position relative to its parent.
      positions: (nframe, njoint, 3) global joint positions.
      rotations: (nframe, njoint, 3, 3) global rotations; identity at rest.
      fps: frames a second.
      ends: joint name to (3,) offset of the end of a last bone, in that joint's frame.
    """

    name: str
    joint_names: tuple[str, ...]
    parents: NDArray[np.int64]
    offsets: NDArray[np.float64]
    positions: NDArray[np.float64]
    rotations: NDArray[np.float64]
    fps: float
    ends: Mapping[str, NDArray[np.float64]]

    @property
    def nframe(self) -> int:
        """Number of frames."""
        return len(self.positions)

    @property
    def rest_positions(self) -> NDArray[np.float64]:
        """(njoint, 3) joint positions when every rotation is the identity."""
        rest = np.array(self.offsets)
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                rest[joint] += rest[parent]
        return rest

    def __post_init__(self) -> None:
        """Refuse names that are none."""
        longest = max(map(len, self.joint_names), default=0)
        at_most(longest, MOST_NAME, f"letters of a joint's name in '{self.name}'", ClipError)

    def index(self, joint: str) -> int:
        """Return the index of a joint by name.

        Raises:
          ClipError: there is no such joint.
        """
        if joint not in self.joint_names:
            raise ClipError(f"'{self.name}' has no joint '{joint}': see its joint_names")
        return self.joint_names.index(joint)

    def end_positions(self, joint: str) -> NDArray[np.float64]:
        """Return (nframe, 3) global positions of the end site of ``joint``."""
        at = self.index(joint)
        return self.positions[:, at] + self.rotations[:, at] @ self.ends[joint]

    def at_rate(self, fps: float) -> Clip:
        """Return the same frames at another rate.

        Raises:
          ClipError: no recording has such a rate.
        """
        return dataclasses.replace(self, fps=checked_rate(self.name, fps))

    def cut(self, start: int, end: int) -> Clip:
        """Return frames ``start`` up to, not including, ``end``."""
        return dataclasses.replace(
            self, positions=self.positions[start:end], rotations=self.rotations[start:end]
        )


def pose_skeleton(
    name: str,
    joint_names: tuple[str, ...],
    parents: NDArray[np.int64],
    offsets: NDArray[np.float64],
    translations: NDArray[np.float64],
    local: NDArray[np.float64],
    fps: float,
    ends: Mapping[str, NDArray[np.float64]],
) -> Clip:
    """Run forward kinematics and return the clip.

    Args:
      name: for messages.
      joint_names: (njoint) names, parents before children.
      parents: (njoint,) parent indices.
      offsets: (njoint, 3) rest offsets.
      translations: (nframe, njoint, 3) positions relative to the parent, in the parent's frame.
      local: (nframe, njoint, 3, 3) rotations relative to the parent.
      fps: frames a second.
      ends: end sites.

    Raises:
      ClipError: no frames, values that are not finite, or a rate that no recording has.
    """
    if len(local) == 0:
        raise ClipError(f"'{name}' has no frames: export the clip again with its motion")
    finite = np.isfinite(translations).all(axis=(1, 2)) & np.isfinite(local).all(axis=(1, 2, 3))
    if not finite.all():
        bad = np.flatnonzero(~finite)
        raise ClipError(
            f"'{name}' has values that are not finite at frames {frame_list(bad.tolist())}:"
            " mend the file",
            bad.tolist(),
        )
    fps = checked_rate(name, fps)
    at_most(len(local), MOST_FRAMES, f"frames of '{name}'", ClipError)
    far = np.flatnonzero((np.abs(translations) > MOST_UNITS).any(axis=(1, 2)))
    if len(far):
        raise ClipError(
            f"'{name}' has lengths beyond {MOST_UNITS:g} units at frames"
            f" {frame_list(far.tolist())}: mend the file",
            far.tolist(),
        )
    positions, rotations = np.empty_like(translations), np.empty_like(local)
    for joint, parent in enumerate(parents):
        if parent < 0:
            positions[:, joint], rotations[:, joint] = translations[:, joint], local[:, joint]
        else:
            turn = rotations[:, parent]
            shift = (turn @ translations[:, joint, :, None])[..., 0]
            positions[:, joint] = positions[:, parent] + shift
            rotations[:, joint] = turn @ local[:, joint]
    return Clip(name, joint_names, parents, offsets, positions, rotations, float(fps), dict(ends))


def checked_rate(name: str, fps: float) -> float:
    """Return frames a second, as they are.

    Raises:
      ClipError: no recording has such a rate.
    """
    if not LEAST_RATE <= fps <= MOST_RATE:
        raise ClipError(
            f"'{name}' has a rate of {fps:g} frames a second: give the right one as --fps, from"
            f" {LEAST_RATE:g} to {MOST_RATE:g}"
        )
    return float(fps)


def axis_rotations(axis: str, angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (..., 3, 3) rotations about the axis ``"x"``, ``"y"`` or ``"z"`` by angles [rad]."""
    first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    result = np.zeros((*angles.shape, 3, 3))
    result[..., range(3), range(3)] = 1.0
    cos, sin = np.cos(angles), np.sin(angles)
    result[..., first, first] = result[..., second, second] = cos
    result[..., first, second], result[..., second, first] = -sin, sin
    return result


def read_lines(path: str | Path, kind: str) -> list[str]:
    """Return the lines of a clip file, be it in Unicode, Shift-JIS or a Western code page.

    Raises:
      ClipError: the file is missing, not readable, not text, or has too many or too long lines.
    """
    text = _decoded(file_bytes(path, f"{kind} file", MOST_TEXT, ClipError))
    if text is None:
        raise ClipError(f"'{path}' is not a {kind} file: it is not text")
    if not text.strip():
        raise ClipError(f"{kind} file '{path}' is empty: export the clip again")
    if "\r" in text:
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    at_most(text.count("\n"), MOST_LINES, f"lines of '{path}'", ClipError)
    lines = text.split("\n")
    longest = max(lines, key=len)
    if len(longest) > MOST_LINE:
        raise ClipError(
            f"'{path}' line {lines.index(longest) + 1} has {len(longest):,} letters, and at most"
            f" {MOST_LINE:,} can be: it is no {kind} file"
        )
    return lines


def check_skeleton_size(path: str | Path, lines: Sequence[str]) -> None:
    """Refuse lines that would tell a skeleton, and are far too many letters for one.

    Raises:
      ClipError: by the file, with the bound.
    """
    letters = sum(map(len, lines))
    at_most(letters, MOST_SKELETON, f"letters of the skeleton in '{path}'", ClipError)


def _decoded(data: bytes) -> str | None:
    """Return bytes as text, or None where they are none."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        encodings = ["utf-16"]
    elif b"\0" in data:
        encodings = ["utf-8-sig"]
    else:
        letters = np.frombuffer(data, np.uint8)
        kana = (letters >= _KANA.start) & (letters < _KANA.stop)
        japanese = 4 * int(kana.sum()) > int((letters >= 0x80).sum())
        encodings = ["utf-8-sig", *(["cp932"] if japanese else []), "cp1252", "latin-1"]
    for encoding in encodings:
        try:
            return data.decode(encoding)
        except UnicodeDecodeError:
            continue
    return None
