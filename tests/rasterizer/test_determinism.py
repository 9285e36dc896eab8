"""The same input gives the same bits, whatever the number of threads and whoever else draws."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from drawing import native_picture
from helpers import join, odd_camera, one_gaussian, random_gaussians, run_python

from frog_blender.engine.rasterizer import GaussianArrays, native

CAMERA = odd_camera(75, 51)


@pytest.fixture(autouse=True)
def all_threads_afterwards() -> Iterator[None]:
    yield
    native.set_thread_count(0)


@pytest.fixture(scope="module")
def crowd() -> GaussianArrays:
    """More Gaussians than one thread's share of the projection, some at exactly the same depth."""
    gaussians = random_gaussians(CAMERA, 3000, 1, seed=8)
    gaussians.means[1500:2000] = gaussians.means[:500]
    return gaussians


def assert_same_bits(found: dict[str, np.ndarray], expected: dict[str, np.ndarray]) -> None:
    for name, values in expected.items():
        assert found[name].tobytes() == values.tobytes(), name


def test_one_two_and_three_threads(crowd: GaussianArrays) -> None:
    native.set_thread_count(1)
    expected = native_picture(crowd, CAMERA)
    assert native.library().frog_thread_count() == 1
    for threads in (2, 3, 1):
        native.set_thread_count(threads)
        assert native.library().frog_thread_count() == threads
        assert_same_bits(native_picture(crowd, CAMERA), expected)


def test_repeated_runs(crowd: GaussianArrays) -> None:
    expected = native_picture(crowd, CAMERA)
    for _ in range(3):
        assert_same_bits(native_picture(crowd, CAMERA), expected)


def test_ties_in_depth_are_broken_by_index() -> None:
    """Two sheets at one place: the first in the list lies in front."""
    place = CAMERA.unproject(np.array([[37.0, 25.0]]), np.array([3.0]))[0]
    wide = {"scales": [[100.0] * 3], "opacities": [0.9]}
    white, black = (one_gaussian(tuple(place), sh=[[[grey] * 3]], **wide) for grey in (1.7, -1.7))
    assert native_picture(join(white, black), CAMERA)["rgb"].min() > 0.85
    assert native_picture(join(black, white), CAMERA)["rgb"].max() < 0.15


def test_two_python_threads_at_once(crowd: GaussianArrays) -> None:
    other = random_gaussians(CAMERA, 2000, 0, seed=9)
    expected = [native_picture(crowd, CAMERA), native_picture(other, CAMERA)]
    found: list[list[dict[str, np.ndarray]]] = [[], []]

    def work(which: int) -> None:
        for _ in range(6):
            found[which].append(native_picture((crowd, other)[which], CAMERA))

    threads = [threading.Thread(target=work, args=(which,)) for which in (0, 1)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for which in (0, 1):
        assert len(found[which]) == 6
        for picture in found[which]:
            assert_same_bits(picture, expected[which])


DRAW = """
import sys, numpy as np
from helpers import odd_camera, random_gaussians
from frog_blender.engine.rasterizer import RasterizeOptions, native
camera, random = odd_camera(75, 51), np.random.default_rng(0)
gaussians = random_gaussians(camera, 300, 3, seed=8).checked()
size = (camera.height, camera.width)
rgb, alpha = np.empty((*size, 3), np.float32), np.empty(size, np.float32)
frame = native.Frame(gaussians, camera, (0.3, 0.6, 0.1), RasterizeOptions(), {"rgb": rgb, "alpha": alpha})
gradients = {name: np.empty_like(value) for name, value in vars(gaussians).items()}
gradients["screen"] = np.empty((300, 2), np.float32)
by_rgb, by_alpha = np.float32(random.normal(size=rgb.shape)), np.float32(random.normal(size=size))
frame.backward({"rgb": rgb, "alpha": alpha}, by_rgb, by_alpha, gradients)
np.savez(sys.argv[1], rgb=rgb, alpha=alpha, **gradients)
print(native.instruction_set())
"""


def test_instruction_sets_agree(tmp_path: Path) -> None:
    """Vector widths round and sum differently, and nothing else."""
    pictures = {}
    for wanted in ("baseline", "avx2", "avx512"):
        run = run_python(DRAW, tmp_path / "picture.npz", FROG_INSTRUCTION_SET=wanted)
        assert run.returncode == 0, run.stderr
        with np.load(tmp_path / "picture.npz") as archive:
            pictures[run.stdout.strip()] = dict(archive)
    assert "baseline" in pictures
    if len(pictures) == 1:
        pytest.skip("this processor has the baseline only")
    baseline = pictures.pop("baseline")
    for name, picture in pictures.items():
        assert np.abs(picture["rgb"] - baseline["rgb"]).max() < 1e-5, name
        for attribute in ("means", "quaternions", "scales", "opacities", "sh"):
            difference = np.linalg.norm(picture[attribute] - baseline[attribute])
            assert difference < 1e-5 * np.linalg.norm(baseline[attribute]), (name, attribute)
