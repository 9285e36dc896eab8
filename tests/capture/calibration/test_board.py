"""Cameras from a board that they saw, and boards found in images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from frog_blender.engine.arrays import Float64s, ImageArray
from frog_blender.engine.capture.calibration.board import calibrate_board
from frog_blender.engine.capture.calibration.board_detection import Board, find_board, find_corners, read_board
from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.capture.synchronization.run import CalibrationRefused
from frog_blender.engine.capture.video import load_opencv
from frog_blender.engine.errors import FrogError

from .rigs import WIDE, around, board_poses, corners_seen, facts_of, pixels_of, rig_errors

BOARD = Board(6, 9, square=0.06, marker=0.75, dictionary="DICT_5X5_100")


def rig(count: int = 3, focal: float = 950.0) -> list[Camera]:
    return around([40.0 * number for number in range(count)], WIDE, focal, distance=1.8)


@pytest.mark.parametrize("k1", [0.0, -0.3])
def test_the_rig_its_lenses_and_its_scale_are_found(k1: float) -> None:
    cameras = [camera.resized(*WIDE) for camera in rig()]
    poses = board_poses(24, 1)
    corners = [corners_seen(camera, BOARD, poses, 0.2, 10 + i, k1=k1) for i, camera in enumerate(cameras)]

    found = calibrate_board(facts_of(cameras), BOARD, corners)

    centers, rotation, focal, scale = rig_errors(found, cameras)
    assert centers < 0.3
    assert rotation < 0.3
    assert focal < 0.5
    assert abs(scale - 1) < 0.005
    assert found.is_metric
    assert found.warnings == ()
    assert np.allclose([each.distortion[0] for each in found.cameras], k1, atol=0.03)
    assert all(each.support.residual < 0.5 for each in found.cameras)


def test_false_corners_do_not_bend_the_rig_of_a_board_of_unknown_size() -> None:
    cameras, poses = rig(), board_poses(24, 3)
    corners = [corners_seen(camera, BOARD, poses, 0.2, i) for i, camera in enumerate(cameras)]
    rng = np.random.default_rng(0)
    for found_corners in corners:
        for each in found_corners:
            if each is not None:
                each.pixels[rng.random(len(each.pixels)) < 0.08] += 60.0

    found = calibrate_board(facts_of(cameras), replace(BOARD, square=None), corners)

    centers, _, focal, _ = rig_errors(found, cameras)
    assert centers < 0.5 and focal < 1.0
    assert not found.is_metric and "not given" in found.warnings[0]


def test_a_camera_that_hardly_saw_the_board_is_named() -> None:
    cameras, poses = rig(), board_poses(20, 6)
    corners = [corners_seen(camera, BOARD, poses, 0.2, i) for i, camera in enumerate(cameras)]
    corners[2] = [each if i < 3 else None for i, each in enumerate(corners[2])]

    with pytest.raises(CalibrationRefused, match="Camera cam02 shows the board in 3 of 20 images"):
        calibrate_board(facts_of(cameras), BOARD, corners)


def test_cameras_that_never_saw_it_together_are_named() -> None:
    cameras, poses = rig(), board_poses(20, 7)
    corners = [corners_seen(camera, BOARD, poses, 0.2, i) for i, camera in enumerate(cameras)]
    corners[0] = [each if i < 10 else None for i, each in enumerate(corners[0])]
    corners[1] = [each if i < 10 else None for i, each in enumerate(corners[1])]
    corners[2] = [each if i >= 10 else None for i, each in enumerate(corners[2])]

    with pytest.raises(CalibrationRefused, match="at the same time as cam02"):
        calibrate_board(facts_of(cameras), BOARD, corners)


def test_a_board_that_is_never_tilted_leaves_the_focal_length_open() -> None:
    cameras = [around([0.0], WIDE, 900.0, distance=2.0)[0]]
    facing = []
    for number in range(12):
        pose = np.eye(4)
        pose[:3, :3] = cameras[0].rotation.T
        pose[:3, 3] = [0.0, -0.3 + 0.03 * number, 0.8 + 0.02 * number]
        facing.append(pose)
    corners = [corners_seen(cameras[0], BOARD, facing, 0.3, 0)]

    with pytest.raises(CalibrationRefused, match="focal length"):
        calibrate_board(facts_of(cameras), BOARD, corners)


def test_films_out_of_step_are_refused() -> None:
    cameras, poses = rig(), board_poses(24, 8)
    corners = [corners_seen(camera, BOARD, poses, 0.2, i) for i, camera in enumerate(cameras)]
    corners[1] = corners[1][5:] + corners[1][:5]

    with pytest.raises(CalibrationRefused, match="not in step"):
        calibrate_board(facts_of(cameras), BOARD, corners)


def test_films_a_little_out_of_step_come_with_a_warning() -> None:
    cameras, poses = rig(), board_poses(24, 8)
    late = [pose.copy() for pose in poses]
    for number, pose in enumerate(late):
        pose[:3, 3] += 0.012 * np.array([np.cos(number), np.sin(number), 0.0])
    corners = [corners_seen(camera, BOARD, late if i == 1 else poses, 0.2, i) for i, camera in enumerate(cameras)]

    found = calibrate_board(facts_of(cameras), BOARD, corners)

    assert any("out of step" in warning for warning in found.warnings)


# --- boards in images


def printed(board: Board, side: int = 40) -> ImageArray:
    """The board from straight above, a square being so many pixels, with a rim."""
    cv2 = load_opencv()
    if board.dictionary:
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
        made = cv2.aruco.CharucoBoard((board.columns, board.rows), 1.0, board.marker, dictionary)
        made.setLegacyPattern(board.legacy)
        flat = made.generateImage((board.columns * side, board.rows * side))
    else:
        cells = np.add.outer(np.arange(board.rows), np.arange(board.columns)) % 2
        flat = np.kron(cells * 255, np.ones((side, side))).astype(np.uint8)
    padded = np.pad(flat, side, constant_values=255)
    return np.asarray(255 - padded if board.inverted else padded, np.uint8)


def photographed(board: Board, camera: Camera, pose: Float64s, side: int = 40) -> ImageArray:
    """The board before a gray wall, as the camera sees it, from 3 x 3 samples a pixel."""
    cv2 = load_opencv()
    texture = printed(board, side)
    unit = (board.square or 1.0) / side
    fine = camera.resized(3 * camera.width, 3 * camera.height)
    corners = np.array([[0, 0], [texture.shape[1], 0], texture.shape[::-1], [0, texture.shape[0]]], np.float64)
    on_board = np.column_stack([(corners - side) * unit, np.zeros(4)])
    seen, _ = fine.project(on_board @ pose[:3, :3].T + pose[:3, 3])
    # Pixel centres: the homography maps positions with the centre at +0.5, warpPerspective counts from the centre.
    half = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]])
    warp = cv2.getPerspectiveTransform(corners.astype(np.float32), seen.astype(np.float32)).astype(np.float64)
    warp = half @ warp @ np.linalg.inv(half)
    size = (fine.width, fine.height)
    shown = cv2.warpPerspective(texture, warp, size, flags=cv2.INTER_LINEAR)
    covers = cv2.warpPerspective(np.full_like(texture, 255), warp, size, flags=cv2.INTER_NEAREST) > 127
    image = np.where(covers, shown, 110).astype(np.uint8)
    return np.asarray(cv2.resize(image, (camera.width, camera.height), interpolation=cv2.INTER_AREA))


def views_of(board: Board, count: int, tilt: float = 0.5, size: tuple[int, int] = (800, 600)) -> list[ImageArray]:
    camera = around([0.0], size, 900.0, distance=1.2)[0]
    images = []
    for pose in facing(camera, board, count, tilt):
        images.append(photographed(board, camera, pose))
    return images


def facing(camera: Camera, board: Board, count: int, tilt: float) -> list[Float64s]:
    """Poses of a board that fills much of the image."""
    rng = np.random.default_rng(5)
    middle = np.array([board.columns, board.rows, 0.0]) / 2 * (board.square or 1.0)
    poses = []
    for turned in board_poses(count, 11, tilt=tilt):
        local = np.eye(4)
        local[:3, :3] = turned[:3, :3]
        local[:3, 3] = [*rng.uniform(-0.06, 0.06, 2), rng.uniform(0.8, 1.0)] - local[:3, :3] @ middle
        poses.append(np.linalg.inv(camera.world_to_camera) @ local)
    return poses


@pytest.mark.parametrize(
    "board",
    [
        Board(4, 5, square=0.08, dictionary="DICT_4X4_50", inverted=True),
        Board(5, 8, square=0.06, dictionary="DICT_5X5_50", marker=0.7, legacy=True),
    ],
    ids=str,
)
def test_a_charuco_board_is_found_by_itself(board: Board) -> None:
    found = find_board(views_of(board, 4))

    assert found is not None
    assert (found.columns, found.rows, found.dictionary) == (board.columns, board.rows, board.dictionary)
    assert (found.inverted, found.square) == (board.inverted, None)
    assert found.legacy == (board.legacy and board.rows % 2 == 0)
    assert found.marker == pytest.approx(board.marker, abs=0.06)


def test_a_checkerboard_is_found_by_itself() -> None:
    found = find_board(views_of(Board(9, 6, square=0.05, marker=0.0), 5, tilt=0.3))

    assert found == Board(9, 6, square=None, marker=0.0)


def test_nothing_is_found_where_nothing_is() -> None:
    rng = np.random.default_rng(0)
    cv2 = load_opencv()
    walls = [cv2.GaussianBlur(rng.integers(0, 255, (300, 400), dtype=np.uint8), (0, 0), 4) for _ in range(6)]

    assert find_board(walls) is None
    assert find_board([]) is None


@pytest.mark.parametrize(
    "board",
    [
        Board(5, 7, square=0.06, dictionary="DICT_4X4_50", inverted=True),
        Board(9, 6, square=0.05, marker=0.0),
    ],
    ids=["inverted", "checkerboard"],
)
def test_corners_lie_where_they_are(board: Board) -> None:
    camera = around([0.0], (960, 720), 1040.0, distance=1.2)[0]
    poses = facing(camera, board, 4, 0.4)
    found = list(find_corners(board, [photographed(board, camera, pose) for pose in poses]))

    off = []
    for corners, pose in zip(found, poses, strict=True):
        if corners is not None:
            truth = pixels_of(camera, board.places @ pose[:3, :3].T + pose[:3, 3])[corners.numbers]
            off.append(corners.pixels - truth)
    assert len(off) >= 3
    assert np.abs(np.median(np.concatenate(off), axis=0)).max() < 0.1  # half a pixel if a convention were wrong
    assert np.median(np.linalg.norm(np.concatenate(off), axis=1)) < 0.25


def test_images_without_the_board_give_none() -> None:
    blank = np.full((300, 400, 3), 127, np.uint8)

    assert list(find_corners(BOARD, [blank, blank])) == [None, None]


# --- boards described in files


def written(folder: Path, content: str, name: str = "board.toml") -> Path:
    path = folder / name
    path.write_text(content, encoding="utf-8")
    return path


def test_a_board_in_toml_and_json(tmp_path: Path) -> None:
    toml = written(
        tmp_path, 'squares = [4, 5]\nsquare_size = 0.054\nmarker_size = 0.0405\ndictionary = "DICT_4x4_50"\n'
    )
    json = written(
        tmp_path,
        '{"squares": [4, 5], "square_size": 0.054, "marker_size": 0.0405, "dictionary": "DICT_4X4_50"}',
        "board.json",
    )

    expected = Board(4, 5, 0.054, 0.0405 / 0.054, "DICT_4X4_50")
    assert read_board(toml) == expected
    assert read_board(json) == expected


def test_a_checkerboard_in_a_file(tmp_path: Path) -> None:
    assert read_board(written(tmp_path, "squares = [10, 7]\nsquare_size = 0.025")) == Board(10, 7, 0.025, 0.0)


def test_a_board_as_caliscope_writes_it(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        'columns = 4\nrows = 5\nboard_height = 11.0\nboard_width = 8.5\ndictionary = "DICT_4X4_1000"\n'
        'units = "inch"\naruco_scale = 0.75\nsquare_size_override_cm = 6.25\ninverted = true\n',
    )

    assert read_board(path) == Board(4, 5, 0.0625, 0.75, "DICT_4X4_1000", inverted=True)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", "squares = None"),
        ("squares = [4, 5", "no TOML"),
        ("squares = [4, 1]\nsquare_size = 1", "number of squares = 1"),
        ("squares = [4, true]\nsquare_size = 1", "number of squares = True"),
        ("squares = [8, 8]\nsquare_size = 0.1", "upside down"),
        ("squares = [9, 6]\nsquare_size = 25", "square_size = 25"),
        ("squares = [9, 6]\nsquare_size = nan", "square_size = nan"),
        ('squares = [4, 5]\nsquare_size = 0.05\nmarker_size = 0.06\ndictionary = "DICT_4X4_50"', "marker_size = 0.06"),
        ('squares = [4, 5]\nsquare_size = 0.05\nmarker_size = 0.04\ndictionary = "__class__"', "dictionary"),
        ('squares = [40, 50]\nsquare_size = 0.05\nmarker_size = 0.04\ndictionary = "DICT_4X4_50"', "larger dictionary"),
        ("squares = [9, 6]\nsquare_size = 0.02\ninverted = 1", "inverted = 1"),
    ],
)
def test_a_file_that_describes_no_board_is_refused_in_a_sentence(tmp_path: Path, content: str, said: str) -> None:
    path = written(tmp_path, content)

    with pytest.raises(FrogError) as refused:
        read_board(path)
    assert str(path) in str(refused.value)
    assert said in str(refused.value)


@pytest.mark.parametrize(
    "make",
    [
        lambda path: path.write_bytes(b"\xff\xfe squares"),
        lambda path: path.write_bytes(b"#" * 2**17),
        lambda path: path.mkdir(),
        lambda path: None,
    ],
    ids=["not text", "huge", "a folder", "missing"],
)
def test_what_is_no_text_file_is_refused(tmp_path: Path, make: Callable[[Path], object]) -> None:
    path = tmp_path / "board.toml"
    make(path)

    with pytest.raises(FrogError, match=r"board\.toml"):
        read_board(path)
