"""Between display-referred and scene-linear colour."""

from __future__ import annotations

import numpy as np

from frog_blender.color_spaces import image_to_linear, to_display, to_linear


def test_there_and_back():
    values = np.linspace(0, 1.5, 1000, dtype=np.float32)
    np.testing.assert_allclose(to_display(to_linear(values)), values, atol=1e-5)


def test_the_table_for_images_is_as_exact_as_it_says():
    image = np.random.default_rng(0).random((100, 100, 3)).astype(np.float32)
    image[0, 0], image[0, 1] = 0.0, 1.0
    np.testing.assert_allclose(image_to_linear(image), to_linear(image), atol=2e-5)
    assert image_to_linear(image).dtype == np.float32
    assert (image_to_linear(image)[0, :2] == [[0.0] * 3, [1.0] * 3]).all()
