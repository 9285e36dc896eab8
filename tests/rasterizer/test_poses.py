"""Poses of the camera as tensors: where it stands, and their gradients."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from support.builders import ATTRIBUTES, odd_camera, random_gaussians, rotation_of
from support.torch_drawing import BACKGROUND, draw_with_gradients, image_weights, relative_error

from frog_blender.engine.rasterizer import GaussianArrays, RasterizeOptions, rasterize

CAMERA = odd_camera(45, 27)
BACKENDS = pytest.mark.parametrize("backend", ["cpu", "reference"])


def moved() -> np.ndarray:
    """(4, 4) a pose a little off the camera's own."""
    pose = CAMERA.world_to_camera.copy()
    pose[:3, :3] = rotation_of((1.0, 0.2, -0.4), 0.06) @ pose[:3, :3]
    pose[:3, 3] += 0.05, -0.08, 0.1
    return pose


def few(degree: int) -> GaussianArrays:
    """Overlapping Gaussians, bright enough that no colour is clamped at black."""
    gaussians = random_gaussians(CAMERA, 6, degree, seed=3, opacity=(0.4, 0.9))
    gaussians.sh[:, 0] += 1.0
    gaussians.scales *= 2
    return gaussians


def reference_loss(gaussians: GaussianArrays, pose: torch.Tensor) -> torch.Tensor:
    leaves = GaussianArrays(*[torch.tensor(getattr(gaussians, name)) for name in ATTRIBUTES])
    image = rasterize(leaves, CAMERA, BACKGROUND, pose=pose, backend="reference")
    by_rgb, by_alpha = image_weights(CAMERA)
    return (image.rgb * by_rgb).sum() + (image.alpha * by_alpha).sum()


@pytest.mark.parametrize("degree", [0, 3])
def test_pose_gradient_of_the_reference_equals_finite_differences(degree: int) -> None:
    """Colour depends on the pose too, through the viewing direction."""
    gaussians, step = few(degree), 1e-6
    pose = torch.tensor(moved(), requires_grad=True)
    reference_loss(gaussians, pose).backward()
    expected = np.zeros((4, 4))
    with torch.no_grad():
        for entry in range(12):
            for sign in (1, -1):
                other = pose.detach().clone()
                other.view(-1)[entry] += sign * step
                change = sign * float(reference_loss(gaussians, other)) / (2 * step)
                expected.flat[entry] += change
    assert np.abs(expected[:3]).min() > 1e-3
    assert relative_error(pose.grad.numpy(), expected) < 1e-6


@pytest.mark.parametrize(
    ("rows", "options", "degree"), [(3, RasterizeOptions(), 3), (4, RasterizeOptions(region=(8, 3, 30, 20)), 0)]
)
def test_pose_gradient_equals_the_reference(rows: int, options: RasterizeOptions, degree: int) -> None:
    gaussians, pose = random_gaussians(CAMERA, 150, degree, seed=6), moved()[:rows]
    gaussians.scales[:20] *= 6  # reach in from where the linearisation is clamped
    image, found = draw_with_gradients(gaussians, CAMERA, "cpu", options=options, pose=pose)
    reference, expected = draw_with_gradients(gaussians, CAMERA, "reference", torch.float64, options, pose=pose)
    assert float((image.rgb - reference.rgb).detach().abs().max()) < 1e-5
    assert found["pose"].shape == (rows, 4) and not found["pose"][3:].any()
    for name, gradient in expected.items():
        assert relative_error(found[name], gradient) < 1e-5, name


@BACKENDS
def test_a_pose_is_where_the_camera_stands(backend: str) -> None:
    gaussians = random_gaussians(CAMERA, 80, 2, seed=6)
    everything = RasterizeOptions(depth=True)
    standing = draw_with_gradients(gaussians, CAMERA.with_pose(moved()), backend, options=everything)
    posed = draw_with_gradients(gaussians, CAMERA, backend, options=everything, pose=moved())
    for name in ("rgb", "alpha", "median_depth", "mean_depth"):
        found, expected = getattr(posed[0], name), getattr(standing[0], name)
        torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-5, equal_nan=True)
    elsewhere = draw_with_gradients(gaussians, CAMERA, backend)[0]
    assert float((elsewhere.rgb - posed[0].rgb).detach().abs().max()) > 0.1
