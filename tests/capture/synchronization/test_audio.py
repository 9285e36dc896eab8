"""Sound: lags of noise like speech, clocks that drift, and films without sound or without ffmpeg."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from frog_blender.engine.capture import ffmpeg
from frog_blender.engine.capture.synchronization import audio
from frog_blender.engine.capture.synchronization.recordings import open_recording

from .moving_scene import write_film

RATE = audio.RATE


def speech(seconds: float, seed: int = 3) -> np.ndarray:
    """Bursts of band-limited noise, as long as syllables."""
    random = np.random.default_rng(seed)
    count = int(seconds * RATE)
    spectrum = np.fft.rfft(random.normal(size=count))
    frequencies = np.fft.rfftfreq(count, 1 / RATE)
    spectrum *= np.exp(-0.5 * ((np.log(np.maximum(frequencies, 1)) - np.log(700)) / 0.8) ** 2)
    loudness = np.repeat(random.uniform(0, 1, count // 2400 + 1) ** 2, 2400)[:count]
    sound = np.fft.irfft(spectrum, count) * loudness
    return (0.3 * sound / np.abs(sound).max()).astype(np.float32)


def room(sound: np.ndarray, seed: int) -> np.ndarray:
    """The same with reflections and noise of 10 dB below."""
    random = np.random.default_rng(seed)
    taps = np.zeros(3200)
    taps[0] = 1
    taps[200:] = random.normal(size=3000) * np.exp(-np.arange(3000) / 700) * 0.08
    heard = np.convolve(sound, taps)[: len(sound)]
    noise = random.normal(size=len(heard)) * np.sqrt(np.mean(heard**2) / 10)
    return (heard + noise).astype(np.float32)


@pytest.mark.parametrize("lag", [0.0, 1.2345, -2.71])
def test_the_lag_is_found_to_a_few_milliseconds(lag: float) -> None:
    whole = speech(16)
    begin = 4 * RATE
    shifted = begin + round(lag * RATE)
    first, second = whole[begin : begin + 8 * RATE], whole[shifted : shifted + 8 * RATE]
    found = audio.audio_lag((0, 1), (room(first, 1), room(second, 2)))
    assert found is not None
    assert abs(found.lag - lag) < 0.003
    assert found.rate == 1.0
    assert abs(found.curve.lags[int(found.curve.scores.argmax())] - lag) < 0.003


def test_a_drifting_clock_is_measured() -> None:
    whole = speech(70)
    fast = 1.0005  # seconds of the first film for each second of the second
    times = np.arange(60 * RATE) / RATE
    first = whole[: 65 * RATE]
    second = np.interp(2.0 + fast * times, np.arange(len(whole)) / RATE, whole).astype(np.float32)
    found = audio.audio_lag((0, 1), (first, second))
    assert found is not None
    assert abs(found.rate - fast) < 2e-5
    assert abs(found.lag - (2.0 + (fast - 1) * found.at)) < 0.002


def test_different_sounds_have_no_lag() -> None:
    assert audio.audio_lag((0, 1), (speech(8, 1), speech(8, 2))) is None


def with_sound(path: Path, sound: np.ndarray, folder: Path, delay: float = 0.0) -> Path:
    program = ffmpeg.program()
    assert program is not None
    raw = folder / "sound.f32"
    raw.write_bytes(sound.astype("<f4").tobytes())
    encoded, made = folder / "sound.m4a", folder / f"{path.stem}_{delay}.mp4"
    start = [program, "-y", "-v", "error"]
    subprocess.run([*start, "-f", "f32le", "-ar", str(RATE), "-ac", "1", "-i", str(raw), str(encoded)], check=True)
    both = ["-i", str(path), "-itsoffset", str(delay), "-i", str(encoded), "-map", "0:v", "-map", "1:a", "-c", "copy"]
    subprocess.run([*start, *both, str(made)], check=True)
    return made


def test_sound_is_read_from_the_films_own_zero(tmp_path: Path) -> None:
    pytest.importorskip("imageio_ffmpeg")
    silent = write_film(tmp_path / "a.mp4", lambda frame: np.full((48, 64, 3), 5 * frame, np.uint8), 40, 10.0)
    assert audio.read_audio(open_recording("a", silent)) is None
    sound = speech(3)
    on_time = audio.read_audio(open_recording("a", with_sound(silent, sound, tmp_path)))
    assert on_time is not None
    late = audio.read_audio(open_recording("a", with_sound(silent, sound, tmp_path, delay=0.5)))
    assert late is not None
    for heard, delay in ((on_time, 0.0), (late, 0.5)):
        found = audio.audio_lag((0, 1), (heard, sound))
        assert found is not None
        assert abs(found.lag - delay) < 0.03  # the encoder's own delay
    assert audio.read_audio(open_recording("a", with_sound(silent, 0 * sound, tmp_path))) is None


def test_without_ffmpeg_there_is_no_sound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    film = open_recording("a", write_film(tmp_path / "a.mp4", lambda frame: np.zeros((48, 64, 3), np.uint8), 5, 10.0))
    monkeypatch.setattr(audio, "program", lambda: None)
    assert audio.read_audio(film) is None
    monkeypatch.setattr(ffmpeg, "program", lambda: None)
    assert ffmpeg.notes(film.path) == ""
