"""The two depths and the blending rule by hand, and a mesh's depth against rays and triangles in numpy."""

import numpy as np
import pytest
import torch
from support.builders import odd_camera, one_gaussian, plain_camera
from support.torch_drawing import EVERYTHING, tensors

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.gaussians import joined
from frog_blender.engine.rasterizer import GaussianArrays, Image, RasterizeOptions, rasterize
from frog_blender.engine.rasterizer.mesh_depth import mesh_depth

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
    image = drawn(joined([sheet((0.3, 0.4, 4.0), 0.6, 1.0), sheet((0.6, -0.2, 2.0), 0.3, 0.2)]), backend)
    np.testing.assert_allclose(image.rgb.numpy(), 0.3 * 0.2 + 0.7 * 0.6 * 1.0, atol=1e-4)
    np.testing.assert_allclose(image.alpha.numpy(), 1 - 0.7 * 0.4, atol=1e-4)
    np.testing.assert_allclose(image.median_depth.numpy(), np.sqrt(0.3**2 + 0.4**2 + 4.0**2), rtol=1e-5)
    np.testing.assert_allclose(image.mean_depth.numpy(), (0.3 * 2 + 0.7 * 0.6 * 4) / (1 - 0.7 * 0.4), rtol=1e-4)
    np.testing.assert_allclose(image.max_weights.numpy(), [0.7 * 0.6, 0.3], atol=1e-4)


@BACKENDS
def test_one_layer_alone_crosses_one_half_or_none_does(backend: str) -> None:
    image = drawn(joined([sheet((0.3, 0.4, 4.0), 0.6), sheet((0.6, -0.2, 2.0), 0.55)]), backend)
    np.testing.assert_allclose(image.median_depth.numpy(), np.sqrt(0.6**2 + 0.2**2 + 2.0**2), rtol=1e-5)
    image = drawn(joined([sheet((0, 0, 4.0), 0.25), sheet((0, 0, 2.0), 0.3)]), backend)
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
    weak = drawn(joined([sheet((0, 0, 1.0), 1.0, 0.0), sheet((0, 0, 2.0), 0.88, 1.0)]), backend)
    strong = drawn(joined([sheet((0, 0, 1.0), 1.0, 0.0), sheet((0, 0, 2.0), 0.95, 1.0)]), backend)
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
    layers = joined([sheet((0, 0, 1.0), 0.5), sheet((0, 0, 3.0), 0.5)])
    image = drawn(layers, backend, RasterizeOptions(near_plane=2.0))
    assert image.radii[0] == 0 and image.radii[1] > 0
    np.testing.assert_allclose(image.alpha.numpy(), 0.5, atol=1e-4)


def by_rays(vertices: np.ndarray, triangles: np.ndarray, camera: Camera, near: float = 0.01) -> np.ndarray:
    """(H, W) the same by Moeller and Trumbore, one ray a pixel, in float64."""
    y, x = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
    rays = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3) @ np.linalg.inv(camera.intrinsics).T
    seen = vertices @ camera.rotation.T + camera.world_to_camera[:3, 3]
    depth = np.full(len(rays), np.inf)
    for a, b, c in seen[triangles]:
        u, v = b - a, c - a
        p = np.cross(rays, v)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1 / (p @ u)
            first = (p @ -a) * inverse
            q = np.cross(-a, u)
            second = (rays @ q) * inverse
            z = (q @ v) * inverse
        hit = (first >= 0) & (second >= 0) & (first + second <= 1) & (z >= near)
        depth = np.where(hit, np.minimum(depth, z), depth)
    return depth.reshape(camera.height, camera.width)


def agree(found: np.ndarray, expected: np.ndarray) -> None:
    """Edges through a pixel's very centre may fall to either side."""
    assert found.dtype == np.float32 and found.shape == expected.shape
    both = np.isfinite(found) & np.isfinite(expected)
    assert np.mean(np.isfinite(found) != np.isfinite(expected)) < 2e-3
    assert np.mean(~np.isclose(found[both], expected[both], rtol=2e-5)) < 2e-3


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("camera", [plain_camera(61, 37), odd_camera(90, 71)], ids=["plain", "odd"])
def test_random_triangles(camera: Camera, seed: int) -> None:
    """Before, behind, across the near plane, beyond the image's edges."""
    random = np.random.default_rng(seed)
    vertices = (random.normal(0, 2.0, (60, 3)) + np.array([0, 0, 2])).astype(np.float32)
    triangles = random.integers(0, 60, (40, 3))
    found = mesh_depth(vertices, triangles, camera)
    assert np.isfinite(found).mean() > 0.1
    agree(found, by_rays(vertices.astype(float), triangles, camera))


def test_a_tilted_floor_is_exact() -> None:
    camera = plain_camera(64, 48)
    corners = np.array([[-500, 1, 0.5], [500, 1, 0.5], [500, 1, 90], [-500, 1, 90]], np.float32)
    depth = mesh_depth(corners, np.array([[0, 1, 2], [2, 3, 0]]), camera)
    rows = np.arange(48) + 0.5 - 24
    with np.errstate(divide="ignore", invalid="ignore"):
        expected = np.where((rows > 0) & (40 / rows < 90) & (40 / rows > 0.5), 40 / rows, np.inf)
    np.testing.assert_allclose(depth, np.repeat(expected[:, None], 64, 1), rtol=1e-5)
    assert np.isinf(depth[:24]).all()


def test_a_region_is_that_part_of_the_image() -> None:
    camera, random = odd_camera(70, 50), np.random.default_rng(1)
    vertices, triangles = random.normal(0, 2, (30, 3)) + np.array([0, 0, 2]), random.integers(0, 30, (20, 3))
    whole = mesh_depth(vertices, triangles, camera)
    part = mesh_depth(vertices, triangles, camera, RasterizeOptions(region=(13, 7, 40, 33)))
    np.testing.assert_array_equal(part, whole[7:40, 13:53])


def test_what_cannot_be_drawn_is_left_out() -> None:
    camera = plain_camera()
    good = [[-1, -1, 3], [1, -1, 3], [0, 1, 3]]
    vertices = np.array([*good, [np.nan, 0, 3], [np.inf, 0, 3], [1e30, 1e30, 1e30]], np.float32)
    whole = mesh_depth(vertices[:3], np.array([[0, 1, 2]]), camera)
    triangles = np.array([[0, 1, 3], [0, 1, 4], [0, 1, 99], [-1, 0, 1], [0, 0, 0], [0, 1, 1], [0, 1, 2]])
    np.testing.assert_array_equal(mesh_depth(vertices, triangles, camera), whole)
    assert np.isfinite(whole).any()
    assert not np.isnan(mesh_depth(vertices, np.array([[0, 1, 5]]), camera)).any()
    assert np.isinf(mesh_depth(np.zeros((0, 3)), np.zeros((0, 3)), camera)).all()


def test_arrays_of_other_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match=r"vertices: shape \(4, 2\)"):
        mesh_depth(np.zeros((4, 2)), np.zeros((0, 3)), plain_camera())
    with pytest.raises(ValueError, match="triangles"):
        mesh_depth(np.zeros((4, 3)), np.zeros((2, 4)), plain_camera())
