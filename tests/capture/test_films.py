"""Films as players show them: which frames, when, and which way up."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from support.films import copied, encode, ffmpeg, high_dynamic_range, kept, number_of, numbered, shown

from frog_blender.engine.capture import video
from frog_blender.engine.capture.movie_header import read_movie_header
from frog_blender.engine.capture.tone_mapping import ToneMapping
from frog_blender.engine.capture.video import decode, read_facts, read_image
from frog_blender.engine.srgb import srgb_to_linear


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ninety frames, a key frame every second."""
    return encode(tmp_path_factory.mktemp("film") / "film.mp4", numbered(90), "-g", 30)


@pytest.mark.parametrize("is_large", [False, True])
@pytest.mark.parametrize(("start", "first", "delay"), [(0.7, 21, 0.0), (0.75, 23, 1 / 60), (1.0, 30, 0.0)])
def test_a_film_cut_without_encoding_shows_what_its_edit_list_shows(
    film: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, start: float, first: int, delay: float, is_large: bool
) -> None:
    """Large films are not decoded to count their frames: their header says it."""
    monkeypatch.setattr(video, "_COUNT_BY_DECODING", 0 if is_large else 1e8)
    cut = copied(film, tmp_path / "cut.mp4", "-ss", start)
    facts = read_facts(cut)
    assert facts.frame_count == len(shown(cut, 64, 48)) == 90 - first
    np.testing.assert_allclose(facts.timestamps, delay + np.arange(90 - first) / 30, atol=1e-6)
    images = list(decode(cut, [0, facts.frame_count - 1]))
    assert [number_of(image) for image in images] == [first, 89]


def test_a_film_cut_at_its_end_shows_no_more(film: Path, tmp_path: Path) -> None:
    cut = copied(film, tmp_path / "cut.mp4", "-ss", 0.5, "-t", 1.3)
    header = read_movie_header(cut)
    assert header is not None
    assert header.timestamps is not None
    assert len(header.timestamps) == len(list(shown(cut, 64, 48))) == read_facts(cut).frame_count


def test_a_film_that_starts_late_says_so(film: Path, tmp_path: Path) -> None:
    late = copied(film, tmp_path / "late.mp4", "-itsoffset", 0.5)
    np.testing.assert_allclose(read_facts(late).timestamps, 0.5 + np.arange(90) / 30)


@pytest.mark.parametrize("ending", ["mp4", "mkv"])
def test_dropped_frames_leave_gaps_in_the_times(film: Path, tmp_path: Path, ending: str) -> None:
    frames = [frame for frame in range(60) if frame not in (7, 8, 40)]
    facts = read_facts(kept(film, tmp_path / f"dropped.{ending}", frames))
    np.testing.assert_allclose(facts.timestamps, np.array(frames) / 30, atol=1e-3)


def test_a_film_in_fragments_is_counted(film: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video, "_COUNT_BY_DECODING", 0)
    ffmpeg("-i", film, "-c", "copy", "-movflags", "frag_keyframe+empty_moov", tmp_path / "a.mp4")
    np.testing.assert_allclose(read_facts(tmp_path / "a.mp4").timestamps, np.arange(90) / 30, atol=1e-6)


