"""Files of named arrays in the safetensors format, read whole without mapping them. No pickle, no torch.

A mapped file that somebody writes anew while it is read, or a stick that is pulled out, ends the process. And arrays
that nobody knows are passed over without a byte of them being read.
"""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Callable
from io import BufferedReader
from pathlib import Path

import numpy as np

from ..arrays import Array
from ..errors import brief, found_instead
from .plain_values import UnfitValue, entries, items, plain_json, whole
from .regular_file import regular_file

LONGEST_HEADER = 48 << 20
"""Bytes of the header of a file that is read."""
_MOST_ARRAYS = 65_536
_LONGEST_AXIS = 2**40
_DTYPES: dict[str, type[np.generic]] = {
    "F64": np.float64,
    "F32": np.float32,
    "F16": np.float16,
    "BOOL": np.bool_,
    **{f"I{8 * size}": kind for size, kind in ((1, np.int8), (2, np.int16), (4, np.int32), (8, np.int64))},
    **{f"U{8 * size}": kind for size, kind in ((1, np.uint8), (2, np.uint16), (4, np.uint32), (8, np.uint64))},
}


def read_tensors(
    path: str | Path, kind: str, wanted: Callable[[str], bool] = lambda name: True
) -> tuple[dict[str, Array], dict[str, str]]:
    """Arrays and metadata of a safetensors file; sizes are checked before anything is allocated.

    Args:
        kind: what the file should be, for the sentence that says it is not.
        wanted: which arrays to read, by name.

    Raises:
        FrogError: in one sentence, for a file that is missing, damaged, of another kind, or too large for the memory.
    """
    regular_file(path, kind)
    try:
        with Path(path).open("rb") as file:
            return _read(file, wanted)
    except MemoryError as error:
        raise found_instead(path, "a file that is larger than the free memory", kind) from error
    except OSError as error:
        raise found_instead(path, f"a file that cannot be read ({error.strerror or error})", kind) from error
    except ValueError as error:
        raise found_instead(path, f"a damaged or foreign file ({error})", kind) from error


def find_tensor(path: str | Path, kind: str, name: str) -> tuple[int, str, tuple[int, ...]]:
    """Where one array of a safetensors file lies, without reading it: its first byte, its type in the format's words,
    and its shape.

    Raises:
        FrogError: as ``read_tensors``, and where there is no such array.
    """
    regular_file(path, kind)
    try:
        with Path(path).open("rb") as file:
            start, places, _ = _places(file)
    except OSError as error:
        raise found_instead(path, f"a file that cannot be read ({error.strerror or error})", kind) from error
    except ValueError as error:
        raise found_instead(path, f"a damaged or foreign file ({error})", kind) from error
    if name not in places:
        raise found_instead(path, f"no {name}", kind)
    begin, _, dtype, shape = places[name]
    return start + begin, dtype, shape


def _read(file: BufferedReader, wanted: Callable[[str], bool]) -> tuple[dict[str, Array], dict[str, str]]:
    start, places, metadata = _places(file)
    arrays = {}
    for name, (begin, _, dtype, shape) in places.items():
        if wanted(name):
            file.seek(start + begin)
            arrays[name] = _array(file, dtype, shape)
    return arrays, metadata


def _places(file: BufferedReader) -> tuple[int, dict[str, tuple[int, int, str, tuple[int, ...]]], dict[str, str]]:
    """The first byte of the arrays, where each of them lies behind it (see ``_place``), and the metadata."""
    size = os.fstat(file.fileno()).st_size
    first = file.read(8)
    length = struct.unpack("<Q", first)[0] if len(first) == 8 else size
    if length > min(size - 8, LONGEST_HEADER):
        raise UnfitValue(f"a header of {length} bytes in a file of {size}", "a shorter one")
    header = entries(plain_json(file.read(length).decode(), "a header"), "a header")
    metadata = entries(header.pop("__metadata__", {}), "metadata")
    if len(header) > _MOST_ARRAYS or not all(type(text) is str for text in metadata.values()):
        raise UnfitValue("metadata or arrays that cannot be", f"texts, and at most {_MOST_ARRAYS} arrays")
    places = {name: _place(name, entry) for name, entry in header.items()}
    end = 0
    for begin, after, _, _ in sorted(places.values(), key=lambda place: place[:2]):
        if begin != end:
            raise UnfitValue(f"an array that begins at byte {begin}", f"one after the other, the next at {end}")
        end = after
    if 8 + length + end != size:
        raise UnfitValue(f"{size} bytes", f"{8 + length + end}")
    return 8 + length, places, metadata


def _place(name: str, found: object) -> tuple[int, int, str, tuple[int, ...]]:
    """First byte, the one after the last, type and shape of an array."""
    entry = entries(found, name)
    dtype, lengths, offsets = (entry.get(key) for key in ("dtype", "shape", "data_offsets"))
    if not isinstance(dtype, str) or dtype not in _DTYPES:
        raise UnfitValue(f"{name} of type {brief(dtype)}", f"one of {', '.join(_DTYPES)}")
    shape = tuple(whole(length, f"a length of {name}", 0, _LONGEST_AXIS) for length in items(lengths, "lengths", 8))
    begin, end = (whole(offset, f"an offset of {name}", 0, 2**62) for offset in items(offsets, "offsets", 2) or (0, 0))
    size = math.prod(shape) * np.dtype(_DTYPES[dtype]).itemsize
    if end - begin != size:
        raise UnfitValue(f"{name} of shape {shape} in {end - begin} bytes", f"{size}")
    return begin, end, dtype, shape


def _array(file: BufferedReader, dtype: str, shape: tuple[int, ...]) -> Array:
    array = np.empty(shape, _DTYPES[dtype])
    if array.size:
        into = array.reshape(-1).view(np.uint8).data
        while into:
            count = file.readinto(into)
            if not count:
                raise UnfitValue("an end in the middle of an array", "a file that nobody cuts meanwhile")
            into = into[count:]
    # Any byte but 0 and 1 is no truth value.
    return array.view(np.uint8) != 0 if dtype == "BOOL" else array
