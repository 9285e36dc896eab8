"""Cameras that are exposed otherwise than their neighbours."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from support import synthetic_capture as film
from support.image_stores import ImageStore
from support.training_steps import train

from frog_blender.engine.capture.camera import NEUTRAL
from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.playback.render import draw
from frog_blender.engine.rasterizer import GaussianArrays, rasterize
from frog_blender.engine.training.optimize import camera_refinement
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session.checkpoint import restore, state_of

FACTORS = {"cam01": (0.7, 0.7, 0.7), "cam02": (1.0, 1.0, 1.0), "cam03": (0.8, 0.9, 0.7)}
"""Of the training cameras of ``filmed``; nothing becomes brighter than white by them."""
MEDIAN = np.median(list(FACTORS.values()), axis=0)
"""How bright the scene will be; the held-out camera is exposed so."""


class Exposed(ImageStore):
    """A store of images that each camera exposed otherwise."""

    def __init__(self, store: FrameStore, capture: Capture) -> None:
        self._store, self._capture = store, capture

    def image(self, index: int) -> np.ndarray:
        name = self._capture.cameras[self._capture.shots[index].camera].name
        exposed = self._store.image(index) * np.array(FACTORS.get(name, MEDIAN))
        return exposed.round().clip(0, 255).astype(np.uint8)


@pytest.fixture
def exposed(store: FrameStore, capture: Capture) -> Exposed:
    return Exposed(store, capture)


def found_by(trainer: Trainer) -> dict[str, tuple[float, float, float]]:
    return {camera.name: camera.exposure for camera in trainer.capture.cameras}


def test_exposures_are_found_and_the_scene_gains(make_trainer: Callable[..., Trainer], exposed: Exposed) -> None:
    plain = train(make_trainer(300, watched=exposed, exposure_from=1.0))
    assert set(found_by(plain).values()) == {NEUTRAL}
    trainer = train(make_trainer(300, watched=exposed))
    found = found_by(trainer)
    assert found.pop("cam00") == NEUTRAL
    for name, factors in found.items():
        np.testing.assert_allclose(factors, np.array(FACTORS[name]) / MEDIAN, rtol=0.1)
    np.testing.assert_allclose(np.median(list(found.values()), axis=0), 1.0, rtol=1e-9)
    assert trainer.evaluate(4)[0] > plain.evaluate(4)[0] + 1.0


def test_what_matches_say_is_there_before_the_first_step(
    make_trainer: Callable[..., Trainer], monkeypatch: pytest.MonkeyPatch
) -> None:
    said = {1: np.array([0.5, 0.5, 0.4]), 2: np.array([1.5, 1.0, 1.0]), 3: np.array([100.0, 1.0, 1.0])}
    monkeypatch.setattr(camera_refinement, "matched_exposures", lambda capture, store: said)
    found = found_by(make_trainer(20))
    assert found["cam00"] == NEUTRAL
    np.testing.assert_allclose(found["cam01"], said[1])
    np.testing.assert_allclose(found["cam02"], said[2])
    np.testing.assert_allclose(found["cam03"], (4.0, 1.0, 1.0))
    assert set(found_by(make_trainer(20, exposure_from=1.0)).values()) == {NEUTRAL}


def test_a_resume_has_the_same_exposures(make_trainer: Callable[..., Trainer], exposed: Exposed) -> None:
    one, other = (make_trainer(60, watched=exposed) for _ in range(2))
    train(one, until=30)
    restore(other, state_of(one))
    assert found_by(other) == found_by(one) != found_by(make_trainer(60))
    train(one, until=40)
    train(other, until=40)
    assert found_by(one) == found_by(other)


def test_drawings_and_their_gradients_are_multiplied(capture: Capture) -> None:
    arrays, camera = film.gaussians_at(0), capture.cameras[1]
    brighter = camera.with_exposure((1.5, 1.0, 0.5))
    gradients = []
    for each, by in ((camera, (1.5, 1.0, 0.5)), (brighter, (1.0, 1.0, 1.0))):
        scene = GaussianArrays(*[torch.from_numpy(np.float32(value)) for value in vars(arrays).values()])
        scene.sh.requires_grad_()
        rgb = rasterize(scene, each, (0.1, 0.2, 0.3)).rgb * torch.tensor(by)
        rgb.square().sum().backward()
        gradients.append((rgb.detach(), scene.sh.grad))
    for one, two in zip(*gradients, strict=True):
        torch.testing.assert_close(one, two)
    np.testing.assert_array_equal(draw(arrays, brighter, (0.1, 0.2, 0.3)).rgb, gradients[1][0].numpy())
