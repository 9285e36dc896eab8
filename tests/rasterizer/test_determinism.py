"""The same bits, whatever the threads and whoever else draws; and what a drawing holds on to, for how long."""

import gc
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import torch
from support.builders import odd_camera, one_gaussian, printed, random_gaussians, run_python
from support.equality import assert_same_bits
from support.torch_drawing import BACKGROUND, EVERYTHING, draw_with_gradients, image_weights, native_image, tensors

from frog_blender.engine.gaussians import ATTRIBUTES, joined
from frog_blender.engine.native import binding
from frog_blender.engine.playback.render import draw
from frog_blender.engine.rasterizer import GaussianArrays, RasterizeOptions, rasterize

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
    assert native_image(joined([white, black]), CAMERA)["rgb"].min() > 0.85
    assert native_image(joined([black, white]), CAMERA)["rgb"].max() < 0.15


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


ODD = odd_camera()


@pytest.fixture
def num_frames() -> Iterator[Callable[[], int]]:
    """Counts the native frames that are alive and were not before.

    Cyclic garbage collection is off: a cycle through a torch operation would not be collected anyway.
    """
    gc.freeze()  # what was there before is not looked at
    gc.disable()
    yield lambda: sum(type(held) is binding.Frame for held in gc.get_objects())
    gc.enable()
    gc.unfreeze()


def test_a_frame_goes_with_its_image_or_its_backward_pass(num_frames: Callable[[], int]) -> None:
    """Training draws thousands."""
    gaussians = tensors(random_gaussians(ODD, 20))
    image = rasterize(gaussians, ODD, BACKGROUND, EVERYTHING)
    assert num_frames() == 1  # its backward pass may still come
    del image
    assert num_frames() == 0
    draw_with_gradients(random_gaussians(ODD, 20), ODD, "cpu")
    assert num_frames() == 0
    constant = {name: getattr(gaussians, name).detach() for name in ATTRIBUTES if name != "means"}
    for scene in (gaussians, replace(gaussians, **constant)):  # of all attributes, and of one
        image = rasterize(scene, ODD)
        assert num_frames() == 1
        image.rgb.sum().backward()
        del image
        assert num_frames() == 0
    with torch.no_grad():
        image = rasterize(gaussians, ODD, BACKGROUND)
    drawing = draw(random_gaussians(ODD, 20), ODD)
    assert num_frames() == 0 and image.rgb.shape == drawing.rgb.shape


def test_gaussians_changed_before_the_backward_pass_are_refused() -> None:
    """The frame would read the new numbers: gradients of an image that was never drawn."""
    gaussians = tensors(random_gaussians(ODD, 20))
    scales = gaussians.scales * 1.0
    image = rasterize(replace(gaussians, scales=scales), ODD, BACKGROUND)
    scales.detach().mul_(2)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        image.rgb.sum().backward()


def test_the_backward_pass_outlives_everything_else_that_named_its_input() -> None:
    """The frame reads the Gaussians again in its backward pass: they must still be there."""
    expected = draw_with_gradients(random_gaussians(ODD, 200), ODD, "cpu")[1]["means"]
    means = torch.tensor(random_gaussians(ODD, 200).means, dtype=torch.float32, requires_grad=True)

    def drawn() -> torch.Tensor:
        others = tensors(random_gaussians(ODD, 200))
        passing = [getattr(others, name) * 1 for name in ATTRIBUTES[1:]]  # named by nobody else
        image = rasterize(GaussianArrays(means * 1, *passing), ODD, BACKGROUND)
        by_rgb, by_alpha = (weights.float() for weights in image_weights(ODD))
        return (image.rgb * by_rgb).sum() + (image.alpha * by_alpha).sum()

    loss = drawn()
    _ = [torch.full((200, 16, 3), 7.0) for _ in range(50)]  # would land in freed memory
    loss.backward()
    torch.testing.assert_close(means.grad, torch.from_numpy(expected))


def test_a_frame_drawn_for_no_way_back_has_none() -> None:
    gaussians = random_gaussians(ODD, 20).checked()
    image = RasterizeOptions().new_image(ODD, 20)
    frame = binding.Frame(gaussians, ODD, BACKGROUND, RasterizeOptions(), image)
    with pytest.raises(ValueError, match="expected differentiable=True"):
        frame.backward(image["rgb"], None, {})


def test_gradients_of_a_strided_or_missing_loss() -> None:
    """torch hands over whatever gradient it has: expanded, transposed, or none for alpha."""
    gaussians = random_gaussians(ODD, 60)
    leaves, copies = tensors(gaussians), tensors(gaussians)
    rasterize(leaves, ODD, BACKGROUND).rgb.sum().backward()
    image = rasterize(copies, ODD, BACKGROUND)
    (image.rgb.permute(2, 1, 0).contiguous().sum() + 0 * image.alpha.sum()).backward()
    torch.testing.assert_close(leaves.means.grad, copies.means.grad)
    alone = tensors(gaussians)
    rasterize(alone, ODD, BACKGROUND).alpha.sum().backward()
    assert float(alone.opacities.grad.abs().max()) > 0 and not alone.sh.grad.any()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
def test_a_forked_process_draws_with_threads_of_its_own() -> None:
    script = """
import os, sys
import numpy as np
from support.builders import plain_camera, random_gaussians
from frog_blender.engine.playback.render import draw
from frog_blender.engine.native import binding
binding.set_thread_count(3)
camera = plain_camera(64, 64)
gaussians = random_gaussians(camera, 3000)
expected = draw(gaussians, camera).rgb
if (child := os.fork()) == 0:
    os._exit(0 if np.array_equal(draw(gaussians, camera).rgb, expected) else 1)
status = os.waitpid(child, 0)[1]
assert np.array_equal(draw(gaussians, camera).rgb, expected)
sys.exit(os.waitstatus_to_exitcode(status))
"""
    printed(run_python(script))
