"""Regions and depth limits: each does what it says, forward and backward."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from support.builders import ATTRIBUTES, odd_camera, one_gaussian, plain_camera, random_gaussians
from support.torch_drawing import (
    BACKGROUND,
    EVERYTHING,
    cut,
    draw_with_gradients,
    image_weights,
    relative_error,
    tensors,
)

from frog_blender.engine.native import binding
from frog_blender.engine.rasterizer import GaussianArrays, Image, RasterizeOptions, rasterize

CAMERA = odd_camera(90, 61)
BACKENDS = pytest.mark.parametrize("backend", ["cpu", "reference"])
IMAGES = ("rgb", "alpha", "median_depth", "median_z", "mean_depth")
ALIGNED = [(0, 0, 90, 61), (32, 16, 48, 32), (64, 48, 26, 13), (0, 32, 16, 16), (16, 0, 1, 1)]
"""Regions that begin where a tile does."""
ANYWHERE = [(7, 5, 33, 29), (89, 60, 1, 1), (1, 0, 89, 61), (40, 13, 3, 48)]


def crowd(degree: int = 1) -> GaussianArrays:
    return random_gaussians(CAMERA, 400, degree, seed=21)


def shallow_limit(seed: int = 1) -> torch.Tensor:
    """(H, W) depths among the Gaussians', some pixels unlimited and some shut."""
    random = np.random.default_rng(seed)
    limit = random.uniform(1.0, 5.5, (CAMERA.height, CAMERA.width))
    limit[random.uniform(size=limit.shape) < 0.1] = np.inf
    limit[random.uniform(size=limit.shape) < 0.1] = 0
    return torch.tensor(limit, dtype=torch.float32)


def drawn(gaussians: GaussianArrays, options: RasterizeOptions, backend: str, **more: object) -> Image:
    with torch.no_grad():
        return rasterize(tensors(gaussians), CAMERA, BACKGROUND, options, backend=backend, **more)


def assert_same_image(found: Image, expected: Image, region: tuple[int, int, int, int], exactly: bool) -> None:
    for name in IMAGES:
        part = cut(getattr(expected, name), region)
        if exactly:
            assert torch.equal(getattr(found, name).nan_to_num(-1), part.nan_to_num(-1)), name
        else:
            torch.testing.assert_close(getattr(found, name), part, atol=1e-5, rtol=1e-5, equal_nan=True)


@BACKENDS
def test_a_region_is_its_part_of_the_whole_image(backend: str) -> None:
    """The native one of whole tiles to the bit. Where tiles begin elsewhere positions round differently."""
    whole = drawn(crowd(), EVERYTHING, backend)
    for region in ALIGNED + ANYWHERE:
        part = drawn(crowd(), replace(EVERYTHING, region=region), backend)
        assert part.rgb.shape == (region[3], region[2], 3)
        assert_same_image(part, whole, region, exactly=backend == "cpu" and region in ALIGNED)
        assert bool((part.max_weights <= whole.max_weights * (1 + 1e-5)).all())


@BACKENDS
@pytest.mark.parametrize("region", [ALIGNED[2], ANYWHERE[0]])
def test_gradients_of_a_region_are_those_of_a_loss_on_it(region: tuple[int, int, int, int], backend: str) -> None:
    dtype = torch.float32 if backend == "cpu" else torch.float64
    limit, pose = shallow_limit(), CAMERA.world_to_camera
    options, more = RasterizeOptions(region=region), {"pose": pose, "depth_limit": cut(limit, region)}
    _, found = draw_with_gradients(crowd(), CAMERA, backend, dtype, options, **more)
    leaves, moving = tensors(crowd(), dtype), torch.tensor(pose).float().to(dtype).requires_grad_()
    image = rasterize(leaves, CAMERA, BACKGROUND, pose=moving, depth_limit=limit, backend=backend)
    mask = torch.zeros_like(image.alpha)
    cut(mask, region)[:] = 1
    by_rgb, by_alpha = (weights.to(dtype) for weights in image_weights(CAMERA))
    ((image.rgb * by_rgb * mask[..., None]).sum() + (image.alpha * by_alpha * mask).sum()).backward()
    expected = {name: getattr(leaves, name).grad for name in ATTRIBUTES}
    expected |= {"screen": image.screen.grad, "pose": moving.grad}
    # Positions round differently where tiles begin elsewhere, most without fused multiply-adds.
    most = 1e-12 if region in ALIGNED else 2e-6 if binding.instruction_set() == "baseline" else 1e-6
    for name, gradient in expected.items():
        assert relative_error(found[name], gradient.double().numpy()) <= most, name


