"""Extension modules, torch's too, are loaded without Python's lock before they are imported, and work as ever."""

import subprocess
import sys
from pathlib import Path

import pytest
from support.builders import run_python

from frog_blender.engine import preloading

OPENCV = """
import sys
from frog_blender.engine import preloading
opened, really_open = [], preloading.open_library
preloading.open_library = lambda path: opened.append(really_open(path))
preloading.open_extension("cv2")
assert opened == [True]
assert "cv2" not in sys.modules, "Python has not imported it"
import cv2, numpy
assert cv2.resize(numpy.ones((4, 4), numpy.uint8), (2, 2)).tolist() == [[1, 1], [1, 1]]
preloading.open_extension("cv2")
assert opened == [True], "where it is imported there is nothing to do"
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Python does it itself there")
def test_opencv_is_imported_after_its_library() -> None:
    pytest.importorskip("cv2")
    done = subprocess.run([sys.executable, "-c", OPENCV], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", ["frog_no_such_package", "this"])
def test_what_has_no_extension_is_left_to_the_import(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(preloading, "open_library", lambda path: pytest.fail(f"{path} was loaded"))
    preloading.open_extension(name)


@pytest.mark.skipif(sys.platform == "win32", reason="not loaded by us there")
def test_a_broken_library_is_left_to_the_import(tmp_path: Path) -> None:
    broken = tmp_path / "broken.so"
    broken.write_bytes(b"not a library")
    assert not preloading.open_library(broken)
    assert not preloading.open_library(tmp_path / "missing.so")


FIRST = """
import sys
from frog_blender.engine.training import torch_libraries
assert "torch" not in sys.modules
loaded = torch_libraries.load()
assert "torch" not in sys.modules, "Python has not imported it"
import torch
assert float(torch.ones(8).sum()) == 8.0
assert not torch_libraries.load(), "where torch is loaded there is nothing to do"
print(loaded)
"""
WITHOUT = """
import sys
sys.modules["torch"] = None
from frog_blender.engine.training import torch_libraries
assert not torch_libraries.load()
del sys.modules["torch"]
sys.path[:] = [each for each in sys.path if "site-packages" not in each]
print(torch_libraries.load())
"""


@pytest.mark.skipif(sys.platform == "win32", reason="torch does it itself there")
@pytest.mark.parametrize(("script", "loaded"), [(FIRST, "True"), (WITHOUT, "False")], ids=["there", "not there"])
def test_torch_is_imported_after_its_libraries(script: str, loaded: str) -> None:
    run = run_python(script)
    assert (run.returncode, run.stdout.strip()) == (0, loaded), run.stderr
