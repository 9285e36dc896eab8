"""Baselines, trained: each follows what moves, goes on where it was stopped, and plays as it ended."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from support.training_steps import moving_psnr, train

from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session.checkpoint import load_checkpoint, save_checkpoint

BASELINES = ("d3dgs", "hexplane", "curves")
STEPS = 480  # 4DGaussians has found the ball by then, whatever the seed


@pytest.fixture(scope="module")
def static(make_trainer: Callable[..., Trainer]) -> Trainer:
    return train(make_trainer(STEPS, "static"))


@pytest.mark.parametrize(
    "method", ["curves", *(pytest.param(method, marks=pytest.mark.slow) for method in ("d3dgs", "hexplane"))]
)
def test_what_moves_is_followed(
    make_trainer: Callable[..., Trainer], store: FrameStore, static: Trainer, method: str
) -> None:
    """Static Gaussians can only smear the ball."""
    trained = train(make_trainer(STEPS, method))
    gains = [moving_psnr(trained, store, camera) - moving_psnr(static, store, camera) for camera in (0, 2)]
    assert min(gains) > 1.5


@pytest.mark.parametrize("method", BASELINES)
def test_a_stopped_training_goes_on_to_the_same_bits(
    make_trainer: Callable[..., Trainer], bits: Callable[[Trainer], dict[str, bytes]], tmp_path, method: str
) -> None:
    whole = train(make_trainer(30, method))
    stopped = train(make_trainer(30, method), until=13)
    save_checkpoint(tmp_path / "x", stopped)
    resumed = make_trainer(30, method)
    load_checkpoint(tmp_path / "x", resumed)
    assert bits(train(resumed)) == bits(whole)
