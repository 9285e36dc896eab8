"""Files of named arrays in the safetensors format, read whole without mapping them. No pickle, no torch.

A mapped file that somebody writes anew while it is read, or a stick that is pulled out, ends the process. And arrays
that nobody knows are passed over without a byte of them being read.
"""

import json
import math
import os
import shutil
import struct
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from io import FileIO
from pathlib import Path

import numpy as np

from ..arrays import Array
from ..errors import FrogError, brief, found_instead, in_words
from .atomic_files import atomic_file, remove_partial_files
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


@dataclass(frozen=True)
class Tensor:
    """Where an array lies in a file.

    Attributes:
        begin, end: its first byte, and the one after the last.
        dtype: its type in the format's words.
        shape: its lengths.
    """

    begin: int
    end: int
    dtype: str
    shape: tuple[int, ...]


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
    arrays = {}
    with opened_tensors(path, kind) as file:
        tensors, metadata = read_header(file)
        for name, tensor in tensors.items():
            if wanted(name):
                file.seek(tensor.begin)
                arrays[name] = _array(file, tensor)
    return arrays, metadata


@contextmanager
def opened_tensors(path: str | Path, kind: str) -> Iterator[FileIO]:
    """An open file to read; what does not fit raises the same in the block as of ``read_tensors``."""
    try:
        with FileIO(regular_file(path, kind), "rb") as file:  # not buffered: what is read is on the disk now
            yield file
    except MemoryError as error:
        raise found_instead(path, "a file that is larger than the free memory", kind) from error
    except OSError as error:
        raise found_instead(path, f"a file that cannot be read ({error.strerror or error})", kind) from error
    except ValueError as error:
        raise found_instead(path, f"a damaged or foreign file ({error})", kind) from error


def read_header(file: FileIO) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Where each array of a file lies, and the metadata; ValueError for what is none."""
    size = os.fstat(file.fileno()).st_size
    first = file.read(8)
    length = struct.unpack("<Q", first)[0] if len(first) == 8 else size
    if length > min(size - 8, LONGEST_HEADER):
        raise UnfitValue(f"a header of {length} bytes in a file of {size}", "a shorter one")
    header = entries(plain_json(file.read(length).decode(), "a header"), "a header")
    metadata = entries(header.pop("__metadata__", {}), "metadata")
    if len(header) > _MOST_ARRAYS or not all(type(text) is str for text in metadata.values()):
        raise UnfitValue("metadata or arrays that cannot be", f"texts, and at most {_MOST_ARRAYS} arrays")
    tensors = {name: _tensor(name, entry, 8 + length) for name, entry in header.items()}
    end = 8 + length
    for tensor in sorted(tensors.values(), key=lambda tensor: (tensor.begin, tensor.end)):
        if tensor.begin != end:
            raise UnfitValue(f"an array that begins at byte {tensor.begin}", f"one after the other, the next at {end}")
        end = tensor.end
    if end != size:
        raise UnfitValue(f"{size} bytes", f"{end}")
    return tensors, metadata


def framed_header(text: str) -> bytes:
    """What a file begins with: the length of its header, and this JSON, filled up so that arrays are aligned."""
    header = text.encode()
    header += b" " * (-len(header) % 8)
    return len(header).to_bytes(8, "little") + header


def write_rows(
    path: Path,
    arrays: Mapping[str, Array],
    metadata: Mapping[str, str],
    last: tuple[str, str, tuple[int, int]],
    rows: Iterable[Array],
) -> Generator[int, None, None]:
    """Writes arrays, and after them one that comes row by row; yields how many rows are written, from 0 on.

    The file appears when all are. Closing the iterator before its end leaves nothing behind.

    Args:
        metadata: texts of the file's header.
        last: name, type and shape of what comes in rows.
        rows: of bytes; none but one of them is held.

    Raises:
        FrogError: when it cannot be written; an earlier file is untouched then.
    """
    codes = {np.dtype(kind): code for code, kind in _DTYPES.items()}
    described = [(name, codes[array.dtype], array.shape) for name, array in arrays.items()]
    header: dict[str, object] = {"__metadata__": metadata}
    end = 0
    for name, code, shape in (*described, last):
        begin, end = end, end + math.prod(shape) * np.dtype(_DTYPES[code]).itemsize
        header[name] = {"dtype": code, "shape": list(shape), "data_offsets": [begin, end]}
    head = framed_header(json.dumps(header))
    with in_words(f"{path}: could not be written", "; nothing was changed."):
        path.parent.mkdir(parents=True, exist_ok=True)
        remove_partial_files(path)
        free = shutil.disk_usage(path.parent).free
        if end > free:
            raise FrogError(f"{path}: needs {end / 1e6:,.0f} MB, found {free / 1e6:,.0f} MB on the disk.")
        with atomic_file(path) as file:
            file.write(head)
            for array in arrays.values():
                file.write(np.ascontiguousarray(array).data)
            yield 0
            written = 0
            for done, row in enumerate(rows, 1):
                written += file.write(row.data)
                yield done
            if written != end - begin:
                raise AssertionError(f"{written} bytes in rows, expected {end - begin}")


def _tensor(name: str, described: object, start: int) -> Tensor:
    """Of a file whose arrays begin at a byte."""
    entry = entries(described, name)
    dtype, lengths, offsets = (entry.get(key) for key in ("dtype", "shape", "data_offsets"))
    if not isinstance(dtype, str) or dtype not in _DTYPES:
        raise UnfitValue(f"{name} of type {brief(dtype)}", f"one of {', '.join(_DTYPES)}")
    shape = tuple(whole(length, f"a length of {name}", 0, _LONGEST_AXIS) for length in items(lengths, "lengths", 8))
    begin, end = (whole(offset, f"an offset of {name}", 0, 2**62) for offset in items(offsets, "offsets", 2) or (0, 0))
    size = math.prod(shape) * np.dtype(_DTYPES[dtype]).itemsize
    if end - begin != size:
        raise UnfitValue(f"{name} of shape {shape} in {end - begin} bytes", f"{size}")
    return Tensor(start + begin, start + end, dtype, shape)


def _array(file: FileIO, tensor: Tensor) -> Array:
    array = np.empty(tensor.shape, _DTYPES[tensor.dtype])
    into = array.reshape(-1).view(np.uint8).data
    while into:
        count = file.readinto(into)
        if not count:
            raise UnfitValue("an end in the middle of an array", "a file that nobody cuts meanwhile")
        into = into[count:]
    # Any byte but 0 and 1 is no truth value.
    return array.view(np.uint8) != 0 if tensor.dtype == "BOOL" else array
