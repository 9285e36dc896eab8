"""A drawing is freed with its image: training draws thousands."""

from __future__ import annotations

import gc
import weakref

import torch

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.native import binding
from frog_blender.engine.rasterizer import GaussianArrays, rasterize


def test_frames_are_freed_after_the_backward_pass(monkeypatch):
    frames: list[weakref.ref] = []
    made = binding.Frame.__init__

    def remember(self, *arguments, **keywords):
        made(self, *arguments, **keywords)
        frames.append(weakref.ref(self))

    monkeypatch.setattr(binding.Frame, "__init__", remember)
    camera = Camera("c", 20, 16, [[20, 0, 10], [0, 20, 8], [0, 0, 1]], torch.eye(4).numpy())
    means = torch.tensor([[0.0, 0.0, 2.0]], requires_grad=True)
    gaussians = GaussianArrays(
        means, torch.tensor([[1.0, 0, 0, 0]]), torch.full((1, 3), 0.1), torch.tensor([0.9]), torch.ones(1, 1, 3)
    )
    gc.disable()  # a cycle through a torch operation would not be collected anyway
    try:
        for _ in range(3):
            image = rasterize(gaussians, camera)
            image.rgb.sum().backward()
        del image
        assert len(frames) == 3
        assert [frame() for frame in frames] == [None] * 3
    finally:
        gc.enable()
