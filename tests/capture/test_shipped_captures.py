"""The shipped captures are complete, decode, and their cameras and contents are what their READMEs say."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.video import decode

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "captures"
NAMES = [f"cam{index:02d}" for index in range(12)]
FRAMES = 30


# Width and height, focal length in pixels, bytes at most: what the READMEs say.
SHIPPED = {
    "room": ((320, 240), 300.0, 5_000_000),
    "dim": ((256, 192), 240.0, 5_000_000),
    "fast": ((256, 192), 240.0, 1_500_000),
}


def project(capture: str, camera: int, points: np.ndarray) -> np.ndarray:
    """World points (..., 3) in metres -> (..., 2) pixels, whole numbers at the corners of pixels."""
    pixels, _ = opened(capture).cameras[camera].project(points.reshape(-1, 3))
    return pixels.reshape(*points.shape[:-1], 2)


@cache
def opened(capture: str) -> Capture:
    return open_capture(FOLDER / capture)


@cache
def film(capture: str, camera: int) -> np.ndarray:
    """(frames, height, width, 3) uint8 RGB."""
    return np.array(list(decode(FOLDER / capture / f"{NAMES[camera]}.mp4", range(FRAMES))))


@pytest.mark.parametrize("capture", SHIPPED)
def test_the_reader_takes_it_and_it_is_small(capture: str) -> None:
    folder, (size, focal, bytes_at_most) = FOLDER / capture, SHIPPED[capture]
    found = opened(capture)
    assert [camera.name for camera in found.cameras] == NAMES and len(found.shots) == 12 * FRAMES
    assert {(camera.width, camera.height, camera.intrinsics[0, 0]) for camera in found.cameras} == {(*size, focal)}
    assert (folder / "README.md").is_file()
    assert sum(path.stat().st_size for path in folder.iterdir()) < bytes_at_most


# A rectangle on a patterned plane that every camera sees: x and z bounds and the plane's y, in metres.
FLAT_PATTERNS = {"room": ((-0.35, 0.59), (1.84, 2.21), 1.9 - 0.065), "dim": ((-1.3, 1.0), (2.15, 2.52), 1.7)}


@pytest.mark.parametrize("capture", FLAT_PATTERNS)
def test_known_points_lie_at_their_pixels_in_every_view(capture: str) -> None:
    """A pattern in the scene, fetched from its pixels in each camera, agrees between cameras to half a pixel."""
    cv2 = pytest.importorskip("cv2")
    (left, right), (bottom, top), depth = FLAT_PATTERNS[capture]
    step = 0.01  # metres between samples, less than half a pixel
    x, z = np.meshgrid(np.arange(left, right, step), np.arange(top, bottom, -step))
    points = np.stack([x, np.full_like(x, depth), z], axis=-1)
    patterns = []
    for camera in range(12):
        places = (project(capture, camera, points) - 0.5).astype(np.float32)  # OpenCV counts from pixel centres
        image = np.median(film(capture, camera).mean(axis=-1), axis=0).astype(np.float32)
        pattern = cv2.remap(image, places[..., 0], places[..., 1], cv2.INTER_CUBIC)
        patterns.append(pattern - cv2.GaussianBlur(pattern, (0, 0), 8))
    window = cv2.createHanningWindow(patterns[0].shape[::-1], cv2.CV_32F)
    pixel = 6.2 / SHIPPED[capture][1]  # metres on the plane, at its distance from the cameras
    for pattern in patterns[1:]:
        shift, _ = cv2.phaseCorrelate(patterns[0], pattern, window)
        assert np.hypot(*shift) * step < pixel / 2


def test_the_block_in_fast_lies_at_its_pixels_in_every_view() -> None:
    cv2 = pytest.importorskip("cv2")
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    turn = np.array([[np.cos(0.4), -np.sin(0.4), 0], [np.sin(0.4), np.cos(0.4), 0], [0, 0, 1]])
    corners = 0.28 * signs @ turn.T + np.array([0.35, 0.95, 0.28])
    for camera in range(12):
        red, green, blue = np.moveaxis(film("fast", camera)[0].astype(int), -1, 0)
        orange = np.zeros((192, 256), dtype=np.uint8)
        orange[(red - blue > 50) & (green - blue > 20) & (red - green < 90)] = 1
        hull = cv2.convexHull((project("fast", camera, corners) - 0.5).astype(np.float32))
        expected = np.zeros_like(orange)
        cv2.fillConvexPoly(expected, np.round(hull * 16).astype(np.int32), 1, shift=4)
        around = cv2.dilate(expected, np.ones((9, 9), dtype=np.uint8))
        seen = orange & around
        assert (seen & expected).sum() > 0.9 * (seen | expected).sum()
        offset = [np.mean(np.nonzero(seen)[axis]) - np.mean(np.nonzero(expected)[axis]) for axis in (0, 1)]
        assert np.abs(offset).max() < 0.7
