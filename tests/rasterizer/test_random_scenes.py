"""The native library against the reference in float64 on random scenes of every kind.

Images: where float32 decides a threshold the other way a whole contribution appears or goes, which no tolerance can
hide. Such pixels ("flips", beyond FLIP) are counted over all scenes together and must be very rare; all others are held
to a mean error. A single scene may hold a few more of them than its share.

Gradients: the relative L2 error of every parameter's, where no pixel flipped: where the images agree within AGREEMENT
everywhere. Over all scenes together it is held to GRADIENT_ERROR. In a few of a hundred scenes float32 does not suffice
(1 - alpha of an alpha near 0.999 has lost three digits; hundreds of pixels' parts cancel): alone they may be beyond
that, never by much.

And the reference's own gradients against finite differences, away from the blending rule's thresholds.
"""

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from support.builders import odd_camera, random_gaussians, rotation_of
from support.random_scenes import Scene, scenes
from support.torch_drawing import BACKGROUND, draw_with_gradients, image_weights, relative_error

from frog_blender.engine.rasterizer import GaussianArrays, rasterize

EXAMPLES = 120
FLIP, FLIPPED_SHARE, FLIPS_IN_ONE = 1e-4, 3e-4, 8
MEAN_ERROR = 1e-6
AGREEMENT = 1e-5
GRADIENT_ERROR, LARGEST_ERROR, INEXACT_SHARE = 1e-5, 3e-4, 0.04


Squares = dict[str, tuple[float, float]]
"""Of each parameter's expected gradients, and of how far off they were, summed."""


def compared(scene: Scene) -> tuple[int, float, int, Squares]:
    """Pixels, the sum of their mean errors and how many flipped; nothing of the gradients where any did."""
    camera, gaussians, options = scene.camera(), scene.gaussians(), scene.drawing()
    pose = camera.world_to_camera if scene.posed else None
    image, found = draw_with_gradients(gaussians, camera, "cpu", options=options, pose=pose)
    reference, expected = draw_with_gradients(gaussians, camera, "reference", torch.float64, options, pose=pose)
    for name, gradient in found.items():
        assert np.isfinite(gradient).all(), name
    difference = (image.rgb.detach() - reference.rgb.detach()).abs()
    alpha_difference = (image.alpha.detach() - reference.alpha.detach()).abs()
    flips = int((difference.amax(-1) > FLIP).sum())
    assert flips <= FLIPS_IN_ONE
    squares: Squares = {}
    if max(float(difference.max()), float(alpha_difference.max())) <= AGREEMENT:
        for name, gradient in expected.items():
            assert relative_error(found[name], gradient) <= LARGEST_ERROR, name
            squares[name] = float(np.square(gradient).sum()), float(np.square(found[name] - gradient).sum())
    return image.alpha.numel(), float(difference.mean(-1).sum()), flips, squares


def test_random_scenes() -> None:
    results = []

    @settings(
        max_examples=EXAMPLES, derandomize=True, deadline=None, database=None, suppress_health_check=list(HealthCheck)
    )
    @given(scenes())
    def check(scene: Scene) -> None:
        results.append(compared(scene))

    check()
    pixels, errors, flips = (sum(values) for values in list(zip(*results, strict=True))[:3])
    assert len(results) >= EXAMPLES and errors / pixels <= MEAN_ERROR and flips <= FLIPPED_SHARE * pixels
    agreeing = [squares for *_, squares in results if squares]
    assert len(agreeing) >= 0.98 * len(results)
    inexact = [any(off > GRADIENT_ERROR**2 * square for square, off in squares.values()) for squares in agreeing]
    assert sum(inexact) <= INEXACT_SHARE * len(agreeing)
    names = {name for squares in agreeing for name in squares}
    assert len(names) == 7
    for name in names:
        square, off = np.sum([squares[name] for squares in agreeing if name in squares], axis=0)
        assert off <= GRADIENT_ERROR**2 * square, name


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
