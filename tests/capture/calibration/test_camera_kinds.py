"""Make and model of cameras, as videos and photographs say."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from frog_blender.engine.capture.calibration.camera_kinds import kind_by, kind_of
from frog_blender.engine.capture.calibration.films import find_films, look, with_groups

IMAGE = np.random.default_rng(0).integers(0, 255, (24, 32, 3), np.uint8)


def exif(order: str, make: str, model: str, focal: int) -> bytes:
    """A TIFF header, a directory with make and model, and one with the focal length that 35 mm film would need."""
    texts = [text.encode() + b"\0" for text in (make, model)]
    end = 8 + 2 + 3 * 12 + 4
    at = [end, end + len(texts[0])]
    more = end + sum(map(len, texts))
    entries = [
        struct.pack(f"{order}HHI", tag, 2, len(text))
        + (text.ljust(4, b"\0") if len(text) <= 4 else struct.pack(f"{order}I", place))
        for tag, text, place in zip((0x010F, 0x0110), texts, at, strict=True)
    ]
    entries.append(struct.pack(f"{order}HHII", 0x8769, 4, 1, more))
    directory = struct.pack(f"{order}H", 3) + b"".join(entries) + bytes(4)
    second = struct.pack(f"{order}HHHIHH", 1, 0xA405, 3, 1, focal, 0) + bytes(4)
    start = {"<": b"II*\0", ">": b"MM\0*"}[order] + struct.pack(f"{order}I", 8)
    return start + directory + b"".join(texts) + second


def as_jpeg(body: bytes) -> bytes:
    jpeg = cv2.imencode(".jpg", IMAGE)[1].tobytes()
    content = b"Exif\0\0" + body
    return jpeg[:2] + b"\xff\xe1" + (len(content) + 2).to_bytes(2, "big") + content + jpeg[2:]


def as_png(body: bytes) -> bytes:
    png = cv2.imencode(".png", IMAGE)[1].tobytes()
    chunk = b"eXIf" + body
    return png[:33] + struct.pack(">I", len(body)) + chunk + struct.pack(">I", zlib.crc32(chunk)) + png[33:]


def frames(folder: Path, name: str, content: bytes) -> Path:
    ending = ".png" if content.startswith(b"\x89PNG") else ".jpg"
    (folder / name).mkdir(parents=True)
    for number in range(3):
        (folder / name / f"{number:04d}{ending}").write_bytes(content)
    return folder / name


@pytest.mark.parametrize(
    ("said", "kind"),
    [
        ("    com.apple.quicktime.make: Apple\n    com.apple.quicktime.model: iPhone 13\n", "Apple, iPhone 13"),
        ("    com.android.manufacturer: Google\n    com.android.model: Pixel 7\n", "Google, Pixel 7"),
        ("    firmware        : HD9.01.01.60.00\n", "HD9"),
        ("    major_brand     : isom\n    encoder         : Lavf59.27.100\n", ""),
    ],
)
def test_make_and_model_are_read_from_what_ffmpeg_says(said: str, kind: str) -> None:
    assert kind_by(said) == kind


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("written", [as_jpeg, as_png])
def test_make_and_model_of_frames_are_read_from_exif(
    tmp_path: Path, order: str, written: Callable[[bytes], bytes]
) -> None:
    folder = frames(tmp_path, "cam01", written(exif(order, "Sony", "ILCE-7M3", 35)))
    assert kind_of(folder) == "Sony, ILCE-7M3, 35"


def test_frames_without_exif_are_of_no_known_kind(tmp_path: Path) -> None:
    assert kind_of(frames(tmp_path, "a", cv2.imencode(".jpg", IMAGE)[1].tobytes())) == ""
    assert kind_of(frames(tmp_path, "b", as_jpeg(exif("<", " \x07 ", "", 0)))) == ""


@pytest.mark.parametrize("order", ["<", ">"])
def test_exif_that_is_cut_short_or_points_outside_ends_in_no_error(tmp_path: Path, order: str) -> None:
    whole = exif(order, "Canon", "EOS R5", 24)
    path = frames(tmp_path, "cam01", as_jpeg(whole)) / "0000.jpg"
    for length in range(len(whole)):
        path.write_bytes(as_jpeg(whole[:length]))
        assert "Canon, EOS R5, 24".startswith(kind_of(path.parent))
    for place in range(8, len(whole) - 4):
        path.write_bytes(as_jpeg(whole[:place] + b"\xff\xff\xff\xff" + whole[place + 4 :]))
        assert len(kind_of(path.parent)) < 100


def test_frames_of_two_makes_of_one_size_are_of_two_kinds(tmp_path: Path) -> None:
    for name, make in {"a": "Sony", "b": "Canon", "c": "Sony"}.items():
        frames(tmp_path, name, as_jpeg(exif(">", make, "X", 35)))
    films = find_films(tmp_path)
    views = [look(film, [], lambda: None) for film in films]
    assert [view.group for view in with_groups(views, kinds=[film.kind for film in films])] == [1, 0, 1]
