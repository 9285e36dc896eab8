"""Kernels compiled for different processors round and sum differently, and nothing else."""

from pathlib import Path

import numpy as np
import pytest
from support.builders import run_python
from support.equality import assert_equal, scenes
from support.torch_drawing import relative_error

Arrays = dict[str, np.ndarray]
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
DEFORM = """
import sys
import numpy as np
from support.deformation_fields import field_arrays, in_groups, output_arrays
from frog_blender.engine.native import binding
from frog_blender.engine.native.deformation import FieldShape, PlaybackField, deform, deform_backward

found = {}
cases = [(33, 3, 0, "unit", 1), (33, 3, 24, "paper", 1), (64, 32, 0, "off", 1)]
cases += [(33, 3, 24, "unit", 2), (64, 8, 0, "unit", 2)]
for case, (hidden, embedding, head, form, networks) in enumerate(cases):
    shape = FieldShape(head, 9, 4, form, 10.0, 0.6, 0.5, networks)
    arrays, result = field_arrays(shape, hidden, embedding, seed=case), output_arrays(shape, 500, changes=True)
    random = np.random.default_rng(case)
    by = {name: np.float32(random.normal(size=array.shape)) for name, array in result.items() if name != "changes"}
    gradients = {name: np.empty_like(array) for name, array in arrays.items()}
    deform(shape, arrays, result)
    deform_backward(shape, arrays, by, gradients)
    found |= {f"{case}/{name}": array for name, array in result.items()}
    found |= {f"{case}/gradient/{name}": array for name, array in gradients.items()}
    if head == 0:
        for kept in (False, True):
            played = {name: np.zeros_like(array) for name, array in output_arrays(shape, 500).items()}
            PlaybackField(shape, in_groups(shape, arrays, kept), kept).deform({}, played)
            found |= {f"{case}/played/{kept}/{name}": array for name, array in played.items()}
np.savez(sys.argv[1], **found)
print(binding.instruction_set())
"""


def saved_by(script: str, path: Path) -> tuple[Arrays, list[Arrays]]:
    """What a script saves by the baseline's kernels, and by those for larger processors that this one is."""
    results: dict[str, Arrays] = {}
    for instruction_set in ("baseline", "avx2", "avx512"):  # or the next smaller one
        run = run_python(script, path, FROG_INSTRUCTION_SET=instruction_set)
        assert run.returncode == 0, run.stderr
        with np.load(path) as archive:
            results[run.stdout.strip()] = dict(archive)
    baseline = results.pop("baseline")
    if not results:
        pytest.skip("this processor has the baseline only")
    return baseline, list(results.values())


def test_drawings_agree(tmp_path: Path) -> None:
    baseline, others = saved_by(DRAW, tmp_path / "drawn.npz")
    for arrays in others:
        for name, scene in scenes().items():
            found, expected = (
                {key.split("/")[1]: array for key, array in each.items() if key.startswith(f"{name}/")}
                for each in (arrays, baseline)
            )
            assert_equal(scene, found, expected, gradient_error=1e-5)
        for name in (name for name in baseline if name.startswith("limits/")):
            np.testing.assert_allclose(arrays[name], baseline[name], atol=1e-5, rtol=1e-5, err_msg=name)


def test_deformed_gaussians_agree(tmp_path: Path) -> None:
    baseline, others = saved_by(DEFORM, tmp_path / "deformed.npz")
    for arrays in others:
        for name, expected in baseline.items():
            assert relative_error(arrays[name], expected) < 1e-5, name
