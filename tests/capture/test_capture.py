from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.errors import FrogError


def test_holding_out_frames_splits_every_camera_the_same_way(n3dv: Path) -> None:
    capture = open_capture(n3dv).with_holdout(2)
    assert capture.test_frames == {1, 3}
    assert {shot.frame for shot in capture.train_shots} == {0, 2, 4}
    assert all(capture.cameras[shot.camera].name != "cam00" for shot in capture.train_shots)
    assert len(capture.train_shots) + len(capture.test_shots) == len(capture.shots) == 15
    assert capture.with_holdout(0).test_frames == frozenset()


@pytest.mark.parametrize("every", [1, -3])
def test_a_holdout_that_leaves_nothing_is_refused(n3dv: Path, every: int) -> None:
    with pytest.raises(FrogError, match="cannot be held out"):
        open_capture(n3dv).with_holdout(every)


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


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan"), 0.01])
def test_a_senseless_scale_is_refused(n3dv: Path, scale: float) -> None:
    with pytest.raises(FrogError, match="scale"):
        open_capture(n3dv).scaled(scale)


def test_a_pixel_offset_moves_the_principal_point_back(n3dv: Path) -> None:
    plain, moved = open_capture(n3dv), open_capture(n3dv, pixel_offsets={"cam01": (8, -2.5)})
    assert moved.cameras[1].intrinsics[0, 2] == plain.cameras[1].intrinsics[0, 2] - 8
    assert moved.cameras[1].intrinsics[1, 2] == plain.cameras[1].intrinsics[1, 2] + 2.5
    assert moved.crops == ((0.0, 0.0), (8.0, -2.5), (0.0, 0.0))


def test_a_pixel_offset_for_nobody_is_refused(n3dv: Path) -> None:
    with pytest.raises(FrogError, match=r"'cam02'.*cam00, cam01, cam03"):
        open_capture(n3dv, pixel_offsets={"cam02": (8, 0)})


def test_only_pictures_at_different_moments_are_one_moving_camera(n3dv: Path) -> None:
    capture = open_capture(n3dv)
    one_moment = tuple(shot for shot in capture.shots if shot.frame == 0)
    along_a_path = tuple(replace(shot, frame=shot.camera) for shot in one_moment)
    assert not replace(capture, shots=one_moment, frame_count=1).is_moving
    assert replace(capture, shots=along_a_path).is_moving
