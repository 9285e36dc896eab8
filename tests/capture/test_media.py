"""What films and photographs say of themselves, and how they are shown: which frames, when, and which way up."""

import os
import struct
import sys
import zlib
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from support.builders import refused
from support.clicks import clicks, times_of_clicks
from support.films import INTERLACED, copied, encode, number_of, numbered, photograph, shown, sliding, woven

from frog_blender.engine.capture import media, video
from frog_blender.engine.capture.media import Photograph, has_sound, read_film_header, read_photograph, watch
from frog_blender.engine.capture.tone_mapping import ToneMapping
from frog_blender.engine.source_media.sound import Samples
from frog_blender.engine.srgb import srgb_to_linear

NOISE = np.random.default_rng(0).integers(0, 255, (31, 47, 3), np.uint8)


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ninety frames, a key frame every second."""
    return encode(tmp_path_factory.mktemp("film") / "film.mp4", numbered(90))


# Films ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("is_large", [False, True])
@pytest.mark.parametrize(("start", "first", "delay"), [(0.7, 21, 0.0), (0.75, 23, 1 / 60)])
def test_a_film_cut_without_encoding_shows_what_its_edit_list_shows(
    film: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, start: float, first: int, delay: float, is_large: bool
) -> None:
    """Large films are not decoded to count their frames."""
    monkeypatch.setattr(video, "_COUNT_BY_DECODING", 0 if is_large else 1e8)
    cut = copied(film, tmp_path / "cut.mp4", start=start)
    facts = video.read_facts(cut)
    assert facts.frame_count == len(shown(cut)) == 90 - first
    np.testing.assert_allclose(facts.timestamps, delay + np.arange(90 - first) / 30, atol=1e-6)
    images = list(video.decode(cut, [0, facts.frame_count - 1]))
    assert [number_of(image) for image in images] == [first, 89]


@pytest.mark.parametrize("ending", ["mp4", "mov", "mkv"])
def test_times_are_those_of_the_file(tmp_path: Path, ending: str) -> None:
    """Of films whose cameras dropped frames; of those that start late see ``KINDS``."""
    there = [frame for frame in range(60) if frame not in (7, 8, 40)]
    times = [frame / 30 for frame in there]
    dropped = encode(tmp_path / f"dropped.{ending}", [numbered(60)[frame] for frame in there], times=times)
    np.testing.assert_allclose(video.read_facts(dropped).timestamps, times, atol=1e-3)


@pytest.mark.parametrize(("ending", "codec"), [("mp4", "libx264"), ("avi", "mpeg4"), ("webm", "libvpx")])
def test_films_without_a_table_of_frames_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str, codec: str
) -> None:
    monkeypatch.setattr(video, "_COUNT_BY_DECODING", 0)
    whole = encode(tmp_path / f"whole.{ending}", numbered(50), codec=codec)
    path = copied(whole, tmp_path / "a.mp4", movflags="frag_keyframe+empty_moov") if ending == "mp4" else whole
    times = video.read_facts(path).timestamps
    np.testing.assert_allclose(times - times[0], np.arange(50) / 30, atol=1e-3)


@pytest.mark.parametrize("is_large", [False, True])
def test_a_film_that_is_cut_off_is_refused(
    film: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_large: bool
) -> None:
    monkeypatch.setattr(video, "_COUNT_BY_DECODING", 0 if is_large else 1e8)
    for flags, sentence in (
        ("", "a file that cannot be decoded"),
        ("faststart", "frames could be decoded, expected 90"),
    ):
        content = copied(film, tmp_path / "whole.mp4", movflags=flags).read_bytes()
        (tmp_path / "cut.mp4").write_bytes(content[: len(content) * 2 // 3])
        refused(rf"cut\.mp4: .*{sentence}", video.read_facts, tmp_path / "cut.mp4")


@pytest.mark.parametrize("turn", [90, 180, 270])
def test_a_rotation_flag_is_obeyed(film: Path, tmp_path: Path, turn: int) -> None:
    flagged = copied(film, tmp_path / "turned.mp4", turn=turn)
    facts = video.read_facts(flagged)
    assert (facts.width, facts.height) == ((48, 64) if turn % 180 else (64, 48))
    assert facts.turn == 360 - turn  # FFmpeg counts against the clock
    expected = np.rot90(shown(flagged)[3], turn // 90)
    assert np.abs(next(video.decode(flagged, [3])).astype(int) - expected).mean() < 2


FOURTHS, NARROW = Fraction(4, 3), Fraction(8, 9)
KINDS = [  # ending, codec, aspect of the pixels, first line of the first field or none, delay
    *[("mp4", "libx264", None, None, 0.0), ("mov", "libx264", FOURTHS, 0, 0.5), ("mkv", "libx264", NARROW, 1, 0.5)],
    *[("mts", "libx264", FOURTHS, 0, 0.0), ("m2ts", "libx264", None, 1, 0.0), ("ts", "mpeg2video", FOURTHS, 1, 0.0)],
    *[("mpg", "mpeg2video", FOURTHS, 0, 0.0), ("vob", "mpeg2video", None, None, 0.0), ("avi", "mpeg4", None, 0, 0.0)],
    *[("h264", "libx264", FOURTHS, 0, 0.0), ("mxf", "mpeg2video", None, None, 0.0), ("3gp", "mpeg4", None, None, 0.0)],
    *[("wmv", "wmv2", None, None, 0.0), ("flv", "flv1", None, None, 0.0), ("webm", "libvpx", None, None, 0.5)],
]


@pytest.mark.parametrize(("ending", "codec", "aspect", "top", "delay"), KINDS)
def test_every_container_shows_what_a_player_does(
    tmp_path: Path, ending: str, codec: str, aspect: Fraction | None, top: int | None, delay: float
) -> None:
    """Square pixels, the first field's moment, and times from the film's start."""
    truth = [sliding(moment) for moment in range(9)]
    images = truth if top is None else [woven(truth[k], sliding(k + 0.5), top) for k in range(9)]
    options = {} if top is None else INTERLACED
    times = [delay + k / 25 for k in range(9)] if delay else []
    film = encode(tmp_path / f"a.{ending}", images, codec=codec, rate=25, aspect=aspect, times=times, **options)
    assert video.find_videos(tmp_path) == [film]
    facts, width = video.read_facts(film), round(128 * (aspect or 1))
    assert ((facts.width, facts.height), facts.stored) == ((width, 96), (128, 96))
    np.testing.assert_allclose(facts.timestamps, delay + np.arange(9) / 25, atol=0.002)
    for k, image in zip((1, 4, 7), video.decode(film, [1, 4, 7]), strict=True):
        expected = cv2.resize(truth[k], (width, 96)).astype(int)
        assert np.abs(image.astype(int) - expected).mean() < 5  # of two moments it is 13 and more
        comb = np.abs(2 * image[28:68:2].astype(int) - image[27:67:2] - image[29:69:2]).mean()
        assert comb < 6


def test_what_is_marked_as_interlaced_and_is_not_stays_whole(tmp_path: Path) -> None:
    film = encode(tmp_path / "a.mts", [sliding(moment) for moment in range(9)], **INTERLACED)
    assert read_film_header(film).fields == ""
    still = encode(tmp_path / "still.mts", [sliding(0)] * 9, **INTERLACED)
    assert read_film_header(still).fields == "tff"  # as it is marked


def test_fields_and_copies_of_which_a_file_says_nothing_are_seen(tmp_path: Path) -> None:
    combed = [woven(sliding(k), sliding(k + 0.5), 0) for k in range(9)]
    assert watch(encode(tmp_path / "combed.mp4", combed)) == ("tff", 1.0)
    assert watch(encode(tmp_path / "webcam.mp4", [sliding(k // 5) for k in range(45)])) == ("", 5.0)
    paused = [sliding(min(k, 8) if k < 30 else k - 22) for k in range(34)]
    assert watch(encode(tmp_path / "paused.mp4", paused))[1] == 1.0


def test_small_copies_beside_a_film_are_no_cameras(tmp_path: Path) -> None:
    copy = tmp_path / "GL010001.LRV"
    copy.touch()
    assert video.find_videos(tmp_path) == [copy]
    (tmp_path / "GX010001.MP4").touch()
    assert [path.name for path in video.find_videos(tmp_path)] == ["GX010001.MP4"]


def test_what_else_a_film_says(film: Path, tmp_path: Path) -> None:
    plain = read_film_header(film)
    assert (plain.transfer, plain.fields, plain.aspect, plain.times) == ("", "", 1.0, None)
    assert not has_sound(film)
    tags = {"timecode": "01:02:03:12", "creation_time": "2024-05-06T07:08:09Z", "Make": "Son\x1by" + 300 * "-"}
    sound = clicks([0.1], 0.3).values
    odd = encode(tmp_path / "odd.mkv", numbered(9), tags=tags, sound=sound)
    said = read_film_header(odd)
    assert has_sound(odd)
    assert said.tags["timecode"] == "01:02:03:12" and said.tags["creation_time"].startswith("2024-05-06T07:08:09")
    assert said.tags["make"].startswith("Son\\x1by") and len(said.tags["make"]) <= 200
    (tmp_path / "text.mp4").write_bytes(b"text")
    assert not has_sound(tmp_path / "text.mp4")
    (tmp_path / "list.mp4").write_text(f"#EXTM3U\n#EXT-X-TARGETDURATION:10\n#EXTINF:10,\n{film}\n#EXT-X-ENDLIST\n")
    refused(r"list\.mp4: found a list of other files", read_film_header, tmp_path / "list.mp4")


def test_without_pyav_or_pillow_it_is_told_what_is_missing(
    film: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("av", "PIL"):
        monkeypatch.setitem(sys.modules, name, None)
    for read in (video.read_facts, has_sound, read_film_header):
        refused("need PyAV: pip install av", read, film)
    refused("need Pillow: pip install pillow", read_photograph, tmp_path / "a.png")


@pytest.mark.parametrize("matrix", [0, 1, 9])
@pytest.mark.parametrize("is_full", [False, True])
def test_the_whole_range_of_brightness_and_colours_are_those_that_were_filmed(
    tmp_path: Path, is_full: bool, matrix: int
) -> None:
    image = ramp()
    image[16:32] = np.concatenate([image[16:32, :, :1], 255 - image[16:32, :, :1], image[16:32, :, :1] // 3], axis=2)
    film = encode(tmp_path / "ramp.mp4", [image] * 2, is_full_range=is_full, matrix=matrix)
    read = next(video.decode(film, [1])).astype(int)
    np.testing.assert_allclose(read[[4, 24, 44]], image[[4, 24, 44]], atol=9)


def ramp() -> np.ndarray:
    return np.repeat(np.linspace(0, 255, 64).astype(np.uint8)[None, :, None], 48, axis=0).repeat(3, axis=2)


@pytest.mark.parametrize(("transfer", "white"), [("hlg", 0.75), ("pq", 0.58)])
@pytest.mark.parametrize("ending", ["mp4", "mkv"])
def test_a_film_of_high_dynamic_range_is_tone_mapped(tmp_path: Path, transfer: str, white: float, ending: str) -> None:
    """Greys keep their order and stay grey; the reference white, 203 cd/m2 of a signal, comes out bright."""
    film = encode(tmp_path / f"hdr.{ending}", [ramp()] * 3, transfer=transfer)
    assert video.read_facts(film).header.transfer == transfer
    row = next(video.decode(film, [1]))[24].astype(int)
    assert np.ptp(row, axis=1).max() <= 8
    assert (np.diff(row.mean(axis=1)) >= -2).all()
    assert row[0].max() < 10
    assert 0.68 < row[round(63 * white)].mean() / 255 < 0.82
    assert row[-1].min() > 245


def test_tone_mapping_keeps_the_hue_of_colours_inside_the_narrow_gamut() -> None:
    """A colour of sRGB's gamut, in BT.2020's primaries and PQ."""
    linear = np.array([0.30, 0.10, 0.05])  # of the reference white
    to_wide = np.array([[0.627404, 0.329283, 0.043313], [0.069097, 0.919540, 0.011362], [0.016391, 0.088013, 0.895595]])
    light = (to_wide @ linear) * 203 / 10000
    power = light**0.1593017578125
    signal = ((0.8359375 + 18.8515625 * power) / (1 + 18.6875 * power)) ** 78.84375
    image = np.full((2, 2, 3), np.round(signal * 255), np.uint8)
    read = srgb_to_linear(ToneMapping("pq").apply(image)[0, 0] / 255)
    np.testing.assert_allclose(read / read[0], linear / linear[0], atol=0.05)


@pytest.mark.parametrize("rate", [16_000, 44_100])
def test_sound_is_in_step_with_the_images_from_any_second_on(tmp_path: Path, rate: int) -> None:
    """Of tracks of 44.1 kHz, of films that start late, far into them, and whose track starts later."""
    times = np.arange(30) + 0.25
    sound = clicks(times, 30.0, 44_100).values
    film = encode(tmp_path / "a.mp4", numbered(150), rate=5, sound=sound, sound_rate=44_100)
    late = copied(film, tmp_path / "late.mkv", delay=0.5, sound_delay=0.3)
    for path, delay in ((film, 0.0), (late, 0.8)):
        for start in (0.0, 0.9, 21.3):
            heard = media.read_sound(path, rate, 2, start, 5.0)
            assert heard is not None and heard.shape == (5 * rate, 2)
            expected = times + delay - start
            within = expected[(expected > 0) & (expected < 5)]
            np.testing.assert_allclose(times_of_clicks(Samples(heard, rate)), within, atol=0.003)


on_linux = pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="names that this system does not take")


@on_linux
def test_a_colon_names_no_protocol(film: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "take10:30.mp4").write_bytes(film.read_bytes())
    monkeypatch.chdir(tmp_path)
    assert number_of(next(video.decode(Path("take10:30.mp4"), [5]))) == 5


@on_linux
def test_a_name_that_is_not_utf8_is_one_sentence(film: Path, tmp_path: Path) -> None:
    path = tmp_path / os.fsdecode(b"caf\xe9.mp4")
    path.write_bytes(film.read_bytes())
    refused(r"caf.*: found a name that is not UTF-8", video.read_facts, path).encode()


@on_linux
def test_an_image_that_the_system_does_not_read_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "a.png").symlink_to("/proc/self/mem")  # nothing is mapped at its start
    refused(r"a\.png: found a file that cannot be read \(Input/output error\)", video.read_image, tmp_path / "a.png")


# Photographs ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", [".png", ".jpg", ".bmp", ".tif", ".webp"])
def test_a_size_is_that_of_the_decoded_image(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"a{ending}"
    cv2.imwrite(str(path), NOISE)
    assert video.image_size(path) == (47, 31) == video.read_image(path).shape[1::-1]


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("ending", [".jpg", ".png"])
def test_exif_turns_an_image_once(tmp_path: Path, ending: str, orientation: int) -> None:
    image = np.zeros((48, 64, 3), np.uint8)
    image[:12, :32], image[36:, :8] = 250, 120
    file = photograph(tmp_path / f"a{ending}", image, turned=orientation)
    upright = photograph(tmp_path / "b.jpg", image, turned=orientation)
    expected = cv2.cvtColor(cv2.imread(str(upright), cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)  # which obeys JPEG's
    read = video.read_image(file)
    assert read.shape == expected.shape and video.image_size(file) == read.shape[1::-1]
    assert np.abs(read.astype(int) - expected).mean() < 3
    assert np.abs(video.read_gray(file).astype(int) - expected[..., 0]).mean() < 3
    assert video.image_facts(file, np.zeros(1), 30.0).turn == {3: 180, 6: 90, 8: 270}.get(orientation, 0)


def test_what_else_a_photograph_says(tmp_path: Path) -> None:
    said = read_photograph(photograph(tmp_path / "a.jpg", NOISE, make="Sony\x07 ", model="ILCE-7M3", focal_length=35))
    assert said == Photograph((47, 31), camera=("Sony", "ILCE-7M3", "35"))
    plain = read_photograph(photograph(tmp_path / "b.png", NOISE, turned=9, make=" \x07 ", focal_length=0))
    assert plain == Photograph((47, 31))
    for ending, channels in ((".png", 4), (".webp", 4), (".png", 3), (".jpg", 3)):
        path = tmp_path / f"c{ending}"
        cv2.imwrite(str(path), np.dstack([NOISE, NOISE[..., :1]])[..., :channels])
        read = read_photograph(path)
        assert read is not None and read.has_alpha == (channels == 4)


@pytest.mark.parametrize("kind", ["float", "half"])
def test_linear_light_is_shown_as_srgb_without_its_alpha(tmp_path: Path, kind: str) -> None:
    """A renderer's EXR: colours are multiplied by their alpha, and reach beyond white."""
    light = np.zeros((16, 32, 4), np.float32)
    light[..., :3], light[..., 3] = (0.5, 0.2, 0.05), 1.0
    light[:4] *= 0.5
    light[8:, :, :3] = 40.0
    write_exr(tmp_path / "a.exr", light, kind)
    shown = video.read_image(tmp_path / "a.exr", (1.0, 1.0, 1.0))
    np.testing.assert_allclose(shown[6, 3], [188, 124, 63], atol=1)
    np.testing.assert_allclose(shown[2, 3], [221, 189, 159], atol=1)
    assert (shown[12] == 255).all() and (video.read_alpha(tmp_path / "a.exr")[[2, 6], 3] == (128, 255)).all()
    assert read_photograph(tmp_path / "a.exr") == Photograph((32, 16), has_alpha=True)
    content = (tmp_path / "a.exr").read_bytes()
    huge, window = struct.pack("<4i", 0, 0, 60_000, 60_000), struct.pack("<4i", 0, 0, 31, 15)
    (tmp_path / "huge.exr").write_bytes(content.replace(window, huge))
    for read in (video.read_image, video.image_size):
        refused(r"huge\.exr: found a file that cannot be decoded", read, tmp_path / "huge.exr")


