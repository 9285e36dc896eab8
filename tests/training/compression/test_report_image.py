"""The image of a scene's capacity."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from support.training_steps import compression, train

from frog_blender.engine.training.optimize.gaussian_state import freeze_motion
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session.pictures import draw_report_image


def test_the_image_tells_dynamic_from_static(make_trainer: Callable[..., Trainer]) -> None:
    trainer = make_trainer(60, capacity="auto")
    train(trainer, until=40)
    canonical = trainer.model.canonical

    def redness() -> float:
        red, _, blue = draw_report_image(compression(trainer), 8).astype(float).mean((0, 1))
        return red - blue

    image = draw_report_image(compression(trainer), 8)
    assert image.shape == (36, 48, 3) and image.dtype == np.uint8
    moving = redness()
    names = ("means", "quaternions", "log_scales", "opacity_logits", "sh")
    state = {name: getattr(canonical, name).detach().clone() for name in names}
    freeze_motion(trainer.gaussians, torch.arange(canonical.num_dynamic), state)
    assert moving > 10 > -10 > redness()
    resting = redness()
    compression(trainer).removed = canonical.means.detach().numpy() + 0.0
    assert redness() > resting + 1  # red dots
