"""The native library against the reference in float64: values, depths and gradients."""

import pytest
import torch
from support.builders import one_gaussian, plain_camera
from support.equality import assert_equal, draw, of_other_degrees, scenes
from support.torch_drawing import draw_with_gradients

SCENES = scenes() | of_other_degrees()


@pytest.mark.parametrize("name", SCENES)
def test_agrees_with_the_reference(name: str) -> None:
    scene, gradient_error = SCENES[name], 2e-5 if name == "needles" else 1e-5
    found, expected = draw(scene, "cpu", torch.float32), draw(scene, "reference", torch.float64)
    assert_equal(scene, found, expected, gradient_error)


def test_where_alpha_is_clamped_nothing_reaches_the_shape() -> None:
    """Around the centre of an opaque splat alpha is 0.999 whatever its size. Beyond one nothing changes."""
    for opacity in (0.9999, 1.5):
        wide = one_gaussian((0, 0, 2.0), scales=[[1e4, 1e4, 1e4]], opacities=[opacity])
        _, gradients = draw_with_gradients(wide, plain_camera(), "cpu")
        for attribute in ("means", "scales", "quaternions", "opacities"):
            assert not gradients[attribute].any(), attribute
        assert gradients["sh"].any()
