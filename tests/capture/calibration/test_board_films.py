"""A board in films, from their files to cameras."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from frog_blender.engine.arrays import ImageArray
from frog_blender.engine.capture.calibration.board import board_in_films, calibrate_board, corners_in_films, images_at
from frog_blender.engine.capture.calibration.board_detection import Board
from frog_blender.engine.capture.calibration.films import Film, find_films
from frog_blender.engine.capture.video import load_opencv

from .rigs import around, board_poses, facts_of, rig_errors
from .test_board import photographed

RATE = 10.0


def written(path: Path, images: Sequence[ImageArray]) -> None:
    cv2 = load_opencv()
    height, width = images[0].shape
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), RATE, (width, height))
    for image in images:
        writer.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    writer.release()


def go_on() -> None:
    """Nobody cancels."""


def steps(folder: Path) -> Film:
    """A film of five images, each brighter than the one before."""
    written(folder / "steps.avi", [np.full((48, 64), 40 * number, np.uint8) for number in range(5)])
    return find_films(folder)[0]


def test_images_are_those_nearest_to_the_times(tmp_path: Path) -> None:
    film = steps(tmp_path)

    found = list(images_at(film, [-0.2, 0.0, 0.12, 0.14, 0.31, 0.6], go_on))

    assert [None if image is None else round(float(image.mean()) / 40) for image in found] == [None, 0, 1, 1, 3, None]


def test_cancelling_ends_the_reading(tmp_path: Path) -> None:
    class Cancelled(Exception):
        pass

    def cancel() -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        list(images_at(steps(tmp_path), [0.0], cancel))


def test_films_of_a_board_become_cameras(tmp_path: Path) -> None:
    board = Board(5, 4, square=0.12, marker=0.75, dictionary="DICT_4X4_50")
    cameras = around([0.0, 30.0], (640, 480), 640.0, distance=1.5)
    poses = board_poses(16, 21, tilt=0.45)
    for pose in poses:
        pose[:3, :3] = cameras[0].rotation.T @ pose[:3, :3]
        pose[:3, 3] = pose[:3, 3] / 4 + [0.0, 0.0, 0.7] - pose[:3, :3] @ [0.3, 0.24, 0.0]
    for camera in cameras:
        written(tmp_path / f"{camera.name}.avi", [photographed(board, camera, pose) for pose in poses])
    films, times, stages = find_films(tmp_path), [number / RATE for number in range(16)], []

    known = board_in_films(films, times, go_on)
    corners = corners_in_films(films, times, board, lambda *stage: stages.append(stage), go_on)
    found = calibrate_board(facts_of(cameras), board, corners)

    assert known is not None
    assert (known.columns, known.rows, known.dictionary) == (5, 4, "DICT_4X4_50")
    assert [each.camera.name for each in found.cameras] == ["cam00", "cam01"]
    assert found.is_metric
    baseline = np.linalg.norm(found.cameras[0].camera.center - found.cameras[1].camera.center)
    assert baseline == pytest.approx(np.linalg.norm(cameras[0].center - cameras[1].center), rel=0.03)
    assert rig_errors(found, cameras)[2] < 3.0
    assert stages[0] == ("board", 0, 2)