def write_exr(path: Path, light: np.ndarray, kind: str) -> None:
    with av.open(str(path), "w") as file:
        stream = file.add_stream("exr", options={"format": kind})
        stream.height, stream.width, stream.pix_fmt = *light.shape[:2], "gbrapf32le"
        file.mux(stream.encode(av.VideoFrame.from_ndarray(light, "gbrapf32le")))
        file.mux(stream.encode(None))


@pytest.mark.parametrize("name", ["a.HEIC", "a.avif", "a.dng", "a.jxl"])
def test_photographs_in_a_format_that_is_not_read_name_it_and_the_way_out(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"\0\0\0\x18ftypheic\0\0\0\0mif1heic" + bytes(500))
    refused(rf"found an image in {name[2:].upper()}, expected PNG.*magick mogrify", video.read_image, tmp_path / name)


def test_exif_that_is_cut_short_or_lies_ends_in_no_error(tmp_path: Path) -> None:
    path = photograph(tmp_path / "a.jpg", NOISE, turned=6, make="Canon", model="EOS R5", focal_length=24)
    whole = path.read_bytes()
    begin = whole.index(b"Exif\0\0")
    for position in range(begin, begin + 140, 3):
        for damage in (b"\xff\xff\xff\xff", b"\0\0\0\0", b"\x7f\0\0\1"):
            path.write_bytes(whole[:position] + damage + whole[position + 4 :])
            said = read_photograph(path) or Photograph((47, 31))  # None: Pillow opens it no more
            assert said.size == (47, 31) and 1 <= said.orientation <= 8 and len(", ".join(said.camera)) < 500


