"""Every layout that other programs write: the same cameras, the same images."""

from pathlib import Path

import numpy as np
import pytest
from support.filmed_scene import FRAMES, image
from support.layouts import moving_rigs, rigs
from support.layouts.colmap import POINTS
from support.layouts.written import FISHEYES, STANDING, Writer

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.capture.lenses import WIDEST
from frog_blender.engine.capture.readers import open_capture

from .reading import assert_same_cameras, assert_same_images, opened, refuses


def written(folder: Path, writer: Writer) -> list[Camera]:
    folder.mkdir()
    return writer(folder)


MOVING_FISHEYE = {"nerfstudio_fisheye": ("transforms", moving_rigs.nerfstudio_fisheye, ())}
LAYOUTS = {**STANDING, **FISHEYES, **MOVING_FISHEYE}


@pytest.mark.parametrize("name", LAYOUTS)
def test_cameras_and_images_are_those_that_were_written(name: str, tmp_path: Path) -> None:
    layout, writer, _ = LAYOUTS[name]
    is_moving, is_fisheye = name in MOVING_FISHEYE, name in {*FISHEYES, *MOVING_FISHEYE}
    cameras = written(tmp_path / "capture", writer)
    capture = opened(tmp_path / "capture", layout)
    assert capture.is_moving == capture.has_moving_cameras == is_moving
    assert capture.frame_count == (moving_rigs.COUNT if is_moving else FRAMES)
    assert bool(capture.test_frames) == is_moving
    assert len(capture.shots) == (moving_rigs.COUNT if is_moving else FRAMES * len(cameras))
    assert {bool(lens) for lens in capture.distortions} == {is_fisheye}
    assert_same_cameras(capture, cameras, poses_only=is_fisheye)
    assert_same_images(capture, tmp_path / "cache", image, off=5.0 * is_fisheye)
    if is_fisheye:
        assert all(2 * np.arctan(c.width / 2 / c.intrinsics[0, 0]) <= WIDEST + 1e-9 for c in capture.cameras)
        assert_same_images(capture.scaled(0.5), tmp_path / "cache", image, off=8.0)


def test_the_cameras_of_test_meta_are_held_out(tmp_path: Path) -> None:
    rigs.panoptic_sports(tmp_path)
    capture = open_capture(tmp_path)
    assert capture.test_cameras == {"11"}
    np.testing.assert_allclose(capture.points, POINTS)


def test_a_part_of_the_image_seen_through_a_fisheye(tmp_path: Path) -> None:
    """A film that was cut off at the left after calibration: what is left must be undistorted as the whole was."""
    folder, offset = tmp_path / "capture", (6.0, 0.0)
    cameras = written(folder, rigs.immersive)
    whole = open_capture(folder)
    capture = open_capture(folder, pixel_offsets={cameras[1].name: offset})
    lens, cropped = whole.distortions[1], capture.distortions[1]
    np.testing.assert_allclose((lens.lens - cropped.lens)[0, 2] * cameras[1].width, 6.0)
    assert capture.cameras[1].intrinsics[0, 2] == whole.cameras[1].intrinsics[0, 2] - 6.0


def test_a_camera_of_immersive_that_is_no_fisheye(tmp_path: Path) -> None:
    rigs.immersive(tmp_path)
    models = tmp_path / "models.json"
    models.write_text(models.read_text().replace('"fisheye"', '"perspective"'))
    np.testing.assert_allclose(open_capture(tmp_path).distortions[0].coefficients[:5], [*rigs.FISHEYE[1][:2], 0, 0, 0])
    models.write_text(models.read_text().replace('"perspective"', '"panorama"'))
    refuses(tmp_path, "found the projection_type panorama of camera_0001, expected fisheye or perspective")


def test_gaps_stay_gaps(tmp_path: Path) -> None:
    rigs.easyvolcap(tmp_path)
    (tmp_path / "images" / "01" / "000002.png").unlink()
    capture = open_capture(tmp_path)
    assert capture.frame_count == FRAMES and capture.shot_index(1, 2) is None and capture.shot_index(1, 3) is not None
    assert any("1 of 20 images are missing" in warning for warning in capture.warnings)


def test_cameras_without_films_are_said_where_films_tell_the_sizes(tmp_path: Path) -> None:
    (tmp_path / "videos" / f"{rigs.easymocap(tmp_path)[3].name}.avi").unlink()
    assert "1 of 4 cameras are left out, without footage: 4." in open_capture(tmp_path).warnings[0]
