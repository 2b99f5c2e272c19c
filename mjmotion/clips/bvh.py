"""Reader for BVH, the Biovision hierarchy: any channel order, position channels on any joint.

``docs/decisions.md`` says why this is the project's own and not one of the readers on PyPI.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mjmotion.clips.skeleton import Clip, axis_rotations, pose_skeleton, read_text
from mjmotion.exceptions import ClipError

_CHANNELS = {f"{axis}{kind}" for axis in "xyz" for kind in ("position", "rotation")}


class _Hierarchy:
    """What the part of the file before MOTION says."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.parents: list[int] = []
        self.offsets: list[list[float]] = []
        self.channels: list[list[str]] = []
        self.ends: dict[str, NDArray[np.float64]] = {}


def read_bvh(path: str | Path) -> Clip:
    """Read a BVH file.

    Args:
      path: the file.

    Returns:
      The clip in the file's own units and axes.

    Raises:
      ClipError: the file is missing, truncated or malformed: one line, with the line number.
    """
    lines = read_text(str(path), "BVH").splitlines()
    at = next((n for n, line in enumerate(lines) if line.strip().upper() == "MOTION"), None)
    tokens = _tokens(lines[:at])
    if not tokens or tokens[0][0].upper() != "HIERARCHY":
        raise ClipError(f"'{path}' is not a BVH file: it does not begin with HIERARCHY")
    tree = _read_hierarchy(path, tokens)
    if at is None:
        raise ClipError(f"'{path}' ends before MOTION: the file is cut off, export it again")
    nchannel = sum(len(names) for names in tree.channels)
    values, fps = _read_motion(path, lines, at, nchannel)
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
        str(path), tuple(tree.names), parents, offsets, translations, local, fps, tree.ends
    )


def _tokens(lines: list[str]) -> list[tuple[str, int]]:
    """Return the words of the lines with their line numbers; braces are words of their own."""
    return [
        (word, number)
        for number, line in enumerate(lines, 1)
        for word in line.replace("{", " { ").replace("}", " } ").split()
    ]


def _read_hierarchy(path: str | Path, tokens: list[tuple[str, int]]) -> _Hierarchy:
    """Read the tree of joints."""
    tree = _Hierarchy()
    open_joints: list[int] = []  # joints whose braces are open; -1 stands for an End Site
    at = 1

    def take(count: int) -> list[str]:
        nonlocal at
        if at + count > len(tokens):
            raise ClipError(
                f"'{path}' ends inside its HIERARCHY: the file is cut off, export it again"
            )
        at += count
        return [word for word, _ in tokens[at - count : at]]

    def fail(what: str) -> ClipError:
        line = tokens[min(at, len(tokens)) - 1][1]
        return ClipError(f"'{path}' line {line}: {what}: mend the file or export it again")

    def name_of_joint() -> str:
        words = []
        while at < len(tokens) and tokens[at][0] != "{":
            words += take(1)
        take(1)
        return " ".join(words)

    while at < len(tokens):
        word = take(1)[0]
        key = word.upper()
        if key in ("ROOT", "JOINT"):
            if (key == "ROOT") == bool(tree.names):
                raise fail("a second ROOT" if tree.names else f"'{word}' comes before any ROOT")
            if key == "JOINT" and (not open_joints or open_joints[-1] < 0):
                raise fail("a JOINT outside its parent")
            tree.parents.append(open_joints[-1] if open_joints else -1)
            tree.names.append(name_of_joint())
            tree.offsets.append([0.0, 0.0, 0.0])
            tree.channels.append([])
            open_joints.append(len(tree.names) - 1)
        elif key == "END":
            name_of_joint()
            if not open_joints or open_joints[-1] < 0:
                raise fail("an End Site outside a joint")
            open_joints.append(-1)
        elif key == "OFFSET":
            try:
                offset = [float(number) for number in take(3)]
            except ValueError:
                raise fail("OFFSET needs three numbers") from None
            if not open_joints or not np.isfinite(offset).all():
                raise fail("an OFFSET that is not finite or belongs to no joint")
            if open_joints[-1] < 0:
                tree.ends[tree.names[open_joints[-2]]] = np.array(offset)
            else:
                tree.offsets[open_joints[-1]] = offset
        elif key == "CHANNELS":
            count = take(1)[0]
            if not count.isdigit() or not open_joints or open_joints[-1] < 0:
                raise fail("CHANNELS needs a count and a joint")
            names = [name.lower() for name in take(int(count))]
            if not set(names) <= _CHANNELS:
                raise fail(
                    f"CHANNELS {count} is followed by {' '.join(names)}, not {count} channels"
                )
            tree.channels[open_joints[-1]] = names
        elif key == "}":
            if not open_joints:
                raise fail("a } too many")
            open_joints.pop()
        else:
            raise fail(f"'{word}' is not expected here (a wrong channel count?)")
    if not tree.names:
        raise ClipError(f"'{path}' has no ROOT: it is not a complete BVH file")
    if open_joints:
        raise ClipError(f"'{path}' ends inside its HIERARCHY: the file is cut off, export it again")
    return tree


def _read_motion(
    path: str | Path, lines: list[str], at: int, nchannel: int
) -> tuple[NDArray[np.float64], float]:
    """Return the values (nframe, nchannel) and the rate from the lines after MOTION."""
    body = [(n, line.split()) for n, line in enumerate(lines[at + 1 : at + 20], at + 2)]
    body = [(n, words) for n, words in body if words][:2]
    try:
        (_, frames), (start, rate) = body
        if frames[0].lower() != "frames:" or [w.lower() for w in rate[:2]] != ["frame", "time:"]:
            raise ValueError
        nframe, frame_time = int(frames[1]), float(rate[2])
    except (ValueError, IndexError):
        raise ClipError(
            f"'{path}' line {at + 1}: MOTION needs 'Frames: N' and 'Frame Time: S': mend the file"
        ) from None
    if nframe <= 0:
        raise ClipError(f"'{path}' has no frames: export the clip again with its motion")
    if not (np.isfinite(frame_time) and frame_time > 0):
        raise ClipError(f"'{path}' has a frame time of {frame_time} s: it must be positive")
    rows = [line for line in lines[start:] if line.strip()]
    if len(rows) < nframe:
        raise ClipError(
            f"'{path}' has {len(rows)} of its {nframe} frames: the file is cut off, export it again"
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
    # A frame time is written with few digits (0.0083333): snap to the whole rate it stands for.
    fps = 1 / frame_time
    return values, float(round(fps)) if abs(fps - round(fps)) < 1e-4 * fps else fps
