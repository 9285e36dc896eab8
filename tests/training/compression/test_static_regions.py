"""What does not move: seen before the first step, told from what does, and shown in the image of a scene's capacity."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from support import synthetic_capture as film
from support.image_stores import ImageStore
from support.training_steps import MakeJob, train

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.options import JobOptions
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.recipes import Recipe
from frog_blender.engine.training.compression.passes import is_static_capture
from frog_blender.engine.training.compression.schedule import CompressionSchedule
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session.run import run_training


class Repeated(ImageStore):
    """A store whose images are a camera's first, with noise; ``moved`` pixels of one frame differ."""

    def __init__(self, capture: Capture, noise: float, moved: int = 0) -> None:
        self._capture, self._noise, self._moved = capture, noise, moved

    def image(self, index: int) -> np.ndarray:
        shot = self._capture.shots[index]
        image = film.image(self._capture.cameras[shot.camera], 0).astype(float)
        image += np.random.default_rng(index).normal(0, self._noise, image.shape)
        if self._moved and shot.frame == 3:
            image[10 : 10 + self._moved, 20 : 20 + self._moved] = 255 - image[10, 20]
        return image.round().clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize("noise", [0.0, 1.5, 4.0])
def test_static_captures_are_found_through_noise(capture: Capture, noise: float) -> None:
    assert is_static_capture(capture, Repeated(capture, noise))
    assert not is_static_capture(capture, Repeated(capture, noise, moved=4))


@pytest.mark.parametrize("kind", ["waves", "fade"])
def test_motion_everywhere_is_no_noise(capture: Capture, kind: str) -> None:
    class Everywhere:
        def image(self, index: int) -> np.ndarray:
            frame = capture.shots[index].frame
            x = np.arange(film.WIDTH) / film.WIDTH + frame / film.FRAMES
            row = 128 + 120 * np.sin(2 * np.pi * x) if kind == "waves" else np.full(film.WIDTH, 30.0 + 20 * frame)
            return np.tile(row[None, :, None], (film.HEIGHT, 1, 3)).astype(np.uint8)

    assert not is_static_capture(capture, Everywhere())


def test_one_moment_is_static_from_the_start(capture: Capture, lively: Callable[..., Recipe]) -> None:
    """Several cameras of one frame have no second image to compare with; the network is given nothing to do."""
    one_frame = capture.segment(0, 1)
    images = Repeated(one_frame, 0.0)
    assert is_static_capture(one_frame, images)
    settings = lively(4, capacity="auto")
    trainer = Trainer(one_frame, images, film.seeds(), settings, JobOptions())
    trainer.add_hook(CompressionSchedule())
    assert trainer.gaussians.num_dynamic == 0 < trainer.count
    before = {name: value.clone() for name, value in trainer.model.deformation.state_dict().items()}
    train(trainer)
    assert all(torch.equal(value, before[name]) for name, value in trainer.model.deformation.state_dict().items())


@pytest.mark.parametrize(("cameras", "frames"), [(4, 4), (2, 3), (1, 1)])
def test_a_short_event_is_seen_by_some_camera(capture: Capture, cameras: int, frames: int) -> None:
    """Of 240 frames, all cameras together look at each."""
    capture = film.longer(capture, 240)
    capture = replace(capture, shots=tuple(s for s in capture.shots if s.camera < cameras), test_cameras=frozenset())

    class Short(Repeated):
        def image(self, index: int) -> np.ndarray:
            image = super().image(index)
            if 100 <= capture.shots[index].frame < 100 + frames:
                image[10:20, 10:20] = 255 - image[10:20, 10:20]
            return image

    assert not is_static_capture(capture, Short(capture, 1.0))


class OfStillImages(Trainer):
    """Whatever it is given to train on."""

    def __init__(self, capture: Capture, store: FrameStore, *arguments: Any, **options: Any) -> None:
        super().__init__(capture, Repeated(capture, 1.5), *arguments, **options)


def test_a_still_scene_has_no_network_and_plays(make_job: MakeJob) -> None:
    task = make_job(60, {"holdout_frames": 0}, capacity="auto")
    finished = list(run_training(task, trainer_type=OfStillImages))[-1]
    assert finished.capacity["dynamic"] == 0
    scene = ScenePlayer.load(task.output)
    assert scene.num_dynamic == 0 and scene.header.model == {}
    np.testing.assert_array_equal(scene.at(0.2).means, scene.at(0.9).means)
