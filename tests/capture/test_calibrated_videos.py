import json
import re
import unicodedata
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support.films import encode, sliding
from support.layouts.files import write_image
from support.layouts.lists import opencv_entry, write_opencv
from support.layouts.rigs import opencv_frames, qualisys
from support.small_captures import write_video

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.capture.decoding import decode_masked
from frog_blender.engine.capture.quality_check import check_capture
from frog_blender.engine.capture.readers import open_capture

from .readers.reading import refuses

ROTATION = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
CENTER = np.array([1.2, -0.5, 2.0])
LENS = [-0.1, 0.01, 0.001, 0.002, 0.0]


def filmed(name: str) -> Camera:
    pose = np.vstack([np.column_stack([ROTATION, -ROTATION @ CENTER]), [0, 0, 0, 1]])
    return Camera(name, 64, 48, np.array([[50.0, 0, 30], [0, 51.0, 25], [0, 0, 1]]), pose)


def qca(name: str = "a", head: str = "<?xml version='1.0'?>") -> str:
    return head + qualisys([filmed(name)], LENS)


def opencv(name: str = "a", **changes: Any) -> dict[str, Any]:
    return opencv_entry(filmed(name), **{"dist": LENS, **changes})


def write(folder: Path, *cameras: dict[str, Any]) -> Path:
    write_opencv(folder, cameras)
    for camera in cameras:
        if not (folder / f"{camera['name']}.mp4").exists():
            write_video(folder / f"{camera['name']}.mp4", 3)
    return folder


def test_both_calibrations_give_the_same_camera(tmp_path: Path) -> None:
    (tmp_path / "Calib.qca.txt").write_text(qca())
    write_video(tmp_path / "a.mp4", 3)
    qualisys = open_capture(tmp_path)
    plain = open_capture(write(tmp_path, opencv()))
    for capture in (qualisys, plain):
        camera = capture.cameras[0]
        np.testing.assert_allclose(camera.intrinsics, [[50, 0, 30], [0, 51, 25], [0, 0, 1]])
        np.testing.assert_allclose(camera.rotation, ROTATION, atol=1e-9)
        np.testing.assert_allclose(camera.center, CENTER, atol=1e-9)
        np.testing.assert_allclose(capture.distortions[0].coefficients, LENS)
        assert (capture.format, sum(map(capture.is_test, capture.shots))) == ("calibrated_videos", 0)


@pytest.mark.parametrize(("width", "focal"), [(64, 50.0), (96, 75.0)])
def test_pixels_that_are_not_square_are_calibrated_as_they_are_stored_or_shown(
    tmp_path: Path, width: int, focal: float
) -> None:
    encode(tmp_path / "a.mp4", [sliding(k, 64, 48) for k in range(3)], aspect=Fraction(3, 2))
    write(tmp_path, opencv("a", width=width, K=[[focal, 0, width / 2], [0, 51.0, 25], [0, 0, 1]], dist=[]))
    (tmp_path / "masks").mkdir()
    cv2.imwrite(str(tmp_path / "masks" / "a.png"), np.full((48, width), 255, np.uint8))
    capture = open_capture(tmp_path)
    camera = capture.cameras[0]
    assert (camera.width, camera.height) == (96, 48) and "pixels that are not square" in capture.warnings[0]
    np.testing.assert_allclose(camera.intrinsics, [[75, 0, 48], [0, 51, 25], [0, 0, 1]])
    shot = next(decode_masked(capture, [0]))
    assert shot.alpha is not None and shot.image.shape[:2] == shot.alpha.shape == (48, 96)


