"""What every reader's tests ask: are the cameras and the images those that were written?"""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from support.builders import refused
from support.filmed_scene import still

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.readers import detect, open_capture
from frog_blender.engine.frames.store import FrameStore

Images = Callable[[Camera, int], np.ndarray]


def opened(folder: Path, layout: str) -> Capture:
    """The capture of a folder that must be recognised as this layout."""
    assert detect(folder) == layout
    capture = open_capture(folder)
    assert capture.format == layout
    return capture


def refuses(folder: Path, sentence: str) -> None:
    refused(sentence, open_capture, folder)


def assert_same_cameras(capture: Capture, expected: Sequence[Camera], *, poses_only: bool = False) -> None:
    """Names, sizes, K and poses to 1e-6."""
    by_name = {camera.name: camera for camera in capture.cameras}
    assert sorted(by_name) == sorted(camera.name for camera in expected)
    for camera in expected:
        found = by_name[camera.name]
        np.testing.assert_allclose(found.world_to_camera, camera.world_to_camera, atol=1e-6, rtol=0)
        assert (found.width, found.height) == (camera.width, camera.height)
        if not poses_only:
            np.testing.assert_allclose(found.intrinsics, camera.intrinsics, atol=1e-6, rtol=0)


def assert_same_images(
    capture: Capture, cache: Path, images: Images | None = None, *, off: float = 0.0, of_frame: Sequence[int] = ()
) -> None:
    """Every image of the capture as it is decoded, against ``images(camera, frame)`` (by default ``still``).

    Args:
        off: levels of 255 by which the mean may differ, of films and undistorted images.
        of_frame: the scene's frame that each frame of the capture shows, where they differ.
    """
    store = FrameStore.open(capture, cache_folder=cache)
    assert len(store) > 0
    for index, shot in enumerate(capture.shots):
        camera = capture.cameras[shot.camera]
        frame = of_frame[shot.frame] if of_frame else shot.frame
        expected = still(camera.name, frame) if images is None else images(camera, frame)
        difference = np.abs(store.image(index).astype(float) - expected)
        assert difference.mean() <= off, (camera.name, frame, difference.mean())
