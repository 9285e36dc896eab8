"""The reference's gradients against finite differences in float64, away from the blending rule's thresholds."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from support.builders import ATTRIBUTES, odd_camera, random_gaussians
from support.torch_drawing import BACKGROUND, image_weights, relative_error

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.rasterizer import GaussianArrays, rasterize

STEP = 1e-6


def loss_of(gaussians: GaussianArrays, camera: Camera) -> torch.Tensor:
    image = rasterize(gaussians, camera, BACKGROUND, backend="reference")
    by_rgb, by_alpha = image_weights(camera)
    return (image.rgb * by_rgb).sum() + (image.alpha * by_alpha).sum()


def analytic(gaussians: GaussianArrays, camera: Camera) -> dict[str, np.ndarray]:
    leaves = GaussianArrays(*[torch.tensor(getattr(gaussians, name), requires_grad=True) for name in ATTRIBUTES])
    loss_of(leaves, camera).backward()
    return {name: getattr(leaves, name).grad.numpy() for name in ATTRIBUTES}


def differences(gaussians: GaussianArrays, camera: Camera, name: str) -> np.ndarray:
    """Central differences of the loss by every number of one attribute."""
    values = {other: torch.tensor(getattr(gaussians, other)) for other in ATTRIBUTES}
    result = np.zeros(values[name].numel())
    for i in range(len(result)):
        for sign in (1, -1):
            moved = dict(values, **{name: values[name].clone()})
            moved[name].view(-1)[i] += sign * STEP
            result[i] += sign * loss_of(GaussianArrays(**moved), camera).item() / (2 * STEP)
    return result.reshape(values[name].shape)


def scene(camera: Camera, degree: int) -> GaussianArrays:
    """Six overlapping Gaussians, bright enough that no colour is clamped at black."""
    gaussians = random_gaussians(camera, 6, degree, seed=3, opacity=(0.4, 0.9))
    gaussians.sh[:, 0] += 1.0
    gaussians.scales *= 2
    return gaussians


@pytest.mark.parametrize("degree", [0, 3])
def test_every_attribute(degree: int) -> None:
    camera = odd_camera(17, 11)
    gaussians = scene(camera, degree)
    for name, found in analytic(gaussians, camera).items():
        expected = differences(gaussians, camera, name)
        assert np.abs(expected.reshape(len(expected), -1)).max(1).min() > 1e-3, "each Gaussian matters"
        assert relative_error(found, expected) < 1e-6, name


def test_gaussians_beside_the_image_where_the_linearisation_is_clamped() -> None:
    camera = odd_camera(17, 11)
    gaussians = scene(camera, 1)
    local = gaussians.means @ camera.rotation.T + camera.world_to_camera[:3, 3]
    local[:3, 0] = local[:3, 2] * (1.4 * camera.width - camera.intrinsics[0, 2]) / camera.intrinsics[0, 0]
    local[3:, 1] = local[3:, 2] * (-0.4 * camera.height - camera.intrinsics[1, 2]) / camera.intrinsics[1, 1]
    gaussians.means = (local - camera.world_to_camera[:3, 3]) @ camera.rotation
    gaussians.scales *= 2
    for name, found in analytic(gaussians, camera).items():
        expected = differences(gaussians, camera, name)
        assert np.abs(expected).max() > 1e-3
        assert relative_error(found, expected) < 1e-6, name
