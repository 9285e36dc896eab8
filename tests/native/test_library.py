"""Where the native library is looked for. What is none of ours, or of another version, is a sentence."""

import ctypes.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from support.builders import run_python

from frog_blender.engine.native import binding

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
    run = run_python(script, **({"FROG_NATIVE_LIBRARY": ""} | environment))  # whatever these tests run on
    assert run.returncode == 0, run.stderr
    return Path(run.stdout.strip())


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
