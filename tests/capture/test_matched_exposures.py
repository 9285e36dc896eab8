"""Exposures from what two cameras see at one time."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.seeding.exposures import matched_exposures
from frog_blender.engine.frames.store import FrameStore

HALL = Path(__file__).resolve().parents[2] / "examples" / "captures" / "fast"
"""Cameras that are alike, of which the first is held out."""


class Exposed:
    """A store of images that each camera exposed otherwise; a held-out one must not be asked for."""

    def __init__(self, store: FrameStore, capture: Capture, factors: np.ndarray) -> None:
        self._store, self._capture, self._factors = store, capture, factors

    def image(self, index: int) -> np.ndarray:
        shot = self._capture.shots[index]
        assert not self._capture.is_test(shot)
        exposed = self._store.image(index) * self._factors[shot.camera]
        return exposed.round().clip(0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def hall(tmp_path_factory: pytest.TempPathFactory) -> tuple[Capture, FrameStore]:
    capture = open_capture(HALL)
    return capture, FrameStore.open(capture, cache_folder=tmp_path_factory.mktemp("cache"))


@pytest.mark.parametrize("spread", [0.05, 0.2])
def test_exposures_of_a_rig_are_found(hall: tuple[Capture, FrameStore], spread: float) -> None:
    """Whose cameras of one kind differ by a twentieth, or of many kinds."""
    capture, store = hall
    factors = np.exp(np.random.default_rng(3).normal(0, spread, (len(capture.cameras), 3)))
    factors /= factors.max(axis=0)  # nothing becomes brighter than white
    exposures = matched_exposures(capture, Exposed(store, capture, factors))
    assert exposures is not None and list(exposures) == capture.train_cameras
    expected = factors[capture.train_cameras]
    expected = expected / np.median(expected, axis=0)
    np.testing.assert_allclose(list(exposures.values()), expected, rtol=0.03)


def test_cameras_that_are_alike_have_none(hall: tuple[Capture, FrameStore]) -> None:
    assert matched_exposures(*hall) is None


def test_cameras_without_common_features_have_none(hall: tuple[Capture, FrameStore]) -> None:
    """Each filmed at times of its own."""
    capture, store = hall
    apart = replace(capture, shots=tuple(shot for shot in capture.shots if shot.frame % 12 == shot.camera))
    dark = np.linspace(0.3, 1, len(capture.cameras))[:, None].repeat(3, axis=1)
    assert matched_exposures(apart, Exposed(store, apart, dark)) is None
