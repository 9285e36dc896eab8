"""Arrays from ``.npy`` and ``.npz`` files, which anybody may have written. No pickle.

What a header announces is looked at before anything is allocated for it. numpy's own reader evaluates headers as text,
and raises whatever comes of a damaged one.
"""

import math
import os
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as layout

from ..arrays import Array
from ..errors import FrogError, brief, found_instead
from .regular_file import regular_file

Check = Callable[[str, tuple[int, ...]], None]
"""Told the name and the shape of an array before it is read; raises FrogError where it is not wanted."""

_NUMBERS = "biuf"  # kinds of arrays, as numpy names them
_LARGEST_NUMBER = 16  # bytes
_LONGEST_HEADER = 1000  # characters: of plain arrays it has a tenth of that
_MOST_ARRAYS = 10_000
_HEADERS: dict[tuple[int, int], Callable[..., tuple[tuple[int, ...], bool, np.dtype[np.generic]]]] = {
    (1, 0): layout.read_array_header_1_0,
    (2, 0): layout.read_array_header_2_0,
}
_COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


def read_npy(path: Path, expected: str, most: int) -> Array:
    """The array of numbers in a ``.npy`` file.

    Args:
        expected: what the file should be, for the sentence that says it is not.
        most: numbers that the array may have.

    Raises:
        FrogError: in one sentence, for a file that is missing, damaged, of another kind, or too large.
    """
    with _told(path, expected, "a NumPy array of numbers"), path.open("rb") as file:
        return _read(file, os.fstat(file.fileno()).st_size, most)


def read_npz(path: Path, expected: str, most: int, check: Check | None = None) -> dict[str, Array]:
    """All arrays of an ``.npz`` file by name; errors as of ``read_npy``.

    Args:
        most: numbers that all arrays together may have.
        check: asked before each array is read.
    """
    arrays: dict[str, Array] = {}
    with _told(path, expected, "an archive of NumPy arrays"), zipfile.ZipFile(path) as archive:
        entries = archive.infolist()
        if len(entries) > _MOST_ARRAYS:
            raise ValueError(f"{len(entries)} arrays")
        for entry in entries:
            if entry.compress_type not in _COMPRESSIONS:
                raise ValueError(f"compression {entry.compress_type}")
            name = entry.filename.removesuffix(".npy")
            with archive.open(entry) as file:
                left = most - sum(array.size for array in arrays.values())
                arrays[name] = _read(file, entry.file_size, left, check and partial(check, name))
    return arrays


@contextmanager
def _told(path: Path, expected: str, kind: str) -> Iterator[None]:
    """One sentence for whatever is raised where a file is read; ``kind`` is what it may not be."""
    try:
        regular_file(path, expected)
        yield
    except FrogError:
        raise
    except OSError as error:
        raise found_instead(path, f"a file that cannot be read ({error.strerror or error})", expected) from error
    except Exception as error:
        raise found_instead(path, f"a file that is not {kind} ({brief(error)})", expected) from error


def _read(
    file: Any,  # typing.IO has no readinto, which both kinds of files have
    size: int,
    most: int,
    check: Callable[[tuple[int, ...]], None] | None = None,
) -> Array:
    """One array of a file of ``size`` bytes; anything may be raised for what is none."""
    read_magic: Callable[..., tuple[int, int]] = layout.read_magic
    version = read_magic(file)
    if version not in _HEADERS:
        raise ValueError(f"version {version} of the format")
    shape, by_columns, dtype = _HEADERS[version](file, max_header_size=_LONGEST_HEADER)
    if dtype.kind not in _NUMBERS or any(length < 0 for length in shape):
        raise ValueError(f"{dtype} of shape {shape}")
    count, needed = math.prod(shape), math.prod(shape) * dtype.itemsize
    if max(count, needed // _LARGEST_NUMBER) > most:
        raise ValueError(f"{dtype} of shape {shape}, expected at most {most:,} numbers")
    if needed > size - file.tell():
        raise ValueError(f"{dtype} of shape {shape} in a file of {size:,} bytes")
    if check is not None:
        check(shape)
    content = bytearray(needed)
    if file.readinto(content) != needed:
        raise ValueError("a file that was cut off")
    file.read(1)  # at the end an archive compares its sum
    return np.frombuffer(content, dtype).reshape(shape, order="F" if by_columns else "C")
