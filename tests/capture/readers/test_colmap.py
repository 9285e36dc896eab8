"""COLMAP's models with images, folders, films; every lens; and a model by COLMAP itself, with rigs."""

import struct
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from support.filmed_scene import FRAMES, NAMES, Rays, image, moving, rig, still
from support.films import photograph
from support.layouts.colmap import POINTS, write_model
from support.layouts.files import write_films, write_frames, write_image

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.capture.lenses import WIDEST
from frog_blender.engine.capture.readers import open_capture

from .reading import assert_same_cameras, assert_same_images, opened, refuses

BINARY_OR_TEXT = pytest.mark.parametrize("text", [False, True], ids=["binary", "text"])
EACH_FRAME = [camera for camera in rig() for _ in range(FRAMES)]


def folders(folder: Path, text: bool = False) -> None:
    write_frames(folder / "images", rig())
    names = [f"{camera.name}/{frame:04d}.png" for camera in rig() for frame in range(FRAMES)]
    write_model(folder / "sparse" / "0", names[::-1], EACH_FRAME[::-1], text=text)


def flat_with_poses_at_one_time(folder: Path) -> None:
    for camera in rig():
        for frame in range(FRAMES):
            write_image(folder / "images" / f"{camera.name}_{frame:04d}.png", still(camera.name, frame))
    write_model(folder / "sparse" / "0", [f"{camera.name}_0000.png" for camera in rig()], rig())


def one_image_each(folder: Path) -> None:
    write_model(folder / "sparse" / "0", [f"{camera.name}.png" for camera in rig()], rig())
    for camera in rig():
        write_image(folder / "images" / f"{camera.name}.png", still(camera.name, 0))


def films(folder: Path, beside: str) -> None:
    one_image_each(folder)
    write_films(folder / beside, rig())


STANDING: dict[str, tuple[Callable[[Path], None], int]] = {
    "folders, binary": (folders, FRAMES),
    "folders, text": (partial(folders, text=True), FRAMES),
    "flat": (flat_with_poses_at_one_time, FRAMES),
    "films": (partial(films, beside="."), FRAMES),
    "videos": (partial(films, beside="videos"), FRAMES),
    "one time": (one_image_each, 1),
}


@pytest.mark.parametrize("name", STANDING)
def test_standing_cameras(tmp_path: Path, name: str) -> None:
    write, count = STANDING[name]
    write(tmp_path / "capture")
    capture = opened(tmp_path / "capture", "colmap")
    assert (capture.frame_count, capture.test_cameras, capture.test_frames) == (count, frozenset(), frozenset())
    assert {shot.path.suffix for shot in capture.shots} == {".avi" if name in ("films", "videos") else ".png"}
    assert_same_cameras(capture, rig())
    assert_same_images(capture, tmp_path / "cache")
    np.testing.assert_allclose(capture.points, POINTS)


def test_videos_that_no_image_is_named_as_are_said_or_asked_for(tmp_path: Path) -> None:
    one_image_each(tmp_path)
    write_films(tmp_path / "videos", [replace(camera, name=name) for camera, name in zip(rig(), "wxyz", strict=True)])
    capture = open_capture(tmp_path)
    assert capture.frame_count == 1 and "4 videos (videos/w.avi ...) are not used" in capture.warnings[0]
    write_films(tmp_path, [replace(camera, name=f"port_{index + 2}") for index, camera in enumerate(rig())])
    refuses(tmp_path, "cameras cam00 to cam03 and footage port_2 to port_5, which may be counted from different")


def test_the_largest_of_several_models_is_taken(tmp_path: Path) -> None:
    folders(tmp_path)
    (tmp_path / "sparse" / "0").rename(tmp_path / "sparse" / "1")
    write_model(tmp_path / "sparse" / "0", [f"{NAMES[0]}/0000.png"], rig()[:1])
    capture = opened(tmp_path, "colmap")
    assert [camera.name for camera in capture.cameras] == list(NAMES)
    assert "sparse/1: the largest of 2 models is taken" in capture.warnings[0]


@BINARY_OR_TEXT
def test_one_moving_camera_in_the_order_of_numbers_with_gaps(tmp_path: Path, text: bool) -> None:
    folder, cameras = tmp_path / "capture", moving(9)
    numbers = [9, 1, 2, 3, 5, 6, 7, 8, 10]  # the list is not in order; 4 had no pose
    for camera, number in zip(cameras, numbers, strict=True):
        write_image(folder / "images" / f"frame_{number}.png", image(camera, 0))
    write_model(folder / "sparse" / "0", [f"frame_{number}.png" for number in numbers], cameras, text=text)
    capture = opened(folder, "colmap")
    assert capture.is_moving and capture.frame_count == 10
    assert [capture.cameras[shot.camera].name for shot in capture.shots] == [f"frame_{n}" for n in sorted(numbers)]
    assert [shot.frame for shot in capture.shots] == [number - 1 for number in sorted(numbers)]
    assert capture.test_frames == {4}  # every eighth
    expected = [replace(c, name=f"frame_{n}") for c, n in zip(cameras, numbers, strict=True)]
    assert_same_cameras(capture, expected)
    assert_same_images(capture, tmp_path / "cache", lambda camera, frame: image(camera, 0))