def test_what_should_be_known_before_an_hour_is_spent(tmp_path: Path) -> None:
    """A wrong principal point, one pose twice, a film that cuts the others, masks aside, copies of pictures."""
    for name, count in (("a", 3), ("b", 50)):
        encode(tmp_path / f"{name}.mp4", [sliding(k // 5, 64, 48) for k in range(count)])
        write_image(tmp_path / "mask" / f"{name}.png", np.zeros((48, 64, 3), np.uint8))
    capture = open_capture(write(tmp_path, opencv("a", K=[[50, 0, 0], [0, 51, 0], [0, 0, 1]]), opencv("b")))
    *_, cut, alike, center, aside = capture.warnings
    assert "a and 1 more of 2 cameras stand at one place and look one way, which tells no depth" in alike
    assert "a.mp4 3 frames, b.mp4 50" in cut and "take the shortest out, or put all of it there" in cut
    assert "principal point of 1 of 2 cameras" in center and "(a: 0 0 of 64 x 48)" in center
    assert "mask (of 1 such) may be a mask and is not used" in aside
    assert any("b.mp4 shows each picture 5 times" in found for found in check_capture(capture).findings)


BROKEN = {
    "Calib.qca.txt": [
        *[("no xml", "not XML"), ("<a/>", "no camera"), (qca(""), "without a serial")],
        *[(qca(head=head), "document type or entities") for head in ('<!DOCTYPE x [<!ENTITY a "b">]>', "<!doctype x>")],
    ],
    "cameras_opencv.json": [("{", "not JSON"), ("[]", "JSON list"), ('{"cameras": []}', "no list")],
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_file_is_refused(tmp_path: Path, name: str) -> None:
    for text, found in BROKEN[name]:
        (tmp_path / name).write_text(text)
        refuses(tmp_path, found)


def test_a_camera_without_video_and_a_video_without_camera_are_left_out_and_named(tmp_path: Path) -> None:
    write(tmp_path, opencv("a"), opencv("b"))
    (tmp_path / "b.mp4").rename(tmp_path / "c.mp4")
    capture = open_capture(tmp_path)
    assert [camera.name for camera in capture.cameras] == ["a"]
    assert "1 of 2 cameras are left out, without footage: b" in capture.warnings[0]
    assert "footage of no calibrated camera is left out: c" in capture.warnings[1]


def test_what_a_file_leaves_empty_is_as_if_left_out(tmp_path: Path) -> None:
    write(tmp_path, opencv("a"))
    write_opencv(
        tmp_path,
        [opencv("a", t=[[v] for v in opencv()["t"]], R=[opencv()["R"]], dist=None, offset=None, rate=None, video=None)],
        points=None,
    )
    nested = open_capture(tmp_path)
    np.testing.assert_allclose(nested.cameras[0].rotation, ROTATION, atol=1e-9)
    np.testing.assert_allclose(nested.cameras[0].center, CENTER, atol=1e-9)
    assert nested.distortions == (None,)


def test_clocks_are_those_of_the_recording_that_was_calibrated(tmp_path: Path) -> None:
    for take in ("walk", "run"):
        for name in "ab":
            (tmp_path / name).mkdir(exist_ok=True)
            write_video(tmp_path / name / f"{take}.mp4", 3)
    write_opencv(tmp_path, [opencv(name, video=f"{name}/walk.mp4", offset=0.5) for name in "ab"])
    for take, is_other in (("walk", False), ("run", True)):
        capture = open_capture(tmp_path / take)
        assert {shot.path.name for shot in capture.shots} == {f"{take}.mp4"}
        assert any("those of other films, and not used" in warning for warning in capture.warnings) == is_other


def test_qualisys_cameras_without_lens_or_film_are_left_aside_and_the_film_says_the_size(tmp_path: Path) -> None:
    off = '<camera serial="m"><fov_video bottom="47" left="0" right="63" top="0"/></camera></cameras>'
    marker = re.search("<camera .*</camera>", qca("marker"), re.DOTALL)
    text = qca().replace('bottom="47"', 'bottom="48"').replace('right="63"', 'right="64"')
    (tmp_path / "Calib.qca.txt").write_text(text.replace("</cameras>", marker[0] + off))
    write_video(tmp_path / "a.mp4", 3)
    capture = open_capture(tmp_path)
    (camera,) = capture.cameras
    assert (camera.width, camera.height, camera.intrinsics[0, 0]) == (64, 48, 50.0)
    assert len(capture.warnings) == 1 and "without footage: marker" in capture.warnings[0]


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"K": None}, "nothing as K of camera a"),
        ({"t": [0, float("nan"), 0]}, "t of camera a with a value that is not finite"),
        ({"R": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}, "mirrors"),
        ({"R": "up"}, "not made of numbers"),
        ({"t": [False, 0, 0]}, "t of camera a that is not made of numbers"),
        ({"K": [["60", 0, 20], [0, 60, 15], [0, 0, 1]]}, "K of camera a that is not made of numbers"),
        ({"dist": [0.1, 0.2]}, "2 distortion coefficients"),
        ({"width": 0}, "width of camera a = 0"),
        ({"name": ""}, "without a name"),
        ({"K": [[60, 0, 0], [0, 60, 0], [20, 15, 1]]}, "K of camera a that is transposed: its last row is 20 15 1"),
        ({"K": [[60, 0, 20], [0, 60, 15], [0, 0, 2]]}, "expected the rows fx s cx, 0 fy cy and 0 0 1"),
        ({"K": [[-60, 0, 20], [0, 60, 15], [0, 0, 1]]}, "a focal length of -60"),
        ({"width": 10**400}, "width of camera a with a number too large"),
        ({"t": [0, 0, 1e300]}, "t of camera a with the number 1e.300"),
    ],
)
def test_values_that_cannot_be_used_are_refused(tmp_path: Path, changes: dict[str, Any], found: str) -> None:
    write(tmp_path, opencv("a"))
    write_opencv(tmp_path, [opencv(**changes)])
    refuses(tmp_path, found)


