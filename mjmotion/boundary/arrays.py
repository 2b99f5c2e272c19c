"""NumPy's files, judged by their headers before anything is unpacked; pickles are never run."""

from __future__ import annotations

import io
import math
import struct
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from mjmotion.boundary.files import check_plain
from mjmotion.boundary.limits import MOST_COUNT, MOST_DIRECTORY, MOST_UNPACKED
from mjmotion.boundary.words import first_line
from mjmotion.exceptions import MotionError

_SUFFIX = ".npy"
_PART = 1 << 22  # read at once [bytes]
_TAIL = (1 << 16) + 22  # where an archive tells of its members, a comment after it [bytes]


def read_archive(
    path: str | Path, needed: Sequence[str], optional: Sequence[str] = ()
) -> dict[str, NDArray[Any]]:
    """Return arrays of an ``.npz`` file.

    Args:
      path: the file.
      needed: names of arrays that must be there.
      optional: names of arrays that may be.

    Raises:
      ValueError: one line without the file's name: it is missing, damaged, too large or lying.
    """
    try:
        with _archive(path) as archive:
            members = archive.infolist()
            names = [member.filename for member in members]
            wanted = {name + _SUFFIX: name for name in (*needed, *optional)}
            if twice := [name for name in wanted if names.count(name) > 1]:
                raise ValueError(f"it holds {twice[0]} twice")
            if lacking := [name for name in needed if name + _SUFFIX not in names]:
                raise ValueError(f"it lacks {', '.join(lacking)}")
            inside = [member for member in members if member.filename in wanted]
            size = sum(member.file_size for member in inside)
            if size > MOST_UNPACKED:
                raise ValueError(f"{size:,} bytes unpacked, and at most {MOST_UNPACKED:,} can be")
            found = {}
            for member in inside:
                name = wanted[member.filename]
                with archive.open(member) as file:
                    found[name] = _array(file, member.file_size, name)  # type: ignore[arg-type]
            return found
    except ValueError:
        raise
    except MotionError as error:
        raise ValueError(str(error)) from None
    except OSError as error:
        raise ValueError(error.strerror or first_line(error)) from None
    except Exception as error:  # unpacking raises what zlib, struct, lzma and others raise
        raise ValueError(f"it is damaged: {first_line(error)}") from None


def names_in_archive(path: str | Path) -> set[str]:
    """Return the names of the arrays of an ``.npz`` file; none where it is not one."""
    try:
        with _archive(path) as archive:
            return {name.removesuffix(_SUFFIX) for name in archive.namelist()}
    except (OSError, ValueError, MotionError, zipfile.BadZipFile):
        return set()


def read_array(path: str | Path) -> NDArray[Any]:
    """Return the array of an ``.npy`` file.

    Raises:
      ValueError: as :func:`read_archive`.
    """
    path = Path(path)
    try:
        size = check_plain(path, "array file")
        with path.open("rb") as file:
            return _array(file, size, path.name)
    except ValueError:
        raise
    except MotionError as error:
        raise ValueError(str(error)) from None
    except OSError as error:
        raise ValueError(error.strerror or first_line(error)) from None
    except Exception as error:  # numpy's header is Python's own syntax, and fails in its ways
        raise ValueError(f"it is damaged: {first_line(error)}") from None


def _archive(path: str | Path) -> zipfile.ZipFile:
    """Open an archive whose list of members is of a size that can be read."""
    size = check_plain(path, "archive")
    if not size:
        raise ValueError("it is empty")
    with Path(path).open("rb") as file:
        file.seek(-min(size, _TAIL), io.SEEK_END)
        tail = file.read()
    at = tail.rfind(b"PK\5\6")
    if at < 0:
        raise ValueError("it is no .npz archive, or cut off")
    if len(tail) >= at + 16:
        (directory,) = struct.unpack_from("<I", tail, at + 12)
        if directory > MOST_DIRECTORY or tail[:at].rfind(b"PK\6\7") >= 0:
            raise ValueError("it holds far more files than a motion has arrays")
    return zipfile.ZipFile(path)


def _array(file: BinaryIO, size: int, name: str) -> NDArray[Any]:
    """Read one array whose file has ``size`` bytes, and just as many as its header says."""
    # The header is small: it is read on its own, so that what it claims is judged first.
    head = io.BytesIO(file.read(min(size, 1 << 16)))
    version = npy.read_magic(head)
    if version == (1, 0):
        shape, by_column, dtype = npy.read_array_header_1_0(head)
    elif version == (2, 0):
        shape, by_column, dtype = npy.read_array_header_2_0(head)
    else:
        raise ValueError(f"{name} is of version {version}, which is not for numbers")
    if dtype.hasobject:
        raise ValueError(f"{name} holds pickled objects, which are not read")
    if dtype.names is not None or dtype.subdtype is not None:
        raise ValueError(f"{name} holds records: it must hold plain numbers or text")
    if len(shape) > 4 or any(side > MOST_COUNT or side < 0 for side in shape):
        raise ValueError(f"{name} has the shape {shape}, which is none of a motion")
    said = math.prod(shape) * dtype.itemsize
    if said > MOST_UNPACKED:
        raise ValueError(f"{name} has {said:,} bytes, and at most {MOST_UNPACKED:,} can be")
    there = size - head.tell()
    if said != there:
        raise ValueError(f"{name} has {there:,} bytes where its header says {said:,}")
    # Read into its place: of an array as large as may be, there is one copy.
    array = np.empty(math.prod(shape), dtype)
    begun = head.read()
    data = array.view(np.uint8)
    data[: len(begun)] = np.frombuffer(begun, np.uint8)
    filled = len(begun)
    while part := file.read(min(_PART, said - filled)):
        data[filled : filled + len(part)] = np.frombuffer(part, np.uint8)
        filled += len(part)
    if filled != said:
        raise ValueError(f"{name} is cut off: {filled:,} of {said:,} bytes")
    return array.reshape(shape[::-1]).T if by_column else array.reshape(shape)
