"""Reader for animations of glTF 2.0 files (.glb, .gltf, .vrma), sampled at an even rate.

Only what moves is read: nodes, the joints of the first skin, one animation.
``docs/decisions.md`` says why this is the project's own.
"""

from __future__ import annotations

import base64
import binascii
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from mjmotion.boundary.files import file_bytes
from mjmotion.boundary.limits import (
    MOST_BINARY,
    MOST_FRAMES,
    MOST_JOINTS,
    MOST_PAUSE,
    MOST_POSES,
    MOST_TEXT,
    MOST_UNITS,
    at_most,
    shown,
    whole_number,
)
from mjmotion.boundary.structured import parse_json
from mjmotion.clips.skeleton import Clip, checked_rate
from mjmotion.exceptions import ClipError
from mjmotion.numerics import rotations as rot

Array = NDArray[np.float64]

_WAYS = ("LINEAR", "STEP", "CUBICSPLINE")
_RATE = 30.0  # frames a second where none is asked for
_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_OF_OTHERS = {
    KeyError: "it lacks what glTF demands, or names a kind that there is not",
    IndexError: "it names what it does not have",
    RecursionError: "it is far too deep",
    struct.error: "it is cut off",
    binascii.Error: "a buffer is no base64",
}
_SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class _Unsound(ValueError):
    """What is wrong with a file, in words."""


class _File:
    """The JSON of a file and its buffers, read when they are needed."""

    def __init__(self, path: Path) -> None:
        self.path = path
        data = file_bytes(path, "glTF file", MOST_BINARY, ClipError)
        self.binary: bytes | None = None
        if data[:4] == b"glTF":
            said = struct.unpack_from("<I", data, 8)[0] if len(data) >= 12 else 12
            if said > len(data):
                raise _Unsound(f"it is cut off: {len(data):,} of {said:,} bytes")
            at, text = 12, b""
            while at + 8 <= len(data):
                size, kind = struct.unpack_from("<II", data, at)
                if at + 8 + size > len(data):
                    raise _Unsound("a chunk is longer than the file")
                chunk = data[at + 8 : at + 8 + size]
                if kind == 0x4E4F534A:
                    text = chunk
                elif kind == 0x004E4942:
                    self.binary = chunk
                at += 8 + size
            if not text:
                raise _Unsound("it has no JSON")
            data = text
        elif data.strip()[:1] not in (b"{", b"\xef", b""):
            raise _Unsound("it begins neither with glTF nor with {")
        at_most(len(data), MOST_TEXT, f"bytes of JSON of '{path}'", ClipError)
        content = parse_json(data, f"glTF file '{path}'", ClipError)
        if not isinstance(content, dict):
            raise _Unsound("its JSON is no object")
        self.content: dict[str, Any] = content

    def items(self, name: str) -> list[dict[str, Any]]:
        """Return a list of the file, empty where it has none."""
        found = self.content.get(name) or []
        if not isinstance(found, list):
            raise _Unsound(f"its {name} are {shown(found)} and no list")
        return found

    def item(self, name: str, index: Any) -> dict[str, Any]:
        """Return an entry of a list by its number."""
        entries = self.items(name)
        if type(index) is not int or not 0 <= index < len(entries):
            raise _Unsound(f"it names {shown(index)} of its {len(entries)} {name}")
        return entries[index]

    def values(self, index: int) -> Array:
        """Return the values (n, size) of an accessor."""
        accessor = self.item("accessors", index)
        kind, size = np.dtype(_TYPES[accessor["componentType"]]), _SIZES[accessor["type"]]
        count = whole_number(accessor["count"], "count of an accessor", ClipError)
        if "sparse" in accessor or "bufferView" not in accessor:
            raise _Unsound("sparse accessors are not read")
        view = self.item("bufferViews", accessor["bufferView"])
        offsets = [part.get("byteOffset", 0) for part in (view, accessor)]
        stride = view.get("byteStride") or size * kind.itemsize
        if not all(type(n) is int and n >= 0 for n in offsets) or type(stride) is not int:
            raise _Unsound(f"accessor {index} begins nowhere")
        if stride < size * kind.itemsize or count < 1:
            raise _Unsound(f"accessor {index} has values within each other, or none")
        start, data = sum(offsets), self._buffer(view["buffer"])
        if start + (count - 1) * stride + size * kind.itemsize > len(data):
            raise _Unsound(f"the buffer of accessor {index} is cut off")
        raw = np.ndarray((count, size), kind, data, start, (stride, kind.itemsize))
        values = raw.astype(float)
        if not np.isfinite(values).all():
            row = int(np.argwhere(~np.isfinite(values))[0][0])
            raise _Unsound(f"accessor {index} is not finite at its value {row}")
        if accessor.get("normalized") and kind.kind in "iu":
            values = np.maximum(values / np.iinfo(kind).max, -1.0)
        return values

    def _buffer(self, index: Any) -> bytes:
        uri = self.item("buffers", index).get("uri")
        if uri is None:
            if self.binary is None:
                raise _Unsound("its binary chunk is missing")
            return self.binary
        if not isinstance(uri, str):
            raise _Unsound(f"a buffer's uri is {shown(uri)}")
        if uri.startswith("data:"):
            return base64.b64decode(uri.partition(",")[2])
        name = unquote(uri)
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise _Unsound(f"its buffer '{name}' is outside its folder")
        return file_bytes(self.path.parent / name, "glTF buffer", MOST_BINARY, ClipError)


