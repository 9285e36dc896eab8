from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support.builders import refused
from support.layouts.lists import posed, rewrite, write_listed
from support.layouts.lists import write_moving as write

from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.readers.checks import path_inside
from frog_blender.engine.frames.store import FrameStore

from .readers.reading import refuses


def test_an_images_own_values_win(tmp_path: Path) -> None:
    data = write(tmp_path, 3, camera_angle_x=1.0, k1=-0.1)
    del data["fl_x"]
    data["frames"][1].update({"fl_x": 33.0, "k1": 0.0, "cx": 11.0})
    rewrite(tmp_path, data)
    capture = open_capture(tmp_path)
    assert capture.cameras[0].intrinsics[0, 0] == pytest.approx(20 / np.tan(0.5))
    np.testing.assert_allclose(capture.cameras[1].intrinsics, [[33, 0, 11], [0, 33, 15], [0, 0, 1]])
    assert capture.distortions[0] is not None
    assert capture.distortions[1] is None


def test_frames_are_ranks_of_distinct_times(tmp_path: Path) -> None:
    data = write(tmp_path, 4)
    for frame, time in zip(data["frames"], [0.5, 0.0, 0.5, 0.9], strict=True):
        frame["time"] = time
    rewrite(tmp_path, data)
    capture = open_capture(tmp_path)
    assert capture.frame_count == 3
    assert sorted((shot.camera, shot.frame) for shot in capture.shots) == [(0, 1), (1, 0), (2, 1), (3, 2)]
    assert not capture.test_frames  # not one moving camera: nothing is held out by default


def test_clocks_of_standing_cameras_that_differ_leave_them_their_frames(tmp_path: Path) -> None:
    data = write(tmp_path, 6)
    for index, frame in enumerate(data["frames"]):
        frame["transform_matrix"] = data["frames"][index % 2]["transform_matrix"]
        frame["time"] = index // 2 / 2 + (0.02 if index in (1, 3) else 0)
    rewrite(tmp_path, data)
    capture = open_capture(tmp_path)
    assert [shot.frame for shot in capture.shots] == [0, 0, 1, 1, 2, 2] and not capture.warnings
    assert [round(shot.offset, 3) for shot in capture.shots] == [0, 0.04, 0, 0.04, 0, 0]
    del data["frames"][3]["time"]
    rewrite(tmp_path, data)
    assert '5 of 6 images say their "time"' in open_capture(tmp_path).warnings[0]


def test_missing_images_are_counted_and_none_is_an_error(tmp_path: Path) -> None:
    write(tmp_path, 10)
    (tmp_path / "transforms_001.png").rename(tmp_path / "transforms_001.PNG")
    for index in (2, 7):
        (tmp_path / f"transforms_{index:03d}.png").unlink()
    capture = open_capture(tmp_path)
    assert len(capture.shots) == 8
    assert "2 of 10 listed images are missing" in capture.warnings[1]
    for image in tmp_path.glob("*.[pP]*"):
        image.unlink()
    refuses(tmp_path, "10 listed images of which none exists")


@pytest.mark.parametrize("name", ["../secret.png", "/etc/hostname", "a/../../b.png", "..\\x.png"])
def test_paths_outside_the_folder_are_refused(tmp_path: Path, name: str) -> None:
    data = write(tmp_path, 2)
    data["frames"][1]["file_path"] = name
    rewrite(tmp_path, data)
    refuses(tmp_path, "outside the capture's folder")


@pytest.mark.parametrize("root", ["/home/else/capture/", "C:\\else\\capture\\", "//server/share/"])
def test_whole_paths_of_another_computer(tmp_path: Path, root: str) -> None:
    data = write(tmp_path, 3)
    there = [str(tmp_path / frame["file_path"]) for frame in data["frames"]]
    for frame in data["frames"]:
        frame["file_path"] = root + frame["file_path"]
    rewrite(tmp_path, data)
    assert sorted(str(shot.path.with_suffix("")) for shot in open_capture(tmp_path).shots) == sorted(there)


