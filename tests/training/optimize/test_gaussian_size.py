"""Gaussians are kept small where nothing says how deep they are."""

from __future__ import annotations

import torch
from support import synthetic_capture as film

from frog_blender.engine.model.canonical import CanonicalField, new_gaussians
from frog_blender.engine.training.optimize.gaussian_size import add_size_gradient


def canonical_field() -> CanonicalField:
    points, colors = (torch.from_numpy(array) for array in (film.seeds().points, film.seeds().colors))
    spacings = torch.linspace(0.01, 0.3, len(points))
    return CanonicalField(new_gaussians(points, colors, spacings, 1, 0))


def test_the_gradient_is_that_of_the_mean_size() -> None:
    canonical, unit, weight = canonical_field(), 2.5, 0.3
    (wanted,) = torch.autograd.grad(weight * canonical.log_scales.exp().mean() / unit, canonical.log_scales)
    before = torch.randn_like(canonical.log_scales)
    canonical.log_scales.grad = before.clone()
    add_size_gradient(canonical, weight, unit)
    torch.testing.assert_close(canonical.log_scales.grad, before + wanted)


def test_a_step_that_saw_nothing_changes_nothing() -> None:
    canonical = canonical_field()
    add_size_gradient(canonical, 0.3, 1.0)
    assert canonical.log_scales.grad is None
