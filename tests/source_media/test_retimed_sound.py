"""Sound that is retimed as images are: each click is heard while its image is shown."""

from pathlib import Path

import numpy as np
import pytest
from support.clicks import clicks, film_of_clicks, samples_of, times_of_clicks
from support.films import copied

from frog_blender.engine.errors import FrogError
from frog_blender.engine.source_media.retimed_sound import heard_frames, retimed_sound
from frog_blender.engine.source_media.sound import RATE, Samples, check_length, read_sound, wav_of

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
    with pytest.raises(FrogError, match=r"b\.mp4: found a file that cannot be decoded"):
        read_sound(tmp_path / "b.mp4", 0.0, 2.0)
    with pytest.raises(FrogError, match="found no sound"):
        read_sound(copied(film, tmp_path / "silent.mp4", has_sound=False), 0.0, 2.0)
    with pytest.raises(FrogError, match="expected at most"):
        check_length(film, 1e5)
    with pytest.raises(FrogError, match="expected at most"):
        retimed_sound(early, [0.0, 1.0], 1e-4, COUNT, OWN_RATE)


def test_files_hold_what_they_were_given(sound):
    np.testing.assert_array_equal(samples_of(wav_of(sound)).values, sound.values)
    floats = Samples(sound.values.astype(np.float32) / 32767, RATE)
    np.testing.assert_array_equal(samples_of(wav_of(floats)).values, sound.values)
