"""Loads torch's largest library before Python imports torch.

Python holds its global lock while it loads the libraries of an extension module: half a second or more for torch's, in
which no other thread runs Python, and Blender's window stands still. A foreign call does not hold it.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import sys
from pathlib import Path

_LIBRARIES = (("libtorch_global_deps", "RTLD_GLOBAL"), ("libtorch_cpu", "RTLD_LOCAL"))
"""As torch itself loads them: the first makes what they depend on visible to all. None of them calls Python."""


def load() -> bool:
    """Loads what there is of torch's libraries, which importing torch then finds loaded; true if there was any.

    Does nothing on Windows, where torch loads its libraries by foreign calls itself, and where torch is loaded.
    """
    if sys.platform == "win32" or "torch" in sys.modules:
        return False
    try:
        spec = importlib.util.find_spec("torch")
    except (ImportError, ValueError):  # half removed, or standing in for what is not there
        return False
    if spec is None or spec.origin is None:
        return False
    folder, ending = Path(spec.origin).parent / "lib", ".dylib" if sys.platform == "darwin" else ".so"
    open_library = ctypes.CDLL(None).dlopen
    open_library.restype, open_library.argtypes = ctypes.c_void_p, (ctypes.c_char_p, ctypes.c_int)
    loaded = False
    for name, scope in _LIBRARIES:
        path = folder / f"{name}{ending}"
        if path.is_file():  # a failure is torch's own to tell: it mends some, and says the others better
            loaded |= bool(open_library(os.fsencode(path), os.RTLD_NOW | getattr(os, scope)))
    return loaded
