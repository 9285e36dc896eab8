"""The native library of frog_blender, and where it lies."""

from __future__ import annotations

import sys
from pathlib import Path


def library_path() -> Path:
    """Where the library lies: beside this file."""
    name = {"win32": "frog_native.dll", "darwin": "libfrog_native.dylib"}.get(sys.platform, "libfrog_native.so")
    return Path(__file__).with_name(name)
