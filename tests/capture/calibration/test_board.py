"""Cameras from a board that they saw, and boards found in images."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.builders import refused

from frog_blender.engine.arrays import Float64s, ImageArray
from frog_blender.engine.capture.calibration import board_detection
from frog_blender.engine.capture.calibration.board import calibrate_board
from frog_blender.engine.capture.calibration.board_detection import Board
from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.capture.synchronization.films import CalibrationRefused
from frog_blender.engine.capture.video import load_opencv

from .rigs import WIDE, around, board_poses, corners_seen, drawn, facts_of, pixels_of, rig_errors

BOARD = Board(6, 9, square=0.06, marker=0.75, dictionary="DICT_5X5_100")


def rig() -> list[Camera]:
    return around([0.0, 40.0, 80.0], WIDE, 950.0, distance=1.8)


def filmed(
    poses: list[Float64s], *, k1: float = 0.0
) -> tuple[list[Camera], list[list[board_detection.Corners | None]]]:
    """Three cameras, and what they see of a board at those poses."""
    cameras = rig()
    return cameras, [corners_seen(camera, BOARD, poses, 0.2, i, k1=k1) for i, camera in enumerate(cameras)]


@pytest.mark.parametrize("k1", [0.0, -0.3])
def test_the_rig_its_lenses_and_its_scale_are_found(k1: float) -> None:
    cameras, corners = filmed(board_poses(24, 1), k1=k1)

    found = calibrate_board(facts_of(cameras), BOARD, corners)

    centers, rotation, focal, scale = rig_errors(found, cameras)
    assert centers < 0.3 and rotation < 0.3 and focal < 0.5
    assert abs(scale - 1) < 0.005 and found.is_metric and found.warnings == ()
    assert np.allclose([calibrated.distortion[0] for calibrated in found.cameras], k1, atol=0.03)
    assert all(calibrated.support.residual < 0.5 for calibrated in found.cameras)


def test_false_corners_do_not_bend_the_rig_of_a_board_of_unknown_size() -> None:
    cameras, corners = filmed(board_poses(24, 3))
    rng = np.random.default_rng(0)
    for seen in (image for of_camera in corners for image in of_camera if image is not None):
        seen.pixels[rng.random(len(seen.pixels)) < 0.08] += 60.0

    found = calibrate_board(facts_of(cameras), replace(BOARD, square=None), corners)

    centers, _, focal, _ = rig_errors(found, cameras)
    assert centers < 0.5 and focal < 1.0
    assert not found.is_metric and "not given" in found.warnings[0]


@pytest.mark.parametrize(
    ("seen", "why"),
    [
        ({2: range(3)}, "Camera cam02 shows the board in 3 of 20 images"),
        ({0: range(10), 1: range(10), 2: range(10, 20)}, "at the same time as cam02"),
    ],
)
def test_cameras_that_hardly_saw_the_board_or_never_together_are_named(seen: dict[int, range], why: str) -> None:
    cameras, corners = filmed(board_poses(20, 7))
    for camera, times in seen.items():
        corners[camera] = [image if time in times else None for time, image in enumerate(corners[camera])]

    with pytest.raises(CalibrationRefused, match=why):
        calibrate_board(facts_of(cameras), BOARD, corners)


def test_a_board_that_is_never_tilted_leaves_the_focal_length_open() -> None:
    (camera,) = around([0.0], WIDE, 900.0, distance=2.0)
    facing = np.tile(np.eye(4), (12, 1, 1))
    facing[:, :3, :3] = camera.rotation.T
    facing[:, 1:3, 3] = np.array([-0.3, 0.8]) + np.outer(np.arange(12), [0.03, 0.02])

    with pytest.raises(CalibrationRefused, match="focal length"):
        calibrate_board(facts_of([camera]), BOARD, [corners_seen(camera, BOARD, list(facing), 0.3, 0)])


def test_films_out_of_step_are_refused_or_a_little_warned_of() -> None:
    poses = board_poses(24, 8)
    cameras, corners = filmed(poses)
    with pytest.raises(CalibrationRefused, match="not in step"):
        calibrate_board(facts_of(cameras), BOARD, [corners[0], corners[1][5:] + corners[1][:5], corners[2]])
    late = [pose.copy() for pose in poses]
    for index, pose in enumerate(late):
        pose[:3, 3] += 0.012 * np.array([np.cos(index), np.sin(index), 0.0])
    corners[1] = corners_seen(cameras[1], BOARD, late, 0.2, 1)
    found = calibrate_board(facts_of(cameras), BOARD, corners)
    assert any("out of step" in warning for warning in found.warnings)


# --- boards in images


def printed(board: Board, side: int = 40) -> ImageArray:
    """The board from straight above, a square being so many pixels, with a rim."""
    if board.dictionary:
        flat = board_detection.charuco(board).generateImage((board.columns * side, board.rows * side))
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
    height, width = texture.shape
    corners = (np.array([[0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0]]) - [side, side, 0]) * unit
    wall = np.full((fine.height, fine.width), 110, np.uint8)
    image = drawn(wall, fine, texture, corners @ pose[:3, :3].T + pose[:3, 3])
    return np.asarray(cv2.resize(image, (camera.width, camera.height), interpolation=cv2.INTER_AREA))


def facing(camera: Camera, board: Board, count: int, tilt: float) -> list[Float64s]:
    """Poses of a board that fills much of the image."""
    rng = np.random.default_rng(5)
    middle = np.array([board.columns, board.rows, 0.0]) / 2 * (board.square or 1.0)
    poses = []
    for turned in board_poses(count, 11, tilt=tilt):
        turned[:3, 3] = [*rng.uniform(-0.06, 0.06, 2), rng.uniform(0.8, 1.0)] - turned[:3, :3] @ middle
        poses.append(np.linalg.inv(camera.world_to_camera) @ turned)
    return poses


@pytest.mark.parametrize(
    "board",
    [
        Board(4, 5, square=0.08, dictionary="DICT_4X4_50", inverted=True),
        Board(5, 8, square=0.06, dictionary="DICT_5X5_50", marker=0.7, legacy=True),
        Board(9, 6, square=0.05, marker=0.0),
    ],
    ids=str,
)
def test_a_board_is_found_by_itself(board: Board) -> None:
    (camera,) = around([0.0], (800, 600), 900.0, distance=1.2)
    found = board_detection.find_board([photographed(board, camera, pose) for pose in facing(camera, board, 5, 0.3)])

    assert found is not None and found.marker == pytest.approx(board.marker, abs=0.06)
    assert replace(found, marker=board.marker) == replace(board, square=None)


def test_nothing_is_found_where_nothing_is() -> None:
    rng = np.random.default_rng(0)
    cv2 = load_opencv()
    walls = [cv2.GaussianBlur(rng.integers(0, 255, (300, 400), dtype=np.uint8), (0, 0), 4) for _ in range(6)]

    assert board_detection.find_board(walls) is None
    assert board_detection.find_board([]) is None
    assert list(board_detection.find_corners(BOARD, walls[:2])) == [None, None]


@pytest.mark.parametrize(
    "board",
    [Board(5, 7, square=0.06, dictionary="DICT_4X4_50", inverted=True), Board(9, 6, square=0.05, marker=0.0)],
    ids=["inverted", "checkerboard"],
)
def test_corners_lie_where_they_are(board: Board) -> None:
    camera = around([0.0], (960, 720), 1040.0, distance=1.2)[0]
    poses = facing(camera, board, 4, 0.4)
    found = list(board_detection.find_corners(board, [photographed(board, camera, pose) for pose in poses]))

    off = []
    for corners, pose in zip(found, poses, strict=True):
        if corners is not None:
            truth = pixels_of(camera, board.places @ pose[:3, :3].T + pose[:3, 3])[corners.numbers]
            off.append(corners.pixels - truth)
    assert len(off) >= 3
    assert np.abs(np.median(np.concatenate(off), axis=0)).max() < 0.1  # half a pixel if a convention were wrong
    assert np.median(np.linalg.norm(np.concatenate(off), axis=1)) < 0.25


# --- boards described in files


CHARUCO = 'squares = [4, 5]\nsquare_size = 0.5\nmarker_size = {}\ndictionary = "{}"'
CALISCOPE = 'columns = 4\nrows = 5\naruco_scale = 0.75\ndictionary = "DICT_4X4_1000"\ninverted = true\n'


SLEAP = "board_x = 8\nboard_y = 11\nsquare_length = 24.0\nmarker_length = 18.75\nmarker_bits = 4\ndict_size = 1000"
ANIPOSE = """project = "hand"
[calibration]
board_type = "charuco"
board_size = [6, 5]
board_marker_bits = 4
board_marker_dict_number = 50
board_marker_length = 3.75 # mm
board_square_side_length = 5 # mm"""