def read_gltf(path: str | Path, *, fps: float | None = None) -> Clip:
    """Read the first animation of a glTF file that moves its skeleton.

    Args:
      path: the .glb, .gltf or .vrma file.
      fps: frames a second to sample the animation at: 30 without.

    Returns:
      The joints of the file's first skin, or without a skin what is animated, with all nodes above.

    Raises:
      ClipError: the file is missing, damaged, or holds no animation.
    """
    rate = checked_rate(str(path), _RATE if fps is None else fps)
    try:
        return _read(Path(path), rate)
    except (
        ValueError,
        KeyError,
        IndexError,
        TypeError,
        AttributeError,
        RecursionError,
        struct.error,
        binascii.Error,
    ) as error:
        # What Python says of its own types says nothing to those who exported the file.
        own = isinstance(error, _Unsound)
        reason = str(error) if own else _OF_OTHERS.get(type(error), "a value is of another kind")
        raise ClipError(f"'{path}' is not a sound glTF file ({reason}): export it again") from None


def _read(path: Path, fps: float) -> Clip:
    """Read a file; what is damaged raises whatever it raises."""
    file = _File(path)
    nodes = file.items("nodes")
    above = {child: n for n, node in enumerate(nodes) for child in node.get("children", ())}
    for child in above:
        file.item("nodes", child)
    chosen = _animation(file)
    if chosen is None:
        raise ClipError(f"'{path}' has no animation of a skeleton: export it with its motion")
    tracks = {
        (channel["target"]["node"], channel["target"]["path"]): _sampler(chosen, channel)
        for channel in chosen["channels"]
        if "node" in channel["target"] and channel["target"]["path"] != "weights"
    }
    skins = file.items("skins")
    joints = skins[0]["joints"] if skins else [node for node, _ in tracks]
    for joint in joints:
        file.item("nodes", joint)
    if not joints:
        raise _Unsound("its skin has no joints")
    order = _with_those_above(joints, above, len(nodes))
    at_most(len(order), MOST_JOINTS, f"joints of '{path}'", ClipError)
    ends = [file.values(sampler["input"])[:, 0] for sampler in tracks.values()]
    first, last = min(float(t[0]) for t in ends), max(float(t[-1]) for t in ends)
    if not (np.isfinite([first, last]).all() and 0 <= (last - first) * fps < MOST_FRAMES):
        raise _Unsound(f"its times go from {first:g} to {last:g} s")
    pause = max(float(np.diff(t).max(initial=0.0)) for t in ends)
    if pause > MOST_PAUSE:
        raise _Unsound(f"{pause:g} s pass from one of its keys to the next, {MOST_PAUSE:g} at most")
    frames = (last - first) * fps * len(order)
    at_most(round(frames), MOST_POSES, f"joints x frames of '{path}'", ClipError)
    times = first + np.arange(round((last - first) * fps) + 1) / fps
    moving = _places(file, nodes, order, above, tracks, times)
    rest = _places(file, nodes, order, above, {}, times[:1])
    names = _names(nodes, order)
    parents = np.array([order.index(above[node]) if node in above else -1 for node in order])
    turns = moving[1] @ np.swapaxes(rest[1], -1, -2)
    offsets = rest[0][0] - np.where((parents < 0)[:, None], 0.0, rest[0][0][parents])
    if not (np.isfinite(moving[0]).all() and np.isfinite(turns).all()):
        raise _Unsound("its nodes turn to what is not finite")
    if (largest := float(np.abs(moving[0]).max())) > MOST_UNITS:
        raise _Unsound(f"a joint is at {largest:g} units, {MOST_UNITS:g} at most")
    return Clip(str(path), names, parents, offsets, moving[0], turns, fps, {})


def _sampler(animation: Mapping[str, Any], channel: Mapping[str, Any]) -> Mapping[str, Any]:
    samplers, index = animation["samplers"], channel["sampler"]
    if type(index) is not int or not 0 <= index < len(samplers):
        raise _Unsound(f"it names {shown(index)} of its {len(samplers)} samplers")
    sampler: Mapping[str, Any] = samplers[index]
    if (way := sampler.get("interpolation", "LINEAR")) not in _WAYS:
        raise _Unsound(f"interpolation is {shown(way)}, none of {', '.join(_WAYS)}")
    return sampler


