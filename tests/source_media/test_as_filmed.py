"""Clips of films that a video program would show at other times, or otherwise, than training saw them."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.builders import plain_camera
from support.films import copied, encode, number_of, numbered
from support.layouts.lists import opencv_entry, write_opencv
from support.small_captures import llff_row

from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.video import decode
from frog_blender.engine.source_media.clips import find_clips
from frog_blender.engine.source_media.undistorted_clips import Undistortion, clips_folder, undistortion

from .test_undistorted_clips import header_of


@pytest.fixture
def film(tmp_path: Path) -> Path:
    return encode(tmp_path / "film.mp4", numbered(20), key_every=5)


def calibrated(folder: Path, **changes: dict[str, Any]) -> Path:
    cameras = [replace(plain_camera(64, 48, 50.0), name=name) for name in ("a", "b")]
    return write_opencv(folder, [opencv_entry(camera, **changes.get(camera.name, {})) for camera in cameras])


def n3dv(folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    np.save(folder / "poses_bounds.npy", [llff_row(48, 64, 50.0)] * 2)
    return folder


def with_films(folder: Path, film: Path, names: str = "ab") -> Path:
    for name in names:
        (folder / f"{name}.mp4").write_bytes(film.read_bytes())
    return folder


def needed(folder: Path) -> Undistortion | None:
    """What has to be written for the scene ``c.frog`` beside the capture."""
    return undistortion(header_of(open_capture(folder)), folder.with_suffix(".frog"), folder)


def written(folder: Path, name: str, frames: Iterable[int]) -> list[int]:
    """The numbers that images of a clip show."""
    films = needed(folder)
    if films is not None:
        list(films.steps)
    return [number_of(image) for image in decode(clips_folder(folder.with_suffix(".frog")) / f"{name}.mp4", frames)]


@pytest.mark.parametrize("layout", [calibrated, n3dv])
def test_clips_of_films_that_lack_frames_show_each_image_at_its_time(film: Path, tmp_path: Path, layout: Any) -> None:
    folder = with_films(layout(tmp_path / "c"), film, "a")
    there = [frame for frame in range(20) if frame not in (4, 5, 11)]
    encode(folder / "b.mp4", [numbered(20)[frame] for frame in there], times=[frame / 30 for frame in there])
    shown = [0, 1, 2, 3, 3, 3, 6, 7, 8, 9, 10, 10, *range(12, 20)]
    assert written(folder, "b", range(20)) == shown, "the image before stays in a gap"


@pytest.mark.parametrize("layout", [calibrated, n3dv])
def test_plain_films_are_shown_as_they_are(film: Path, tmp_path: Path, layout: Any) -> None:
    assert needed(with_films(layout(tmp_path / "c"), film)) is None


def test_a_late_clock_and_high_dynamic_range_need_clips(film: Path, tmp_path: Path) -> None:
    late = with_films(calibrated(tmp_path / "late", b={"offset": 0.1}), film)
    assert (written(late, "a", [5]), written(late, "b", [5])) == ([8], [5])
    bright = calibrated(tmp_path / "bright")
    for name in ("a", "b"):
        encode(bright / f"{name}.mp4", numbered(4), transfer="pq")
    assert needed(bright) is not None


def test_trimmed_films_need_no_clips(film: Path, tmp_path: Path) -> None:
    folder = calibrated(tmp_path / "c")
    for name in ("a", "b"):
        copied(film, folder / f"{name}.mp4", start=0.2)
    assert needed(folder) is None


def test_films_that_a_calibration_names_are_found(film: Path, tmp_path: Path) -> None:
    folder = with_films(calibrated(tmp_path / "c", a={"video": "../film.mp4"}), film, "b")
    clips = find_clips(header_of(open_capture(folder)), folder)
    assert {name: clip.path.resolve() for name, clip in clips.items()} == {"a": film, "b": folder / "b.mp4"}
