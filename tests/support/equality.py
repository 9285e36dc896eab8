"""Scenes on which native and CUDA kernels must agree with the reference in float64, and the comparison."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from support.builders import odd_camera, one_gaussian, plain_camera, random_gaussians
from support.strange_gaussians import scattered
from support.torch_drawing import EVERYTHING, draw_with_gradients, relative_error

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.gaussians import joined
from frog_blender.engine.rasterizer import GaussianArrays, RasterizeOptions

OUTPUTS = ("rgb", "alpha", "median_depth", "mean_depth", "radii", "max_weights")
# Where float32 decides a threshold the other way a whole contribution appears or goes, at the rim of a splat mostly.
FLIPPED_SHARE = 3e-4
CUDA_ERROR = 2e-5  # of gradients: CUDA's exponentials and divisions round a little less well


@dataclass(frozen=True)
class Scene:
    """What is drawn, and how far float32 may stray.

    Attributes:
        camera, gaussians: as they are; gaussians float64 numpy.
        options: of the drawing.
        pose: the camera's own matrix is given as a tensor with gradients.
        tolerance: of images and depths.
    """

    camera: Camera
    gaussians: GaussianArrays
    options: RasterizeOptions = EVERYTHING
    pose: bool = False
    tolerance: float = 2e-5


def _shaped(change: Callable[[GaussianArrays], None], gaussians: GaussianArrays) -> GaussianArrays:
    change(gaussians)
    return gaussians


def _needles(g: GaussianArrays) -> None:
    g.scales[::2] = [1.5, 1e-4, 1e-4]
    g.scales[1::2] = [0.8, 0.8, 1e-5]


def _giants(g: GaussianArrays) -> None:
    g.scales[::3] *= 60
    g.opacities *= 0.3


def _some_behind(g: GaussianArrays) -> None:
    g.means[::3] *= -1.0
    g.means[1::6] *= 0.01  # close to the camera, on both sides of the near plane


def _clear_and_opaque(g: GaussianArrays) -> None:
    g.scales *= 6  # so that alpha is clamped over whole pixels
    g.opacities[:] = np.tile([0.0, 1.0, 0.9995, 1.5, 0.0039, 0.5], len(g))[: len(g)]


def _sheets(g: GaussianArrays) -> None:
    g.means = np.stack([np.zeros(len(g)), np.zeros(len(g)), np.linspace(1.0, 5.0, len(g))], 1)
    g.scales[:] = [3.0, 4.0, 2.0]


def _ties(g: GaussianArrays) -> None:
    g.means[:, 2] = 2.0


def _beside(camera: Camera) -> GaussianArrays:
    """Beside the image, where the linearisation is clamped."""
    gaussians = random_gaussians(camera, 60, 0, seed=9)
    local = gaussians.means @ camera.rotation.T + camera.world_to_camera[:3, 3]
    sides = np.array([[1.35, 0.5], [-0.35, 0.5], [0.5, 1.4], [0.5, -0.4]])[np.arange(60) % 4]
    pixels = sides * [camera.width, camera.height] - camera.intrinsics[:2, 2]
    local[:, :2] = pixels / camera.intrinsics[[0, 1], [0, 1]] * local[:, 2:]
    gaussians.means = (local - camera.world_to_camera[:3, 3]) @ camera.rotation
    gaussians.scales *= 3
    return gaussians


def _steps(camera: Camera) -> np.ndarray:
    """A depth limit that changes from column to column."""
    columns = np.linspace(1, 6, camera.width, dtype=np.float32)
    return np.ascontiguousarray(np.broadcast_to(columns, (camera.height, camera.width)))


def scenes() -> dict[str, Scene]:
    """By what is special about them."""
    odd, whole = odd_camera(97, 71), plain_camera(64, 32)
    small, tall = odd_camera(45, 27), odd_camera(18, 700)
    crowd = random_gaussians(odd, 400, 3, seed=1)
    return {
        "off-centre, degree 3": Scene(odd, crowd),
        "only colour": Scene(small, random_gaussians(small, 80, 0, seed=2), RasterizeOptions()),
        "only depth": Scene(small, random_gaussians(small, 80, 0, seed=3), RasterizeOptions(depth=True)),
        "only weights": Scene(small, random_gaussians(small, 80, 0, seed=4), RasterizeOptions(weights=True)),
        "region": Scene(odd, crowd, replace(EVERYTHING, region=(23, 5, 50, 44))),
        "depth limit": Scene(odd, crowd, replace(EVERYTHING, depth_limit=_steps(odd))),
        "pose": Scene(odd, crowd, pose=True),
        "pose of one colour": Scene(small, random_gaussians(small, 300, 0, seed=8), pose=True),
        "pose and region": Scene(odd, crowd, RasterizeOptions(region=(3, 2, 60, 60)), pose=True),
        "low-passes of their own, far near plane": Scene(
            odd,
            replace(random_gaussians(odd, 200, 3, seed=10), low_pass=np.linspace(0, 4, 200)),
            replace(EVERYTHING, near_plane=2.5),
        ),
        "whole tiles": Scene(whole, random_gaussians(whole, 200, 3, seed=11)),
        "needles": Scene(odd, _shaped(_needles, random_gaussians(odd, 80, 0, seed=12)), tolerance=2e-4),
        "giants": Scene(odd, _shaped(_giants, random_gaussians(odd, 60, 0, seed=13))),
        "giants over more tile rows than a warp has lanes": Scene(
            tall, _shaped(_giants, random_gaussians(tall, 40, 0, seed=20))
        ),
        "behind and near": Scene(
            plain_camera(97, 71), _shaped(_some_behind, random_gaussians(plain_camera(97, 71), 300, 0, seed=14))
        ),
        "clear and opaque": Scene(small, _shaped(_clear_and_opaque, random_gaussians(small, 60, 0, seed=15))),
        "sheets that finish early": Scene(
            plain_camera(37, 21),
            _shaped(_sheets, random_gaussians(plain_camera(37, 21), 200, 0, seed=16, opacity=(0.02, 0.5))),
        ),
        "equal depths": Scene(
            plain_camera(45, 27), _shaped(_ties, random_gaussians(plain_camera(45, 27), 60, 0, seed=17))
        ),
        "beside the image": Scene(small, _beside(small), pose=True),
        "one pixel": Scene(plain_camera(1, 1), random_gaussians(plain_camera(1, 1), 30, 0, seed=18)),
        "nothing in view": Scene(
            small, joined([one_gaussian((0.0, 0.0, -40.0)), one_gaussian((90.0, 0.0, -40.0))]), pose=True
        ),
        "no Gaussians": Scene(small, crowd.part(slice(0)), pose=True),
    }


def of_other_degrees() -> dict[str, Scene]:
    """The kernels' other specialisations, which the emulator would compile for seconds each."""
    odd = odd_camera(97, 71)
    return {
        f"degree {degree}, pose: {pose}": Scene(odd, random_gaussians(odd, 200, degree, seed=2), pose=pose)
        for degree in (1, 2)
        for pose in (False, True)
    }


