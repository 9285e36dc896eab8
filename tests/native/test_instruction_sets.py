"""Kernels compiled for different processors round and sum differently, and nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.builders import run_python

DRAW = """
import sys
import numpy as np
from support.builders import odd_camera, plain_camera, random_gaussians
from frog_blender.engine.rasterizer import RasterizeOptions
from frog_blender.engine.native import binding

found = {}


def draw(scene, camera, gaussians, options=RasterizeOptions(), limited=False):
    random, count = np.random.default_rng(0), len(gaussians)
    _, _, width, height = options.region_of(camera)
    image = {"rgb": np.empty((height, width, 3), np.float32), "alpha": np.empty((height, width), np.float32)}
    extras = {"mean_depth": np.empty((height, width), np.float32), "radii": np.empty(count, np.float32)}
    extras["median_index"] = np.empty((height, width), np.int32)
    extras["max_weights"] = np.empty(count, np.float32)
    gaussians = gaussians.checked()
    limit = np.float32(random.uniform(1, 5, (height, width))) if limited else None
    frame = binding.Frame(gaussians, camera, (0.3, 0.6, 0.1), options, {**image, **extras}, limit, differentiable=True)
    gradients = {name: np.empty_like(value) for name, value in vars(gaussians).items()}
    gradients["screen"], gradients["pose"] = np.empty((count, 2), np.float32), np.empty((3, 4), np.float32)
    by_rgb, by_alpha = (np.float32(random.normal(size=image[name].shape)) for name in ("rgb", "alpha"))
    frame.backward(by_rgb, by_alpha, gradients)
    for kind, arrays in (("image", {**image, **extras}), ("gradient", gradients)):
        found.update({f"{scene}/{kind}/{name}": array for name, array in arrays.items()})


camera = odd_camera(75, 51)
for degree in range(4):
    draw(f"degree {degree}", camera, random_gaussians(camera, 300, degree, seed=8))
needles = random_gaussians(camera, 100, 0, seed=2)
needles.scales[:] = 0.4, 0.02, 0.02
draw("needles", camera, needles)
draw("limits", camera, random_gaussians(camera, 300, 1, seed=9), limited=True)
draw("region", camera, random_gaussians(camera, 300, 1, seed=9), RasterizeOptions(region=(13, 7, 41, 22)))
draw("nothing", camera, random_gaussians(camera, 0, 1))
np.savez(sys.argv[1], **found)
print(binding.instruction_set())
"""


def relative_difference(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.linalg.norm(found - expected) / max(float(np.linalg.norm(expected)), 1e-6))


def test_instruction_sets_agree(tmp_path: Path) -> None:
    results: dict[str, dict[str, np.ndarray]] = {}
    for wanted in ("baseline", "avx2", "avx512"):  # a processor without it takes the next smaller one
        run = run_python(DRAW, tmp_path / "drawn.npz", FROG_INSTRUCTION_SET=wanted)
        assert run.returncode == 0, run.stderr
        with np.load(tmp_path / "drawn.npz") as archive:
            results[run.stdout.strip()] = dict(archive)
    assert "baseline" in results
    if len(results) == 1:
        pytest.skip("this processor has the baseline only")
    baseline = results.pop("baseline")
    for instruction_set, result in results.items():
        assert result.keys() == baseline.keys()
        for name, expected in baseline.items():
            where, found = (instruction_set, name), result[name]
            if name.endswith("median_index"):
                assert float(np.mean(found != expected, dtype=float)) <= 3e-4 if expected.size else True, where
            elif "/gradient/" in name:
                assert relative_difference(found, expected) < 1e-5, where
            else:
                np.testing.assert_allclose(found, expected, atol=1e-5, rtol=1e-5, err_msg=str(where))
