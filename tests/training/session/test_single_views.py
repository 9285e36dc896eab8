"""An object photographed once at each moment: what is learned of it holds from other sides."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from support import turning_object

from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.evaluation.evaluate import TrueImages, evaluate_images
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.recipes import recipe
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import run_training

_MOST_LOST = 3.0  # dB between images that are learned from and others


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "cache"))
    yield tmp_path / "cache"


@pytest.mark.slow
def test_one_image_a_camera_generalises(tmp_path: Path, cache: Path) -> None:
    folder = turning_object.write_capture(tmp_path / "object")
    capture = open_capture(folder)
    assert capture.has_moving_cameras and len(capture.train_shots) == turning_object.IMAGES
    settings = recipe("standard", capacity="auto", max_gaussians=3000, seed_gaussians=2500)
    output = tmp_path / "object.frog"
    for _ in run_training(TrainingJob(folder, output, recipe=settings, steps=800, device="cpu")):
        pass
    store, scene = FrameStore.open(capture), ScenePlayer.load(output)
    learned = evaluate_images(scene, TrueImages(capture, store), split="training")["psnr"]
    other = evaluate_images(scene, TrueImages(capture, store), split="held-out")["psnr"]
    assert learned > 30.0  # far above an image of the background, which has 14
    assert other > learned - _MOST_LOST
