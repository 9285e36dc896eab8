"""Where the native library is looked for, what addresses it is given, and how its kernels differ by processor."""

import ctypes.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from support.builders import printed, run_python
from support.equality import assert_equal, scenes
from support.torch_drawing import relative_error

from frog_blender.engine.native import binding
from frog_blender.engine.native.structs import address

DRAW = """
import sys
from frog_blender.engine.errors import FrogError
from frog_blender.engine.native.binding import library
try:
    library()
except FrogError as error:
    sys.exit(str(error))
"""


def said(library: object) -> str:
    run = run_python(DRAW, FROG_NATIVE_LIBRARY=str(library))
    assert run.returncode == 1 and run.stderr.count("\n") == 1, run.stderr
    assert str(library) in run.stderr
    return run.stderr


def test_what_is_no_library_of_ours(tmp_path: Path) -> None:
    (tmp_path / "text.so").write_text("text")
    assert "could not be loaded" in said(tmp_path / "text.so")
    assert "build it with 'make'" in said(tmp_path / "none.so")
    assert "found a folder" in said(tmp_path)
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.so")  # which is not waited for
        assert "found a pipe" in said(tmp_path / "pipe.so")
    if name := ctypes.util.find_library("m"):
        another = said(name)
        assert "found another library" in another
        assert "expected the native rasterizer; build it again with 'make'" in another


def test_a_library_of_another_version(tmp_path: Path) -> None:
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("needs a compiler")
    (tmp_path / "old.c").write_text("int frog_abi_version(void) { return 3; }")
    subprocess.run([compiler, "-shared", "-fPIC", "-o", tmp_path / "old.so", tmp_path / "old.c"], check=True)
    assert "found interface version 3, expected" in said(tmp_path / "old.so")


def test_the_program_that_draws_elsewhere_draws_here(tmp_path: Path) -> None:
    """tools/cross_build.py runs it under wine."""
    compiler = shutil.which("c++")
    if compiler is None or sys.platform == "win32":
        pytest.skip("needs a compiler")
    sources, program = Path(binding.__file__).parent / "src", tmp_path / "draw_one"
    source = Path(__file__).with_name("draw_one.cpp")
    subprocess.run([compiler, "-std=c++17", f"-I{sources}", source, "-o", program, "-ldl"], check=True)
    run = subprocess.run([program, binding.library_path()], capture_output=True, text=True)
    assert run.returncode == 0 and f"interface {binding.ABI_VERSION}, kernels" in run.stdout, run.stdout
    assert subprocess.run([program, source], capture_output=True).returncode == 1


WHERE = """
import sys
from frog_blender.engine.native import binding
binding.__file__, sys.path[:] = {file!r}, {folders!r}
print(binding.library_path())
"""


def where(file: Path, *folders: Path, **environment: str) -> Path:
    """Where the library is taken from by a binding in ``file``, with these folders to import from."""
    script = WHERE.format(file=str(file), folders=list(map(str, folders)))
    environment = {"FROG_NATIVE_LIBRARY": "", **environment}  # whatever these tests run on
    return Path(printed(run_python(script, **environment)).strip())


def test_where_it_is_looked_for(tmp_path: Path) -> None:
    package = tmp_path / "site" / "frog_blender_native"
    package.mkdir(parents=True)
    sources = Path(__file__).parents[2] / "packaging" / "native" / "frog_blender_native"
    shutil.copy2(sources / "__init__.py", package)
    beside, site = tmp_path / "binding.py", tmp_path / "site"
    name = where(beside).name
    assert where(beside) == tmp_path / name, "without the package, where a checkout has it"
    assert where(beside, site) == package / name
    installed = tmp_path / "packages" / "frog_blender" / "engine" / "native" / name
    installed.parent.mkdir(parents=True)
    installed.touch()
    assert where(beside, tmp_path / "packages") == installed, "which a clone hides, in which nothing was built"
    (tmp_path / name).touch()
    assert where(beside, site, tmp_path / "packages") == tmp_path / name
    assert where(beside, site, FROG_NATIVE_LIBRARY="another.so") == Path("another.so")


NUMBERS = np.arange(12, dtype=np.float32).reshape(3, 4)


def read_only(array: np.ndarray) -> np.ndarray:
    view = array.view()
    view.flags.writeable = False
    return view


@pytest.mark.parametrize(
    "array", [NUMBERS, NUMBERS[1:], NUMBERS[0, 0:0], NUMBERS[:, 1], NUMBERS.T, read_only(NUMBERS), np.float32([])]
)
def test_an_address_is_where_an_array_lies(array: np.ndarray) -> None:
    assert address(array) == array.ctypes.data


def test_no_array_has_no_address_and_a_tensor_its_own() -> None:
    tensor = torch.ones(2, 3)
    assert address(None) is None and address(tensor) == tensor.data_ptr()


def test_memory_can_be_given_back_afterwards() -> None:
    """Nothing holds on to what was asked for an address (see playback.buffer_pool)."""
    block = bytearray(8)
    assert address(np.frombuffer(block, np.float32)) is not None
    block.append(0)


Arrays = dict[str, np.ndarray]
DRAW_BY = """
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
        used = printed(run_python(script, path, FROG_INSTRUCTION_SET=instruction_set)).strip()
        with np.load(path) as archive:
            results[used] = dict(archive)
    baseline = results.pop("baseline")
    if not results:
        pytest.skip("this processor has the baseline only")
    return baseline, list(results.values())


def test_drawings_agree(tmp_path: Path) -> None:
    baseline, others = saved_by(DRAW_BY, tmp_path / "drawn.npz")
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
