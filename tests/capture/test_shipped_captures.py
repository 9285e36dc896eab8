"""The bundled demo capture is complete, decodes, and its cameras are what its README says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

ROOM = Path(__file__).resolve().parents[2] / "examples" / "captures" / "room"
NAMES = [f"cam{index:02d}" for index in range(12)]


@pytest.fixture(scope="module")
def poses() -> np.ndarray:
    return np.load(ROOM / "poses_bounds.npy", allow_pickle=False)


def opencv_axes(poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(12, 3, 3) camera-to-world rotations (right, down, forwards) and (12, 3) centres."""
    matrices = poses[:, :15].reshape(-1, 3, 5)
    down, right, backwards = matrices[:, :, 0], matrices[:, :, 1], matrices[:, :, 2]
    return np.stack([right, down, -backwards], axis=2), matrices[:, :, 3]


def film_frames(name: str) -> list[np.ndarray]:
    cv2 = pytest.importorskip("cv2")
    reader, frames = cv2.VideoCapture(str(ROOM / f"{name}.mp4")), []
    while True:
        more, frame = reader.read()
        if not more:
            return frames
        frames.append(frame)


def test_files_are_present_and_small() -> None:
    assert sorted(path.stem for path in ROOM.glob("*.mp4")) == NAMES
    assert (ROOM / "README.md").is_file()
    assert sum(path.stat().st_size for path in ROOM.iterdir()) < 5_000_000


@pytest.mark.parametrize("name", NAMES)
def test_every_film_decodes_to_thirty_frames(name: str) -> None:
    frames = film_frames(name)
    assert [frame.shape for frame in frames] == [(240, 320, 3)] * 30


def test_the_test_view_moves_where_it_should() -> None:
    deviation = np.std(np.array(film_frames("cam00"), dtype=np.float32), axis=0).mean(axis=-1)
    assert 0.15 < (deviation > 6).mean() < 0.30
    assert np.median(deviation) < 2.0  # the room itself stands still


def test_camera_rows(poses: np.ndarray) -> None:
    assert poses.shape == (12, 17) and poses.dtype == np.float64
    np.testing.assert_array_equal(poses[:, :15].reshape(-1, 3, 5)[:, :, 4], np.tile([240.0, 320.0, 300.0], (12, 1)))
    near, far = poses[:, 15], poses[:, 16]
    assert (near > 1.0).all() and (near < 3.5).all() and (far > 5.5).all() and (far < 9.0).all()


def test_rotations_are_proper_and_upright(poses: np.ndarray) -> None:
    axes, _ = opencv_axes(poses)
    np.testing.assert_allclose(axes.transpose(0, 2, 1) @ axes, np.tile(np.eye(3), (12, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(axes), 1.0, atol=1e-12)
    np.testing.assert_allclose(axes[:, 2, 0], 0.0, atol=1e-12)  # "right" is level
    assert (axes[:, 2, 1] < -0.9).all()  # "down" points down in a world whose z is up


def test_all_cameras_look_at_one_point(poses: np.ndarray) -> None:
    axes, centers = opencv_axes(poses)
    forwards = axes[:, :, 2]
    # The point nearest to all viewing rays: sum (I - d d^T) (x - c) = 0.
    across = np.eye(3) - forwards[:, :, None] * forwards[:, None, :]
    target = np.linalg.solve(across.sum(axis=0), np.einsum("nij,nj->i", across, centers))
    local = np.einsum("nji,nj->ni", axes, target - centers)
    np.testing.assert_allclose(local, np.tile([0.0, 0.0, 4.4], (12, 1)), atol=1e-9)


def test_the_test_view_lies_inside_the_rig(poses: np.ndarray) -> None:
    _, centers = opencv_axes(poses)
    offsets = centers[1:] - centers[0]
    for axis in (0, 2):  # sideways and upwards
        assert offsets[:, axis].min() < -0.3 and offsets[:, axis].max() > 0.3
    assert np.linalg.norm(offsets, axis=1).min() > 0.3  # no training camera stands beside it
