"""Arrays from files that anybody may have written, NumPy's and those of named tensors: nothing is run, nothing believed
or allocated before it was checked."""

import json
import re
import shutil
import struct
import tracemalloc
import warnings
import zipfile
from collections.abc import Callable, Generator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import save_file
from support.builders import refused

from frog_blender.engine.errors import FrogError
from frog_blender.engine.io.numpy_files import read_npy, read_npz
from frog_blender.engine.io.tensor_files import read_tensors, write_rows

POINTS = np.arange(12.0).reshape(4, 3)


def npy(header: str, content: bytes = b"", version: tuple[int, int] = (1, 0)) -> bytes:
    """A file whose header is that text."""
    text = header.encode("latin1")
    length = struct.pack("<H" if version == (1, 0) else "<I", len(text))
    return b"\x93NUMPY" + bytes(version) + length + text + content


def no_points(read: Callable[..., object], path: Path, *limits: Any) -> str:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tracemalloc.start()
        sentence = refused(rf"^{re.escape(str(path))}.*expected points\.$", read, path, "points", *(limits or (100,)))
        assert tracemalloc.get_traced_memory()[1] < 5e6
        tracemalloc.stop()
    return sentence


@pytest.mark.parametrize("array", [POINTS, POINTS.T, POINTS.astype(">f4"), POINTS > 3, np.zeros((0, 3)), np.array(5)])
def test_arrays_are_as_numpy_wrote_them(tmp_path: Path, array: np.ndarray) -> None:
    np.save(tmp_path / "a.npy", array)
    array_read = read_npy(tmp_path / "a.npy", "points", 100)
    np.testing.assert_array_equal(array_read, array)
    assert array_read.dtype == array.dtype and array_read.flags.writeable
    for save in (np.savez, np.savez_compressed):
        save(tmp_path / "a.npz", one=array)
        np.testing.assert_array_equal(read_npz(tmp_path / "a.npz", "points", 100)["one"], array)


GOOD = "{'descr': '<f8', 'fortran_order': False, 'shape': (4, 3), }"
HEADERS = [
    *("", "{", "5", "[]", "{}", "'\\\n", "(" * 900, "-" * 900, "x" * 60_000, "{'descr': open('/etc/passwd')}"),
    *(GOOD.replace("(4, 3)", shape) for shape in ("(4, -3)", "(2**80, 3)", "4", "(4, 3.0)", "(10**18, 10**18)", "x")),
    *(GOOD.replace("<f8", kind) for kind in ("|O", "<U9", "<M8[s]", "|V8", "f8, f8", "", "x", "<f99", "(1000000,)f8")),
    GOOD.replace("'<f8'", "[('a', '<f8')]"),
    GOOD.replace("False", "5"),
    GOOD.replace("(4, 3)", f"({2**40}, 3)"),
    GOOD.replace("(4, 3)", f"({'1, ' * 80})"),
]


@pytest.mark.parametrize("header", HEADERS, ids=lambda header: header[:60])
def test_headers_that_announce_something_else(tmp_path: Path, header: str) -> None:
    path, packed = tmp_path / "a.npy", tmp_path / "a.npz"
    for version in ((1, 0), (2, 0), (3, 0), (9, 9)):
        path.write_bytes(npy(header, POINTS.tobytes(), version))
        no_points(read_npy, path)
        with zipfile.ZipFile(packed, "w") as archive:
            archive.write(path, "a.npy")
        no_points(read_npz, packed)


def test_files_that_are_none(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    no_points(read_npy, path)
    no_points(read_npy, tmp_path)
    no_points(read_npz, tmp_path)
    np.save(path, POINTS)
    whole = path.read_bytes()
    for content in (b"", b"\x80\x04\x95" + bytes(40), whole[:5], whole[:60], whole[:-1], b"PK\x03\x04" + whole):
        path.write_bytes(content)
        no_points(read_npy, path)
        no_points(read_npz, path)
    np.save(path, np.array([{}], dtype=object), allow_pickle=True)
    assert "not a NumPy array of numbers (object" in no_points(read_npy, path)


def test_what_is_too_much_in_all(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez_compressed(path, **{f"a{index}": np.zeros(1000) for index in range(20)})
    assert "expected at most 200 numbers" in no_points(read_npz, path, 9_200)
    assert len(read_npz(path, "points", 20_000)) == 20


def test_what_is_not_wanted_is_not_read(tmp_path: Path) -> None:
    path, asked = tmp_path / "a.npz", list[tuple[str, tuple[int, ...]]]()
    np.savez_compressed(path, a=POINTS, b=np.zeros(2**24))

    def wanted(name: str, shape: tuple[int, ...]) -> None:
        asked.append((name, shape))
        if name == "b":
            raise FrogError(f"{path}: found b, expected points.")

    assert "found b" in no_points(read_npz, path, 2**30, wanted)
    assert asked == [("a", (4, 3)), ("b", (2**24,))]


def test_a_flipped_bit_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, a=POINTS)
    content = bytearray(path.read_bytes())
    content[content.index(POINTS.tobytes()) + 20] ^= 4
    path.write_bytes(content)
    assert "Bad CRC" in no_points(read_npz, path)


KIND = "a box of numbers"


def written(path: Path, header: Any, payload: bytes = b"") -> Path:
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    path.write_bytes(struct.pack("<Q", len(text)) + text + payload)
    return path


def no_tensors(path: Path) -> None:
    assert refused(rf", expected {KIND}\.$", read_tensors, path, KIND).isprintable()


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
    no_tensors(written(tmp_path / "x", header, bytes(8)))


def test_sizes_that_cannot_be(tmp_path: Path) -> None:
    path = tmp_path / "x"
    for content in (b"", b"1234567", struct.pack("<Q", 2**63) + b"{}", struct.pack("<Q", 2**64 - 1), bytes(8)):
        path.write_bytes(content)
        no_tensors(path)
    for payload in (bytes(7), bytes(9), b""):
        no_tensors(written(path, {"a": entry()}, payload))


def test_arrays_that_are_not_wanted_are_not_read(tmp_path: Path) -> None:
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

    refused("an end in the middle of an array", read_tensors, path, KIND, cut)


def test_reading_takes_no_more_memory_than_what_is_read(tmp_path: Path) -> None:
    save_file({"a": np.zeros(2**22, np.float32)}, tmp_path / "x")
    tracemalloc.start()
    read_tensors(tmp_path / "x", KIND)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert 2**24 <= peak < 1.1 * 2**24


def test_rows_that_do_not_all_come_or_have_no_room_leave_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def writing() -> Generator[int, None, None]:
        rows = (np.full(4, row, np.uint8) for row in range(3))
        return write_rows(tmp_path / "x", {"a": POINTS}, {"of": "x"}, ("rows", "U8", (3, 4)), rows)

    assert list(writing()) == [0, 1, 2, 3]
    arrays, metadata = read_tensors(tmp_path / "x", "rows")
    np.testing.assert_array_equal(arrays["rows"], np.repeat(np.arange(3), 4).reshape(3, 4))
    np.testing.assert_array_equal(arrays["a"], POINTS)
    assert metadata == {"of": "x"}
    (tmp_path / "x").unlink()
    stopped = writing()
    assert [next(stopped), next(stopped)] == [0, 1] and len(list(tmp_path.iterdir())) == 1
    stopped.close()
    assert not list(tmp_path.iterdir())
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=100))
    refused("needs 0 MB, found 0 MB on the disk", list, writing())
    assert not list(tmp_path.iterdir())
