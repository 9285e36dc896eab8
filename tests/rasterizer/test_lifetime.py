"""What a drawing holds on to, and for how long."""

import gc
import os
from collections.abc import Callable, Iterator
from dataclasses import replace

import pytest
import torch
from support.builders import odd_camera, random_gaussians, run_python
from support.torch_drawing import BACKGROUND, EVERYTHING, draw_with_gradients, image_weights, tensors

from frog_blender.engine.gaussians import ATTRIBUTES
from frog_blender.engine.native import binding
from frog_blender.engine.playback.render import draw
from frog_blender.engine.rasterizer import GaussianArrays, RasterizeOptions, rasterize

CAMERA = odd_camera()


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
    gaussians = tensors(random_gaussians(CAMERA, 20))
    image = rasterize(gaussians, CAMERA, BACKGROUND, EVERYTHING)
    assert num_frames() == 1  # its backward pass may still come
    del image
    assert num_frames() == 0
    draw_with_gradients(random_gaussians(CAMERA, 20), CAMERA, "cpu")
    assert num_frames() == 0
    constant = {name: getattr(gaussians, name).detach() for name in ATTRIBUTES if name != "means"}
    for scene in (gaussians, replace(gaussians, **constant)):  # of all attributes, and of one
        image = rasterize(scene, CAMERA)
        assert num_frames() == 1
        image.rgb.sum().backward()
        del image
        assert num_frames() == 0
    with torch.no_grad():
        image = rasterize(gaussians, CAMERA, BACKGROUND)
    drawing = draw(random_gaussians(CAMERA, 20), CAMERA)
    assert num_frames() == 0 and image.rgb.shape == drawing.rgb.shape


def test_gaussians_changed_before_the_backward_pass_are_refused() -> None:
    """The frame would read the new numbers: gradients of an image that was never drawn."""
    gaussians = tensors(random_gaussians(CAMERA, 20))
    scales = gaussians.scales * 1.0
    image = rasterize(replace(gaussians, scales=scales), CAMERA, BACKGROUND)
    scales.detach().mul_(2)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        image.rgb.sum().backward()


def test_the_backward_pass_outlives_everything_else_that_named_its_input() -> None:
    """The frame reads the Gaussians again in its backward pass: they must still be there."""
    expected = draw_with_gradients(random_gaussians(CAMERA, 200), CAMERA, "cpu")[1]["means"]
    means = torch.tensor(random_gaussians(CAMERA, 200).means, dtype=torch.float32, requires_grad=True)

    def drawn() -> torch.Tensor:
        others = tensors(random_gaussians(CAMERA, 200))
        passing = [getattr(others, name) * 1 for name in ATTRIBUTES[1:]]  # named by nobody else
        image = rasterize(GaussianArrays(means * 1, *passing), CAMERA, BACKGROUND)
        by_rgb, by_alpha = (weights.float() for weights in image_weights(CAMERA))
        return (image.rgb * by_rgb).sum() + (image.alpha * by_alpha).sum()

    loss = drawn()
    _ = [torch.full((200, 16, 3), 7.0) for _ in range(50)]  # would land in freed memory
    loss.backward()
    torch.testing.assert_close(means.grad, torch.from_numpy(expected))


def test_a_frame_drawn_for_no_way_back_has_none() -> None:
    gaussians = random_gaussians(CAMERA, 20).checked()
    image = RasterizeOptions().new_image(CAMERA, 20)
    frame = binding.Frame(gaussians, CAMERA, BACKGROUND, RasterizeOptions(), image)
    with pytest.raises(ValueError, match="expected differentiable=True"):
        frame.backward(image["rgb"], None, {})


def test_gradients_of_a_strided_or_missing_loss() -> None:
    """torch hands over whatever gradient it has: expanded, transposed, or none for alpha."""
    gaussians = random_gaussians(CAMERA, 60)
    leaves, copies = tensors(gaussians), tensors(gaussians)
    rasterize(leaves, CAMERA, BACKGROUND).rgb.sum().backward()
    image = rasterize(copies, CAMERA, BACKGROUND)
    (image.rgb.permute(2, 1, 0).contiguous().sum() + 0 * image.alpha.sum()).backward()
    torch.testing.assert_close(leaves.means.grad, copies.means.grad)
    alone = tensors(gaussians)
    rasterize(alone, CAMERA, BACKGROUND).alpha.sum().backward()
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
    done = run_python(script)
    assert done.returncode == 0, done.stderr