def test_numbers_that_are_no_times_of_a_film_are_told(tmp_path: Path) -> None:
    names = [f"frame_{number}.png" for number in (1, 2, 3, 9999)]  # a counter that began again
    write_model(tmp_path / "sparse" / "0", names, moving(4))
    for name in names:
        write_image(tmp_path / "images" / name, still("cam01", 0))
    capture = opened(tmp_path, "colmap")
    assert capture.frame_count == 4 and "too far apart for a film" in capture.warnings[0]


def test_images_are_missing(tmp_path: Path) -> None:
    write_model(tmp_path / "sparse" / "0", ["a/1.png", "b/1.png"], rig()[:2])
    refuses(tmp_path, r"a COLMAP model of 2 images \(a/1.png, \.\.\.\) and none of these images")
    write_image(tmp_path / "images" / "b" / "1.png", still("cam01", 0))
    assert any("1 of 2 images of the model are missing" in each for each in open_capture(tmp_path).warnings)


def test_names_that_lead_outside_are_refused(tmp_path: Path) -> None:
    write_model(tmp_path / "capture" / "sparse" / "0", ["../cam00.png"], rig()[:1])
    write_image(tmp_path / "cam00.png", still("cam00", 0))
    refuses(tmp_path / "capture", "lies outside the capture's folder")


def test_smaller_images_than_the_model_was_made_of(tmp_path: Path) -> None:
    cameras = rig()
    write_model(tmp_path / "sparse" / "0", ["cam00.png"], [cameras[0].resized(128, 96)])
    write_image(tmp_path / "images" / "cam00.png", still("cam00", 0))
    assert_same_cameras(open_capture(tmp_path), cameras[:1])


PERSPECTIVE = {
    "SIMPLE_PINHOLE": (52.0, 32.5, 23.0),
    "SIMPLE_RADIAL": (52.0, 32.5, 23.0, -0.1),
    "RADIAL": (52.0, 32.5, 23.0, -0.1, 0.02),
    "OPENCV": (52.0, 53.0, 32.5, 23.0, -0.1, 0.02, 0.003, -0.002),
    "FULL_OPENCV": (52.0, 53.0, 32.5, 23.0, -0.1, 0.02, 0.003, -0.002, 0.01, 0.05, -0.01, 0.004),
}
FISHEYE = {
    "OPENCV_FISHEYE": (26.0, 26.5, 32.5, 23.0, -0.03, 0.01, -0.002, 0.0003),
    "SIMPLE_RADIAL_FISHEYE": (26.0, 32.5, 23.0, -0.03),
    "RADIAL_FISHEYE": (26.0, 32.5, 23.0, -0.03, 0.004),
    "THIN_PRISM_FISHEYE": (26.0, 26.5, 32.5, 23.0, -0.03, 0.01, 0.002, -0.001, -0.002, 0.0003, 0.001, -0.002),
    "FOV": (30.0, 30.5, 32.5, 23.0, 0.9),
}
LENSES = PERSPECTIVE | FISHEYE
ONE_FOCAL = {"SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"}
SCALE = 4  # of the images: half a pixel would then change them by 0.66 levels of 255, and sampling does by 0.25


@pytest.mark.parametrize("model", LENSES)
def test_lenses_are_undistorted(tmp_path: Path, model: str) -> None:
    """The image is drawn through COLMAP's own lens; undistorted it must be what the pinhole camera sees."""
    values, pixels = LENSES[model], 3 if model in ONE_FOCAL else 4
    small = rig((values[0], values[pixels - 3]), (32.5, 23.0))[1]
    camera = small.resized(SCALE * small.width, SCALE * small.height)
    values = (*(SCALE * value for value in values[:pixels]), *values[pixels:])
    write_image(tmp_path / "c" / "images" / "cam01.png", image(camera, 2, colmap_rays(camera, model, values)))
    write_model(tmp_path / "c" / "sparse" / "0", ["cam01.png"], [camera], [(model, values)])
    capture = opened(tmp_path / "c", "colmap")
    assert (capture.distortions[0] is None) == (model == "SIMPLE_PINHOLE")
    assert_same_cameras(capture, [camera], poses_only=model in FISHEYE)
    assert_same_images(capture, tmp_path / "cache", lambda camera, frame: image(camera, 2), off=0.33)
    if model in FISHEYE:
        shown = capture.cameras[0]
        assert np.radians(80) < 2 * np.arctan(shown.width / 2 / shown.intrinsics[0, 0]) <= WIDEST + 1e-9


