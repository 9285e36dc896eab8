"""Ways in which other rasterizers have failed their users: each is shown not to happen here.

Among them Gaussians that cannot be drawn: nothing crashes, no neighbour changes, gradients stay where they belong.
More are shown elsewhere: the same bits on any number of threads (test_determinism), principal points off the centre
and quaternions of any length (everywhere, by ``odd_camera`` and ``random_gaussians``), the background in the gradients
(test_random_scenes).
"""

from itertools import product

import numpy as np
import pytest
import torch
from support.builders import odd_camera, one_gaussian, plain_camera, random_gaussians
from support.equality import assert_neighbours_stay
from support.strange_gaussians import STRANGE
from support.torch_drawing import EVERYTHING, draw_with_gradients, tensors

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.gaussians import ATTRIBUTES, joined
from frog_blender.engine.native import binding
from frog_blender.engine.rasterizer import GaussianArrays, RasterizeOptions, rasterize

BACKENDS = pytest.mark.parametrize("backend", ["cpu", "reference"])
FOCAL, LOW_PASS = 40.0, 0.3


def reaching(center: tuple[float, float], reach: tuple[float, float], camera: Camera, opacity: float) -> GaussianArrays:
    """One Gaussian whose box of alpha >= 1/255 has these half sides around ``center``, in pixels."""
    variances = np.square(reach) / (2 * np.log(255 * opacity))
    assert (variances > LOW_PASS).all()
    x, y = (np.array(center) - camera.intrinsics[:2, 2]) / FOCAL
    scales = [[*(np.sqrt(variances - LOW_PASS) / FOCAL), 1e-6]]
    return one_gaussian((x, y, 1.0), scales=scales, opacities=[opacity])


def exact_alpha(center: tuple[float, float], reach: tuple[float, float], camera: Camera, opacity: float) -> np.ndarray:
    """(H, W) alpha of the same before anything is skipped."""
    variances = np.square(reach) / (2 * np.log(255 * opacity))
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    square = (x - center[0]) ** 2 / variances[0] + (y - center[1]) ** 2 / variances[1]
    return opacity * np.exp(-square / 2)


# Where the box of a splat ends, in pixels: at a tile's edge, at the pixel centres beside it, and a little off.
EDGES = [15.5, 16.0, 16.5, 31.5, 32.0, 32.5, 15.4999, 16.5001]
BORDERS = [0.5, 0.501, 47.5, 47.499]


@pytest.mark.parametrize("edge", EDGES + BORDERS)
def test_boxes_that_end_exactly_at_an_edge_lose_nothing(edge: float) -> None:
    """Every pixel above the threshold is drawn, however the box falls on tiles and on the image's border. Pixels
    whose alpha is 1/255 within rounding may be drawn or not."""
    camera = plain_camera(48, 48, FOCAL)
    kinds = ((6.0, 9.0, 0.9), (2.5, 20.0, 0.3), (40.0, 7.25, 0.99))
    for axis, side, (reach, across, opacity) in product((0, 1), (-1, 1), kinds):
        center = (edge - side * reach, 21.3)[:: 1 if axis == 0 else -1]
        sides = (reach, across)[:: 1 if axis == 0 else -1]
        part = reaching(center, sides, camera, opacity)
        with torch.no_grad():
            alpha = rasterize(tensors(part), camera, options=EVERYTHING).alpha.double().numpy()
        expected = exact_alpha(center, sides, camera, opacity)
        clear = np.abs(255 * expected - 1) > 1e-3
        np.testing.assert_allclose(alpha[clear], np.where(expected >= 1 / 255, expected, 0)[clear], atol=2e-6)
        nearly = ~clear & (alpha > 0)
        np.testing.assert_allclose(alpha[nearly], 1 / 255, rtol=2e-3)


def test_what_is_counted_is_what_is_drawn() -> None:
    """Lists of tiles, blending and the count of blended pairs see the same pixels."""
    camera = odd_camera(75, 51)
    for seed in range(20):
        gaussians = random_gaussians(camera, 1, 0, seed).checked()
        image = RasterizeOptions().new_image(camera, 1)
        frame = binding.Frame(gaussians, camera, (0, 0, 0), RasterizeOptions(), image)
        assert frame.count_pairs() == np.count_nonzero(image["alpha"]) <= 256 * frame.instances


