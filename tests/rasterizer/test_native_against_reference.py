"""The native library against the reference in float64: values, depths and gradients."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from support.builders import ATTRIBUTES, odd_camera, one_gaussian, plain_camera, random_gaussians
from support.torch_drawing import draw_with_gradients, relative_error

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.rasterizer import GaussianArrays, Image

# Where float32 decides a threshold the other way a whole contribution appears or goes, at the rim of a splat mostly.
FLIP, FLIPPED_SHARE = 1e-5, 3e-4

SCENES = {
    "degree 0, tiles cut at both sides": (odd_camera(45, 27), 120, 0),
    "degree 2": (odd_camera(16, 31), 80, 2),
    "degree 3, crowded": (odd_camera(70, 41), 500, 3),
}


def pair(camera: Camera, gaussians: GaussianArrays) -> tuple[Image, dict, Image, dict]:
    native = draw_with_gradients(gaussians, camera, "cpu")
    reference = draw_with_gradients(gaussians, camera, "reference", torch.float64)
    return *native, *reference


def assert_close_but_for_flips(found: torch.Tensor, expected: torch.Tensor, tolerance: float = FLIP) -> None:
    assert found.shape == expected.shape
    found, expected = found.detach().double(), expected.detach()
    wrong = (found - expected).abs() > tolerance
    wrong |= found.isnan() != expected.isnan()
    assert float(wrong.double().mean()) <= FLIPPED_SHARE, f"{int(wrong.sum())} of {wrong.numel()} differ"


def assert_same_gradients(native: dict, reference: dict, names: tuple[str, ...] = ATTRIBUTES) -> None:
    for attribute in names:
        assert np.isfinite(native[attribute]).all()
        assert relative_error(native[attribute], reference[attribute]) < 1e-5, attribute


@pytest.mark.parametrize("name", SCENES)
def test_values_and_gradients(name: str) -> None:
    camera, count, degree = SCENES[name]
    native, native_gradients, reference, reference_gradients = pair(
        camera, random_gaussians(camera, count, degree, seed=count + degree)
    )
    assert native.rgb.shape == (camera.height, camera.width, 3)
    assert float(native.alpha.detach().max()) > 0.9 and float(reference.alpha.detach().min()) < 0.5
    assert_close_but_for_flips(native.rgb, reference.rgb)
    assert_close_but_for_flips(native.alpha, reference.alpha)
    assert float((native.rgb.detach() - reference.rgb.detach()).abs().mean()) < 1e-6
    assert_close_but_for_flips(native.mean_depth, reference.mean_depth, 1e-4)
    assert_close_but_for_flips(native.median_depth, reference.median_depth, 1e-4)
    np.testing.assert_allclose(native.radii.numpy(), reference.radii.detach().numpy(), rtol=1e-4)
    np.testing.assert_allclose(native.max_weights.numpy(), reference.max_weights.numpy(), atol=1e-4)
    assert int((native.radii > 0).sum()) > count // 2
    assert_same_gradients(native_gradients, reference_gradients, (*ATTRIBUTES, "screen"))


def test_splats_beside_the_image_where_the_linearisation_is_clamped() -> None:
    camera = odd_camera(45, 27)
    gaussians = random_gaussians(camera, 60, 1, seed=9)
    local = gaussians.means @ camera.rotation.T + camera.world_to_camera[:3, 3]
    sides = np.array([[1.35, 0.5], [-0.35, 0.5], [0.5, 1.4], [0.5, -0.4]])[np.arange(60) % 4]
    pixels = sides * [camera.width, camera.height] - camera.intrinsics[:2, 2]
    local[:, :2] = pixels / camera.intrinsics[[0, 1], [0, 1]] * local[:, 2:]
    gaussians.means = (local - camera.world_to_camera[:3, 3]) @ camera.rotation
    gaussians.scales *= 3
    native, native_gradients, reference, reference_gradients = pair(camera, gaussians)
    assert float(reference.alpha.detach().max()) > 0.1
    assert_close_but_for_flips(native.rgb, reference.rgb)
    assert_same_gradients(native_gradients, reference_gradients)


def test_many_opaque_layers_end_early_with_the_same_gradients() -> None:
    """Forty opaque sheets: pixels finish after a few, the sheets behind get exactly nothing."""
    camera = plain_camera(37, 21)
    gaussians = random_gaussians(camera, 40, 0, seed=4, opacity=(0.7, 0.97))
    gaussians.means = np.stack([np.zeros(40), np.zeros(40), np.linspace(1.0, 5.0, 40)], 1)
    gaussians.scales[:] = 30.0
    native, native_gradients, reference, reference_gradients = pair(camera, gaussians)
    assert float(native.alpha.detach().min()) > 0.999
    assert_close_but_for_flips(native.rgb, reference.rgb)
    for attribute in ("means", "opacities", "sh"):
        # relative to the largest: means barely matter under sheets this wide
        difference = np.abs(native_gradients[attribute] - reference_gradients[attribute]).max()
        assert difference < 1e-5 * np.abs(reference_gradients[attribute]).max(), attribute
    seen = native.max_weights.numpy() > 0
    assert 3 <= seen.sum() < 30 and not seen[30:].any()
    for attribute in ATTRIBUTES:
        assert not native_gradients[attribute][~seen].any()


def test_where_alpha_is_clamped_nothing_reaches_the_shape() -> None:
    """Around the centre of an opaque splat alpha is 0.999 whatever its size; its rim still pulls."""
    camera = odd_camera(45, 27)
    gaussians = random_gaussians(camera, 12, 0, seed=12)
    gaussians.opacities[:] = np.tile([1.0, 0.9995, 1.5], 4)
    gaussians.scales *= 4
    native, native_gradients, reference, reference_gradients = pair(camera, gaussians)
    assert float((reference.alpha.detach() > 0.9985).double().mean()) > 0.02
    assert_close_but_for_flips(native.rgb, reference.rgb)
    assert_same_gradients(native_gradients, reference_gradients)
    assert not native_gradients["opacities"][2::3].any()  # beyond one nothing changes
    wide = one_gaussian((0, 0, 2.0), scales=[[1e4, 1e4, 1e4]], opacities=[0.9999])
    _, gradients = draw_with_gradients(wide, plain_camera(), "cpu")
    for attribute in ("means", "scales", "quaternions", "opacities"):
        assert not gradients[attribute].any(), attribute
    assert gradients["sh"].any()