@pytest.mark.parametrize(
    ("name", "content", "board"),
    [
        ("a.toml", CHARUCO.format(0.375, "DICT_4x4_50"), Board(4, 5, 0.5, 0.75, "DICT_4X4_50")),
        ("a.toml", "squares = [10, 7]\nsquare_size = 0.025", Board(10, 7, 0.025, 0.0)),
        (
            "a.json",
            '{"squares": [10, 7], "square_size": 0.025, "inverted": true}',
            Board(10, 7, 0.025, 0.0, inverted=True),
        ),
        (
            "a.toml",
            CALISCOPE + "square_size_override_cm = 6.25\nlegacy_pattern = true",
            Board(4, 5, 0.0625, 0.75, "DICT_4X4_1000", inverted=True, legacy=True),
        ),
        ("board.toml", SLEAP, Board(8, 11, 0.024, 0.78125, "DICT_4X4_1000")),
        ("board.toml", SLEAP[: SLEAP.index("marker_length")], Board(9, 12, 0.024, 0.0)),
        ("config.toml", ANIPOSE, Board(6, 5, 0.005, 0.75, "DICT_4X4_50")),
        ("config.toml", ANIPOSE.replace("charuco", "checkerboard"), Board(7, 6, 0.005, 0.0)),
        (
            "a.toml",
            CALISCOPE + 'board_height = 10.0\nboard_width = 20.0\nunits = "inch"',
            Board(4, 5, 0.0508, 0.75, "DICT_4X4_1000", inverted=True),
        ),
    ],
)
def test_boards_in_files(tmp_path: Path, name: str, content: str, board: Board) -> None:
    (tmp_path / name).write_text(content)
    assert board_detection.read_board(tmp_path / name) == board


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", "squares = None"),
        ("squares = [4, 5", "no TOML"),
        ("#" * 2**17, "bytes"),
        ("squares = [4, true]\nsquare_size = 1", "number of squares = True"),
        ("squares = [8, 8]\nsquare_size = 0.1", "upside down"),
        ("squares = [9, 6]\nsquare_size = nan", "square_size = nan"),
        (CHARUCO.format(0.06, "DICT_4X4_50"), "marker_size = 0.06"),
        (CHARUCO.format(0.375, "__class__"), "dictionary"),
        (CHARUCO.format(0.375, "DICT_4X4_50").replace("4, 5", "40, 50"), "larger dictionary"),
        ("squares = [9, 6]\nsquare_size = 0.02\ninverted = 1", "inverted = 1"),
        (SLEAP.replace("24.0", "0.024"), "length of a square in millimetres = 0.024"),
        (ANIPOSE.replace("charuco", "aruco"), "board_type = aruco"),
        ("calibration = 3", "calibration = 3"),
    ],
)
def test_a_file_that_describes_no_board_is_refused_in_a_sentence(tmp_path: Path, content: str, said: str) -> None:
    path = tmp_path / "board.toml"
    path.write_text(content)
    sentence = refused(".", board_detection.read_board, path)
    assert str(path) in sentence and said in sentence
