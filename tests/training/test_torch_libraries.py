"""torch's libraries are loaded without Python's lock, before torch is imported, and it works as ever."""

from __future__ import annotations

import subprocess
import sys

import pytest

SCRIPT = """
import sys, threading, time
from frog_blender.engine.training import torch_libraries
assert "torch" not in sys.modules
loaded = torch_libraries.load()
assert "torch" not in sys.modules, "Python has not imported it"
import torch
assert float(torch.ones(8).sum()) == 8.0
assert not torch_libraries.load(), "where torch is loaded there is nothing to do"
print(loaded)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="torch does it itself there")
def test_torch_is_imported_after_its_libraries() -> None:
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["True"]


def test_without_torch_there_is_nothing_to_load() -> None:
    script = """
import sys
sys.modules["torch"] = None
from frog_blender.engine.training import torch_libraries
assert not torch_libraries.load()
del sys.modules["torch"]
sys.path[:] = [each for each in sys.path if "site-packages" not in each]
assert not torch_libraries.load()
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