def draw(scene: Scene, backend: str, dtype: torch.dtype, device: str = "cpu") -> dict[str, np.ndarray]:
    """Every output, and every gradient as ``by_...``, of a random linear loss; float64 numpy."""
    pose = scene.camera.world_to_camera if scene.pose else None
    image, gradients = draw_with_gradients(
        scene.gaussians, scene.camera, backend, dtype, scene.options, pose=pose, device=device
    )
    drawn = {name: getattr(image, name) for name in OUTPUTS}
    outputs = {name: tensor.detach().double().cpu().numpy() for name, tensor in drawn.items() if tensor is not None}
    return outputs | {f"by_{name}": gradient.astype(np.float64) for name, gradient in gradients.items()}


def assert_equal(
    scene: Scene, values_of: dict[str, np.ndarray], expected: dict[str, np.ndarray], gradient_error: float
) -> None:
    """Within the scene's tolerances; thresholds may fall the other way at a few pixels. ``gradient_error`` is relative
    (L2), of any parameter's."""
    assert values_of.keys() == expected.keys()
    for name in ("rgb", "alpha", "median_depth", "mean_depth"):
        if name not in values_of:
            continue
        values, reference = values_of[name], expected[name]
        assert values.shape == reference.shape, name
        wrong = np.isnan(values) != np.isnan(reference)
        scale = np.maximum(1.0, np.abs(np.nan_to_num(reference)))
        wrong |= np.abs(np.nan_to_num(values) - np.nan_to_num(reference)) > scene.tolerance * scale
        allowed = max(1, FLIPPED_SHARE * wrong.size)
        assert wrong.sum() <= allowed, f"{name}: {wrong.sum()} of {wrong.size} differ"
    np.testing.assert_allclose(values_of["radii"], expected["radii"], rtol=1e-3, atol=1e-3)
    if "max_weights" in values_of:
        np.testing.assert_allclose(values_of["max_weights"], expected["max_weights"], atol=10 * scene.tolerance)
    for name in expected:
        if name.startswith("by_"):
            assert np.isfinite(values_of[name]).all(), name
            if not expected[name].any():
                assert not values_of[name].any(), name
            else:
                assert relative_error(values_of[name], expected[name]) < gradient_error, name


def assert_same_bits(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> None:
    """Of all that ``other`` has."""
    for name, values in other.items():
        assert one[name].tobytes() == values.tobytes(), name


def assert_neighbours_stay(camera: Camera, backend: str) -> None:
    """As they are beside what cannot be drawn, which receives no gradient: scattered through the
    list, so that a shifted index would show, and in front."""
    good = random_gaussians(camera, 30, 0, seed=7)
    gaussians, kept = scattered(good)
    expected = draw(Scene(camera, good), backend, torch.float32)
    for name, values in draw(Scene(camera, gaussians), backend, torch.float32).items():
        if len(values) == len(gaussians):
            assert not np.delete(values, kept, axis=0).any(), name
            values = values[kept]
        np.testing.assert_array_equal(values, expected[name], err_msg=name)
