"""Reader for Acclaim recordings: a skeleton (ASF) and its frames (AMC)."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mjmotion.boundary.files import check_plain
from mjmotion.boundary.limits import MOST_FRAMES, MOST_JOINTS, MOST_POSES, at_most
from mjmotion.clips.skeleton import (
    Clip,
    axis_rotations,
    check_skeleton_size,
    pose_skeleton,
    read_lines,
)
from mjmotion.exceptions import ClipError

Array = NDArray[np.float64]

_FRAME_DIGITS = 18  # of a number of a frame, blanks before it too
_DOF = ("tx", "ty", "tz", "rx", "ry", "rz", "l")


class _Bone:
    """One bone of an ASF file; ``axis`` (3, 3) turns its own frame into the global one at rest."""

    def __init__(self) -> None:
        self.direction = np.zeros(3)
        self.length = 0.0
        self.axis = np.eye(3)
        self.dof: list[str] = []


class _Skeleton:
    """Bones by name ("root" among them), the bone each hangs on, and whether angles are degrees."""

    def __init__(self) -> None:
        self.bones: dict[str, _Bone] = {}
        self.parents: dict[str, str] = {}
        self.degrees = True


def read_amc(path: str | Path, skeleton: str | Path | None = None, *, fps: float = 120.0) -> Clip:
    """Read an AMC file with its skeleton.

    A joint stands at the beginning of the bone it is named after, as in BVH files of such takes.

    Args:
      path: the AMC file.
      skeleton: the ASF file; by default the one beside it: 02_01.amc has 02_01.asf or 02.asf.
      fps: frames a second, which the format does not say; 120 is the CMU library's.

    Returns:
      The clip in the ASF's own units and axes.

    Raises:
      ClipError: a file is missing, truncated or malformed.
    """
    asf = Path(skeleton) if skeleton is not None else _skeleton_file(Path(path))
    tree = _read_skeleton(asf)
    names = _parents_first(tree, asf)
    lines = _frame_lines(path)
    parents = np.array([names.index(tree.parents[n]) if n in tree.parents else -1 for n in names])
    offsets = np.array(
        [
            tree.bones[names[parent]].direction * tree.bones[names[parent]].length
            if parent >= 0
            else np.zeros(3)
            for parent in parents
        ]
    )
    values = _read_values(path, lines, tree)
    nframe = len(values["root"])
    at_most(nframe * len(names), MOST_POSES, f"joints x frames of '{path}'", ClipError)
    translations = np.broadcast_to(offsets, (nframe, *offsets.shape)).copy()
    local = np.broadcast_to(np.eye(3), (*translations.shape, 3)).copy()
    for joint, name in enumerate(names):
        bone = tree.bones[name]
        turn = np.broadcast_to(np.eye(3), (nframe, 3, 3))
        for dof, column in zip(bone.dof, values[name].T, strict=True):
            if dof[0] == "t":
                translations[:, joint, "xyz".index(dof[1])] = column
            elif dof[0] == "r":
                angles = np.radians(column) if tree.degrees else column
                # Acclaim turns about fixed axes in the order given.
                turn = axis_rotations(dof[1], angles) @ turn
        local[:, joint] = bone.axis @ turn @ bone.axis.T
    inner = set(tree.parents.values())
    ends = {n: tree.bones[n].direction * tree.bones[n].length for n in names if n not in inner}
    return pose_skeleton(str(path), tuple(names), parents, offsets, translations, local, fps, ends)


def _skeleton_file(path: Path) -> Path:
    """Return the skeleton file that belongs to an AMC file.

    Of 02_01.amc that is 02_01.asf, else 02.asf, else the longest name that the AMC's begins with
    (HDM_bd.asf of HDM_bd_01-01.amc), else the only one; beside the file, else a folder up.
    """
    check_plain(path, "AMC file", ClipError)
    stem = path.stem.lower()
    seen: list[str] = []
    for folder in (path.parent, path.absolute().parent.parent):
        files = sorted(file for file in folder.iterdir() if file.suffix.lower() == ".asf")
        own = [file for file in files if stem.startswith(file.stem.lower())]
        # The longest, and 02 of 02_01 before 0.
        own = [file for file in own if not stem[len(file.stem) :][:1].isalnum()] or own
        if own:
            return max(own, key=lambda file: len(file.stem))
        if len(files) == 1:
            return files[0]
        seen += [file.name for file in files]
    beside = f"; there are {', '.join(seen[:5])}" if seen else ""
    raise ClipError(
        f"'{path}' needs its skeleton: put {path.stem}.asf or {path.stem.split('_')[0]}.asf beside"
        f" it, or give it as --asf FILE{beside}"
    )


def _read_skeleton(path: Path) -> _Skeleton:
    """Read an ASF file."""
    lines = read_lines(path, "ASF")
    check_skeleton_size(path, lines)
    text = "\n".join(line.partition("#")[0] for line in lines)
    sections = {
        part.split(None, 1)[0].lower(): part.split(None, 1)[-1]
        for part in re.split(r"(?m)^\s*:", text)
        if part.strip()
    }
    for need in ("root", "bonedata", "hierarchy"):
        if need not in sections:
            raise ClipError(f"'{path}' has no :{need} section: the file is cut off or no ASF")
    tree = _Skeleton()
    tree.degrees = not re.search(r"angle\s+rad", sections.get("units", ""))
    try:
        tree.bones["root"] = _root(sections["root"])
        for part in re.split(r"\bbegin\b", sections["bonedata"])[1:]:
            block, *rest = re.split(r"\bend\b", part, maxsplit=1)
            if not rest:
                raise ValueError("a bone begins and does not end")
            name, bone = _bone(block, tree.degrees)
            if name in tree.bones:
                raise ValueError(f"bone {name} stands twice")
            at_most(len(tree.bones), MOST_JOINTS, f"bones of '{path}'", ClipError)
            tree.bones[name] = bone
        for line in sections["hierarchy"].splitlines():
            words = line.split()
            if words and words[0] not in ("begin", "end", "hierarchy"):
                if twice := [child for child in words[1:] if child in tree.parents]:
                    raise ValueError(f"bone {twice[0]} hangs on two others")
                tree.parents.update({child: words[0] for child in words[1:]})
    except (ValueError, KeyError, IndexError) as error:
        raise ClipError(f"'{path}' is not a sound ASF file ({error}): get it again") from None
    return tree


def _root(text: str) -> _Bone:
    fields = _fields(text)
    bone = _Bone()
    bone.dof = [word.lower() for word in fields["order"]]
    _check_dof(bone.dof, "root")
    turn = [float(x) for x in fields.get("orientation", ["0", "0", "0"])]
    bone.axis = _euler(turn, fields.get("axis", ["XYZ"])[0], True)
    return bone


def _bone(text: str, degrees: bool) -> tuple[str, _Bone]:
    fields = _fields(text)
    bone = _Bone()
    direction = np.array([float(x) for x in fields["direction"]])
    if direction.shape != (3,) or not np.linalg.norm(direction) > 0:
        raise ValueError(f"bone {fields['name'][0]} has no direction of three numbers")
    bone.direction = direction / np.linalg.norm(direction)
    bone.length = float(fields["length"][0])
    bone.axis = _euler([float(x) for x in fields["axis"][:3]], fields["axis"][3], degrees)
    bone.dof = [word.lower() for word in fields.get("dof", [])]
    _check_dof(bone.dof, fields["name"][0])
    if not (np.isfinite([*bone.direction, bone.length]).all() and np.isfinite(bone.axis).all()):
        raise ValueError(f"bone {fields['name'][0]} is not finite")
    return fields["name"][0], bone


def _check_dof(dof: list[str], name: str) -> None:
    if unknown := [word for word in dof if word not in _DOF]:
        raise ValueError(f"{name} has the degree of freedom '{unknown[0]}', none of {_DOF}")
    if len(set(dof)) < len(dof):
        raise ValueError(f"{name} has a degree of freedom twice")


def _fields(text: str) -> dict[str, list[str]]:
    """Return key to words of lines such as ``dof rx ry``."""
    rows = [line.split() for line in text.splitlines()]
    return {row[0].lower(): row[1:] for row in rows if row}


def _euler(angles: list[float], order: str, degrees: bool) -> Array:
    """Return the rotation (3, 3) of angles about fixed axes in the order given."""
    result = np.eye(3)
    for axis, angle in zip(order.lower(), angles, strict=True):
        result = axis_rotations(axis, np.radians(angle) if degrees else np.array(angle)) @ result
    return result


def _parents_first(tree: _Skeleton, path: Path) -> list[str]:
    """Return the bones, parents before children."""
    unknown = (set(tree.parents) | set(tree.parents.values())) - set(tree.bones)
    if unknown:
        raise ClipError(f"'{path}': :hierarchy names unknown bones {', '.join(sorted(unknown))}")
    if "root" in tree.parents:
        raise ClipError(f"'{path}': :hierarchy hangs the root on '{tree.parents['root']}'")
    names = ["root"]
    for name in names:
        names += [child for child, parent in tree.parents.items() if parent == name]
    return names


def _frame_lines(path: str | Path) -> list[str]:
    lines = (line.partition("#")[0] for line in read_lines(path, "AMC"))
    return [line for line in lines if line.strip() and not line.lstrip().startswith(":")]


def _read_values(path: str | Path, lines: list[str], tree: _Skeleton) -> dict[str, Array]:
    """Return bone to (nframe, ndof) values."""
    starts = [n for n, line in enumerate(lines) if line.strip().isdigit()]
    if not starts:
        raise ClipError(f"AMC file '{path}' has no frames: export the clip again")
    at_most(len(starts), MOST_FRAMES, f"frames of '{path}'", ClipError)
    moving = {name: len(bone.dof) for name, bone in tree.bones.items() if bone.dof}
    values = {name: np.zeros((len(starts), count)) for name, count in moving.items()}
    values |= {name: np.zeros((len(starts), 0)) for name in tree.bones if name not in moving}
    first_seen = set[str]()
    for frame, (first, last) in enumerate(zip(starts, [*starts[1:], len(lines)], strict=True)):
        seen = set[str]()
        if int(lines[first][:_FRAME_DIGITS]) != int(lines[starts[0]][:_FRAME_DIGITS]) + frame:
            raise ClipError(
                f"'{path}': frame {frame} has the number {lines[first].strip()[:_FRAME_DIGITS]}:"
                " frames are missing or stand twice",
                (frame,),
            )
        for line in lines[first + 1 : last]:
            name, *words = line.split()
            if name not in moving or len(words) != moving[name]:
                expected = f"{moving[name]} values" if name in moving else "a bone of the skeleton"
                raise ClipError(
                    f"'{path}' frame {frame}: '{name}' with {len(words)} values is not {expected}:"
                    " the file is cut off or belongs to another skeleton",
                    (frame,),
                )
            if name in seen:
                raise ClipError(f"'{path}' frame {frame} has '{name}' twice", (frame,))
            try:
                values[name][frame] = [float(word) for word in words]
            except ValueError:
                raise ClipError(
                    f"'{path}' frame {frame}: '{name}' has a value that is not a number", (frame,)
                ) from None
            seen.add(name)
        first_seen = first_seen or seen
        if "root" not in seen or seen != first_seen:
            raise ClipError(
                f"'{path}' frame {frame} lacks bones: the file is cut off, export it again",
                (frame,),
            )
    return values
