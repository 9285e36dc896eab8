"""The same input gives the same bits, whatever the number of threads and whoever else draws."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from support.builders import join, odd_camera, one_gaussian, random_gaussians
from support.equality import assert_same_bits
from support.torch_drawing import draw_with_gradients, native_image

from frog_blender.engine.native import binding
from frog_blender.engine.rasterizer import GaussianArrays, RasterizeOptions

CAMERA = odd_camera(75, 51)


@pytest.fixture(scope="module")
def crowd() -> GaussianArrays:
    """More Gaussians than one thread's share of the projection, some at exactly the same depth."""
    gaussians = random_gaussians(CAMERA, 3000, 1, seed=8)
    gaussians.means[1500:2000] = gaussians.means[:500]
    return gaussians


def test_any_number_of_threads(crowd: GaussianArrays, same_on_threads: Callable[..., None]) -> None:
    """Also of more than one block of the sorting: 8192 are counted and placed separately, many at the same depth."""
    many = random_gaussians(CAMERA, 20_000, 0, seed=3, opacity=(0.02, 0.1))
    many.means[::2] = many.means[1]

    same_on_threads(lambda: [*native_image(crowd, CAMERA).values(), *with_everything(crowd).values()])
    same_on_threads(lambda: native_image(many, CAMERA).values())


def test_ties_in_depth_are_broken_by_index() -> None:
    """Two sheets at one place: the first in the list lies in front."""
    place = CAMERA.unproject(np.array([[37.0, 25.0]]), np.array([3.0]))[0]
    wide = {"scales": [[100.0] * 3], "opacities": [0.9]}
    white, black = (one_gaussian(tuple(place), sh=[[[grey] * 3]], **wide) for grey in (1.7, -1.7))
    assert native_image(join(white, black), CAMERA)["rgb"].min() > 0.85
    assert native_image(join(black, white), CAMERA)["rgb"].max() < 0.15


def test_two_python_threads_at_once(crowd: GaussianArrays) -> None:
    scenes = crowd, random_gaussians(CAMERA, 2000, 0, seed=9)
    expected = [native_image(scene, CAMERA) for scene in scenes]
    with ThreadPoolExecutor(2) as pool:
        images = list(pool.map(lambda turn: native_image(scenes[turn % 2], CAMERA), range(12)))
    for turn, image in enumerate(images):
        assert_same_bits(image, expected[turn % 2])


def with_everything(gaussians: GaussianArrays) -> dict[str, np.ndarray]:
    """Gradients of every kind that there is."""
    pose = CAMERA.world_to_camera
    return draw_with_gradients(gaussians, CAMERA, "cpu", options=RasterizeOptions(), pose=pose)[1]


@pytest.mark.parametrize("slots", [1, 500, 3000])
def test_bands_have_the_bits_of_the_whole(
    crowd: GaussianArrays, slots: int, monkeypatch: pytest.MonkeyPatch, set_thread_count: Callable[[int], None]
) -> None:
    """Backward passes of large frames go through the tile rows in bands, to bound their memory: of one row each, and of
    one or two. Each Gaussian's tiles are still added up in the same order."""
    set_thread_count(1)
    whole = with_everything(crowd)
    monkeypatch.setattr(binding, "SLOT_LIMIT", slots)
    for threads in (1, 2, 7):
        set_thread_count(threads)
        assert_same_bits(with_everything(crowd), whole)
