"""Films of a moving scene, started at different times, to the times they were started at; and the answer's files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.films import encode

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.capture.synchronization.films import Run, find_films
from frog_blender.engine.capture.synchronization.motion import Cameras
from frog_blender.engine.capture.synchronization.pairs import Curve
from frog_blender.engine.capture.synchronization.synchronization import (
    CameraClock,
    RunnerUp,
    Synchronization,
    draw_curves,
    find_clocks,
    synchronize,
)
from frog_blender.engine.io.child_process import Stopped
from frog_blender.engine.io.work_folder import WorkFolder

from .moving_scene import Start, ring, write_films

STILL = [np.full((150, 200, 3), 90, np.uint8)] * 20


def known(cameras: dict[str, Camera]) -> Cameras:
    return {name: (camera, np.zeros(5)) for name, camera in cameras.items()}


def errors(found: Synchronization, starts: dict[str, Start]) -> np.ndarray:
    """Frames by which offsets are wrong, whatever capture time starts with."""
    wrong = np.array([found.clocks[name][0] - start.offset for name, start in starts.items()])
    return np.abs(wrong - np.median(wrong)) / found.frame


def test_offsets_are_right_to_a_few_hundredths_of_a_frame(tmp_path: Path) -> None:
    cameras = ring(4)
    starts = {name: Start(o, 20) for name, o in zip(cameras, (0.0, 0.317, -0.208, 0.111), strict=True)}
    write_films(tmp_path, cameras, starts, 2.0)
    told: list[tuple[str, int, int]] = []
    work = WorkFolder(tmp_path / "work")
    found = synchronize(find_films(tmp_path), work, known(cameras), tell=lambda *step: told.append(step))
    assert errors(found, starts).max() < 0.05
    assert found.refusal is None and found.warnings == ()
    assert all(camera.confidence > 0.8 and camera.sources == ("motion",) for camera in found.cameras)
    assert min(offset for offset, _ in found.clocks.values()) == 0
    assert told[0] == ("sound", 0, 4) and told[-1][0] == "offsets" and told[-1][1] == told[-1][2]
    # The curve's maximum lies at the answer.
    for camera in found.cameras:
        best = camera.curve.lags[int(np.nanargmax(camera.curve.scores))]
        assert abs(best - camera.offset) < 0.3 * found.frame


def test_films_of_different_rates_by_cameras_that_are_not_quite_right(tmp_path: Path) -> None:
    cameras = ring(3)
    starts = {name: Start(o, rate) for name, o, rate in zip(cameras, (0.0, 0.217, -0.108), (24, 30, 24), strict=True)}
    write_films(tmp_path, cameras, starts, 2.0)
    random = np.random.default_rng(2)
    rough = {
        name: camera.moved(np.radians(random.normal(0, 0.2, 3)), random.normal(0, 0.02, 3))
        for name, camera in cameras.items()
    }
    found = synchronize(find_films(tmp_path), WorkFolder(tmp_path / "work"), known(rough))
    assert errors(found, starts).max() < 0.1
    assert found.refusal is None


def test_a_fast_clock_is_measured(tmp_path: Path) -> None:
    cameras = ring(2)
    starts = {"cam00": Start(0.0, 10), "cam01": Start(0.13, 10, 1.001)}
    write_films(tmp_path, cameras, starts, 26.0)
    found = synchronize(find_films(tmp_path), WorkFolder(tmp_path / "work"), known(cameras))
    assert abs(found.clocks["cam01"][1] / found.clocks["cam00"][1] - 1.001) < 1e-4
    assert errors(found, starts).max() < 0.1


def test_what_was_kept_is_not_looked_for_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And a child finds what this process does."""
    cameras = known(ring(2))
    starts = {"cam00": Start(0.0, 20), "cam01": Start(0.15, 20)}
    write_films(tmp_path, ring(2), starts, 1.5)
    films, work, told = find_films(tmp_path), WorkFolder(tmp_path / "kept"), list[tuple[str, int, int]]()
    run = Run(work, lambda *step: told.append(step), lambda: False)
    with pytest.raises(Stopped):
        find_clocks(replace(run, cancelled=lambda: True), films, cameras)
    first = synchronize(films, work, cameras)

    def decoded(*_: object) -> None:
        raise AssertionError("a film was decoded again")

    monkeypatch.setattr("frog_blender.engine.capture.readers.footage.Footage.decode", decoded)
    assert synchronize(films, work, cameras).clocks == first.clocks
    monkeypatch.undo()
    found = find_clocks(run, films, cameras)
    for name, clock in first.clocks.items():
        assert found.clocks[name] == pytest.approx(clock, abs=1e-6)
    assert told[-1][0] == "offsets"
    encode(tmp_path / "cam01.mp4", STILL, rate=20)
    assert synchronize(find_films(tmp_path), work, cameras).refusal is not None  # another film of the same name


def test_a_film_that_shares_nothing_is_refused(tmp_path: Path) -> None:
    """It has sound, of a codec that nobody knows, which is told."""
    cameras = ring(2)
    write_films(tmp_path, cameras, {name: Start(0.0, 20) for name in cameras}, 1.0)
    still = encode(tmp_path / "still.mkv", STILL, rate=20, sound=np.ones((48_000, 1), np.int16))
    still.write_bytes(still.read_bytes().replace(b"A_AAC", b"A_OUR"))
    found = synchronize(find_films(tmp_path), WorkFolder(tmp_path / "work"))
    (told,) = [warning for warning in found.warnings if "sound" in warning]
    assert told.startswith(f"The clocks are found without the sound of still. {still}: found a file that cannot be")
    assert found.refusal is not None and "still" in found.refusal
    assert all(camera.confidence < 0.75 for camera in found.cameras)  # motion energy alone proves little


# --- the image of the answer


def answer() -> Synchronization:
    lags = np.linspace(-1, 1, 41)
    scores = np.exp(-((lags - 0.25) ** 2) / 0.01)
    scores[3] = np.nan
    clock = CameraClock("cam01", 0.25, 1.001, 0.9, ("audio", "motion"), RunnerUp(-0.5, 0.95), Curve(lags, scores))
    other = CameraClock("cam02", 0.0, 1.0, 0.2, (), None, Curve())
    return Synchronization((clock, other), 1 / 30, 0.0004, ("A warning.",), "A refusal.")


def test_the_picture_marks_the_offset_and_its_rival() -> None:
    image = draw_curves(answer())
    assert image.shape == (192, 900, 3)
    green = (image == (30, 150, 70)).all(axis=-1)[:96].any(axis=0)
    orange = (image == (200, 120, 40)).all(axis=-1)[:96].any(axis=0)
    assert np.flatnonzero(green).mean() > np.flatnonzero(orange).mean()
    assert not (image == (30, 150, 70)).all(axis=-1)[96:].any()
