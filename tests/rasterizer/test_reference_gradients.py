"""The reference's gradients against finite differences in float64, away from the blending rule's thresholds."""

import numpy as np
import pytest
import torch
from support.builders import odd_camera, random_gaussians, rotation_of
from support.torch_drawing import BACKGROUND, image_weights, relative_error

from frog_blender.engine.rasterizer import GaussianArrays, rasterize

CAMERA = odd_camera(17, 11)
STEP = 1e-6

Leaves = dict[str, torch.Tensor]


def loss_of(leaves: Leaves) -> torch.Tensor:
    gaussians = GaussianArrays(**{name: leaf for name, leaf in leaves.items() if name != "pose"})
    image = rasterize(gaussians, CAMERA, BACKGROUND, pose=leaves["pose"], backend="reference")
    by_rgb, by_alpha = image_weights(CAMERA)
    return (image.rgb * by_rgb).sum() + (image.alpha * by_alpha).sum()


@torch.no_grad()
def differences(leaves: Leaves, name: str) -> np.ndarray:
    """Central differences of the loss by every number of one of them."""
    result = np.zeros(leaves[name].numel())
    for index in range(len(result)):
        for sign in (1, -1):
            moved = leaves[name].clone()
            moved.view(-1)[index] += sign * STEP
            result[index] += sign * loss_of(leaves | {name: moved}).item() / (2 * STEP)
    return result.reshape(leaves[name].shape)


@pytest.mark.parametrize(("degree", "beside"), [(0, False), (3, False), (1, True)])
def test_every_attribute_and_the_pose(degree: int, beside: bool) -> None:
    """Six overlapping Gaussians, bright enough that no colour is clamped at black; or ones that reach in from beside
    the image, where the linearisation is clamped."""
    gaussians = random_gaussians(CAMERA, 6, degree, seed=3, opacity=(0.4, 0.9))
    gaussians.sh[:, 0] += 1.0
    gaussians.scales *= 4 if beside else 2
    if beside:
        local = gaussians.means @ CAMERA.rotation.T + CAMERA.world_to_camera[:3, 3]
        local[:3, 0] = local[:3, 2] * (1.4 * CAMERA.width - CAMERA.intrinsics[0, 2]) / CAMERA.intrinsics[0, 0]
        local[3:, 1] = local[3:, 2] * (-0.4 * CAMERA.height - CAMERA.intrinsics[1, 2]) / CAMERA.intrinsics[1, 1]
        gaussians.means = (local - CAMERA.world_to_camera[:3, 3]) @ CAMERA.rotation
    pose = CAMERA.world_to_camera[:3].copy()
    if not beside:  # a little off the camera's own
        pose[:, :3] = rotation_of((1.0, 0.2, -0.4), 0.06) @ pose[:, :3]
        pose[:, 3] += 0.05, -0.08, 0.1
    arrays = {**gaussians.arrays, "pose": pose}
    leaves = {name: torch.tensor(array, requires_grad=True) for name, array in arrays.items()}
    loss_of(leaves).backward()
    for name, leaf in leaves.items():
        expected = differences(leaves, name)
        each = np.abs(expected.reshape(len(expected), -1)).max(1)
        assert (each.max() if beside else each.min()) > 1e-3, "each matters"
        assert relative_error(leaf.grad.numpy(), expected) < 1e-6, name
