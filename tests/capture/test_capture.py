from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.builders import refused

from frog_blender.engine.capture.capture import Capture, Shot
from frog_blender.engine.capture.readers import open_capture


def test_holding_out_frames_splits_every_camera_the_same_way(n3dv: Path) -> None:
    capture = open_capture(n3dv).with_holdout(2)
    assert capture.test_frames == {1, 3}
    assert {shot.frame for shot in capture.train_shots} == {0, 2, 4}
    assert all(capture.cameras[shot.camera].name != "cam00" for shot in capture.train_shots)
    assert len(capture.train_shots) + sum(map(capture.is_test, capture.shots)) == len(capture.shots) == 15
    assert capture.with_holdout(0).test_frames == frozenset()


def test_shots_are_ordered_by_frame_then_camera(n3dv: Path) -> None:
    capture = open_capture(n3dv)
    assert [(s.frame, s.camera) for s in capture.shots] == [(f, c) for f in range(5) for c in range(3)]
    assert capture.shots[capture.shot_index(2, 4)].path.name == "cam03.mp4"
    assert capture.shot_index(3, 0) is None


def test_scaling_rounds_sizes_and_keeps_directions(n3dv: Path) -> None:
    capture = open_capture(n3dv)
    half = capture.scaled(0.4)
    assert (half.cameras[0].width, half.cameras[0].height) == (26, 19)
    directions = half.cameras[0].ray_directions(np.array([[26.0, 19.0]]))
    np.testing.assert_allclose(directions, capture.cameras[0].ray_directions(np.array([[64.0, 48.0]])))


def test_a_pixel_offset_moves_the_principal_point_back(n3dv: Path) -> None:
    plain, moved = open_capture(n3dv), open_capture(n3dv, pixel_offsets={"cam01": (8, -2.5)})
    assert moved.cameras[1].intrinsics[0, 2] == plain.cameras[1].intrinsics[0, 2] - 8
    assert moved.cameras[1].intrinsics[1, 2] == plain.cameras[1].intrinsics[1, 2] + 2.5


@pytest.mark.parametrize(
    ("images", "held_out", "is_moving", "has_moving_cameras"),
    [
        ([(0, 0), (1, 1), (2, 2)], [], True, True),
        ([(0, 0), (1, 0), (2, 0)], [], False, False),
        ([(0, 0)], [], False, False),
        ([], [], False, False),
        # of a rig of two moving cameras one trains and one judges, or both train
        ([(0, 0), (1, 0), (2, 1)], ["cam00"], True, True),
        ([(0, 0), (1, 0), (2, 1)], [], False, True),
        ([(0, 0), (1, 0), (2, 1)], ["cam00", "cam01"], False, False),
        # D-NeRF's validation images of one scene are all of one standing camera
        ([(1, 0), (2, 1), (0, 0), (0, 1)], ["cam00"], False, True),
        ([(1, 0), (2, 1), (0, 0), (0, 1)], [], False, False),
    ],
)
def test_cameras_move(
    n3dv: Path, images: list[tuple[int, int]], held_out: list[str], is_moving: bool, has_moving_cameras: bool
) -> None:
    """Held-out images may share a frame with training ones, and move or stand."""
    shots = tuple(Shot(camera, frame, Path("x"), 0) for camera, frame in images)
    capture = replace(open_capture(n3dv), shots=shots, test_cameras=frozenset(held_out))
    assert (capture.is_moving, capture.has_moving_cameras) == (is_moving, has_moving_cameras)


def test_a_camera_left_out_is_gone_with_its_pose_and_its_shots(n3dv: Path) -> None:
    capture = open_capture(n3dv, pixel_offsets={"cam03": (8, 0)})
    less = capture.without_cameras({"cam01"})
    assert [camera.name for camera in less.cameras] == ["cam00", "cam03"]
    np.testing.assert_allclose(less.cameras[1].center, [2, 0, 0])
    assert less.cameras[1].intrinsics[0, 2] == capture.cameras[2].intrinsics[0, 2]
    assert len(less.distortions) == 2
    assert [(s.frame, s.camera) for s in less.shots] == [(f, c) for f in range(5) for c in range(2)]
    assert {s.path.stem for s in less.shots if s.camera == 1} == {"cam03"}
    assert less.test_cameras == {"cam00"}
    assert not capture.without_cameras({"cam00"}).test_cameras
    assert capture.without_cameras(set()).shots == capture.shots


def test_a_segment_counts_its_frames_from_0_and_shows_the_same_images(n3dv: Path) -> None:
    capture = open_capture(n3dv).with_holdout(2)  # 1 and 3
    segment = capture.segment(2, 3)
    assert segment.frame_count == 3
    assert [(s.frame, s.index) for s in segment.shots if s.camera == 1] == [(0, 2), (1, 3), (2, 4)]
    assert segment.test_frames == {1} and len(segment.cameras) == 3
    path = tuple(Shot(index, index, Path("x"), 0) for index in range(3))  # of a moving camera
    moving = replace(capture, shots=path, frame_count=3).segment(1, 2)
    assert [camera.name for camera in moving.cameras] == ["cam01", "cam03"]
    assert [(s.frame, s.camera) for s in moving.shots] == [(0, 0), (1, 1)]


def test_the_time_of_an_image_counts_by_how_much_it_was_late(n3dv: Path) -> None:
    capture = open_capture(n3dv)  # frames 0 to 4
    shot = capture.shots[capture.shot_index(1, 2)]
    assert capture.time_of(shot) == 0.5
    assert capture.time_of(replace(shot, offset=0.25)) == 2.25 / 4
    assert capture.time_of(replace(shot, frame=0, offset=-0.5)) == 0
    assert capture.time_of(replace(shot, frame=4, offset=0.5)) == 1
    one = replace(capture, shots=(replace(shot, frame=0, offset=0.3),), frame_count=1)
    assert one.time_of(one.shots[0]) == 0


def test_a_segment_has_no_images_beside_its_frames(n3dv: Path) -> None:
    capture = open_capture(n3dv)
    for offset, frames in ((0.25, [0, 1]), (-0.25, [1, 2]), (0.0, [0, 1, 2])):
        shots = tuple(replace(shot, offset=offset) for shot in capture.shots)
        segment = replace(capture, shots=shots).segment(1, 3)
        assert [shot.frame for shot in segment.shots if shot.camera == 1] == frames
        assert len(segment.cameras) == 3 and segment.frame_count == 3
        one = replace(capture, shots=shots).segment(2, 1)
        assert len(one.shots) == 3, "one frame is one time"


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda capture: capture.with_holdout(1), "cannot be held out"),
        (lambda capture: capture.scaled(float("nan")), "scale"),
        (lambda capture: capture.scaled(0.01), "leaves 1 x 0 pixels"),
        (lambda capture: capture.with_pixel_offsets({"cam02": (8, 0)}), r"'cam02'.*cam00, cam01, cam03"),
        (lambda capture: capture.without_cameras({"cam02"}), "cam02 cannot be left out, expected some of cam00"),
        (lambda capture: capture.without_cameras({"cam00", "cam01", "cam03"}), "all 3 cameras"),
        (lambda capture: capture.segment(3, 3), "expected some of 0 to 4"),
        (lambda capture: capture.segment(0, 0), "expected some of 0 to 4"),
    ],
)
def test_what_makes_no_sense_is_refused(n3dv: Path, change: Callable[[Capture], Capture], sentence: str) -> None:
    refused(sentence, change, open_capture(n3dv))
