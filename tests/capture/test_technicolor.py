"""Technicolor light fields, true to format and tiny, written here."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from frog_blender.engine.capture.decoding import decode_shots
from frog_blender.engine.capture.readers import detect, open_capture, technicolor
from frog_blender.engine.errors import FrogError
from frog_blender.engine.frames.store import FrameStore

SCALE = 16  # images of 128 x 68 stand for 2048 x 1088
WIDTH, HEIGHT = 2048 // SCALE, 1088 // SCALE
HEADER = "focal cx cy aspect skew qw qx qy qz tx ty tz"
SPOT = np.array([0.3, 0.2, 3.0])
FRAMES = range(151, 155)


def parameters(camera: int, skew: float = 0.0) -> list[float]:
    """A row of a camera of the 4 x 4 grid: turned a little, its principal point far from the centre."""
    angle = 0.02 * (camera - 7)
    quaternion = [np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0]  # about y
    center = np.array([0.1 * (camera % 4) - 0.15, 0.1 * (camera // 4) - 0.15, 0.0])
    translation = -rotation(angle) @ center
    return [1800.0 + camera, 960.0 + 10 * camera, 600.0 - 5 * camera, 1.02, skew, *quaternion, *translation]


def rotation(angle: float) -> np.ndarray:
    """World to camera, by a quaternion about y."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])


def stored_pixel(row: list[float], camera: int) -> np.ndarray:
    """Where the spot lies in a stored image, by the columns of the format."""
    x, y, z = rotation(0.02 * (camera - 7)) @ SPOT + np.array(row[-3:])
    focal, center_x, center_y, aspect, skew = row[:5]
    return np.array([focal * x / z + skew * y / z + center_x, focal * aspect * y / z + center_y]) / SCALE


def write_parameters(folder: Path, rows: list[list[float]], header: str = HEADER) -> None:
    lines = [header, *(" ".join(f"{value:.9g}" for value in row) + "  " for row in rows)]
    (folder / "cameras_parameters.txt").write_text("\n".join(lines) + "\n\n")


