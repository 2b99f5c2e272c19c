"""Seeded damage to bytes: what disks, editors, other programs and jokers do to files."""

from __future__ import annotations

import io
import random
import re
from typing import Any

import numpy as np

NUMBER = re.compile(rb"-?\d+(\.\d+)?([eE][-+]?\d+)?")
NONSENSE = (
    *(b"nan", b"inf", b"-inf", b"1e300", b"-1e300", b"1e-300", b"1e400", b"1e9", b"-1", b"0"),
    *(b"", b"true", b"null", b"none", b"1+2j", b"0x10", b"1_0", b"3.5", b"abc", b'"7"', b"[1]"),
    *(
        b"{}",
        b"9" * 5000,
        b"[" * 200,
        b"\x1b[31m",
        "\u202e".encode(),
        b"\x00",
        b"\xff\xfe",
        b"$x^2$",
    ),
    *(b"999999999999999999999", b"100000000", b"2147483648", b"-0", b"1e", b".", b"--5", b"&a *a"),
)
VALUES: tuple[Any, ...] = (
    *(float("nan"), float("inf"), 1e300, -1e300, 1e-300, 1e15, -1.0, 0.0, True, 1 + 2j, "7"),
    *(b"x", 2**62, None),
)


def damaged(data: bytes, chance: random.Random) -> bytes:
    """Return bytes with one to three damages."""
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        data = chance.choice(_DAMAGES)(data, chance)
    return data


def damaged_archive(arrays: dict[str, Any], chance: random.Random) -> bytes:
    """Return an ``.npz`` file with one array that is not as it should be, or damaged."""
    changed = dict(arrays)
    name = chance.choice(sorted(changed))
    array = np.asarray(changed[name])
    kind = chance.randrange(9)
    if kind == 0:
        del changed[name]
    elif kind == 1:
        kinds = ("?", "c16", "S8", "U8", "f2", "i1", "u8", "f8")
        kind_of = chance.choice(kinds[2:4] if array.dtype.kind == "U" else kinds)
        with np.errstate(all="ignore"):
            changed[name] = array.astype(kind_of)
    elif kind == 2:
        changed[name] = array[..., None] if chance.random() < 0.5 else array.ravel()
    elif kind == 3:
        changed[name] = np.zeros((0, *array.shape[1:]), array.dtype)
    elif kind == 4:
        changed[name] = np.zeros(array.shape, [("a", "f8"), ("b", "i4")])
    elif kind == 5:
        changed[name] = np.array(chance.choice(VALUES[:-1]))
    elif kind == 6 and array.dtype.kind == "f" and array.size:
        copy = array.copy().ravel()
        copy[chance.randrange(len(copy))] = chance.choice(VALUES[:8])
        changed[name] = copy.reshape(array.shape)
    file = io.BytesIO()
    write = np.savez if chance.random() < 0.5 else np.savez_compressed
    write(file, **changed)
    return damaged(file.getvalue(), chance) if kind > 6 else file.getvalue()


def _flip(data: bytes, chance: random.Random) -> bytes:
    if not data:
        return data
    changed = bytearray(data)
    for _ in range(chance.choice((1, 1, 4))):
        changed[chance.randrange(len(changed))] ^= 1 << chance.randrange(8)
    return bytes(changed)


def _cut(data: bytes, chance: random.Random) -> bytes:
    return data[: chance.randrange(len(data) + 1)]


def _lose(data: bytes, chance: random.Random) -> bytes:
    start = chance.randrange(len(data) + 1)
    return data[:start] + data[start + chance.randrange(1, 40) :]


def _again(data: bytes, chance: random.Random) -> bytes:
    start = chance.randrange(len(data) + 1)
    part = data[start : start + chance.randrange(1, 400)]
    return data[:start] + part + data[start:]


def _number(data: bytes, chance: random.Random) -> bytes:
    """Put nonsense for a number."""
    places = list(NUMBER.finditer(data[:200_000]))
    if not places:
        return data
    place = chance.choice(places)
    return data[: place.start()] + chance.choice(NONSENSE) + data[place.end() :]


def _word(data: bytes, chance: random.Random) -> bytes:
    """Put nonsense for a word."""
    places = list(re.finditer(rb"[A-Za-z_]+", data[:200_000]))
    if not places:
        return data
    place = chance.choice(places)
    return data[: place.start()] + chance.choice(NONSENSE) + data[place.end() :]


def _insert(data: bytes, chance: random.Random) -> bytes:
    start = chance.randrange(len(data) + 1)
    return data[:start] + chance.choice(NONSENSE) + data[start:]


def _line(data: bytes, chance: random.Random) -> bytes:
    """Lose a line, have it twice, or put it elsewhere."""
    lines = data.split(b"\n")
    line = lines.pop(chance.randrange(len(lines)))
    for _ in range(chance.randrange(3)):
        lines.insert(chance.randrange(len(lines) + 1), line)
    return b"\n".join(lines)


def _mark(data: bytes, chance: random.Random) -> bytes:
    return chance.choice((b"\xef\xbb\xbf", b"\xff\xfe", b"\x00", b"\x1b[2J")) + data


_DAMAGES = (_flip, _cut, _lose, _again, _number, _number, _number, _word, _insert, _line, _mark)