def test_two_cameras_of_one_name_are_refused(tmp_path: Path) -> None:
    refuses(write(tmp_path, opencv("a"), opencv("a")), "several cameras named a")


@pytest.mark.parametrize(
    ("calibrated", "resized"),
    [
        *[((66, 50), True), ((64 * 3, 48 * 3), True), ((127, 97), True)],
        *[((64, 50), False), ((66, 48), False), ((72, 49), False)],
    ],
)
def test_a_video_is_the_calibrated_image_resized_or_a_part_of_it(
    tmp_path: Path, calibrated: tuple[int, int], resized: bool
) -> None:
    """Videos of 64 x 48 pixels, whose sides an encoder may have rounded."""
    width, height = calibrated
    capture = open_capture(write(tmp_path, opencv("a", width=width, height=height)))
    (camera,), scale = capture.cameras, (64 / width, 48 / height, 1) if resized else (1, 1, 1)
    np.testing.assert_allclose(camera.intrinsics, np.diag(scale) @ opencv()["K"])
    assert (camera.width, camera.height) == (64, 48)
    assert ("the same image, resized" if resized else "its upper left part") in capture.warnings[0]


def test_points_are_seeds(tmp_path: Path) -> None:
    points = [[0.1, 0.2, 3.0], [-1.0, 0.5, 4.25]]
    write(tmp_path, opencv())
    np.testing.assert_array_equal(open_capture(write_opencv(tmp_path, [opencv()], points=points)).points, points)


@pytest.mark.parametrize(
    ("points", "found"),
    [([[1.0, 2.0]], r"shape \(1, 2\) as points"), ([[1.0, 2.0, 3.0], [1.0]], "points that is not made of numbers")],
)
def test_points_that_cannot_be_used_are_refused(tmp_path: Path, points: object, found: str) -> None:
    refuses(write_opencv(tmp_path, [opencv()], points=points), found)


def test_keys_that_are_not_used_are_said_beside_frames(tmp_path: Path) -> None:
    opencv_frames(tmp_path)
    file = tmp_path / "cameras_opencv.json"
    content = json.loads(file.read_text())
    assert open_capture(tmp_path).warnings == ()
    content["cameras"][0]["model"] = "fisheye"
    file.write_text(json.dumps(content | {f"key {number}": 0 for number in range(8)}))
    assert "key 4, key 5 and 3 more; every lens is taken for" in open_capture(tmp_path).warnings[0]


@pytest.mark.parametrize(("written", "named"), [("NFC", "NFD"), ("NFD", "NFC")])
def test_accents_are_the_same_however_they_are_composed(tmp_path: Path, written: str, named: str) -> None:
    name = "caméra"
    write_video(tmp_path / f"{unicodedata.normalize(named, name)}.mp4", 3)
    camera = opencv(unicodedata.normalize(written, name))
    write_opencv(tmp_path, [camera])
    assert [camera.name for camera in open_capture(tmp_path).cameras] == [name]


def test_a_qualisys_file_of_endless_images_is_refused(tmp_path: Path) -> None:
    for side in ("right", "bottom"):
        (tmp_path / "Calib.qca.txt").write_text(re.sub(rf'{side}="[^"]*"', f'{side}="1e308"', qca()))
        refuses(tmp_path, f"fov_video {side} of camera a with the number 1e.308")
