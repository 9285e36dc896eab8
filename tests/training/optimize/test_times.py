"""Images that were taken between frames are compared with the scene as it was then."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
from support import synthetic_capture as film
from support.builders import scene_file

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.evaluation.evaluate import TrueImages, evaluate_images
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.options import JobOptions
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.rasterizer import RasterizeOptions
from frog_blender.engine.recipes import Recipe
from frog_blender.engine.training.compression.sensitivity import sample_views
from frog_blender.engine.training.optimize.trainer import Trainer

LATE = 0.25  # frames


@pytest.fixture
def late(capture: Capture) -> Capture:
    return replace(capture, shots=tuple(replace(shot, offset=LATE) for shot in capture.shots))


def time_of(frame: float) -> float:
    return min(frame, film.FRAMES - 1) / (film.FRAMES - 1)


def test_training_draws_the_scene_as_it_was(
    lively: Callable[..., Recipe], late: Capture, store: FrameStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    trainer = Trainer(late, store, film.seeds(), lively(20), JobOptions(steps=20))
    times: list[float] = []
    draw = trainer.model.draw

    def drawn(time: float, *arguments: Any, **options: Any) -> Any:
        times.append(time)
        return draw(time, *arguments, **options)

    monkeypatch.setattr(trainer.model, "draw", drawn)
    shots = late.train_indices[:5]
    for shot in shots:
        trainer.draw(shot, 1.0, RasterizeOptions())
    assert times == [time_of(late.shots[shot].frame + LATE) for shot in shots]
    played: list[float] = []

    def still(time: float) -> Any:
        played.append(time)
        return trainer.model.canonical.gaussians(), {}

    monkeypatch.setattr(trainer, "deform", still)
    for shot in shots:
        trainer.render_image(shot, 16)
    assert played == times


def test_what_is_seen_is_sampled_around_the_times_of_the_images(late: Capture) -> None:
    shots = [index for index, shot in enumerate(late.shots) if shot.frame == 3]
    views = sample_views(late, shots, 400, torch.Generator().manual_seed(0))
    times = [view.time * (film.FRAMES - 1) for view in views]
    assert 3.25 - 0.5 <= min(times) < 2.8 and 3.7 < max(times) <= 3.25 + 0.5


def test_evaluation_draws_the_scene_as_it_was(
    late: Capture, store: FrameStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    times: list[float] = []
    at = ScenePlayer.at

    def recorded(scene: ScenePlayer, time: float, *arguments: Any) -> Any:
        times.append(time)
        return at(scene, time, *arguments)

    scene = ScenePlayer(scene_file())
    header = replace(scene.header, cameras=late.cameras, test_cameras=tuple(late.test_cameras), test_frames=())
    scene.header = replace(header, camera_shots=((),) * len(late.cameras), frame_count=late.frame_count)
    monkeypatch.setattr(ScenePlayer, "at", recorded)
    evaluate_images(scene, TrueImages(late, store), split="held-out")
    assert times == [time_of(shot.frame + LATE) for shot in late.test_shots]
