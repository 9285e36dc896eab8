"""The two depths and the blending rule on scenes that can be computed by hand."""

import numpy as np
import pytest
import torch
from support.builders import join, one_gaussian, plain_camera
from support.torch_drawing import EVERYTHING, tensors

from frog_blender.engine.rasterizer import GaussianArrays, Image, RasterizeOptions, rasterize

CAMERA = plain_camera(33, 33, 30.0)
BACKENDS = pytest.mark.parametrize("backend", ["cpu", "reference"])


def sheet(mean: tuple[float, float, float], opacity: float, grey: float = 0.5) -> GaussianArrays:
    """So wide that its alpha is its opacity over the whole image; ``grey`` is its colour."""
    sh = [[[(grey - 0.5) / 0.28209479] * 3]]
    return one_gaussian(mean, scales=[[1000.0, 1000.0, 1000.0]], opacities=[opacity], sh=sh)


def drawn(gaussians: GaussianArrays, backend: str, options: RasterizeOptions = EVERYTHING) -> Image:
    with torch.no_grad():
        return rasterize(tensors(gaussians), CAMERA, (0.0, 0.0, 0.0), options, backend=backend)


@BACKENDS
def test_two_layers(backend: str) -> None:
    """The back layer takes transmittance from 0.7 to 0.28: its distance counts, Euclidean to its centre."""
    image = drawn(join(sheet((0.3, 0.4, 4.0), 0.6, 1.0), sheet((0.6, -0.2, 2.0), 0.3, 0.2)), backend)
    np.testing.assert_allclose(image.rgb.numpy(), 0.3 * 0.2 + 0.7 * 0.6 * 1.0, atol=1e-4)
    np.testing.assert_allclose(image.alpha.numpy(), 1 - 0.7 * 0.4, atol=1e-4)
    np.testing.assert_allclose(image.median_depth.numpy(), np.sqrt(0.3**2 + 0.4**2 + 4.0**2), rtol=1e-5)
    np.testing.assert_allclose(image.mean_depth.numpy(), (0.3 * 2 + 0.7 * 0.6 * 4) / (1 - 0.7 * 0.4), rtol=1e-4)
    np.testing.assert_allclose(image.max_weights.numpy(), [0.7 * 0.6, 0.3], atol=1e-4)


@BACKENDS
def test_one_layer_alone_crosses_one_half_or_none_does(backend: str) -> None:
    image = drawn(join(sheet((0.3, 0.4, 4.0), 0.6), sheet((0.6, -0.2, 2.0), 0.55)), backend)
    np.testing.assert_allclose(image.median_depth.numpy(), np.sqrt(0.6**2 + 0.2**2 + 2.0**2), rtol=1e-5)
    image = drawn(join(sheet((0, 0, 4.0), 0.25), sheet((0, 0, 2.0), 0.3)), backend)
    assert image.median_depth.isnan().all()
    assert torch.isfinite(image.mean_depth).all()  # something was hit all the same


@BACKENDS
def test_median_of_a_small_splat_ends_with_it(backend: str) -> None:
    image = drawn(one_gaussian((0, 0, 2.0), opacities=[0.9]), backend)
    np.testing.assert_array_equal(image.median_depth.isnan().numpy(), (image.alpha < 0.5).numpy())
    assert 0 < int((image.alpha > 0.5).sum()) < 100
    np.testing.assert_array_equal(image.mean_depth.isnan().numpy(), (image.alpha == 0).numpy())
    np.testing.assert_allclose(image.mean_depth[image.alpha > 0].numpy(), 2.0, rtol=1e-5)


@BACKENDS
def test_alpha_is_clamped_below_one(backend: str) -> None:
    np.testing.assert_allclose(drawn(sheet((0, 0, 2.0), 5.0), backend).alpha.numpy(), 0.999, atol=1e-6)


@BACKENDS
def test_the_layer_that_would_end_a_pixel_is_left_out(backend: str) -> None:
    """0.999 leaves 1e-3, the second leaves 1e-4 at 0.9 but less at 0.95: then it adds nothing at all."""
    weak = drawn(join(sheet((0, 0, 1.0), 1.0, 0.0), sheet((0, 0, 2.0), 0.88, 1.0)), backend)
    strong = drawn(join(sheet((0, 0, 1.0), 1.0, 0.0), sheet((0, 0, 2.0), 0.95, 1.0)), backend)
    assert float(weak.rgb.min()) > 8e-4
    assert float(strong.rgb.max()) == 0.0 and strong.max_weights[1] == 0


@BACKENDS
def test_extras_come_only_when_asked_for(backend: str) -> None:
    image = drawn(sheet((0, 0, 2.0), 0.5), backend, RasterizeOptions())
    assert (image.median_depth, image.mean_depth, image.max_weights) == (None,) * 3


@BACKENDS
def test_the_low_pass_widens_a_point(backend: str) -> None:
    """A Gaussian without size is drawn as one with the low-pass variance, in pixels."""
    point = one_gaussian((0, 0, 2.0), scales=[[0.0, 0.0, 0.0]], opacities=[0.9])
    for variance in (0.3, 2.0):
        point.low_pass = variance
        alpha = drawn(point, backend, RasterizeOptions()).alpha.numpy()
        middle, beside = alpha[16, 16], alpha[16, 17]
        np.testing.assert_allclose(beside / middle, np.exp(-0.5 / variance), rtol=1e-4)


@BACKENDS
def test_the_near_plane_can_be_moved(backend: str) -> None:
    layers = join(sheet((0, 0, 1.0), 0.5), sheet((0, 0, 3.0), 0.5))
    image = drawn(layers, backend, RasterizeOptions(near_plane=2.0))
    assert image.radii[0] == 0 and image.radii[1] > 0
    np.testing.assert_allclose(image.alpha.numpy(), 0.5, atol=1e-4)