@pytest.mark.parametrize("orientation", [6, 8])
@pytest.mark.parametrize("model", ["OPENCV", "OPENCV_FISHEYE"])
def test_photographs_that_exif_turns_keep_their_poses(tmp_path: Path, model: str, orientation: int) -> None:
    """COLMAP sees images as they are stored; the camera of what is shown is turned with them."""
    values, camera = LENSES[model], rig()[1]
    shown = image(camera, 2, colmap_rays(camera, model, values))
    (tmp_path / "c" / "images").mkdir(parents=True)
    photograph(tmp_path / "c" / "images" / "cam01.png", shown, turned=orientation)
    write_model(tmp_path / "c" / "sparse" / "0", ["cam01.png"], [camera], [(model, values)])
    capture = opened(tmp_path / "c", "colmap")
    assert (capture.cameras[0].width, capture.cameras[0].height) == (48, 64)
    np.testing.assert_allclose(capture.cameras[0].center, camera.center, atol=1e-9)
    off = 4.0 if model in FISHEYE else 3.0
    assert_same_images(capture, tmp_path / "cache", lambda camera, frame: image(camera, 2), off=off)


def colmap_rays(camera: Camera, model: str, values: tuple[float, ...]) -> Rays:
    """The rays of an image through COLMAP's own lens."""
    pycolmap = pytest.importorskip("pycolmap")
    lens = pycolmap.Camera(model=model, width=camera.width, height=camera.height, params=list(values))
    return lambda pixels: np.array([lens.cam_from_img(pixel)[:2] for pixel in pixels])


def test_a_lens_without_a_reader_says_what_to_export(tmp_path: Path) -> None:
    write_model(tmp_path / "sparse" / "0", ["cam00.png"], rig()[:1])
    cameras = tmp_path / "sparse" / "0" / "cameras.bin"
    cameras.write_bytes(struct.pack("<QIiQQ6d", 1, 1, 16, 64, 48, 50, 50, 32, 24, 0.6, 1.1))
    write_image(tmp_path / "images" / "cam00.png", still("cam00", 0))
    refuses(tmp_path, r"model EUCM, expected PINHOLE, OPENCV .*image_undistorter")


@BINARY_OR_TEXT
def test_a_model_of_colmap_itself_with_rigs_and_frames(tmp_path: Path, text: bool) -> None:
    """Two cameras on a moving rig, three frames: the files that COLMAP 3.12 and later write."""
    pycolmap = pytest.importorskip("pycolmap")
    model, left, right = pycolmap.Reconstruction(), rig()[0], rig()[1]
    for index, camera in ((1, left), (2, right)):
        k = camera.intrinsics
        params = [k[0, 0], k[1, 1], k[0, 2], k[1, 2]]
        model.add_camera(pycolmap.Camera(camera_id=index, model="PINHOLE", width=64, height=48, params=params))
    rigs = pycolmap.Rig(rig_id=1)
    sensors = {index: pycolmap.sensor_t(pycolmap.SensorType.CAMERA, index) for index in (1, 2)}
    rigs.add_ref_sensor(sensors[1])
    between = right.world_to_camera @ np.linalg.inv(left.world_to_camera)
    rigs.add_sensor(sensors[2], pycolmap.Rigid3d(between[:3]))
    model.add_rig(rigs)
    expected = []
    for frame, moved in enumerate(moving(3)):
        entry = pycolmap.Frame(frame_id=frame + 1, rig_id=1, rig_from_world=pycolmap.Rigid3d(moved.world_to_camera[:3]))
        for index, sensor in sensors.items():
            entry.add_data_id(pycolmap.data_t(sensor, 10 * index + frame))
        model.add_frame(entry)
        for sensor, pose in ((1, np.eye(4)), (2, between)):
            name = f"{'xyz'[frame]}{'lr'[sensor - 1]}.png"  # nothing in the names tells the camera or the time
            index = 10 * sensor + frame
            model.add_image(pycolmap.Image(image_id=index, camera_id=sensor, name=name, frame_id=frame + 1))
            seen = replace(left, name=name[:-4], world_to_camera=pose @ moved.world_to_camera)
            write_image(tmp_path / "c" / "images" / name, image(seen, frame))
            expected.append((seen, frame))
    folder = tmp_path / "c" / "sparse" / "0"
    folder.mkdir(parents=True)
    (model.write_text if text else model.write_binary)(str(folder))
    assert (folder / f"frames.{'txt' if text else 'bin'}").is_file()
    capture = opened(tmp_path / "c", "colmap")
    assert capture.frame_count == 3 and capture.has_moving_cameras
    assert_same_cameras(capture, [camera for camera, _ in expected])
    frames = {capture.cameras[shot.camera].name: shot.frame for shot in capture.shots}
    assert frames == {camera.name: frame for camera, frame in expected}
    assert_same_images(capture, tmp_path / "cache", image)