def test_more_tiles_than_can_be_counted_are_refused() -> None:
    """A million Gaussians that each cover all tiles of a very wide image: four thousand million entries. The count is
    checked before anything is allocated for it."""
    camera = plain_camera(16 * 4096, 1, 1e3)
    gaussians = one_gaussian((0, 0, 1.0), scales=[[1e3] * 3])
    many = gaussians.mapped(lambda array: np.repeat(array, 2**32 // 4096 + 2, axis=0))
    with torch.no_grad(), pytest.raises(MemoryError, match="1048578 Gaussians at 65536 x 1"):
        rasterize(tensors(many), camera)


@pytest.mark.parametrize(("depth", "size"), [(0.01, 1.0), (0.01, 100.0), (0.0101, 0.01), (0.02, 100.0), (0.05, 1.0)])
def test_giants_at_the_near_plane_are_finite(depth: float, size: float) -> None:
    """In the middle, at the side, and right in the corner of what the camera sees."""
    camera = odd_camera()
    local = np.array([[0, 0, 1], [0.6, 0, 1], [-0.5, 0.5, 1], [30, 0, 1], [0, -1000, 1]]) * depth
    places = (local - camera.world_to_camera[:3, 3]) @ camera.rotation
    giants = joined([one_gaussian(tuple(place), scales=[[size, size / 10, size / 1000]]) for place in places])
    giants.quaternions[:] = 0.3, -0.8, 0.5, 0.1
    image, gradients = draw_with_gradients(joined([giants, random_gaussians(camera, 30, 0)]), camera, "cpu")
    assert torch.isfinite(image.rgb).all() and torch.isfinite(image.radii).all()
    assert float(image.alpha.detach().min()) >= 0 and float(image.alpha.detach().max()) <= 1
    for name, gradient in gradients.items():
        assert np.isfinite(gradient).all(), name


@BACKENDS
def test_light_is_conserved_forward_and_backward(backend: str) -> None:
    """The gradient of an image's brightness by a Gaussian's colour is the sum of its weights; over all Gaussians these
    add up to the coverage. It holds only if the backward pass begins every pixel where it ended."""
    camera = odd_camera(75, 51)
    gaussians = random_gaussians(camera, 400, 0, seed=5, opacity=(0.3, 1.0))
    gaussians.scales *= 3
    gaussians.sh[:] = 0.5
    leaves = tensors(gaussians)
    image = rasterize(leaves, camera, (0, 0, 0), RasterizeOptions(weights=True), backend=backend)
    image.rgb[..., 0].sum().backward()
    weights = leaves.sh.grad[:, 0, 0].double() / 0.28209479177387814
    assert float((image.alpha > 0.9998).double().mean()) > 0.3  # many pixels ended early
    np.testing.assert_allclose(float(weights.sum()), float(image.alpha.detach().double().sum()), rtol=1e-6)
    assert torch.equal(weights > 0, image.max_weights > 0)
    hidden = (image.radii > 0) & (image.max_weights == 0)
    assert int(hidden.sum()) > 20
    for name in ATTRIBUTES:
        assert not getattr(leaves, name).grad[hidden].any(), name


CAMERA = plain_camera()  # at the origin, looking along +z


@BACKENDS
def test_what_cannot_be_drawn_changes_no_neighbour(backend: str) -> None:
    assert_neighbours_stay(CAMERA, backend)


@pytest.mark.parametrize("name", STRANGE)
def test_what_is_strange_leaves_a_finite_image(name: str) -> None:
    gaussians = joined([STRANGE[name], random_gaussians(CAMERA, 30, 0, seed=7)])
    image, gradients = draw_with_gradients(gaussians, CAMERA, "cpu")
    assert torch.isfinite(image.rgb).all() and torch.isfinite(image.alpha).all()
    assert float(image.alpha.detach().min()) >= 0 and float(image.alpha.detach().max()) <= 1
    for attribute in (*ATTRIBUTES, "screen"):
        assert np.isfinite(gradients[attribute]).all(), attribute


def test_wrong_shapes_are_named() -> None:
    gaussians = random_gaussians(odd_camera(), 5, 1)
    for name, array in (("scales", gaussians.scales[:4]), ("sh", gaussians.sh[:, :3]), ("opacities", np.zeros((5, 1)))):
        changed = gaussians.changed({name: array})
        with pytest.raises(ValueError, match=name):
            changed.checked()


def test_tensors_that_the_library_would_misread_are_refused() -> None:
    leaves = tensors(random_gaussians(CAMERA, 6, 1))
    misread = [("opacities", leaves.opacities.double()), ("opacities", leaves.opacities[:, None])]
    misread += [("sh", leaves.sh.half()), ("sh", leaves.sh[:, :2]), ("sh", leaves.sh.flatten(1))]
    misread += [("scales", leaves.scales[:, :1]), ("quaternions", leaves.quaternions[:-1])]
    for name, wrong in misread:
        with pytest.raises(ValueError, match=name):
            rasterize(leaves.changed({name: wrong}), CAMERA)
