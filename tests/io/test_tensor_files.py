"""Files of named arrays: what another library writes is read, and nothing is believed before it was checked."""

import json
import struct
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import save_file

from frog_blender.engine.errors import FrogError
from frog_blender.engine.io.tensor_files import read_tensors

KIND = "a box of numbers"


def written(path: Path, header: Any, payload: bytes = b"") -> Path:
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    path.write_bytes(struct.pack("<Q", len(text)) + text + payload)
    return path


def refused(path: Path) -> str:
    with pytest.raises(FrogError) as caught:
        read_tensors(path, KIND)
    assert str(caught.value).endswith(f", expected {KIND}.") and str(caught.value).isprintable()
    return str(caught.value)


def test_every_type_and_shape_that_the_library_writes(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    kinds = ["f8", "f4", "f2", "i8", "i4", "i2", "i1", "u8", "u4", "u2", "u1", "?"]
    arrays = {kind: random.integers(0, 2, (3, 5)).astype(kind) for kind in kinds}
    arrays |= {
        "scalar": np.full((), 3.5, np.float32),
        "none": np.zeros((0, 7), np.float32),
        "ö": np.ones(1, np.float32),
    }
    save_file(arrays, tmp_path / "x", metadata={"a": "b", "ü": "\n"})
    read, metadata = read_tensors(tmp_path / "x", KIND)
    assert metadata == {"a": "b", "ü": "\n"} and read.keys() == arrays.keys()
    for name, array in arrays.items():
        assert read[name].dtype == array.dtype and read[name].flags.writeable and read[name].flags.aligned
        np.testing.assert_array_equal(read[name], array)


def entry(dtype: Any = "F32", shape: Any = (2,), offsets: Any = (0, 8)) -> dict[str, Any]:
    return {"dtype": dtype, "shape": shape, "data_offsets": offsets}


@pytest.mark.parametrize(
    "header",
    [
        *({"a": entry(dtype=dtype)} for dtype in ("F8_E4M3", "BF16", None, {}, [], 5, "\x1b[2J")),
        *({"a": entry(shape=shape)} for shape in (None, [3], [-2, -1], [2.0], [True, 2], "ab", [0], [1] * 9, [2**70])),
        *(
            {"a": entry(offsets=offsets)}
            for offsets in (None, [0], [0, 8, 8], [8, 0], [-8, 0], [1, 9], [0, 2**70], ["", 8])
        ),
        {"a": entry(), "b": entry()},
        {"a": entry(), "b": entry(offsets=[7, 15])},
        {"a": entry(shape=[0], offsets=[4, 4])},
        *({"a": wrong} for wrong in (None, [], {}, 5, "F32")),
        *({"__metadata__": wrong, "a": entry()} for wrong in (None, [], {"x": 5}, {"x": None}, "x")),
        *(b"", b"[]", b"null", b"{", b"\xff\xfe", b"[" * 10_000, b'{"a":' * 10_000),
    ],
    ids=lambda header: str(header)[:50],
)
def test_headers_that_cannot_be(tmp_path: Path, header: Any) -> None:
    refused(written(tmp_path / "x", header, bytes(8)))


def test_sizes_that_cannot_be(tmp_path: Path) -> None:
    path = tmp_path / "x"
    for content in (b"", b"1234567", struct.pack("<Q", 2**63) + b"{}", struct.pack("<Q", 2**64 - 1), bytes(8)):
        path.write_bytes(content)
        refused(path)
    for payload in (bytes(7), bytes(9), b""):
        refused(written(path, {"a": entry()}, payload))


def test_what_is_not_wanted_is_not_read(tmp_path: Path) -> None:
    """Not even where it would not fit into the memory: the file has a hole there."""
    size = 1 << 40
    header = {"big": entry("U8", [size], [8, 8 + size]), "small": entry()}
    path = written(tmp_path / "x", header, np.array([1, 2], np.float32).tobytes())
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size + size)
    arrays, _ = read_tensors(path, KIND, lambda name: name == "small")
    assert arrays["small"].tolist() == [1, 2] and arrays.keys() == {"small"}


def test_a_file_that_is_cut_while_it_is_read_is_refused(tmp_path: Path) -> None:
    """A mapped one would end the process with SIGBUS."""
    path = tmp_path / "x"
    save_file({"a": np.zeros(2**20, np.float32), "b": np.zeros(2**20, np.float32)}, path)

    def cut(_name: str) -> bool:
        path.write_bytes(path.read_bytes()[:5000])
        return True

    with pytest.raises(FrogError, match="an end in the middle of an array"):
        read_tensors(path, KIND, cut)


def test_reading_takes_no_more_memory_than_what_is_read(tmp_path: Path) -> None:
    save_file({"a": np.zeros(2**22, np.float32)}, tmp_path / "x")
    tracemalloc.start()
    read_tensors(tmp_path / "x", KIND)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert 2**24 <= peak < 1.1 * 2**24
