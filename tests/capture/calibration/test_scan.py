"""Standing cameras that share nothing, and a walk-through that connects them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from frog_blender.engine.capture.calibration.child_process import CalibrationCancelled
from frog_blender.engine.capture.calibration.films import Film
from frog_blender.engine.capture.calibration.pipeline import Options, calibrate
from frog_blender.engine.capture.calibration.scan import walk_throughs
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.video import VideoFacts
from frog_blender.engine.errors import FrogError

from .walls import FOCAL, camera, center_errors, film, image

pytest.importorskip("pycolmap")
APART = [
    camera("left", (-2.3, -0.2, -0.9), (-2.2, 0.1, 2.5)),
    camera("middle", (-0.5, -0.5, -1.6), (-1.0, 0.0, 1.6)),
    camera("right", (1.7, -0.3, -1.0), (1.5, 0.1, 1.5)),
]
"""Neighbours see next to nothing of the same things; the left one and the right one nothing at all."""
SCAN = [
    camera("scan", (-2.3 + 0.17 * i, -0.3 + 0.15 * np.sin(i / 2), -1.6 + 0.3 * np.cos(i / 4)), (-2 + 0.15 * i, 0, 2.2))
    for i in range(26)
]


@pytest.fixture(scope="module")
def footage(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scanned")
    for each in APART:
        film(folder / f"{each.name}.mp4", [image(each)] * 6)
    film(folder / "Scan.mp4", [image(each) for each in SCAN])
    return folder


@pytest.fixture(scope="module")
def out(footage: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out")
    outcome = calibrate(footage, Options(out=out, in_step=True), lambda *_: None, lambda: False)
    assert not any("failed" in warning for warning in outcome.warnings)
    return out


def test_a_walk_through_connects_cameras_that_share_nothing(out: Path) -> None:
    capture = open_capture(out)
    assert [each.name for each in capture.cameras] == ["left", "middle", "right"]
    assert center_errors(list(capture.cameras), APART).max() < 0.02
    assert abs(capture.cameras[0].intrinsics[0, 0] / FOCAL - 1) < 0.02
    assert '"source": "a walk-through"' in (out / "calibration_report.json").read_text()
