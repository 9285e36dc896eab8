"""Sizes of images that nobody can draw: refused in Python, and by the library itself, which others may call."""

from ctypes import byref, c_float, c_int32
from dataclasses import replace

import numpy as np
import pytest
from support.builders import one_gaussian, plain_camera, random_gaussians

from frog_blender.engine.capture.camera import NEUTRAL, Camera
from frog_blender.engine.gaussians import LOW_PASS
from frog_blender.engine.native import binding, structs
from frog_blender.engine.playback import render
from frog_blender.engine.rasterizer import RasterizeOptions
from frog_blender.engine.rasterizer.mesh_depth import mesh_depth

ABSURD = [(0, 8), (8, 0), (-5, 8), (4, 600_000), (600_000, 4), (65_537, 1), (1, 65_537)]
ABSURD += [(2**31 - 1, 1), (65_536, 65_536)]


def test_absurd_sizes_are_refused_before_memory_is_asked_for() -> None:
    gaussians = one_gaussian((0, 0, 1.0), scales=[[1e3] * 3]).checked()
    for size in ABSURD:
        camera = Camera("c", *size, np.eye(3), np.eye(4))
        for draw_it in (render.draw, render.render_image):
            with pytest.raises(ValueError, match="region"):
                draw_it(gaussians, camera)
        with pytest.raises(ValueError, match="region"):
            mesh_depth(np.zeros((3, 3)), np.array([[0, 1, 2]]), camera)


REGIONS = [(-1, 0, 8, 8), (0, -1, 8, 8), (0, 0, 9, 8), (2**31 - 8, 0, 8, 8), (0, 0, 0, 8)]


@pytest.mark.parametrize(
    ("size", "region"), [*((size, (0, 0, *size)) for size in ABSURD), *(((8, 8), region) for region in REGIONS)]
)
def test_the_library_does_nothing_for_absurd_sizes(size: tuple[int, int], region: tuple[int, ...]) -> None:
    """Every pointer to an image is null: whatever were written would end the process."""
    gaussians = one_gaussian((0, 0, 1.0), scales=[[1e3] * 3]).checked()
    camera = structs.camera_struct(plain_camera(8, 8))
    camera.width, camera.height = size
    options = structs.options_struct(RasterizeOptions(), (0.0, 0.0, 0.0), region, LOW_PASS)
    image = structs.Image()
    found = binding.library().frog_draw(
        byref(structs.gaussians_struct(gaussians)), byref(camera), byref(options), byref(image), 1
    )
    assert found is None
    four = (c_int32 * 4)(*region)
    assert binding.library().frog_mesh_depth(None, 0, None, 0, byref(camera), byref(four), 0.01, None) == 2


def test_images_of_absurd_sizes_are_not_compared() -> None:
    value = c_float()
    for width, height in ABSURD:
        assert binding.library().frog_ssim(height, width, None, None, None, None) == 2
        assert binding.library().frog_l1_loss(byref(structs.L1Loss(height=height, width=width)), byref(value)) == 2
    with pytest.raises(ValueError, match="sizes that cannot be"):
        binding.check_status(2, "comparing")


@pytest.mark.parametrize("size", [(65_536, 1), (1, 65_536), (65_536, 17)], ids=str)
def test_the_largest_sides_are_drawn(size: tuple[int, int]) -> None:
    """To the last pixel, by a splat that covers all of it."""
    camera = Camera("c", *size, np.array([[1e3, 0, size[0] / 2], [0, 1e3, size[1] / 2], [0, 0, 1]]), np.eye(4))
    alpha = render.draw(one_gaussian((0, 0, 1.0), scales=[[1e3] * 3]), camera).alpha
    assert alpha.shape == size[::-1] and float(alpha.min()) > 0.7


@pytest.mark.parametrize("exposure", [NEUTRAL, (1.5, 1.0, 0.5)])
@pytest.mark.parametrize("band", [1, 300, 2**22])
def test_images_drawn_in_bands_have_the_same_bits(
    band: int, exposure: tuple[float, float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(render, "_PIXELS_AT_ONCE", band)
    camera = replace(plain_camera(70, 50), exposure=exposure)
    scene = random_gaussians(camera, 200), camera, (0.1, 0.2, 0.3)
    np.testing.assert_array_equal(render.render_image(*scene), render.to_uint8(render.draw(*scene).rgb))
