"""Which film of a capture is heard, and from where on."""

from dataclasses import replace
from pathlib import Path

import pytest
from support.builders import plain_camera
from support.clicks import clicks, film_of_clicks, times_of_clicks
from support.films import copied
from support.layouts.lists import opencv_entry, write_opencv

from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.scene.header import SceneHeader
from frog_blender.engine.source_media.sound import find_sound, read_sound, wav_of

from .test_undistorted_clips import header_of

RATE, SECONDS, LATER = 10, 3.0, 0.5


@pytest.fixture
def header(tmp_path: Path) -> SceneHeader:
    """Of two films, one of them silent, the other one, which has sound, begun half a second after it."""
    film_of_clicks(tmp_path / "b.mp4", [0.5], SECONDS, RATE)
    copied(tmp_path / "b.mp4", tmp_path / "a.mp4", has_sound=False)
    entries = [opencv_entry(replace(plain_camera(), name=name)) for name in ("a", "b")]
    return header_of(open_capture(write_opencv(tmp_path, [entries[0], entries[1] | {"offset": LATER}])))


def test_a_film_is_heard_from_the_captures_first_frame_on(header, tmp_path):
    sound = find_sound(header, tmp_path / "x.frog")
    assert sound is not None and sound.path.name == "b.mp4"
    capture = open_capture(tmp_path)
    names = [camera.name for camera in capture.cameras]
    second = next(shot for shot in capture.shots if names[shot.camera] == "a" and shot.index == RATE)
    heard = sound.start + (second.frame + second.offset) / capture.frames_per_second
    assert heard == pytest.approx(1.0 - LATER, abs=0.5 / RATE), "a's second 1 is b's half a second"


@pytest.mark.parametrize("suffix", ["mp4", "mkv"])
def test_clicks_are_where_their_images_are_in_films_that_begin_later(header, tmp_path, suffix):
    """As cameras write them that began to record before the film that was kept of it."""
    film = (tmp_path / "b.mp4").rename(tmp_path / "source.mp4_")
    copied(film, tmp_path / f"b.{suffix}", delay=0.7)
    sound = find_sound(header, tmp_path / "x.frog")
    assert sound is not None
    capture = open_capture(tmp_path)
    shot = next(shot for shot in capture.shots if shot.path == sound.path and shot.index == round(0.5 * RATE))
    (click,) = times_of_clicks(read_sound(sound.path, sound.start, SECONDS))
    assert click == pytest.approx((shot.frame + shot.offset) / capture.frames_per_second, abs=0.03)


def test_chapters_are_heard_one_after_the_other(tmp_path):
    for chapter, second in ((1, 0.5), (2, 1.0)):
        film_of_clicks(tmp_path / f"GX0{chapter}0040.MP4", [second], SECONDS, RATE)
    heard = times_of_clicks(read_sound(tmp_path / "GX010040.MP4", -0.25, 2 * SECONDS + 1))
    assert heard == pytest.approx([0.75, 0.25 + SECONDS + 1.0], abs=0.03)
    assert times_of_clicks(read_sound(tmp_path / "GX010040.MP4", SECONDS, 2.0)) == pytest.approx([1.0], abs=0.03)


def test_without_the_calibration_films_begin_with_the_capture(header, tmp_path):
    (tmp_path / "cameras_opencv.json").write_text("{}")
    sound = find_sound(header, tmp_path / "x.frog")
    assert sound is not None and sound.start == 0
    (tmp_path / "b.mp4").unlink()
    assert find_sound(header, tmp_path / "x.frog") is None


def test_a_file_beside_the_scene_is_heard_where_no_film_has_sound(header, tmp_path):
    beside = tmp_path / "b.mp4"
    (tmp_path / "x.wav").write_bytes(wav_of(clicks([0.5], SECONDS)))
    sound = find_sound(header, tmp_path / "x.frog")
    assert sound is not None and sound.path == beside, "a film's own sound comes first"
    beside.unlink()
    sound = find_sound(header, tmp_path / "x.frog")
    assert sound is not None and (sound.path, sound.start) == (tmp_path / "x.wav", 0.0)
    (tmp_path / "x.wav").write_bytes(b"no sound")
    assert find_sound(header, tmp_path / "x.frog") is None
