"""What is Technicolor's or N3DV's alone: images that are cut off, frames by their numbers, rows that make no sense."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from support.filmed_scene import FRAMES, image
from support.layouts.rigs import technicolor as write
from support.small_captures import llff_row, write_n3dv, write_video

from frog_blender.engine.capture.readers import detect, open_capture
from frog_blender.engine.errors import FrogError
from frog_blender.engine.frames.store import FrameStore

from .readers.reading import assert_same_images, refuses


def test_rows_belong_to_sorted_names_with_gaps(n3dv: Path) -> None:
    assert detect(n3dv) == "n3dv"
    capture = open_capture(n3dv)
    assert [camera.name for camera in capture.cameras] == ["cam00", "cam01", "cam03"]
    np.testing.assert_allclose([camera.center for camera in capture.cameras], [[0, 0, 0], [1, 0, 0], [2, 0, 0]])
    assert capture.test_cameras == {"cam00"}
    assert (capture.frame_count, capture.frames_per_second, capture.near_far) == (5, 30.0, (0.5, 20.0))
    assert not capture.is_moving
    (n3dv / "cam01.mp4").unlink()
    (n3dv / "cam03.mp4").unlink()
    np.save(n3dv / "poses_bounds.npy", llff_row(480, 640, 500.0)[None])
    (camera,) = open_capture(n3dv).cameras
    np.testing.assert_allclose(camera.intrinsics, [[50, 0, 32], [0, 50, 24], [0, 0, 1]])
    assert not open_capture(n3dv).test_cameras  # the only camera cannot be held out


def test_another_number_of_rows_is_refused(n3dv: Path) -> None:
    (n3dv / "cam01.mp4").unlink()
    refuses(n3dv, "3 rows for 2 videos")


@pytest.mark.parametrize(
    ("rows", "sentence"),
    [
        (np.full((3, 17), np.nan), "row 0 with a value that is not finite"),
        (np.zeros((3, 17)), "zero or less in row 0"),
        (np.ones((3, 17)), "mirrors, scales or shears"),
        (np.ones((3, 15)), "shape \\(3, 15\\)"),
        (np.array(["a"]), "shape \\(1,\\)"),
    ],
)
def test_rows_that_make_no_sense_are_refused(n3dv: Path, rows: np.ndarray, sentence: str) -> None:
    np.save(n3dv / "poses_bounds.npy", rows)
    refuses(n3dv, sentence)


def test_an_empty_video_is_named(n3dv: Path) -> None:
    (n3dv / "cam01.mp4").write_bytes(b"")
    refuses(n3dv, r"cam01\.mp4: found an empty file")


def test_a_video_that_ends_early_tells_how_much_is_left(tmp_path: Path) -> None:
    folder = write_n3dv(tmp_path, ("cam00",), frames=2)
    noise = np.random.default_rng(0).integers(0, 255, (48, 64, 3), dtype=np.uint8)
    video = write_video(folder / "cam00.avi", 40, image=lambda frame: noise)
    video.write_bytes(video.read_bytes()[: video.stat().st_size // 2])  # AVI keeps its header, which says 40
    (folder / "cam00.mp4").unlink()
    refuses(folder, r"cam00\.avi: \d+ frames could be decoded, expected 40")


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    write(tmp_path / "Birthday")
    return tmp_path / "Birthday"


def test_cam10_judges_and_cameras_without_images_are_told(scene: Path) -> None:
    capture = open_capture(scene)
    assert [camera.name for camera in capture.cameras] == ["cam08", "cam09", "cam10", "cam11"]
    assert capture.test_cameras == {"cam10"}
    assert capture.shots[capture.shot_index(1, 2)].path.name == "Birthday_undist_00153_09.png"
    assert "12 cameras, and 4 of them have images" in capture.warnings[0]
    (scene / "Birthday_undist_00152_08.png").unlink()
    for file in scene.glob("*_10.png"):
        file.unlink()
    capture = open_capture(scene)
    assert len(capture.shots) == 3 * FRAMES - 1 and not capture.test_cameras
    sentences = " ".join(capture.warnings)
    for part in ("3 of them have images", "1 of 15 images are missing", "test view cam10"):
        assert part in sentences


def test_skew_is_removed(tmp_path: Path) -> None:
    write(tmp_path / "c", skew=2.0)
    capture = open_capture(tmp_path / "c")
    assert all(capture.distortions)
    assert_same_images(capture, tmp_path / "cache", image, off=3.0)


def test_an_image_that_is_cut_off_is_replaced_by_the_frame_before(scene: Path, tmp_path: Path) -> None:
    """Also two in a row, and never in the test view."""
    for name in ("00153_09", "00154_09", "00153_10", "00151_08"):
        file = scene / f"Birthday_undist_{name}.png"
        file.write_bytes(file.read_bytes()[:-200])
    capture = open_capture(scene)
    store = FrameStore.open(capture, cache_folder=tmp_path / "cache")
    for frame, shown in enumerate((0, 1, 1, 1, 4)):
        index = capture.shot_index(1, frame)
        np.testing.assert_array_equal(store.image(index), image(capture.cameras[1], shown))
    assert capture.shot_index(2, 2) is None and capture.shot_index(0, 0) is None
    assert sum("takes its place" in warning for warning in capture.warnings) == 2
    assert sum("is cut off and left out" in warning for warning in capture.warnings) == 2


def test_a_file_without_its_header_keeps_its_first_camera(scene: Path) -> None:
    path = scene / "cameras_parameters.txt"
    path.write_text("\n".join(path.read_text().splitlines()[1:]))
    assert len(open_capture(scene).cameras) == 4


@pytest.mark.parametrize(
    ("line", "text", "sentence"),
    [
        (slice(12, 13), [], "found 11 rows and images of camera 11 .*_11.png"),
        (slice(1, 13), [], "no row after the header"),
        (2, "1 2 3", r"found shape \(3,\) as line 3"),
        (1, "nan" + 11 * " 1", "line 2 with a value that is not finite"),
        (9, "-1" + 11 * " 1", "zero or less for cam08"),
        (9, "1 1 1 1 0 2 0 0 0 1 1 1", "the row of cam08, a quaternion of length"),
    ],
)
def test_rows_of_technicolor_that_make_no_sense_are_refused(
    scene: Path, line: slice | int, text: object, sentence: str
) -> None:
    lines: list[object] = [*(scene / "cameras_parameters.txt").read_text().splitlines()]
    lines[line] = text  # type: ignore[call-overload]
    (scene / "cameras_parameters.txt").write_text("\n".join(map(str, lines)))
    refuses(scene, sentence)


def test_images_of_another_kind_are_told(scene: Path) -> None:
    first = scene / "Birthday_undist_00151_08.png"
    first.write_bytes(b"GIF89a" + bytes(40))
    assert f"{first}: the image is cut off and left out." in open_capture(scene).warnings
    cv2.imwrite(str(first), np.zeros((80, 80, 3), np.uint8))
    refuses(scene, "images of 80 x 80 pixels, expected the proportions of the calibration, 2048")
    first.rename(scene / "Birthday_undist_999999999_08.png")
    refuses(scene, "images of frames from 151 to 999999999, expected at most 1,000,000 frames")


def test_a_folder_without_images_or_with_two_scenes_is_refused(scene: Path) -> None:
    write(scene, scene="Train")
    refuses(scene, "images of Birthday and Train")
    for file in scene.glob("*.png"):
        file.unlink()
    refuses(scene, r"no image, expected images named SCENE_undist_00151_00\.png")
    with pytest.raises(FrogError, match="a technicolor capture, whose files say it, and --layout moving, expected"):
        open_capture(scene, layout="moving")