def _animation(file: _File) -> dict[str, Any] | None:
    """Return the first animation that turns more than one node, or None."""
    for animation in file.items("animations"):
        channels = animation.get("channels", ())
        if sum(channel["target"].get("path") == "rotation" for channel in channels) > 1:
            return animation
    return None


def _with_those_above(joints: Sequence[int], above: Mapping[int, int], count: int) -> list[int]:
    """Return nodes and all above them, parents first."""
    order: list[int] = []
    seen: set[int] = set()
    for joint in joints:
        line = [joint]
        while line[-1] in above and above[line[-1]] not in seen:
            line.append(above[line[-1]])
            if len(line) > count:
                raise _Unsound("its nodes hang on themselves")
        order += [node for node in reversed(line) if node not in seen]
        seen |= set(line)
    return order


def _names(nodes: Sequence[Mapping[str, Any]], order: Sequence[int]) -> tuple[str, ...]:
    """Return a name for each node; what has none or another's is numbered."""
    names: list[str] = []
    for node in order:
        name = str(nodes[node].get("name") or f"node_{node}")
        names.append(name if name not in names else f"{name}_{node}")
    return tuple(names)


def _places(
    file: _File,
    nodes: Sequence[Mapping[str, Any]],
    order: Sequence[int],
    above: Mapping[int, int],
    tracks: Mapping[tuple[int, str], Mapping[str, Any]],
    times: Array,
) -> tuple[Array, Array]:
    """Return global positions (nframe, n, 3) and rotations (nframe, n, 3, 3) of nodes."""
    nframe = len(times)
    matrices: dict[int, Array] = {}
    positions = np.empty((nframe, len(order), 3))
    rotations = np.empty((nframe, len(order), 3, 3))
    for index, node in enumerate(order):
        given = nodes[node]
        if "matrix" in given:
            local = np.tile(np.array(given["matrix"], float).reshape(4, 4).T, (nframe, 1, 1))
        else:
            parts = {}
            for part, usual in (
                ("translation", (0, 0, 0)),
                ("rotation", (0, 0, 0, 1)),
                ("scale", (1, 1, 1)),
            ):
                track = tracks.get((node, part))
                still = np.tile(np.array(given.get(part, usual), float), (nframe, 1))
                parts[part] = still if track is None else _sampled(file, track, times, part)
            turn = rot.to_matrix(rot.normalized(np.roll(parts["rotation"], 1, axis=1)))
            local = np.tile(np.eye(4), (nframe, 1, 1))
            local[:, :3, :3] = turn * parts["scale"][:, None, :]
            local[:, :3, 3] = parts["translation"]
        whole = matrices[above[node]] @ local if node in above else local
        matrices[node] = whole
        positions[:, index] = whole[:, :3, 3]
        # The turning alone: scales, of armatures in centimetres for one, are in the positions.
        u, size, vt = np.linalg.svd(whole[:, :3, :3])
        if (size < 1e-12).any():
            raise _Unsound(f"node {node} has no size")
        u[..., -1] *= np.linalg.det(u @ vt)[:, None]
        rotations[:, index] = u @ vt
    return positions, rotations


def _sampled(file: _File, sampler: Mapping[str, Any], times: Array, part: str) -> Array:
    """Return the values of a track at given times, by its own interpolation."""
    keys, values = file.values(sampler["input"])[:, 0], file.values(sampler["output"])
    way = sampler.get("interpolation", "LINEAR")
    cubic = way == "CUBICSPLINE"
    if len(values) != len(keys) * (3 if cubic else 1) or (np.diff(keys) < 0).any():
        raise _Unsound("a track has other values than times, or times that run backwards")
    after = np.clip(np.searchsorted(keys, times, side="right"), 1, max(len(keys) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(keys) - 1)
    span = keys[after] - keys[before]
    share = np.clip((times - keys[before]) / np.where(span > 0, span, 1.0), 0.0, 1.0)[:, None]
    if cubic:
        parts = values.reshape(len(keys), 3, -1)
        a, b = parts[before, 1], parts[after, 1]
        rise, fall = parts[before, 2] * span[:, None], parts[after, 0] * span[:, None]
        s, s2, s3 = share, share**2, share**3
        return np.asarray(
            (2 * s3 - 3 * s2 + 1) * a
            + (s3 - 2 * s2 + s) * rise
            + (3 * s2 - 2 * s3) * b
            + (s3 - s2) * fall
        )
    a, b = values[before], values[after]
    if way == "STEP":
        return np.where(share < 1, a, b)
    if part != "rotation":
        return a + share * (b - a)
    # Slerp, in the order wxyz.
    first, second = (rot.normalized(np.roll(quat, 1, axis=1)) for quat in (a, b))
    step = rot.multiply(rot.conjugate(first), second)
    step = np.where(step[:, :1] < 0, -step, step)
    return np.roll(rot.multiply(first, rot.exp(share * rot.log(step))), -1, axis=1)