@pytest.mark.parametrize("turn", [90, 180, 270])
def test_a_rotation_flag_is_obeyed(film: Path, tmp_path: Path, turn: int) -> None:
    flagged = copied(film, tmp_path / "turned.mp4", "-display_rotation", turn)
    size = (48, 64) if turn % 180 else (64, 48)
    facts = read_facts(flagged)
    assert (facts.width, facts.height) == size
    assert facts.turn == 360 - turn  # ffmpeg's option counts against the clock
    np.testing.assert_allclose(next(decode(flagged, [3])), shown(flagged, *size)[3], atol=12)
    assert np.abs(next(decode(flagged, [3])).astype(int) - shown(flagged, *size)[3]).mean() < 2


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("ending", [".jpg", ".png"])
def test_exif_turns_an_image_once(tmp_path: Path, ending: str, orientation: int) -> None:
    image = np.zeros((48, 64, 3), np.uint8)
    image[:12, :32], image[36:, :8] = 250, 120
    file = write_oriented(tmp_path / f"a{ending}", image, orientation)
    expected = cv2.cvtColor(cv2.imread(str(file), cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)  # which obeys JPEG's
    if ending == ".png":
        upright = write_oriented(tmp_path / "b.jpg", image, orientation)
        expected = cv2.cvtColor(cv2.imread(str(upright), cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)
    found = read_image(file)
    assert found.shape == expected.shape
    assert np.abs(found.astype(int) - expected).mean() < 3
    assert np.abs(video.read_gray(file).astype(int) - expected[..., 0]).mean() < 3


def exif(orientation: int) -> bytes:
    """A TIFF header with one entry."""
    entry = (0x0112).to_bytes(2, "little") + b"\3\0" + b"\1\0\0\0" + orientation.to_bytes(4, "little")
    return b"II*\0\x08\0\0\0" + b"\1\0" + entry + b"\0\0\0\0"


def write_oriented(path: Path, image: np.ndarray, orientation: int) -> Path:
    """A JPEG or PNG with EXIF that names its orientation."""
    content = cv2.imencode(path.suffix, image[..., ::-1])[1].tobytes()
    if path.suffix == ".jpg":
        body = b"Exif\0\0" + exif(orientation)
        path.write_bytes(content[:2] + b"\xff\xe1" + (len(body) + 2).to_bytes(2, "big") + body + content[2:])
    else:
        body = exif(orientation)
        chunk = len(body).to_bytes(4, "big") + b"eXIf" + body + b"\0\0\0\0"
        path.write_bytes(content[:33] + chunk + content[33:])
    return path


@pytest.mark.parametrize(("transfer", "name"), [("arib-std-b67", "hlg"), ("smpte2084", "pq")])
@pytest.mark.parametrize("ending", ["mp4", "mkv"])
def test_a_film_of_high_dynamic_range_is_tone_mapped(tmp_path: Path, transfer: str, name: str, ending: str) -> None:
    """Greys keep their order and stay grey; the reference white comes out bright, half of it about two thirds."""
    image = np.repeat(np.linspace(0, 255, 64).astype(np.uint8)[None, :, None], 48, axis=0).repeat(3, axis=2)
    film = high_dynamic_range(tmp_path / f"hdr.{ending}", [image] * 3, transfer)
    assert read_facts(film).transfer == name
    row = next(decode(film, [1]))[24].astype(int)
    assert np.ptp(row, axis=1).max() <= 14  # OpenCV's own greys are up to 3 of 255 off
    assert (np.diff(row.mean(axis=1)) >= -2).all()
    assert row[0].max() < 10
    white = {"hlg": 0.75, "pq": 0.58}[name]  # signals of 203 cd/m2
    bright = row[round(63 * white)].mean() / 255
    assert 0.68 < bright < 0.82
    assert row[-1].min() > 245


def test_tone_mapping_keeps_the_hue_of_colours_inside_the_narrow_gamut() -> None:
    """A colour of sRGB's gamut, in BT.2020's primaries and PQ, as OpenCV decodes it."""
    linear = np.array([0.30, 0.10, 0.05])  # of the reference white
    to_wide = np.array([[0.627404, 0.329283, 0.043313], [0.069097, 0.919540, 0.011362], [0.016391, 0.088013, 0.895595]])
    light = (to_wide @ linear) * 203 / 10000
    power = light**0.1593017578125
    signal = ((0.8359375 + 18.8515625 * power) / (1 + 18.6875 * power)) ** 78.84375
    luma = signal @ [0.2627, 0.6780, 0.0593]
    blue, red = (signal[2] - luma) / 1.8814, (signal[0] - luma) / 1.4746
    decoded = luma + np.array([1.402 * red, -0.344136 * blue - 0.714136 * red, 1.772 * blue])
    image = np.full((2, 2, 3), np.round(decoded * 255), np.uint8)
    found = srgb_to_linear(ToneMapping("pq").apply(image)[0, 0] / 255)
    np.testing.assert_allclose(found / found[0], linear / linear[0], atol=0.05)


def test_ordinary_films_are_decoded_as_ever(film: Path) -> None:
    reader = cv2.VideoCapture(str(film))
    plain = [cv2.cvtColor(reader.read()[1], cv2.COLOR_BGR2RGB) for _ in range(5)]
    np.testing.assert_array_equal(list(decode(film, range(5))), plain)
    assert (read_facts(film).turn, read_facts(film).transfer) == (0, "")


@pytest.mark.parametrize("at", [4, 40, 41, 100, 300])
def test_a_damaged_header_is_no_header(film: Path, tmp_path: Path, at: int) -> None:
    content = bytearray(film.read_bytes())
    place = content.index(b"moov") + at
    content[place : place + 4] = b"\xff\xff\xff\xff"
    (tmp_path / "a.mp4").write_bytes(content)
    read_movie_header(tmp_path / "a.mp4")  # raises nothing
