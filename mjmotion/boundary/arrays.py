"""NumPy's files, judged by their headers before anything is unpacked; pickles are never run."""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from mjmotion.boundary.limits import MOST_COUNT, MOST_UNPACKED
from mjmotion.boundary.words import first_line

_SUFFIX = ".npy"


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
        with zipfile.ZipFile(path) as archive:
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
    except OSError as error:
        raise ValueError(error.strerror or first_line(error)) from None
    except Exception as error:  # unpacking raises what zlib, struct, lzma and others raise
        raise ValueError(f"it is damaged: {first_line(error)}") from None


def read_array(path: str | Path) -> NDArray[Any]:
    """Return the array of an ``.npy`` file.

    Raises:
      ValueError: as :func:`read_archive`.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            return _array(file, path.stat().st_size, path.name)
    except ValueError:
        raise
    except OSError as error:
        raise ValueError(error.strerror or first_line(error)) from None
    except Exception as error:  # numpy's header is Python's own syntax, and fails in its ways
        raise ValueError(f"it is damaged: {first_line(error)}") from None


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
    data = head.read() + file.read()
    if len(data) != said:
        raise ValueError(f"{name} is cut off: {len(data):,} of {said:,} bytes")
    array = np.frombuffer(data, dtype=dtype).copy()
    return array.reshape(shape[::-1]).T if by_column else array.reshape(shape)
