"""Cameras of a rig that the tests film: found, refused, continued, cancelled."""

from pathlib import Path

import numpy as np
import pytest

from frog_blender.engine.capture.calibration.model import Calibration
from frog_blender.engine.capture.calibration.placing import place_standing
from frog_blender.engine.capture.calibration.views import View
from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.capture.synchronization.films import CalibrationRefused, Run

from .rigs import rig_errors
from .walls import FOCAL, kept, rig, run_in, view

pytest.importorskip("pycolmap")


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("stages")


def place(run: Run, cameras: list[Camera], views: list[View] | None = None) -> Calibration:
    seen = kept(run, cameras, views or [view(camera) for camera in cameras])
    return run.in_child(place_standing, seen, (), run.work)


@pytest.fixture(scope="module")
def found(work: Path) -> Calibration:
    return place(run_in(work), rig())


def test_the_rig_is_found_upright_with_points_before_its_cameras(found: Calibration) -> None:
    cameras = [known.camera for known in found.cameras]
    assert rig_errors(cameras, rig())[0] < 0.5
    assert abs(cameras[0].intrinsics[0, 0] / FOCAL - 1) < 0.01
    assert [camera.name for camera in cameras] == [camera.name for camera in rig()]
    up = np.mean([-known.camera.rotation[1] for known in found.cameras], axis=0)
    ahead = np.mean([known.camera.forward for known in found.cameras], axis=0)
    assert up[2] > 0.98 and ahead[1] > 0.9 and abs(ahead[0]) < 0.01
    assert len(found.points) > 100
    assert all((known.camera.project(found.points)[1] > 0).mean() > 0.95 for known in found.cameras)
    assert all(abs(k) < 0.02 for known in found.cameras for k in known.distortion), (
        "none is believed where there is none"
    )


def test_a_second_run_continues_and_makes_damaged_stages_again(found: Calibration, work: Path) -> None:
    lasting = {path: path.stat().st_mtime_ns for path in work.glob("*.npz") if not path.name.startswith("view")}
    assert {path.name.split("-")[0] for path in lasting} == {"features", "pairs"}
    damaged, stages = next(work.glob("features-*.npz")), set[str]()
    damaged.write_bytes(b"PK\x03\x04 cut off")
    again = place(run_in(work, stages), rig())
    assert "matches" not in stages and damaged.stat().st_size > 1000
    del lasting[damaged]
    assert all(path.stat().st_mtime_ns == kept_at for path, kept_at in lasting.items())
    for one, other in zip(found.cameras, again.cameras, strict=True):
        assert np.allclose(one.camera.world_to_camera, other.camera.world_to_camera, atol=1e-3)


def test_cameras_of_another_room_are_refused_by_name(tmp_path: Path) -> None:
    views = [view(camera, 1 if index < 3 else 50) for index, camera in enumerate(rig())]
    with pytest.raises(CalibrationRefused, match=r"cam3 and cam4 share no points .* Next time") as refused:
        place(run_in(tmp_path), rig(), views)
    assert "cam0-cam1 (" in str(refused.value)
