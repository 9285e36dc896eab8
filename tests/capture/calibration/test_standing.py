"""Cameras of a rig that the tests film: found, refused, continued, cancelled."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from frog_blender.engine.capture.calibration.calibration import Calibration, CalibrationRefused
from frog_blender.engine.capture.calibration.placing import Run, place_views
from frog_blender.engine.capture.calibration.work_folder import WorkFolder

from .walls import FOCAL, camera, center_errors, distorted_view, rig, view

pytest.importorskip("pycolmap")


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> WorkFolder:
    return WorkFolder(tmp_path_factory.mktemp("stages"))


@pytest.fixture(scope="module")
def found(work: WorkFolder) -> Calibration:
    return place_views([view(camera) for camera in rig()], Run(work, lambda *_: None, lambda: False))


def test_the_rig_is_found(found: Calibration) -> None:
    cameras = [each.camera for each in found.cameras]
    assert center_errors(cameras, rig()).max() < 0.005
    assert abs(cameras[0].intrinsics[0, 0] / FOCAL - 1) < 0.01
    assert [camera.name for camera in cameras] == ["cam0", "cam1", "cam2", "cam3", "cam4"]


def test_the_world_stands_upright(found: Calibration) -> None:
    up = np.mean([-each.camera.rotation[1] for each in found.cameras], axis=0)
    ahead = np.mean([each.camera.forward for each in found.cameras], axis=0)
    assert up[2] > 0.98
    assert ahead[1] > 0.9 and abs(ahead[0]) < 0.01


def test_points_lie_before_the_cameras(found: Calibration) -> None:
    assert len(found.points) > 100
    for each in found.cameras:
        _, depths = each.camera.project(found.points)
        assert (depths > 0).mean() > 0.95


def test_no_distortion_is_believed_where_there_is_none(found: Calibration) -> None:
    assert all(abs(k) < 0.02 for each in found.cameras for k in each.distortion)


def test_a_second_run_continues(found: Calibration, work: WorkFolder) -> None:
    kept = {path: path.stat().st_mtime_ns for path in work.path.glob("*.npz")}
    assert {path.name.split("-")[0] for path in kept} == {"view", "features", "pairs"}
    stages = set()
    again = place_views(
        [view(camera) for camera in rig()], Run(work, lambda stage, *_: stages.add(stage), lambda: False)
    )
    assert "matches" not in stages
    assert {path: path.stat().st_mtime_ns for path in work.path.glob("*.npz")} == kept
    for one, other in zip(found.cameras, again.cameras, strict=True):
        assert np.allclose(one.camera.world_to_camera, other.camera.world_to_camera, atol=1e-3)


def test_damaged_stages_are_made_again(found: Calibration, work: WorkFolder) -> None:
    damaged = [next(work.path.glob(f"{stage}-*.npz")) for stage in ("view", "features", "pairs")]
    for path in damaged:
        path.write_bytes(b"PK\x03\x04 cut off")
    place_views([view(camera) for camera in rig()], Run(work, lambda *_: None, lambda: False))
    assert all(path.stat().st_size > 1000 for path in damaged)


def test_cameras_of_another_room_are_refused_by_name(tmp_path: Path) -> None:
    views = [view(camera, 1 if index < 3 else 50) for index, camera in enumerate(rig())]
    with pytest.raises(CalibrationRefused, match=r"cam3 and cam4 share no points .* Next time") as refused:
        place_views(views, Run(WorkFolder(tmp_path), lambda *_: None, lambda: False))
    assert "cam0-cam1 (" in str(refused.value)


def test_two_cameras_prove_nothing(tmp_path: Path) -> None:
    with pytest.raises(CalibrationRefused, match="a single pair proves nothing"):
        place_views([view(camera) for camera in rig()[:2]], Run(WorkFolder(tmp_path), lambda *_: None, lambda: False))


def test_distortion_is_found_where_there_is_some(tmp_path: Path) -> None:
    cameras = rig()[:4]
    views = [distorted_view(each, -0.2) for each in cameras]
    found = place_views(views, Run(WorkFolder(tmp_path), lambda *_: None, lambda: False))
    assert all(abs(each.distortion[0] + 0.2) < 0.02 for each in found.cameras)
    assert center_errors([each.camera for each in found.cameras], cameras).max() < 0.005
    assert abs(found.cameras[0].camera.intrinsics[0, 0] / FOCAL - 1) < 0.01


def test_a_rig_that_does_not_fix_its_focal_length_is_refused(tmp_path: Path) -> None:
    """All cameras look the same way: nearly any focal length explains them."""
    line = [camera(f"cam{i}", (-1.2 + 0.6 * i, 0, -3.3), (-1.2 + 0.6 * i, 0, 10)) for i in range(4)]
    with pytest.raises(CalibrationRefused, match="focal length"):
        place_views([view(each) for each in line], Run(WorkFolder(tmp_path), lambda *_: None, lambda: False))
