"""One camera that walks through a room that the tests draw."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from frog_blender.engine.capture.calibration.pipeline import Options, calibrate
from frog_blender.engine.capture.readers import open_capture

from .walls import FOCAL, camera, center_errors, image

pytest.importorskip("pycolmap")
WALK = [camera(f"{i:03d}", (-1.8 + 0.36 * i, 0.25 * np.sin(i), -3.0 - 0.1 * np.cos(i / 2))) for i in range(11)]


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("walk")
    (folder / "images").mkdir()
    for each in WALK:
        cv2.imwrite(str(folder / "images" / f"{each.name}.png"), image(each))
    return folder


def test_a_walk_becomes_a_capture(walked: Path, tmp_path: Path) -> None:
    outcome = calibrate(walked, Options(out=tmp_path), lambda *_: None, lambda: False)
    assert outcome.cameras == tmp_path / "transforms.json"
    capture = open_capture(tmp_path)
    assert capture.is_moving and capture.frame_count == len(WALK)
    ordered = [capture.cameras[shot.camera] for shot in capture.shots]
    assert center_errors(ordered, WALK).max() < 0.01
    assert abs(ordered[0].intrinsics[0, 0] / FOCAL - 1) < 0.02
    assert not (walked / "transforms.json").exists()
