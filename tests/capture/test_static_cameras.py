"""What a capture leaves open: cameras that stand among posed images, and cameras without all their times."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support.builders import plain_camera
from support.layouts.lists import posed, rewrite, write_listed

from frog_blender.engine.capture.readers import open_capture, transforms_json
from frog_blender.engine.capture.seeding.plane_sweep import DepthMap, completed, points_seen_once
from frog_blender.engine.capture.seeding.views import View
from frog_blender.engine.frames.store import FrameStore


def write_standing(
    folder: Path, name: str = "transforms.json", cameras: str = "ab", timed: bool = True
) -> dict[str, Any]:
    """Three frames of static cameras, camera after camera, as converters of videos write them."""
    files = [f"{name[:-5]}_{camera}_{number:04d}" for camera in cameras for number in range(3)]
    times = [{"time": index % 3 / 2} if timed else {} for index in range(len(files))]
    frames = [posed(file, index // 3, **times[index]) for index, file in enumerate(files)]
    return write_listed(folder, [f"{file}.png" for file in files], frames, name)


@pytest.mark.parametrize("timed", [True, False])
def test_images_with_the_same_pose_are_one_standing_cameras(tmp_path: Path, timed: bool) -> None:
    write_standing(tmp_path, timed=timed)
    capture = open_capture(tmp_path)
    assert [camera.name for camera in capture.cameras] == ["transforms_a", "transforms_b"]
    assert not capture.is_moving and capture.frame_count == 3 and not capture.test_cameras and not capture.test_frames
    assert not capture.warnings
    assert [(shot.camera, shot.frame) for shot in capture.shots] == [(c, f) for f in range(3) for c in range(2)]
    np.testing.assert_allclose([camera.center[0] for camera in capture.cameras], [0, 1])
    assert [shot.path.stem[-6:] for shot in capture.shots if shot.camera == 1] == ["b_0000", "b_0001", "b_0002"]


def test_lists_to_train_on_and_to_judge_share_no_camera(tmp_path: Path) -> None:
    """Cameras are held out by name: one that films for both lists is two."""
    write_standing(tmp_path, "transforms_train.json", "ab")
    write_standing(tmp_path, "transforms_test.json", "c")
    capture = open_capture(tmp_path)
    names = ["transforms_train_a", "transforms_train_b", "transforms_test_c"]
    assert [camera.name for camera in capture.cameras] == names
    assert capture.test_cameras == {names[2]} and len(capture.train_shots) == 6


@pytest.mark.parametrize("what", ["a pose of its own", "twice at one time", "another lens"])
def test_images_of_a_camera_that_moves_stay_apart(tmp_path: Path, what: str) -> None:
    """One that pauses has the same pose twice; a rig's cameras in one place are two."""
    data = write_standing(tmp_path)
    frame = data["frames"][4]
    if what == "a pose of its own":
        frame["transform_matrix"][1][3] = 0.5
    elif what == "twice at one time":
        frame["time"] = 0.0
    else:
        frame["fl_x"] = 51.0
    rewrite(tmp_path, data)
    capture = open_capture(tmp_path)
    assert len(capture.cameras) == len(capture.shots) == 6


def test_images_whose_poses_are_not_known_stay_apart(tmp_path: Path) -> None:
    """Nothing can be trained on them, but their clips are found."""
    data = write_standing(tmp_path)
    rewrite(tmp_path, {**data, "frames": [{"file_path": frame["file_path"]} for frame in data["frames"]]})
    found = transforms_json.images_by_camera(tmp_path)
    assert len(found) == 6 and all(len(images) == 1 for images in found.values())


def test_an_image_of_another_size_is_brought_to_its_cameras(tmp_path: Path, cache_folder: Path) -> None:
    write_standing(tmp_path)
    other = tmp_path / "transforms_b_0001.png"
    cv2.imwrite(str(other), np.full((60, 80, 3), 90, np.uint8))
    capture = open_capture(tmp_path)
    store = FrameStore.open(capture, cache_folder=cache_folder)
    images = [store.image(index) for index in range(6)]
    assert {image.shape for image in images} == {(30, 40, 3)}
    assert [int(image.mean()) for image in images] == [0, 30, 10, 90, 20, 50]


WIDTH, HEIGHT = 80, 60
LINES, COLUMNS = np.mgrid[:HEIGHT, :WIDTH]


def view_at(x: float, image: np.ndarray) -> View:
    camera = plain_camera(WIDTH, HEIGHT, 60.0).moved(np.zeros(3), np.array([-x, 0, 0]))
    return View(0, camera, image.astype(np.float32))


def depth_map(view: View, depth: np.ndarray, confirmed: np.ndarray) -> DepthMap:
    sure = np.ones(depth.shape, bool)
    return DepthMap(view, np.asarray(depth, np.float64), sure, sure, 0.01, confirmed)


def test_a_floor_goes_on_where_no_other_view_confirms_it() -> None:
    floor, seen = 1 / (0.1 + 0.002 * LINES), COLUMNS < 50
    mixed = np.where(seen, floor, 30.0)  # a wrong match beyond
    filled = completed(depth_map(view_at(0, np.full((HEIGHT, WIDTH, 3), 0.5)), mixed, seen))
    np.testing.assert_array_equal(filled[seen], floor[seen])
    wrong, one_depth = (np.abs(depth / floor - 1)[~seen] for depth in (filled, np.median(floor)))
    assert np.median(wrong) < min(0.06, np.median(one_depth) / 2)


def test_depth_does_not_flow_across_an_edge_of_the_image() -> None:
    """A dark card before a bright wall; the strip of wall beside it is hidden from the others."""
    card = (COLUMNS >= 30) & (COLUMNS < 50)
    truth = np.where(card, 2.0, 8.0)
    hidden = (COLUMNS >= 50) & (COLUMNS < 60)
    image = np.repeat(np.where(card, 0.1, 0.9)[..., None], 3, axis=2)
    filled = completed(depth_map(view_at(0, image), np.where(hidden, 1.0, truth), ~hidden))
    assert (filled[hidden] > 5.5).mean() > 0.95
    blank = depth_map(view_at(0, np.full(image.shape, 0.5)), np.where(hidden, 1.0, truth), ~hidden)
    assert (completed(blank)[hidden] > 5.5).mean() < 0.5, "it is the image that stops it"


def test_no_point_hides_what_another_camera_confirms() -> None:
    image = np.full((HEIGHT, WIDTH, 3), 0.5)
    wall, near = np.full((HEIGHT, WIDTH), 6.0), np.full((HEIGHT, WIDTH), 3.0)
    left = COLUMNS < 40
    own = depth_map(view_at(0, image), near, left)
    alone = points_seen_once(own, [])
    assert len(alone) == len(alone.colors) == alone.is_textured.sum() == (~left).sum()
    np.testing.assert_allclose(alone.points[:, 2], 3, rtol=0.02)
    sure = depth_map(view_at(0.1, image), wall, np.ones(left.shape, bool))
    pixels, _ = sure.view.camera.project(points_seen_once(own, [sure]).points)
    outside = ((pixels < 0) | (pixels >= [WIDTH, HEIGHT])).any(axis=1)
    assert outside.all(), "the other camera sees the wall there, through these"
    nothing = np.zeros(left.shape, bool)
    assert len(points_seen_once(own, [replace(sure, confirmed=nothing)])) == len(alone)
    assert not len(points_seen_once(replace(own, confirmed=nothing), [sure]))
