"""Gaussians that cannot be drawn: nothing crashes, no neighbour changes, gradients stay where they belong."""

import numpy as np
import pytest
import torch
from support.builders import join, odd_camera, plain_camera, random_gaussians
from support.equality import assert_neighbours_stay
from support.strange_gaussians import STRANGE
from support.torch_drawing import draw_with_gradients, tensors

from frog_blender.engine.gaussians import ATTRIBUTES
from frog_blender.engine.rasterizer import rasterize

CAMERA = plain_camera()  # at the origin, looking along +z


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_what_cannot_be_drawn_changes_no_neighbour(backend: str) -> None:
    assert_neighbours_stay(CAMERA, backend)


@pytest.mark.parametrize("name", STRANGE)
def test_what_is_strange_leaves_a_finite_image(name: str) -> None:
    image, gradients = draw_with_gradients(join(STRANGE[name], random_gaussians(CAMERA, 30, 0, seed=7)), CAMERA, "cpu")
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
