"""Sizes from the first bytes of image files."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from frog_blender.engine.capture.image_size import image_size
from frog_blender.engine.capture.video import read_gray, read_image
from frog_blender.engine.errors import FrogError

IMAGE = np.random.default_rng(0).integers(0, 255, (31, 47, 3), np.uint8)
PROGRESSIVE, RESTARTS = [cv2.IMWRITE_JPEG_PROGRESSIVE, 1], [cv2.IMWRITE_JPEG_RST_INTERVAL, 2]


def marked(jpeg: bytes, marker: int, content: bytes) -> bytes:
    """A JPEG with one more segment, and padding before it."""
    return jpeg[:2] + b"\xff\xff" + bytes([marker]) + (len(content) + 2).to_bytes(2, "big") + content + jpeg[2:]


@pytest.mark.parametrize(
    ("ending", "options"),
    [(".png", []), (".jpg", []), (".jpg", PROGRESSIVE), (".jpg", RESTARTS), (".bmp", []), (".tif", []), (".webp", [])],
)
def test_a_size_is_that_of_the_decoded_image(tmp_path: Path, ending: str, options: list[int]) -> None:
    path = tmp_path / f"a{ending}"
    cv2.imwrite(str(path), IMAGE, options)
    assert image_size(path) == (47, 31) == read_image(path).shape[1::-1]


@pytest.mark.parametrize("marker", [0xE1, 0xC4, 0xFE])
def test_what_stands_before_the_size_is_passed(tmp_path: Path, marker: int) -> None:
    path = tmp_path / "a.jpg"
    path.write_bytes(marked(cv2.imencode(".jpg", IMAGE)[1].tobytes(), marker, bytes(range(200))))
    assert image_size(path) == (47, 31)


def test_a_turned_image_is_as_large_as_it_is_decoded(tmp_path: Path) -> None:
    turned = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    path = tmp_path / "a.jpg"
    path.write_bytes(marked(cv2.imencode(".jpg", IMAGE)[1].tobytes(), 0xE1, turned))
    assert image_size(path) == read_image(path).shape[1::-1]


def test_what_is_no_image_is_refused(tmp_path: Path) -> None:
    png, jpeg = (cv2.imencode(ending, IMAGE)[1].tobytes() for ending in (".png", ".jpg"))
    for content in (b"", b"text", png[:20], jpeg[:2], jpeg[:9], jpeg[:2] + b"\xff\xe0\0\0" + bytes(9)):
        (tmp_path / "a.png").write_bytes(content)
        with pytest.raises(FrogError, match=r"a\.png: found"):
            image_size(tmp_path / "a.png")
    with pytest.raises(FrogError, match="no file"):
        image_size(tmp_path / "none.png")


@pytest.mark.parametrize("size", [(2**31 - 1, 2**31 - 1), (2**31 - 1, 1), (60_000, 60_000), (65_537, 1)])
def test_an_image_that_claims_too_much_is_never_decoded(tmp_path: Path, size: tuple[int, int]) -> None:
    png = bytearray(cv2.imencode(".png", IMAGE)[1].tobytes())
    png[16:24] = struct.pack(">II", *size)
    png[29:33] = struct.pack(">I", zlib.crc32(png[12:29]))
    path = tmp_path / "a.png"
    path.write_bytes(png)
    for read in (image_size, read_image, read_gray):
        with pytest.raises(FrogError, match=f"of {size[0]} x {size[1]} pixels, expected at most 65,536 a side"):
            read(path)


def test_what_opencv_itself_refuses_is_a_sentence(tmp_path: Path) -> None:
    """A bitmap's header is not looked at before: OpenCV raises an error of its own for so many pixels."""
    bitmap = bytearray(cv2.imencode(".bmp", IMAGE)[1].tobytes())
    bitmap[18:26] = struct.pack("<ii", 50_000, 50_000)
    path = tmp_path / "a.bmp"
    path.write_bytes(bitmap)
    for read in (image_size, read_image, read_gray):
        with pytest.raises(FrogError, match="cannot be decoded") as caught:
            read(path)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("length", [0x7FFFFFFF, 10_000])
def test_a_chunk_that_claims_more_than_the_file_is_never_given_room(tmp_path: Path, length: int) -> None:
    """OpenCV would take gigabytes."""
    path = tmp_path / "a.png"
    cv2.imwrite(str(path), np.full((40, 56, 3), 90, np.uint8))
    whole = path.read_bytes()
    read_image(path)
    path.write_bytes(whole[:33] + length.to_bytes(4, "big") + whole[37:])
    with pytest.raises(FrogError, match=r"a\.png: found a PNG that is cut off or damaged"):
        read_image(path)