def write(folder: Path, *, skew: float = 0.0, scene: str = "Birthday", cameras: int = 16) -> Path:
    """A scene; camera c's image of frame f is grey of brightness 20 + 3 c + (f - 151) but for the white spot."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = [parameters(camera, skew) for camera in range(cameras)]
    write_parameters(folder, rows)
    columns, lines = np.arange(WIDTH) + 0.5, np.arange(HEIGHT)[:, None] + 0.5
    for camera, row in enumerate(rows):
        pixel = stored_pixel(row, camera)
        spot = np.exp(-((columns - pixel[0]) ** 2 + (lines - pixel[1]) ** 2) / (2 * 1.5**2))
        for frame in FRAMES:
            grey = 20 + 3 * camera + frame - FRAMES[0]
            image = (grey + (250 - grey) * spot).round().astype(np.uint8)
            cv2.imwrite(str(folder / f"{scene}_undist_{frame:05d}_{camera:02d}.png"), np.dstack([image] * 3))
    return folder


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return write(tmp_path / "Birthday")


def test_sixteen_cameras_of_which_cam10_judges(scene: Path) -> None:
    assert detect(scene) == "technicolor"
    capture = open_capture(scene)
    assert [camera.name for camera in capture.cameras] == [f"cam{index:02d}" for index in range(16)]
    assert capture.test_cameras == {"cam10"}
    assert (capture.frame_count, len(capture.shots)) == (4, 64)
    assert [(s.frame, s.camera) for s in capture.shots] == [(f, c) for f in range(4) for c in range(16)]
    assert capture.shots[capture.shot_index(9, 2)].path.name == "Birthday_undist_00153_09.png"
    assert not capture.warnings
    assert not any(capture.distortions)


@pytest.mark.parametrize("skew", [0.0, 40.0])
def test_a_world_point_lies_where_its_row_says(tmp_path: Path, skew: float) -> None:
    capture = open_capture(write(tmp_path, skew=skew))
    order = [index for index, shot in enumerate(capture.shots) if shot.frame == 0]
    for index, image in zip(order, decode_shots(capture, order), strict=True):
        number = capture.shots[index].camera
        camera = capture.cameras[number]
        (pixel,), (depth,) = camera.project(SPOT[None])
        assert depth == pytest.approx(3.0, abs=0.1)
        weight = np.clip(image[..., 0].astype(np.float64) - 20 - 3 * number - 1, 0, None)
        columns, lines = np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5
        found = np.array([weight.sum(0) @ columns, weight.sum(1) @ lines]) / weight.sum()
        np.testing.assert_allclose(found, pixel, atol=0.06)
        expected = stored_pixel(parameters(number), number)  # as if there were no skew
        np.testing.assert_allclose(pixel, expected, atol=1e-6)
        assert camera.intrinsics[1, 1] == pytest.approx(1.02 * camera.intrinsics[0, 0])


def test_frames_are_chosen_by_their_numbers(scene: Path) -> None:
    capture = technicolor.read(scene, range(152, 154))
    assert capture.frame_count == 2
    assert {shot.path.name[16:21] for shot in capture.shots if shot.frame == 0} == {"00152"}
    with pytest.raises(FrogError, match="frames between 151 and 154, expected every frame from 151 to 200"):
        technicolor.read(scene, range(151, 201))


def test_an_image_that_is_cut_off_is_replaced_by_the_frame_before(scene: Path, tmp_path: Path) -> None:
    """Also two in a row, and never in the test view."""
    for name in ("00153_09", "00154_09", "00153_10", "00151_04"):
        image = scene / f"Birthday_undist_{name}.png"
        image.write_bytes(image.read_bytes()[:-200])
    capture = open_capture(scene)
    store = FrameStore.open(capture, cache_folder=tmp_path / "cache")
    for frame, shown in ((0, 151), (1, 152), (2, 152), (3, 152)):
        index = capture.shot_index(9, frame)
        assert index is not None
        assert store.image(index)[0, 0, 0] == 20 + 3 * 9 + shown - 151
    assert store.image(capture.shot_index(15, 3) or 0)[0, 0, 0] == 20 + 3 * 15 + 3  # what follows is not displaced
    assert capture.shot_index(10, 2) is None
    assert capture.shot_index(4, 0) is None
    assert sum("takes its place" in warning for warning in capture.warnings) == 2
    assert sum("left out" in warning for warning in capture.warnings) == 2


def test_missing_images_and_cameras_are_told(scene: Path) -> None:
    (scene / "Birthday_undist_00152_03.png").unlink()
    for image in scene.glob("*_10.png"):
        image.unlink()
    capture = open_capture(scene)
    assert len(capture.shots) == 59
    assert "cam10" not in [camera.name for camera in capture.cameras]
    assert not capture.test_cameras
    sentences = " ".join(capture.warnings)
    for part in ("16 cameras, and 15 of them have images", "1 of 60 images are missing", "test view cam10"):
        assert part in sentences


def test_a_file_without_its_header_keeps_its_first_camera(scene: Path) -> None:
    path = scene / "cameras_parameters.txt"
    path.write_text("\n".join(path.read_text().splitlines()[1:]))
    assert len(open_capture(scene).cameras) == 16


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda rows: rows[:15], "found 15 rows and images of camera 15 .*_15.png"),
        (lambda rows: [], "no row after the header"),
        (lambda rows: [rows[0], rows[1][:11]], r"found shape \(11,\) as line 3"),
        (lambda rows: [[float("nan"), *rows[0][1:]], *rows[1:]], "line 2 with a value that is not finite"),
        (lambda rows: [[-1.0, *rows[0][1:]], *rows[1:]], "zero or less for cam00"),
        (lambda rows: [[*rows[0][:5], 2.0, *rows[0][6:]], *rows[1:]], "the row of cam00, a quaternion of length"),
    ],
)
def test_rows_that_make_no_sense_are_refused(scene: Path, change, sentence: str) -> None:  # type: ignore[no-untyped-def]
    write_parameters(scene, change([parameters(camera) for camera in range(16)]))
    with pytest.raises(FrogError, match=sentence):
        open_capture(scene)


def test_images_of_another_kind_are_told(scene: Path) -> None:
    first = scene / "Birthday_undist_00151_00.png"
    first.write_bytes(b"GIF89a" + bytes(40))
    assert f"{first}: the image is cut off and left out." in open_capture(scene).warnings
    cv2.imwrite(str(first), np.zeros((80, 80, 3), np.uint8))
    with pytest.raises(
        FrogError, match="images of 80 x 80 pixels, expected the proportions of the calibration, 2048 x 1088"
    ):
        open_capture(scene)


def test_a_folder_without_images_or_with_two_scenes_is_refused(tmp_path: Path) -> None:
    write_parameters(tmp_path, [parameters(0)])
    with pytest.raises(FrogError, match=r"no image, expected images named SCENE_undist_00151_00\.png"):
        open_capture(tmp_path)
    write(tmp_path, scene="Birthday", cameras=1)
    write(tmp_path, scene="Train", cameras=1)
    with pytest.raises(FrogError, match="images of Birthday and Train"):
        open_capture(tmp_path)


def test_numbers_of_frames_that_no_film_has(scene: Path) -> None:
    (scene / "Birthday_undist_00154_03.png").rename(scene / "Birthday_undist_999999999_03.png")
    with pytest.raises(FrogError, match="images of frames from 151 to 999999999, expected at most 1,000,000 frames"):
        open_capture(scene)
