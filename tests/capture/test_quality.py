"""What ``frog info --check`` measures, on a scene whose every fault is known."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.builders import rotation_of
from support.layouts.files import write_image

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.capture.capture import Capture, Shot
from frog_blender.engine.capture.quality_check import Quality, check_capture

FRAMES, WIDTH, HEIGHT = 5, 320, 240
_WALL, _BOARD = 6.0, 4.5
Change = Callable[[str, np.ndarray], np.ndarray]


def camera(index: float, name: str) -> Camera:
    """On an arc before the wall."""
    pose = np.eye(4)
    pose[:3, :3] = rotation_of((0.05, 1, 0), 0.1 * (1 - index))
    pose[:3, 3] = -pose[:3, :3] @ np.array([0.7 * (index - 1), 0.1 * index, 0.0])
    return Camera(name, WIDTH, HEIGHT, np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]]), pose)


@lru_cache(maxsize=2)
def texture(seed: int) -> np.ndarray:
    """(900, 1200) float32, blobs of several sizes that never repeat."""
    random = np.random.default_rng(seed)
    layers = []
    for size, weight in ((3, 60.0), (8, 200.0), (24, 500.0)):
        noise = random.normal(size=(900, 1200)).astype(np.float32)
        layers.append(weight * cv2.GaussianBlur(noise, (0, 0), size / 2))
    return np.clip(128 + sum(layers), 20, 230).astype(np.float32)


def drawn(view: Camera, frame: float) -> np.ndarray:
    """(H, W, 3) uint8; a board slides along the wall, in x and y."""
    across, down = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    flat = np.stack([across.ravel(), down.ravel(), np.ones(across.size)], axis=1)
    rays = flat @ np.linalg.inv(view.intrinsics).T @ view.rotation

    def seen(seed: int, depth: float, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        spot = (view.center + rays * ((depth - view.center[2]) / rays[:, 2])[:, None])[:, :2] - at
        maps = (spot * 110 + [600, 450]).astype(np.float32).reshape(HEIGHT, WIDTH, 2)
        return cv2.remap(texture(seed), maps, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT), spot

    wall, _ = seen(1, _WALL, np.zeros(2))
    board, spot = seen(2, _BOARD, np.array([-0.25 + 0.1 * frame, 0.08 * frame - 0.2]))
    inside = (np.abs(spot).max(axis=1) < 0.7).reshape(HEIGHT, WIDTH)
    return np.repeat(np.where(inside, board, wall)[..., None], 3, axis=2).astype(np.uint8)


@lru_cache
def seen_by(index: int, frame: float) -> np.ndarray:
    """The image of a camera; it is not to be changed."""
    return drawn(camera(index, "c"), frame)


def filmed(folder: Path, *, late: float = 0.0, change: Change = lambda name, image: image) -> Capture:
    """Three cameras of which the second shows what happened ``late`` frames before."""
    cameras = [camera(index, f"cam{index}") for index in range(3)]
    shots = []
    for index, view in enumerate(cameras):
        for frame in range(FRAMES):
            image = change(view.name, seen_by(index, frame - late if index == 1 else frame))
            path = write_image(folder / view.name / f"{frame}.png", image)
            shots.append(Shot(index, frame, path, 0))
    return Capture(folder, "calibrated_videos", tuple(cameras), (None,) * 3, tuple(shots), FRAMES)


def test_nothing_is_found_where_nothing_is_wrong(tmp_path: Path) -> None:
    steps: list[tuple[int, int]] = []
    quality = check_capture(filmed(tmp_path), lambda done, total: steps.append((done, total)))
    assert (quality.findings, quality.untold) == ((), ())
    assert {(pair.first, pair.second) for pair in quality.pairs} >= {("cam0", "cam1"), ("cam1", "cam2")}
    for pair in quality.pairs:
        assert pair.matches > 100 and pair.distance < 0.3
        assert abs(pair.offset) < 0.1
    assert steps[-1][0] == steps[-1][1] == len(steps) > 0
    assert len(quality.lines()) == len(quality.pairs) + 3


def test_cameras_out_of_step_are_found_to_a_tenth_of_a_frame(tmp_path: Path) -> None:
    late = 0.5
    quality = check_capture(filmed(tmp_path, late=late))
    offsets = {(pair.first, pair.second): pair.offset for pair in quality.pairs}
    assert offsets["cam0", "cam1"] == pytest.approx(late, abs=0.1)
    assert offsets["cam1", "cam2"] == pytest.approx(-late, abs=0.1)
    assert all(pair.distance < 0.3 for pair in quality.pairs), "what stands still fits"
    assert any("out of step" in finding and "cam1" in finding for finding in quality.findings)


def test_cameras_whose_times_are_known_are_in_step(tmp_path: Path) -> None:
    capture = filmed(tmp_path, late=0.5)
    known = (replace(shot, offset=-0.5) if shot.camera == 1 else shot for shot in capture.shots)
    quality = check_capture(replace(capture, shots=tuple(known)))
    assert quality.findings == ()
    assert all(pair.offset == pytest.approx(0, abs=0.1) for pair in quality.pairs)


def test_a_wrong_pose_is_found_and_its_camera_blamed(tmp_path: Path) -> None:
    capture = filmed(tmp_path)
    turned = capture.cameras[1].moved(np.array([0.02, 0.0, 0.0]), np.zeros(3))
    quality = check_capture(replace(capture, cameras=(capture.cameras[0], turned, capture.cameras[2])))
    (finding,) = quality.findings
    assert "Poses, lenses or image sizes may be wrong" in finding and "cam1 is in 2 of them" in finding
    far = {pair.distance for pair in quality.pairs if "cam1" in (pair.first, pair.second)}
    assert all(distance == pytest.approx(300 * 0.02, rel=0.3) for distance in far), "the turn, in pixels"
    assert all(np.isnan(pair.offset) for pair in quality.pairs if "cam1" in (pair.first, pair.second))


def test_exposure_and_blur_are_found(tmp_path: Path) -> None:
    def change(name: str, image: np.ndarray) -> np.ndarray:
        if name == "cam0":
            return (image * 0.7).astype(np.uint8)
        return cv2.GaussianBlur(image, (0, 0), 2.5) if name == "cam2" else image

    quality = check_capture(filmed(tmp_path, change=change))
    assert quality.gain["cam1"] / quality.gain["cam0"] == pytest.approx(1 / 0.7, rel=0.03)
    assert any("Exposure differs" in finding and "brighter than cam0" in finding for finding in quality.findings)
    assert any(finding == "More blurred than the others: cam2." for finding in quality.findings)


def test_what_cannot_be_told_is_said(tmp_path: Path) -> None:
    grey = filmed(tmp_path, change=lambda name, image: np.full_like(image, 128))
    quality = check_capture(grey)
    assert quality.findings == () and len(quality.untold) == 2
    assert "too few matches" in quality.untold[0] and "in step" in quality.untold[1]
    alone = replace(grey, shots=tuple(shot for shot in grey.shots if shot.camera == 0))
    assert isinstance(check_capture(alone), Quality) and check_capture(alone).pairs == ()


def test_one_moving_camera(tmp_path: Path) -> None:
    cameras = [camera(0.4 * index, f"view{index}") for index in range(6)]
    shots = [
        Shot(index, index, write_image(tmp_path / f"{index}.png", drawn(view, 0)), 0)
        for index, view in enumerate(cameras)
    ]
    capture = Capture(tmp_path, "transforms", tuple(cameras), (None,) * 6, tuple(shots), 6)
    assert capture.is_moving
    quality = check_capture(capture)
    assert quality.findings == () and len(quality.pairs) >= 5
    assert all(pair.distance < 0.3 and np.isnan(pair.offset) for pair in quality.pairs)
    wrong = [*cameras[:3], cameras[3].moved(np.array([0.03, 0, 0]), np.zeros(3)), *cameras[4:]]
    assert "view3" in check_capture(replace(capture, cameras=tuple(wrong))).findings[0]
