"""Regions, poses and depth limits: each does what it says, forward and backward."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from support import torch_drawing
from support.builders import odd_camera, one_gaussian, plain_camera, random_gaussians, rotation_of
from support.torch_drawing import BACKGROUND, EVERYTHING, draw_with_gradients, tensors

from frog_blender.engine.gaussians import ATTRIBUTES
from frog_blender.engine.playback.render import draw
from frog_blender.engine.rasterizer import GaussianArrays, Image, RasterizeOptions, rasterize

CAMERA = odd_camera(90, 61)
BACKENDS = pytest.mark.parametrize("backend", ["cpu", "reference"])
IMAGES = ("rgb", "alpha", "median_depth", "mean_depth")
ALIGNED = [(0, 0, 90, 61), (32, 16, 48, 32), (64, 48, 26, 13), (0, 32, 16, 16), (16, 0, 1, 1)]
"""Regions that begin where a tile does."""
ANYWHERE = [(7, 5, 33, 29), (89, 60, 1, 1), (1, 0, 89, 61), (40, 13, 3, 48)]


def crowd(degree: int = 1) -> GaussianArrays:
    return random_gaussians(CAMERA, 400, degree, seed=21)


def drawn(gaussians: GaussianArrays, options: RasterizeOptions, backend: str) -> Image:
    with torch.no_grad():
        return rasterize(tensors(gaussians), CAMERA, BACKGROUND, options, backend=backend)


@BACKENDS
def test_a_region_is_its_part_of_the_whole_image(backend: str) -> None:
    """The native one of whole tiles to the bit. Where tiles begin elsewhere positions round differently."""
    whole = drawn(crowd(), EVERYTHING, backend)
    for region in ALIGNED + ANYWHERE:
        part = drawn(crowd(), replace(EVERYTHING, region=region), backend)
        assert part.rgb.shape == (region[3], region[2], 3)
        error = 0.0 if backend == "cpu" and region in ALIGNED else 1e-5
        for name in IMAGES:
            expected = torch_drawing.cut(getattr(whole, name), region)
            torch.testing.assert_close(getattr(part, name), expected, atol=error, rtol=error, equal_nan=True)
        assert bool((part.max_weights <= whole.max_weights * (1 + 1e-5)).all())


@BACKENDS
@pytest.mark.parametrize("region", [ALIGNED[2], ANYWHERE[0]])
def test_gradients_of_a_region_are_those_of_a_loss_on_it(region: tuple[int, int, int, int], backend: str) -> None:
    dtype = torch.float32 if backend == "cpu" else torch.float64
    pose = CAMERA.world_to_camera
    _, found = draw_with_gradients(crowd(), CAMERA, backend, dtype, RasterizeOptions(region=region), pose=pose)
    leaves, moving = tensors(crowd(), dtype), torch.tensor(pose).float().to(dtype).requires_grad_()
    image = rasterize(leaves, CAMERA, BACKGROUND, pose=moving, backend=backend)
    mask = torch.zeros_like(image.alpha)
    torch_drawing.cut(mask, region)[:] = 1
    by_rgb, by_alpha = (weights.to(dtype) for weights in torch_drawing.image_weights(CAMERA))
    ((image.rgb * by_rgb * mask[..., None]).sum() + (image.alpha * by_alpha * mask).sum()).backward()
    expected = {name: getattr(leaves, name).grad for name in ATTRIBUTES}
    expected |= {"screen": image.screen.grad, "pose": moving.grad}
    # Positions round differently where tiles begin elsewhere.
    most = 1e-12 if region in ALIGNED else 2e-6
    for name, gradient in expected.items():
        assert torch_drawing.relative_error(found[name], gradient.double().numpy()) <= most, name


OUTSIDE = [(-1, 0, 5, 5), (0, -1, 5, 5), (86, 0, 5, 5), (0, 57, 5, 5), (0, 0, 0, 5), (0, 0, 5, -2), (0, 0, 91, 61)]


@BACKENDS
def test_regions_that_do_not_lie_in_the_image_are_refused(backend: str) -> None:
    for region in OUTSIDE:
        with pytest.raises(ValueError, match="90 x 61"):
            drawn(crowd(), RasterizeOptions(region=region), backend)


def test_nothing_behind_a_depth_limit_is_seen() -> None:
    """Pixel by pixel as if what lies behind were not there, to the bit; what lies exactly at the limit is seen."""
    gaussians, levels = crowd(), (0.0, 2.0, 3.5, np.inf)
    limit = np.random.default_rng(1).choice(levels, (CAMERA.height, CAMERA.width)).astype(np.float32)
    found = draw(gaussians, CAMERA, BACKGROUND, depth_limit=limit)
    depths = gaussians.means @ CAMERA.forward - CAMERA.center @ CAMERA.forward
    for level in levels:
        there, nearer = limit == level, depths <= level
        some = gaussians.part(nearer)
        expected = draw(some, CAMERA, BACKGROUND)
        for name in (*IMAGES, "median_z"):
            values, wanted = getattr(found, name)[there], getattr(expected, name)[there]
            np.testing.assert_array_equal(values, wanted, err_msg=f"{name}, {level}")
    for depth, visible in ((2.0, True), (np.nextafter(np.float32(2), np.float32(0)), False)):
        shallow = np.full((32, 32), depth, np.float32)
        assert draw(one_gaussian((0, 0, 2.0)), plain_camera(), depth_limit=shallow).alpha.any() == visible
    with pytest.raises(ValueError, match="depth_limit"):
        draw(gaussians, CAMERA, depth_limit=limit[1:])


@BACKENDS
def test_a_pose_is_where_the_camera_stands(backend: str) -> None:
    pose = CAMERA.world_to_camera.copy()
    pose[:3, :3] = rotation_of((1.0, 0.2, -0.4), 0.06) @ pose[:3, :3]
    pose[:3, 3] += 0.05, -0.08, 0.1
    standing = draw_with_gradients(crowd(), CAMERA.with_pose(pose), backend)[0]
    posed = draw_with_gradients(crowd(), CAMERA, backend, pose=pose)[0]
    for name in IMAGES:
        torch.testing.assert_close(getattr(posed, name), getattr(standing, name), atol=1e-5, rtol=1e-5, equal_nan=True)
    elsewhere = draw_with_gradients(crowd(), CAMERA, backend)[0]
    assert float((elsewhere.rgb - posed.rgb).detach().abs().max()) > 0.1


def test_torchs_defaults_decide_nothing() -> None:
    """The library is given addresses: what lies there has to be what it expects."""

    def drawn() -> list[torch.Tensor]:
        scene = tensors(crowd())
        image = rasterize(scene, CAMERA, BACKGROUND, EVERYTHING)
        image.rgb.square().sum().backward()
        return [image.rgb.detach(), image.alpha.detach(), image.mean_depth, image.max_weights, scene.means.grad]

    expected = drawn()
    torch.set_default_dtype(torch.float64)
    try:
        found = drawn()
    finally:
        torch.set_default_dtype(torch.float32)
    for one, other in zip(found, expected, strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=0, equal_nan=True)