def test_what_is_no_image_is_refused(tmp_path: Path) -> None:
    png, jpeg = (cv2.imencode(ending, NOISE)[1].tobytes() for ending in (".png", ".jpg"))
    for content in (b"", b"text", png[:20], jpeg[:2], jpeg[:9], jpeg[:2] + b"\xff\xe0\0\0" + bytes(9)):
        (tmp_path / "a.png").write_bytes(content)
        refused(r"a\.png: found", video.image_size, tmp_path / "a.png")
    refused("no file", video.image_size, tmp_path / "none.png")


@pytest.mark.parametrize("size", [(2**31 - 1, 2**31 - 1), (60_000, 60_000), (65_537, 1)])
def test_an_image_that_claims_too_much_is_never_decoded(tmp_path: Path, size: tuple[int, int]) -> None:
    png = bytearray(cv2.imencode(".png", NOISE)[1].tobytes())
    png[16:24] = struct.pack(">II", *size)
    png[29:33] = struct.pack(">I", zlib.crc32(png[12:29]))
    path = tmp_path / "a.png"
    path.write_bytes(png)
    for read in (video.image_size, video.read_image, video.read_gray):
        refused(r"a\.png: found an image (of 65537 x 1 pixels|that is too large)", read, path)


def test_what_opencv_itself_refuses_is_a_sentence(tmp_path: Path) -> None:
    """A bitmap's header is not looked at before: OpenCV raises an error of its own for so many pixels."""
    bitmap = bytearray(cv2.imencode(".bmp", NOISE)[1].tobytes())
    bitmap[18:26] = struct.pack("<ii", 50_000, 50_000)
    path = tmp_path / "a.bmp"
    path.write_bytes(bitmap)
    for read in (video.image_size, video.read_image, video.read_gray):
        refused("cannot be decoded", read, path)


@pytest.mark.parametrize("length", [0x7FFFFFFF, 10_000])
def test_a_chunk_that_claims_more_than_the_file_is_never_given_room(tmp_path: Path, length: int) -> None:
    """OpenCV would take gigabytes."""
    path, whole = tmp_path / "a.png", cv2.imencode(".png", np.full((40, 56, 3), 90, np.uint8))[1].tobytes()
    path.write_bytes(whole[:33] + length.to_bytes(4, "big") + whole[37:])
    refused(r"a\.png: found a PNG that is cut off or damaged", video.read_image, path)
