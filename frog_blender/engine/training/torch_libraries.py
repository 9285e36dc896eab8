"""Loads torch's largest libraries before Python imports torch, so that Blender's window does not wait for it."""

import sys

from ..preloading import open_library, package_file


def load() -> bool:
    """Loads what there is of torch's libraries, which importing torch then finds loaded; true if there was any.

    They are loaded as torch itself does it: the first makes what they depend on visible to all. None calls Python.
    """
    package = package_file("torch")
    if package is None:
        return False
    folder, ending = package.parent / "lib", ".dylib" if sys.platform == "darwin" else ".so"
    opened = open_library(folder / f"libtorch_global_deps{ending}", visible=True)
    opened = open_library(folder / f"libtorch_cpu{ending}") or opened
    return open_library(folder / f"libtorch_cuda{ending}") or opened
