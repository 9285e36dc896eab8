"""The shipped captures are complete, decode, and their cameras and contents are what their READMEs say."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from frog_blender.engine.capture.readers import open_capture

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "captures"
NAMES = [f"cam{index:02d}" for index in range(12)]
FRAMES = 30


@dataclass(frozen=True)
class Shipped:
    """What a README says: size and focal length in pixels, bytes at most, bounds on near and far in metres."""

    size: tuple[int, int]
    focal: float
    bytes_at_most: int
    near: tuple[float, float]
    far: tuple[float, float]


SHIPPED = {
    "room": Shipped((320, 240), 300.0, 5_000_000, (1.0, 3.5), (5.5, 9.0)),
    "dim": Shipped((256, 192), 240.0, 5_000_000, (1.0, 3.5), (5.5, 9.0)),
    "fast": Shipped((256, 192), 240.0, 1_500_000, (1.0, 3.5), (5.5, 10.5)),
}
captures = pytest.mark.parametrize("capture", SHIPPED)


@cache
def camera_rows(capture: str) -> np.ndarray:
    return np.load(FOLDER / capture / "poses_bounds.npy", allow_pickle=False)


def opencv_axes(capture: str) -> tuple[np.ndarray, np.ndarray]:
    """(12, 3, 3) camera-to-world rotations (right, down, forwards) and (12, 3) centres."""
    matrices = camera_rows(capture)[:, :15].reshape(-1, 3, 5)
    down, right, backwards = matrices[:, :, 0], matrices[:, :, 1], matrices[:, :, 2]
    return np.stack([right, down, -backwards], axis=2), matrices[:, :, 3]


def project(capture: str, camera: int, points: np.ndarray) -> np.ndarray:
    """World points (..., 3) in metres -> (..., 2) pixels, whole numbers at the corners of pixels."""
    axes, centers = opencv_axes(capture)
    local = (points - centers[camera]) @ axes[camera]
    width, height = SHIPPED[capture].size
    return SHIPPED[capture].focal * local[..., :2] / local[..., 2:] + np.array([width / 2, height / 2])


@cache
def film(capture: str, camera: int) -> np.ndarray:
    """(frames, height, width, 3) uint8 BGR."""
    cv2 = pytest.importorskip("cv2")
    reader, frames = cv2.VideoCapture(str(FOLDER / capture / f"{NAMES[camera]}.mp4")), []
    while (decoded := reader.read())[0]:
        frames.append(decoded[1])
    return np.array(frames)


@captures
def test_files_are_present_and_small(capture: str) -> None:
    folder = FOLDER / capture
    assert sorted(path.stem for path in folder.glob("*.mp4")) == NAMES
    assert (folder / "README.md").is_file()
    assert sum(path.stat().st_size for path in folder.iterdir()) < SHIPPED[capture].bytes_at_most


@captures
def test_every_film_decodes_to_thirty_frames(capture: str) -> None:
    width, height = SHIPPED[capture].size
    assert [film(capture, camera).shape for camera in range(12)] == [(FRAMES, height, width, 3)] * 12


@captures
def test_the_reader_takes_it(capture: str) -> None:
    found = open_capture(FOLDER / capture)
    assert len(found.cameras) == 12 and len(found.shots) == 12 * FRAMES


@captures
def test_camera_rows(capture: str) -> None:
    rows, shipped = camera_rows(capture), SHIPPED[capture]
    assert rows.shape == (12, 17) and rows.dtype == np.float64
    size = np.tile([*shipped.size[::-1], shipped.focal], (12, 1))
    np.testing.assert_array_equal(rows[:, :15].reshape(-1, 3, 5)[:, :, 4], size)
    for values, (low, high) in ((rows[:, 15], shipped.near), (rows[:, 16], shipped.far)):
        assert (values > low).all() and (values < high).all()


@captures
def test_rotations_are_proper_and_upright(capture: str) -> None:
    axes, _ = opencv_axes(capture)
    np.testing.assert_allclose(axes.transpose(0, 2, 1) @ axes, np.tile(np.eye(3), (12, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(axes), 1.0, atol=1e-12)
    np.testing.assert_allclose(axes[:, 2, 0], 0.0, atol=1e-12)  # "right" is level
    assert (axes[:, 2, 1] < -0.9).all()  # "down" points down in a world whose z is up


@captures
def test_all_cameras_look_at_one_point(capture: str) -> None:
    axes, centers = opencv_axes(capture)
    forwards = axes[:, :, 2]
    # The point nearest to all viewing rays: sum (I - d d^T) (x - c) = 0.
    across = np.eye(3) - forwards[:, :, None] * forwards[:, None, :]
    target = np.linalg.solve(across.sum(axis=0), np.einsum("nij,nj->i", across, centers))
    local = np.einsum("nji,nj->ni", axes, target - centers)
    np.testing.assert_allclose(local, np.tile([0.0, 0.0, 4.4], (12, 1)), atol=1e-9)


@captures
def test_the_test_view_lies_inside_the_rig(capture: str) -> None:
    _, centers = opencv_axes(capture)
    offsets = centers[1:] - centers[0]
    for axis in (0, 2):  # sideways and upwards
        assert offsets[:, axis].min() < -0.3 and offsets[:, axis].max() > 0.3
    assert np.linalg.norm(offsets, axis=1).min() > 0.3  # no training camera stands beside it


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
    pixel = 6.2 / SHIPPED[capture].focal  # metres on the plane, at its distance from the cameras
    for pattern in patterns[1:]:
        shift, _ = cv2.phaseCorrelate(patterns[0], pattern, window)
        assert np.hypot(*shift) * step < pixel / 2


def test_the_block_in_fast_lies_at_its_pixels_in_every_view() -> None:
    cv2 = pytest.importorskip("cv2")
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    turn = np.array([[np.cos(0.4), -np.sin(0.4), 0], [np.sin(0.4), np.cos(0.4), 0], [0, 0, 1]])
    corners = 0.28 * signs @ turn.T + np.array([0.35, 0.95, 0.28])
    for camera in range(12):
        blue, green, red = np.moveaxis(film("fast", camera)[0].astype(int), -1, 0)
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


def deviation(capture: str) -> np.ndarray:
    """(height, width) standard deviation over time of the test view, in grey levels."""
    return np.std(film(capture, 0).astype(np.float32), axis=0).mean(axis=-1)


def test_the_room_moves_where_it_should() -> None:
    assert 0.15 < (deviation("room") > 6).mean() < 0.30
    assert np.median(deviation("room")) < 2.0  # the room itself stands still


def test_dim_is_dark_but_not_black() -> None:
    for camera in range(12):
        brightness = film("dim", camera).mean(axis=(1, 2, 3)) / 255
        assert 0.06 < brightness.mean() < 0.12
        assert brightness.min() > 0.05 and brightness.max() < 0.15
    assert (film("dim", 0).max(axis=-1) > 0.25 * 255).mean() > 0.04


def test_the_light_of_dim_changes_across_most_of_the_image() -> None:
    def changing(capture: str) -> float:
        grey = film(capture, 0).mean(axis=-1)
        low, high = np.percentile(grey, [10, 90], axis=0)
        return float((high - low > 0.25 * grey.mean(axis=0)).mean())

    assert changing("dim") > 0.5 and changing("room") < 0.3


def test_the_shuttle_in_fast_crosses_at_speed() -> None:
    blue, green, red = np.moveaxis(film("fast", 0)[9:17].astype(int), -1, 0)
    checkers = (red > 150) & (green < 100) & (blue < 100)
    places = np.array([np.median(np.nonzero(frame)[1]) for frame in checkers])
    assert (np.diff(places) > 15).all() and (np.diff(places) < 28).all()
    assert 15 < np.diff(places).mean() < 25


def test_the_doll_in_fast_is_absent_before_it_appears() -> None:
    axis = np.stack([np.full(8, -0.95), np.full(8, -0.15), np.linspace(0.15, 0.5, 8)], axis=1)
    for camera in range(12):
        left, top = np.floor(project("fast", camera, axis).min(axis=0)).astype(int) - 6
        right, bottom = np.ceil(project("fast", camera, axis).max(axis=0)).astype(int) + 6
        frames = film("fast", camera)[:, top:bottom, left:right].astype(float)
        change = np.abs(frames - frames[0]).mean(axis=(1, 2, 3))
        assert change[:15].max() < 8.0 and change[15:].min() > 25.0


def test_what_stands_still_in_fast_does_not_flicker() -> None:
    wall = film("fast", 0)[:, 5:40, 60:150].astype(np.float32)
    assert np.std(wall, axis=0).max(axis=-1).mean() < 1.0
