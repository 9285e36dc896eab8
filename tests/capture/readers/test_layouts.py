"""Every layout that other programs write: the same cameras, the same images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.filmed_scene import FRAMES, image
from support.layouts import phones, rigs
from support.layouts.colmap import POINTS
from support.layouts.written import FISHEYES, PHONES, STANDING, Writer

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.capture.lenses import WIDEST
from frog_blender.engine.capture.readers import open_capture

from .reading import assert_same_cameras, assert_same_images, opened


def written(folder: Path, writer: Writer) -> list[Camera]:
    folder.mkdir()
    return writer(folder)


@pytest.mark.parametrize("name", STANDING)
def test_standing_cameras(name: str, tmp_path: Path) -> None:
    layout, writer, _ = STANDING[name]
    cameras = written(tmp_path / "capture", writer)
    capture = opened(tmp_path / "capture", layout)
    assert capture.frame_count == FRAMES and len(capture.shots) == FRAMES * len(cameras)
    assert capture.distortions == (None,) * len(cameras) and not capture.has_moving_cameras
    assert_same_cameras(capture, cameras)
    assert_same_images(capture, tmp_path / "cache", image)


@pytest.mark.parametrize("name", FISHEYES)
def test_fisheyes_are_undistorted(name: str, tmp_path: Path) -> None:
    layout, writer, _ = FISHEYES[name]
    cameras = written(tmp_path / "capture", writer)
    capture = opened(tmp_path / "capture", layout)
    assert capture.frame_count == FRAMES and all(capture.distortions)
    assert all(2 * np.arctan(c.width / 2 / c.intrinsics[0, 0]) <= WIDEST + 1e-9 for c in capture.cameras)
    assert_same_cameras(capture, cameras, poses_only=True)
    assert_same_images(capture, tmp_path / "cache", image, off=4.0)
    half = capture.scaled(0.5)
    assert_same_images(half, tmp_path / "cache", image, off=8.0)


@pytest.mark.parametrize("name", PHONES)
def test_one_moving_camera(name: str, tmp_path: Path) -> None:
    layout, writer, _ = PHONES[name]
    cameras = written(tmp_path / "capture", writer)
    capture = opened(tmp_path / "capture", layout)
    assert capture.is_moving and capture.frame_count == phones.COUNT and capture.test_frames == {4}
    assert_same_cameras(capture, cameras)
    assert_same_images(capture, tmp_path / "cache", image)


def test_a_moving_fisheye_is_undistorted(tmp_path: Path) -> None:
    cameras = written(tmp_path / "capture", phones.nerfstudio_fisheye)
    capture = opened(tmp_path / "capture", "transforms")
    assert capture.is_moving and all(capture.distortions)
    assert_same_cameras(capture, cameras, poses_only=True)
    assert_same_images(capture, tmp_path / "cache", image, off=5.0)


def test_the_cameras_of_test_meta_are_held_out(tmp_path: Path) -> None:
    rigs.panoptic_sports(tmp_path)
    capture = open_capture(tmp_path)
    assert capture.test_cameras == {"11"}
    np.testing.assert_allclose(capture.points, POINTS)


def test_images_between_frames_keep_their_times(tmp_path: Path) -> None:
    """Polycam's names are microseconds: every other image is 30 ms late, of 500 ms from one to the next."""
    phones.polycam(tmp_path)
    capture = open_capture(tmp_path)
    times = [shot.frame + shot.offset for shot in capture.shots]
    np.testing.assert_allclose(times, [frame + 0.06 * (frame % 2) for frame in range(phones.COUNT)], atol=1e-9)
    assert len({shot.frame for shot in capture.shots}) == phones.COUNT


def test_a_part_of_the_image_seen_through_a_fisheye(tmp_path: Path) -> None:
    """A film that was cut off at the left after calibration: what is left must be undistorted as the whole was."""
    folder, offset = tmp_path / "capture", (6.0, 0.0)
    cameras = written(folder, rigs.immersive)
    whole = open_capture(folder)
    capture = open_capture(folder, pixel_offsets={cameras[1].name: offset})
    lens, cropped = whole.distortions[1], capture.distortions[1]
    np.testing.assert_allclose((lens.lens - cropped.lens)[0, 2] * cameras[1].width, 6.0)
    assert capture.cameras[1].intrinsics[0, 2] == whole.cameras[1].intrinsics[0, 2] - 6.0


def test_gaps_stay_gaps(tmp_path: Path) -> None:
    rigs.easyvolcap(tmp_path)
    (tmp_path / "images" / "01" / "000002.png").unlink()
    capture = open_capture(tmp_path)
    assert capture.frame_count == FRAMES and capture.shot_index(1, 2) is None and capture.shot_index(1, 3) is not None
    assert any("1 of 20 images are missing" in warning for warning in capture.warnings)
