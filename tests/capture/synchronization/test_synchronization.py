"""The answer in JSON and back, and its picture."""

from __future__ import annotations

import json

import numpy as np
import pytest

from frog_blender.engine.capture.synchronization.pairs import Curve
from frog_blender.engine.capture.synchronization.synchronization import (
    CameraClock,
    RunnerUp,
    Synchronization,
    draw_curves,
    read_synchronization,
)
from frog_blender.engine.io.plain_values import UnfitValue, plain


def answer() -> Synchronization:
    lags = np.linspace(-1, 1, 41)
    scores = np.exp(-((lags - 0.25) ** 2) / 0.01)
    scores[3] = np.nan
    clock = CameraClock("cam01", 0.25, 1.001, 0.9, ("audio", "motion"), RunnerUp(-0.5, 0.95), Curve(lags, scores))
    other = CameraClock("cam02", 0.0, 1.0, 0.2, (), None, Curve())
    return Synchronization((clock, other), 1 / 30, 0.0004, ("A warning.",), "A refusal.")


def test_json_and_back() -> None:
    before = answer()
    after = read_synchronization(json.loads(json.dumps(plain(before), allow_nan=False)))
    assert after.clocks == before.clocks
    assert after.warnings == before.warnings and after.refusal == before.refusal
    assert after.cameras[0].runner_up == before.cameras[0].runner_up
    assert after.cameras[0].sources == ("audio", "motion")
    np.testing.assert_array_equal(after.cameras[0].curve.scores, before.cameras[0].curve.scores)


@pytest.mark.parametrize(
    ("where", "value"),
    [
        (("frame",), 0),
        (("cameras", 0), None),
        (("cameras", 0, "offset"), 1e8),
        (("cameras", 0, "rate"), 0.0),
        (("cameras", 0, "confidence"), 1.5),
        (("cameras", 0, "runner_up"), {"offset": 1e300, "share": 1}),
        (("cameras", 0, "curve"), {"lags": [0.0], "scores": [0.0, 1.0]}),
        (("cameras", 0, "curve"), {"lags": [None], "scores": [0.0]}),
    ],
)
def test_damaged_json_is_refused(where: tuple[str | int, ...], value: object) -> None:
    data = plain(answer())
    inner = data
    for key in where[:-1]:
        inner = inner[key]  # type: ignore[index, assignment]
    inner[where[-1]] = value  # type: ignore[index]
    with pytest.raises(UnfitValue):
        read_synchronization(data)


def test_the_picture_marks_the_offset_and_its_rival() -> None:
    image = draw_curves(answer(), width=600)
    assert image.shape == (192, 600, 3)
    green = (image == (30, 150, 70)).all(axis=-1)[:96].any(axis=0)
    orange = (image == (200, 120, 40)).all(axis=-1)[:96].any(axis=0)
    assert np.flatnonzero(green).mean() > np.flatnonzero(orange).mean()
    assert not (image == (30, 150, 70)).all(axis=-1)[96:].any()
