"""Arrays from files that anybody may have written: nothing is run, nothing allocated for what is not there."""

import struct
import tracemalloc
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from frog_blender.engine.errors import FrogError
from frog_blender.engine.io.numpy_files import read_npy, read_npz

POINTS = np.arange(12.0).reshape(4, 3)


def npy(header: str, content: bytes = b"", version: tuple[int, int] = (1, 0)) -> bytes:
    """A file whose header is that text."""
    text = header.encode("latin1")
    length = struct.pack("<H" if version == (1, 0) else "<I", len(text))
    return b"\x93NUMPY" + bytes(version) + length + text + content


def refused(read: Callable[[], object], path: Path) -> str:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tracemalloc.start()
        with pytest.raises(FrogError) as caught:
            read()
        assert tracemalloc.get_traced_memory()[1] < 5e6
        tracemalloc.stop()
    sentence = str(caught.value)
    assert sentence.startswith(str(path)) and sentence.endswith("expected points.") and "\n" not in sentence
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
        refused(lambda: read_npy(path, "points", 100), path)
        with zipfile.ZipFile(packed, "w") as archive:
            archive.write(path, "a.npy")
        refused(lambda: read_npz(packed, "points", 100), packed)


def test_files_that_are_none(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    refused(lambda: read_npy(path, "points", 100), path)
    refused(lambda: read_npy(tmp_path, "points", 100), tmp_path)
    refused(lambda: read_npz(tmp_path, "points", 100), tmp_path)
    np.save(path, POINTS)
    whole = path.read_bytes()
    for content in (b"", b"\x80\x04\x95" + bytes(40), whole[:5], whole[:60], whole[:-1], b"PK\x03\x04" + whole):
        path.write_bytes(content)
        refused(lambda: read_npy(path, "points", 100), path)
        refused(lambda: read_npz(path, "points", 100), path)
    np.save(path, np.array([{}], dtype=object), allow_pickle=True)
    assert "not a NumPy array of numbers (object" in refused(lambda: read_npy(path, "points", 100), path)


def test_what_is_too_much_in_all(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez_compressed(path, **{f"a{index}": np.zeros(1000) for index in range(20)})
    assert "expected at most 200 numbers" in refused(lambda: read_npz(path, "points", 9_200), path)
    assert len(read_npz(path, "points", 20_000)) == 20


def test_what_is_not_wanted_is_not_read(tmp_path: Path) -> None:
    path, asked = tmp_path / "a.npz", list[tuple[str, tuple[int, ...]]]()
    np.savez_compressed(path, a=POINTS, b=np.zeros(2**24))

    def wanted(name: str, shape: tuple[int, ...]) -> None:
        asked.append((name, shape))
        if name == "b":
            raise FrogError(f"{path}: found b, expected points.")

    assert "found b" in refused(lambda: read_npz(path, "points", 2**30, wanted), path)
    assert asked == [("a", (4, 3)), ("b", (2**24,))]


def test_a_flipped_bit_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, a=POINTS)
    content = bytearray(path.read_bytes())
    content[content.index(POINTS.tobytes()) + 20] ^= 4
    path.write_bytes(content)
    assert "Bad CRC" in refused(lambda: read_npz(path, "points", 100), path)
