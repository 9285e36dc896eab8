"""Gaussians are kept small where nothing says how deep they are."""

from __future__ import annotations

import numpy as np
import torch
from support import synthetic_capture as film

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.model.canonical import CanonicalField, new_gaussians
from frog_blender.engine.training.optimize.gaussian_state import add_size_gradient, limit_sizes


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


def test_no_axis_is_longer_than_a_share_of_the_distance_to_the_nearest_training_camera(capture: Capture) -> None:
    canonical = canonical_field()
    trained = sorted({shot.camera for shot in capture.train_shots})
    assert len(trained) < len(capture.cameras)  # one is held out, and says nothing
    centers = np.array([capture.cameras[index].center for index in trained])
    means = canonical.means.detach().numpy()
    nearest = np.linalg.norm(means[:, None] - centers[None], axis=2).min(1)
    before = canonical.log_scales.detach().exp().numpy().copy()
    wanted = np.minimum(before, 0.02 * nearest[:, None])
    assert (wanted < before).any() and (wanted == before).any()
    limit_sizes(canonical, capture, 0.02, 1e-3)
    np.testing.assert_allclose(canonical.log_scales.detach().exp().numpy(), wanted, rtol=1e-5)


def test_what_lies_in_a_camera_keeps_a_size(capture: Capture) -> None:
    canonical = canonical_field()
    camera = capture.cameras[capture.train_shots[0].camera]
    canonical.means.data[0] = torch.from_numpy(camera.center).float()
    limit_sizes(canonical, capture, 0.1, 0.5)
    sizes = canonical.log_scales.detach()[0].exp()
    assert (sizes > 0).all() and (sizes <= 0.05 + 1e-6).all()
