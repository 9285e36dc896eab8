"""FROG_NATIVE_LIBRARY may name anything: what is no native rasterizer of ours is a sentence."""

from __future__ import annotations

import ctypes.util
import os
from pathlib import Path

import pytest
from support.builders import run_python

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


def test_another_library(tmp_path: Path) -> None:
    name = ctypes.util.find_library("m")
    if name is None:
        pytest.skip("needs another library")
    assert "found another library" in said(name) and "expected the native rasterizer" in said(name)


def test_what_is_no_library(tmp_path: Path) -> None:
    (tmp_path / "text.so").write_text("text")
    assert "could not be loaded" in said(tmp_path / "text.so")
    assert "build it with 'make'" in said(tmp_path / "none.so")
    assert "found a folder" in said(tmp_path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes with names")
def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.so")
    assert "found a pipe" in said(tmp_path / "pipe.so")
