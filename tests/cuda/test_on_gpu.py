"""The CUDA kernels on a real GPU: the scenes of the emulated tests, and what only a device can show."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import torch
from support.builders import odd_camera, one_gaussian, plain_camera, random_gaussians
from support.equality import CUDA_ERROR, Scene, assert_equal, assert_same_bits, draw, of_other_degrees, scenes
from support.field_gradients import assert_as_reference, gradients_by
from support.random_models import model_of
from support.torch_drawing import BACKGROUND, EVERYTHING, tensors

from frog_blender.engine.gaussians import ATTRIBUTES
from frog_blender.engine.model.deformation import FrogSettings
from frog_blender.engine.model.interface import ScheduleState
from frog_blender.engine.rasterizer import GaussianArrays, rasterize
from frog_blender.engine.rasterizer.cuda_frame import try_frames
from frog_blender.engine.training.optimize.trial import try_step

pytestmark = [
    pytest.mark.skipif(not torch.cuda.is_available(), reason="torch sees no CUDA device"),
    pytest.mark.usefixtures("compiler"),
]
SCENES = scenes() | of_other_degrees()


def on_gpu(gaussians: GaussianArrays) -> GaussianArrays:
    leaves = tensors(gaussians)
    return leaves.mapped(lambda leaf: leaf.detach().cuda().requires_grad_())


@pytest.mark.parametrize("name", SCENES)
def test_agrees_with_the_reference(name: str) -> None:
    scene = SCENES[name]
    assert_equal(scene, draw(scene, "cuda", torch.float32, "cuda"), draw(scene, "reference", torch.float64), CUDA_ERROR)


@pytest.mark.parametrize("name", ["off-centre, degree 3", "pose", "giants"])
def test_the_same_bits_in_every_run(name: str) -> None:
    first = draw(SCENES[name], "cuda", torch.float32, "cuda")
    for _ in range(5):
        assert_same_bits(draw(SCENES[name], "cuda", torch.float32, "cuda"), first)


def test_automatic_for_float32_on_a_gpu() -> None:
    camera = plain_camera(33, 33)
    gaussians = on_gpu(one_gaussian((0, 0, 2.0), scales=[[100.0, 100.0, 100.0]], opacities=[0.6]))
    image = rasterize(gaussians, camera, (0.25, 0.25, 0.25))
    assert image.rgb.device.type == "cuda"
    expected = 0.6 * (0.5 + 0.5 * 0.28209479) + 0.4 * 0.25
    np.testing.assert_allclose(image.rgb[16, 16].detach().cpu().numpy(), expected, atol=1e-5)


def test_a_large_image_and_many_gaussians_agree_with_the_cpu() -> None:
    """Against the native library, which the reference vouches for."""
    camera = odd_camera(3000, 3000)
    scene = Scene(camera, random_gaussians(camera, 20_000, 1, seed=1), EVERYTHING)
    found, expected = draw(scene, "cuda", torch.float32, "cuda"), draw(scene, "cpu", torch.float32)
    assert float(np.abs(found["rgb"] - expected["rgb"]).mean()) < 1e-5
    for name in ATTRIBUTES:
        difference = np.linalg.norm(found[f"by_{name}"] - expected[f"by_{name}"])
        assert difference < 1e-3 * np.linalg.norm(expected[f"by_{name}"]), name


@pytest.mark.parametrize(("fusion", "embedding", "deformed"), [("product", 40, 1), ("dual", 32, 1), ("concat", 64, 16)])
def test_a_field_and_its_gradients(fusion: str, embedding: int, deformed: int) -> None:
    """Of more Gaussians than the backward pass's blocks hold at once; the same bits in every run."""
    sizes = {"embedding_size": embedding, "deformed_sh": deformed, "fusion": fusion}
    model = model_of(FrogSettings(30, 10, modulation=True, **sizes), 100_000, moving=70_000).cuda()
    found = assert_as_reference(model, ScheduleState(0.5, 0.7), 0.3, error=3e-3)
    for _ in range(3):
        again = gradients_by(model, ScheduleState(0.5, 0.7), 0.3, True)
        assert all(np.array_equal(values, again[name]) for name, values in found.items())


def test_frames_are_the_native_librarys() -> None:
    try_frames(torch.device("cuda"))


def test_other_streams_and_threads() -> None:
    camera = odd_camera(97, 71)
    gaussians = on_gpu(random_gaussians(camera, 400, 1, seed=1))
    expected = rasterize(gaussians, camera, BACKGROUND).rgb.detach()
    torch.cuda.synchronize()

    def work(_: int) -> list[bool]:
        equal = []
        with torch.cuda.stream(torch.cuda.Stream()):
            for _ in range(10):
                image = rasterize(gaussians, camera, BACKGROUND)
                torch.autograd.grad(image.rgb.sum(), gaussians.means)
                equal.append(torch.equal(image.rgb.detach(), expected))
        return equal

    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(work, range(2))) == [[True] * 10] * 2


def test_nothing_is_kept_after_the_backward_pass() -> None:
    camera = odd_camera(97, 71)
    gaussians = on_gpu(random_gaussians(camera, 2000, 1, seed=1))
    used = []
    for _ in range(3):
        image = rasterize(gaussians, camera, BACKGROUND, EVERYTHING)
        image.rgb.sum().backward()
        del image
        torch.cuda.synchronize()
        used.append(torch.cuda.memory_allocated())
    assert used[1] == used[2]


def test_a_step_is_what_plain_torch_finds() -> None:
    try_step(torch.device("cuda"))