@pytest.mark.parametrize(
    ("top", "own", "found"),
    [
        ({"camera_model": "FISHEYE624"}, {}, "FISHEYE624"),
        ({"fl_x": None}, {}, "no focal length"),
        ({"w": 80}, {}, "the proportions of the calibration, 80 x 30"),
        ({}, {"transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [1, 2, 3, 1]]}, "transposed: .* 1 2 3 1"),
        ({}, {"transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 2]]}, "the last row 0 0 0 1"),
        ({"fl_x": 1e-9}, {}, "a focal length of 1e-09"),
        ({}, {"file_path": 3}, "found 3 as file_path"),
        ({}, {"time": True}, "time that is not made of numbers"),
        ({"fl_x": "60"}, {}, "fl_x that is not made of numbers"),
        ({"fps": float("inf")}, {}, "fps with a value that is not finite"),
        ({"k1": 10**400}, {}, "k1 with a number too large"),
        ({"is_fisheye": "false"}, {}, "is_fisheye = 'false', expected true or false"),
    ],
)
def test_values_that_cannot_be_used_are_refused(
    tmp_path: Path, top: dict[str, Any], own: dict[str, Any], found: str
) -> None:
    data = {**write(tmp_path, 3), **top}
    for frame in data["frames"]:
        frame.update(own)
    rewrite(tmp_path, data)
    refuses(tmp_path, found)


def test_times_of_some_lists_alone_are_refused(tmp_path: Path) -> None:
    write_listed(tmp_path, ["a.png"], [posed("./a", 0, time=0.5)], "transforms_train.json")
    write(tmp_path, 2, "transforms_test.json")
    refuses(tmp_path, "lists with times for all images and others without, expected times in all or none")


def test_blender_layout_holds_out_its_test_images_and_lies_over_white(tmp_path: Path) -> None:
    write(tmp_path, 4, "transforms_train.json")
    write_listed(tmp_path, ["x.png", "y.png"], [posed("./x", 0), posed("./y", 0)], "transforms_test.json")
    transparent = np.zeros((30, 40, 4), np.uint8)
    transparent[:, 20:] = (0, 0, 200, 255)  # BGRA
    cv2.imwrite(str(tmp_path / "transforms_train_000.png"), transparent)
    capture = open_capture(tmp_path)
    assert capture.test_cameras == {"x"} and all("--layout" in said for said in capture.warnings)  # of no gap, no twin
    assert len(capture.train_shots) == 4
    store = FrameStore.open(capture, cache_folder=tmp_path / "cache")
    image = store.image(capture.shot_index(0, 0))
    assert image[5, 5].tolist() == [255, 255, 255]
    assert image[5, 30].tolist() == [200, 0, 0]


@pytest.mark.parametrize("stated", [True, False])
def test_every_image_has_its_own_size(tmp_path: Path, stated: bool) -> None:
    data = write(tmp_path, 4)
    sizes = [(40, 30), (80, 60), (30, 40), (60, 30)]
    if not stated:
        del data["w"], data["h"]
    for index, (frame, (width, height)) in enumerate(zip(data["frames"], sizes, strict=True)):
        cv2.imwrite(str(tmp_path / f"transforms_{index:03d}.png"), np.full((height, width, 3), 90, np.uint8))
        frame.update({"w": width, "h": height, "fl_x": 1.5 * width} if stated else {"fl_x": 1.5 * width})
    rewrite(tmp_path, data)
    capture = open_capture(tmp_path)
    store = FrameStore.open(capture, cache_folder=tmp_path / "cache")
    for index, (camera, (width, height)) in enumerate(zip(capture.cameras, sizes, strict=True)):
        assert (camera.width, camera.height) == (width, height)
        expected = [[1.5 * width, 0, width / 2], [0, 1.5 * width, height / 2], [0, 0, 1]]
        np.testing.assert_allclose(camera.intrinsics, expected)
        assert store.image(index).shape == (height, width, 3)


def test_an_image_of_other_proportions_than_its_own_size_is_named(tmp_path: Path) -> None:
    data = write(tmp_path, 3)
    data["frames"][2].update({"w": 30, "h": 40})
    rewrite(tmp_path, data)
    refuses(tmp_path, r"transforms_002\.png: found images of 40 x 30 .*, expected .*, 30 x 40")


def test_a_whole_path_inside_the_folder_is_taken_wherever_one_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = write(tmp_path / "filmed", 2)
    for index, frame in enumerate(data["frames"]):
        frame["file_path"] = str(tmp_path / "filmed" / f"transforms_{index:03d}.png")
    rewrite(tmp_path / "filmed", data)
    monkeypatch.chdir(tmp_path)
    assert len(open_capture(Path("filmed")).shots) == 2
    monkeypatch.chdir(tmp_path / "filmed")
    assert len(open_capture(Path(".")).shots) == 2


@pytest.mark.parametrize(
    "name", ["//server/share/x.png", "\\\\server\\share\\x.png", "\\\\?\\UNC\\server\\share\\x.png"]
)
def test_no_path_of_another_computer_is_looked_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    asked: list[Path] = []
    monkeypatch.setattr(Path, "is_file", lambda path: asked.append(path) or False)
    refused("lies outside the capture's folder", path_inside, tmp_path, name, tmp_path / "transforms.json", "image")
    assert asked and all(path.is_relative_to(tmp_path) for path in asked)
