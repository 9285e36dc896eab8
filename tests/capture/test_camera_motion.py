"""When cameras count as moving."""

from __future__ import annotations

import pytest

from frog_blender.engine.capture.camera_motion import cameras_move


@pytest.mark.parametrize(
    ("images", "frames", "one_camera", "rig"),
    [
        ([1, 1, 1], [0, 1, 2], True, True),
        ([1, 1, 1], [0, 1], True, True),  # the third is held out
        ([1, 1, 1, 1], [0, 0, 1, 1], False, True),
        ([2, 1], [0, 1, 1], False, False),
        ([1, 1], [3, 3], False, False),
        ([1], [0], False, False),
        ([], [], False, False),
    ],
)
def test_cameras_move(images: list[int], frames: list[int], one_camera: bool, rig: bool) -> None:
    assert cameras_move(images, frames) is one_camera
    assert cameras_move(images, frames, rig=True) is rig
