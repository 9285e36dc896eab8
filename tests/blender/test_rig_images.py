"""Each camera's first image, decoded in the background for its frustum."""

from __future__ import annotations

import sys
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest
from support.training_panel import finish

from frog_blender import addon_state
from frog_blender.engine.capture.readers import open_capture
from frog_blender.ui import rig_images, rig_overlay


@pytest.fixture
def capture(addon, tmp_path, monkeypatch):
    pytest.importorskip("cv2")
    film = pytest.importorskip("support.synthetic_capture")
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "cache"))
    yield open_capture(film.write_capture(tmp_path / "capture"))
    addon_state.reset(rig_images.KeptImages)


def decoded(capture):
    return dict(finish(rig_images.images_of(capture)).waiting)


def test_every_camera_has_its_first_image(capture):
    found = decoded(capture)
    assert sorted(found) == list(range(len(capture.cameras)))
    for camera, pixels in found.items():
        width, height = capture.cameras[camera].width, capture.cameras[camera].height
        assert max(pixels.shape[:2]) <= rig_images.LONGEST_SIDE and pixels.dtype == np.uint8
        assert pixels.shape[1] / pixels.shape[0] == pytest.approx(width / height, rel=0.05) and pixels.std() > 1


def test_captures_of_several_windows_keep_their_images(capture):
    first, second = capture, replace(capture)
    for each in (first, second):
        assert sorted(decoded(each)) == list(range(len(capture.cameras)))
    images = rig_images.images_of(first)
    assert rig_images.images_of(second) is not images and rig_images.images_of(first) is images


def test_windows_on_different_scenes_build_each_rig_once(capture, monkeypatch):
    """The graphics card is a stand-in, as there is none without a window."""
    made, shown = [], [capture, replace(capture)]
    extras = SimpleNamespace(batch_for_shader=lambda *_, **__: made.append("batch") or MagicMock())
    monkeypatch.setitem(sys.modules, "gpu", MagicMock())
    monkeypatch.setitem(sys.modules, "gpu_extras.batch", extras)
    monkeypatch.setattr(rig_images, "_texture", lambda pixels: made.append("texture"))
    addon_state.reset(rig_overlay.RigOverlay)
    for _ in range(3):
        for each in (*shown, None):
            monkeypatch.setattr(rig_overlay, "shown_capture", lambda _scene, each=each: each)
            if each is not None:
                finish(rig_images.images_of(each))
            rig_overlay._draw_lines()
    assert made.count("texture") == 2 * len(capture.cameras)
    rigs = list(addon_state.get(rig_overlay.RigOverlay).rigs.values())
    assert len(rigs) == 2 and made.count("batch") == 2 * len(capture.cameras) + sum(len(rig.batches) for rig in rigs)
    addon_state.reset(rig_overlay.RigOverlay)


def test_the_longest_unseen_are_given_up(capture):
    images = rig_images.images_of(capture)
    others = [rig_images.images_of(replace(capture)) for _ in range(rig_images.KEPT)]
    assert images.stopped.is_set() and not any(other.stopped.is_set() for other in others)
    assert rig_images.images_of(capture) is not images


def test_one_that_cannot_be_decoded_is_left_out(capture, monkeypatch):
    decode = rig_images.marked_image

    def fail(asked, shot, side):
        if asked.shots[shot].camera == 1:
            raise OSError("gone")
        return decode(asked, shot, side)

    monkeypatch.setattr(rig_images, "marked_image", fail)
    assert sorted(decoded(capture)) == [0, *range(2, len(capture.cameras))]
