"""Each camera's first image, decoded in the background for its frustum."""

from __future__ import annotations

import numpy as np
import pytest

from frog_blender import addon_state
from frog_blender.engine.capture.readers import open_capture
from frog_blender.ui import rig_images, rig_overlay


@pytest.fixture
def capture(addon, tmp_path, monkeypatch):
    pytest.importorskip("cv2")
    film = pytest.importorskip("support.synthetic_capture")
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "cache"))
    yield open_capture(film.write_capture(tmp_path / "capture"))
    rig_images.follow(None)


def decoded():
    images = addon_state.get(rig_images.RigImages)
    images.thread.join(30.0)
    found = {}
    while not images.found.empty():
        camera, pixels = images.found.get()
        found[camera] = pixels
    return found


def test_every_camera_has_its_first_image(capture):
    rig_images.follow(capture)
    found = decoded()
    assert sorted(found) == list(range(len(capture.cameras)))
    for camera, pixels in found.items():
        width, height = capture.cameras[camera].width, capture.cameras[camera].height
        assert max(pixels.shape[:2]) <= rig_images.LONGEST_SIDE and pixels.dtype == np.uint8
        assert pixels.shape[1] / pixels.shape[0] == pytest.approx(width / height, rel=0.05) and pixels.std() > 1


def test_it_is_followed_once_and_given_up(capture, monkeypatch):
    rig_images.follow(capture)
    images = addon_state.get(rig_images.RigImages)
    thread = images.thread
    rig_images.follow(capture)
    assert images.thread is thread
    rig_images.follow(None)
    thread.join(30.0)
    assert images.thread is None and images.capture is None and images.found.empty()


def test_one_that_cannot_be_decoded_is_left_out(capture, monkeypatch):
    decode = rig_images.marked_image

    def fail(asked, shot, side):
        if asked.shots[shot].camera == 1:
            raise OSError("gone")
        return decode(asked, shot, side)

    monkeypatch.setattr(rig_images, "marked_image", fail)
    rig_images.follow(capture)
    assert sorted(decoded()) == [0, *range(2, len(capture.cameras))]


def test_images_lie_in_the_planes_of_the_frusta(capture):
    planes = rig_overlay._every_corner(list(capture.cameras))[:, 1:5]
    for camera, corners in zip(capture.cameras, planes, strict=True):
        seen = (camera.world_to_camera[:3, :3] @ corners.T).T + camera.world_to_camera[:3, 3]
        pixels = (camera.intrinsics @ seen.T).T
        expected = [(0, 0), (camera.width, 0), (camera.width, camera.height), (0, camera.height)]
        np.testing.assert_allclose(pixels[:, :2] / pixels[:, 2:], expected, atol=1e-6)
