"""Which film of a capture is heard, and from where on; retimed, each click is heard while its image is shown."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.builders import plain_camera, refused
from support.clicks import clicks, film_of_clicks, samples_of, times_of_clicks
from support.films import copied
from support.layouts.lists import opencv_entry, write_opencv

from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.scene.header import SceneHeader
from frog_blender.engine.source_media.retimed_sound import heard_frames, retimed_sound
from frog_blender.engine.source_media.sound import RATE, Samples, check_length, find_sound, read_sound, wav_of

from .test_undistorted_clips import header_of

IMAGES_A_SECOND, SECONDS, LATER = 10, 3.0, 0.5


@pytest.fixture
def header(tmp_path: Path) -> SceneHeader:
    """Of two films, one of them silent, the other one, which has sound, begun half a second after it."""
    film_of_clicks(tmp_path / "b.mp4", [0.5], SECONDS, IMAGES_A_SECOND)
    copied(tmp_path / "b.mp4", tmp_path / "a.mp4", has_sound=False)
    entries = [opencv_entry(replace(plain_camera(), name=name)) for name in ("a", "b")]
    return header_of(open_capture(write_opencv(tmp_path, [entries[0], entries[1] | {"offset": LATER}])))


def test_a_film_is_heard_from_the_captures_first_frame_on(header, tmp_path):
    sound = find_sound(header, tmp_path / "x.frog")
    assert sound is not None and sound.path.name == "b.mp4"
    capture = open_capture(tmp_path)
    names = [camera.name for camera in capture.cameras]
    second = next(shot for shot in capture.shots if names[shot.camera] == "a" and shot.index == IMAGES_A_SECOND)
    heard = sound.start + (second.frame + second.offset) / capture.frames_per_second
    assert heard == pytest.approx(1.0 - LATER, abs=0.5 / IMAGES_A_SECOND), "a's second 1 is b's half a second"


@pytest.mark.parametrize("suffix", ["mp4", "mkv"])
def test_clicks_are_where_their_images_are_in_films_that_begin_later(header, tmp_path, suffix):
    """As cameras write them that began to record before the film that was kept of it."""
    film = (tmp_path / "b.mp4").rename(tmp_path / "source.mp4_")
    copied(film, tmp_path / f"b.{suffix}", delay=0.7)
    sound = find_sound(header, tmp_path / "x.frog")
    assert sound is not None
    capture = open_capture(tmp_path)
    shot = next(
        shot for shot in capture.shots if shot.path == sound.path and shot.index == round(0.5 * IMAGES_A_SECOND)
    )
    (click,) = times_of_clicks(read_sound(sound.path, sound.start, SECONDS))
    assert click == pytest.approx((shot.frame + shot.offset) / capture.frames_per_second, abs=0.03)


def test_chapters_are_heard_one_after_the_other(tmp_path):
    for chapter, second in ((1, 0.5), (2, 1.0)):
        film_of_clicks(tmp_path / f"GX0{chapter}0040.MP4", [second], SECONDS, IMAGES_A_SECOND)
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


COUNT, OWN_RATE = 90, 30.0
CLICKS = (5, 20, 33, 50, 64, 80)  # frames of the capture


@pytest.fixture(scope="module")
def sound() -> Samples:
    return clicks([frame / OWN_RATE for frame in CLICKS], COUNT / OWN_RATE)


def heard(sound: Samples, shown: list[float | None], rate: float = OWN_RATE) -> np.ndarray:
    """Places in ``shown`` at which clicks begin."""
    return times_of_clicks(retimed_sound(sound, shown, rate, COUNT, OWN_RATE)) * rate


def test_what_plays_as_filmed_stays_as_it_is(sound):
    retimed = retimed_sound(sound, range(COUNT), OWN_RATE, COUNT, OWN_RATE)
    np.testing.assert_allclose(retimed.values * 32768, sound.values, atol=0.01)


@pytest.mark.parametrize("rate", [24.0, 30.0, 59.94])
@pytest.mark.parametrize(
    "shown",
    [
        [0.5 * k for k in range(180)],
        [2.5 * k for k in range(36)],
        [89.0 - 0.5 * k for k in range(179)],
        [89 * (k / 200) ** 2 for k in range(201)],
        [45 - 44 * np.cos(k / 50) for k in range(150)],
    ],
    ids=["slow", "fast", "reversed", "curve", "wave"],
)
def test_clicks_are_heard_at_their_frames(sound, shown, rate):
    """Of a click that is played backward the end comes first."""
    retimed = heard(sound, shown, rate)
    frames = np.interp(retimed, np.arange(len(shown)), shown)
    nearest = [min(abs(frame - click) for click in CLICKS) for frame in frames]
    speeds = np.abs(np.interp(retimed, np.arange(len(shown)), np.gradient(np.array(shown))))
    assert len(retimed) >= len(CLICKS) - 1 and (np.array(nearest) <= 0.5 * np.maximum(speeds, 0.2)).all()


def test_a_loop_goes_on_at_its_end(sound):
    retimed = heard(sound, [float(k % COUNT) for k in range(2 * COUNT)])
    np.testing.assert_allclose(retimed, [*CLICKS, *(COUNT + frame for frame in CLICKS)], atol=0.05)


def test_nothing_is_heard_of_what_is_frozen_or_not_there(sound):
    tone = Samples(np.full_like(sound.values, 20_000), RATE)
    shown = [None] * 10 + [float(k) for k in range(40)] + [40.0] * 30 + [float(k) for k in range(40, 60)] + [None] * 5
    level = np.abs(retimed_sound(tone, shown, 30.0, COUNT, OWN_RATE).values[:, 0]).reshape(len(shown), -1)
    loud = level.mean(1) > 0.5
    assert loud.tolist() == [frame is not None and not 49 < position < 80 for position, frame in enumerate(shown)]
    assert not retimed_sound(tone, [3.0] * 9, 30.0, COUNT, OWN_RATE).values.any()
    assert heard_frames(shown, COUNT, 1.0) == range(10, 100)
    assert heard_frames([3.0] * 9, COUNT, 1.0) == heard_frames([None, None], COUNT, 1.0) == range(0)


def test_false_tones_of_fast_sound_are_weak():
    """Eight times as fast, 5 kHz are none that anybody hears; every eighth sample would be as loud a tone of 8 kHz."""
    time = np.arange(3 * RATE) / RATE
    tone = Samples((20_000 * np.sin(2 * np.pi * 5_000 * time)).astype(np.int16)[:, None], RATE)
    retimed = retimed_sound(tone, [8.0 * k for k in range(11)], 30.0, COUNT, OWN_RATE)
    assert np.abs(retimed.values[100:-100]).max() < 0.2 * 20_000 / 32768


def test_films_are_read_from_their_first_image_on(tmp_path: Path):
    film = film_of_clicks(tmp_path / "a.mp4", [0.5, 1.25], 2.0, 30)
    early = read_sound(film, -0.5, 2.0)
    np.testing.assert_allclose(times_of_clicks(early), [1.0, 1.75], atol=0.002)
    assert len(early.values) == 2 * RATE
    assert not read_sound(film, 7200.0, 4.0).values.any(), "there is no more"
    (tmp_path / "b.mp4").write_bytes(b"nothing")
    refused(r"b\.mp4: found a file that cannot be decoded", read_sound, tmp_path / "b.mp4", 0.0, 2.0)
    refused("found no sound", read_sound, copied(film, tmp_path / "silent.mp4", has_sound=False), 0.0, 2.0)
    refused("expected at most", check_length, film, 1e5)
    refused("expected at most", retimed_sound, early, [0.0, 1.0], 1e-4, COUNT, OWN_RATE)


def test_files_hold_what_they_were_given(sound):
    np.testing.assert_array_equal(samples_of(wav_of(sound)).values, sound.values)
    floats = Samples(sound.values.astype(np.float32) / 32767, RATE)
    np.testing.assert_array_equal(samples_of(wav_of(floats)).values, sound.values)