OUTSIDE = [(-1, 0, 5, 5), (0, -1, 5, 5), (86, 0, 5, 5), (0, 57, 5, 5), (0, 0, 0, 5), (0, 0, 5, -2), (0, 0, 91, 61)]


@BACKENDS
def test_regions_that_do_not_lie_in_the_image_are_refused(backend: str) -> None:
    for region in OUTSIDE:
        with pytest.raises(ValueError, match="90 x 61"):
            drawn(crowd(), RasterizeOptions(region=region), backend)


def test_depth_limits_equal_the_reference() -> None:
    limit = shallow_limit()
    image, gradients = draw_with_gradients(crowd(), CAMERA, "cpu", depth_limit=limit)
    expected, by = draw_with_gradients(crowd(), CAMERA, "reference", torch.float64, depth_limit=limit)
    for name in IMAGES:
        difference = (getattr(image, name) - getattr(expected, name)).abs().nan_to_num(0)
        assert float((difference > 1e-4).double().mean()) <= 3e-4, name
    assert torch.equal(image.median_z.isnan(), expected.median_z.isnan())
    for name, gradient in by.items():
        assert relative_error(gradients[name], gradient) < 1e-5, name
    assert float((expected.alpha.detach() - drawn(crowd(), EVERYTHING, "reference").alpha).abs().max()) > 0.5


@BACKENDS
def test_nothing_behind_a_limit_is_seen(backend: str) -> None:
    """Neither as colour nor as depth, and the splat exactly at the limit is."""
    limit = shallow_limit()
    image = drawn(crowd(), EVERYTHING, backend, depth_limit=limit)
    for depth in (image.median_z, image.mean_depth):
        seen = ~depth.isnan()
        assert 0.3 < float(seen.double().mean()) < 0.95 and bool((depth[seen] <= limit[seen] * (1 + 1e-6)).all())
    camera = plain_camera()
    for depth, visible in ((2.0, True), (np.nextafter(np.float32(2), np.float32(0)), False)):
        limit = torch.full((32, 32), float(depth))
        with torch.no_grad():
            alpha = rasterize(tensors(one_gaussian((0, 0, 2.0))), camera, depth_limit=limit, backend=backend).alpha
        assert bool(alpha.any()) == visible


@pytest.mark.parametrize("options", [EVERYTHING, RasterizeOptions()])
def test_an_infinite_limit_is_none(options: RasterizeOptions) -> None:
    unlimited = torch.full((CAMERA.height, CAMERA.width), torch.inf)
    image, gradients = draw_with_gradients(crowd(), CAMERA, "cpu", options=options, depth_limit=unlimited)
    expected, by = draw_with_gradients(crowd(), CAMERA, "cpu", options=options)
    assert torch.equal(image.rgb, expected.rgb) and torch.equal(image.alpha, expected.alpha)
    for name, gradient in by.items():
        np.testing.assert_array_equal(gradients[name], gradient, err_msg=name)


@BACKENDS
def test_a_limit_of_zero_hides_everything(backend: str) -> None:
    shut = torch.zeros(CAMERA.height, CAMERA.width)
    image, gradients = draw_with_gradients(crowd(), CAMERA, backend, depth_limit=shut)
    torch.testing.assert_close(image.rgb.detach(), torch.tensor(BACKGROUND).expand_as(image.rgb))
    assert not image.alpha.any() and not image.max_weights.any()
    assert image.median_depth.isnan().all() and image.mean_depth.isnan().all()
    assert not any(gradient.any() for gradient in gradients.values())


@BACKENDS
def test_a_limit_of_another_size_is_refused(backend: str) -> None:
    options = RasterizeOptions(region=(16, 16, 20, 10))
    for shape in ((61, 90), (20, 10), (10, 20, 1)):
        with pytest.raises(ValueError, match="depth_limit"):
            drawn(crowd(), options, backend, depth_limit=torch.ones(shape))


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
