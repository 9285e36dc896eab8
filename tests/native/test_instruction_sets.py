"""Kernels compiled for different processors round and sum differently, and nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.builders import run_python
from support.equality import assert_equal, scenes

SCENES = scenes()
DRAW = """
import sys
import numpy as np, torch
from support.builders import odd_camera, random_gaussians
from support.equality import draw, scenes
from frog_blender.engine.native.binding import instruction_set
from frog_blender.engine.playback import render

outputs = {name: draw(scene, "cpu", torch.float32) for name, scene in scenes().items()}
camera = odd_camera(75, 51)
limit = np.random.default_rng(0).uniform(1, 5, (51, 75))
limited = render.draw(random_gaussians(camera, 300, 1, seed=9), camera, depth_limit=limit)
outputs["limits"] = {name: getattr(limited, name) for name in ("rgb", "alpha", "median_depth", "mean_depth")}
named = {f"{scene}/{name}": array for scene, arrays in outputs.items() for name, array in arrays.items()}
np.savez(sys.argv[1], **named)
print(instruction_set())
"""


def outputs_of(instruction_set: str, path: Path) -> tuple[str, dict[str, dict[str, np.ndarray]]]:
    """What was drawn by the kernels for a processor, or for the next smaller one, and the outputs by scene."""
    run = run_python(DRAW, path, FROG_INSTRUCTION_SET=instruction_set)
    assert run.returncode == 0, run.stderr
    outputs: dict[str, dict[str, np.ndarray]] = {}
    with np.load(path) as archive:
        for name, array in archive.items():
            scene, output = name.split("/")
            outputs.setdefault(scene, {})[output] = array
    return run.stdout.strip(), outputs


def test_instruction_sets_agree(tmp_path: Path) -> None:
    results = dict(outputs_of(name, tmp_path / "drawn.npz") for name in ("baseline", "avx2", "avx512"))
    baseline = results.pop("baseline")
    if not results:
        pytest.skip("this processor has the baseline only")
    for outputs in results.values():
        limited, expected = outputs.pop("limits"), baseline["limits"]
        for name, array in limited.items():
            np.testing.assert_allclose(array, expected[name], atol=1e-5, rtol=1e-5, err_msg=name)
        for name, arrays in outputs.items():
            assert_equal(SCENES[name], arrays, baseline[name], gradient_error=1e-5)
