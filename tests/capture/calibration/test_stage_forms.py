"""What an earlier run kept is taken for what it is, or not at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from frog_blender.engine.arrays import Array
from frog_blender.engine.capture.calibration.feature_task import arrays_of, view_of
from frog_blender.engine.capture.calibration.stage_forms import fits
from frog_blender.engine.capture.calibration.work_folder import WorkFolder

from .walls import rig, view


def features(count: int = 5) -> dict[str, Array]:
    return {
        "pixels": np.zeros((count, 2)),
        "descriptors": np.zeros((count, 128), np.uint8),
        "moments": np.zeros(count, np.int64),
    }


def test_what_was_kept_fits() -> None:
    assert fits("features", features()) and fits("features", features(0))
    assert fits("pairs", {"0 1": np.zeros((3, 2), np.int64), "0 1 verified": np.zeros((2, 2), np.int64)})
    assert fits("pairs", {}) and fits("view", arrays_of(view(rig()[0]))) and fits("another", {"x": np.zeros(1)})


@pytest.mark.parametrize(
    "changes",
    [
        {"pixels": np.zeros((4, 2))},
        {"pixels": np.zeros((5, 3))},
        {"pixels": np.zeros((5, 2), np.float32)},
        {"pixels": np.full((5, 2), np.inf)},
        {"descriptors": np.zeros(5, np.uint8)},
        {"more": np.zeros(1)},
    ],
)
def test_another_array_does_not_fit(changes: dict[str, Array]) -> None:
    assert not fits("features", features() | changes)


def test_a_missing_array_does_not_fit() -> None:
    kept = features()
    del kept["moments"]
    assert not fits("features", kept) and not fits("standing", {}) and not fits("pairs", {"a b": np.zeros((1, 2))})


def test_what_does_not_fit_is_not_loaded(tmp_path: Path) -> None:
    work = WorkFolder(tmp_path)
    work.keep("standing", "0", {"standing": np.array([True, False])})
    assert work.load("standing", "0") is None
    seen = view(rig()[0])
    work.keep("view", "0", arrays_of(seen))
    arrays = work.load("view", "0")
    assert arrays is not None
    again = view_of({"name": seen.name, "size": seen.size, "group": 0}, arrays)
    assert np.array_equal(again.plate, seen.plate)
