"""torch's libraries are loaded without Python's lock, before torch is imported, and it works as ever."""

import sys

import pytest
from support.builders import run_python

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
