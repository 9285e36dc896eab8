"""Loads the shared libraries of large packages without Python's global lock, before Python imports them.

Python holds its lock while it loads an extension module and the libraries that it needs: half a second or more for
some, in which no other thread runs Python, and Blender's window stands still. A foreign call does not hold it. What is
loaded so is found loaded by the import. Nothing is done on Windows, where Python itself lets its lock go.
"""

import ctypes
import importlib.util
import os
import sys
from pathlib import Path


def package_file(name: str) -> Path | None:
    """Where the package or module ``name`` is; none if it is imported already, is not installed or is half removed."""
    if sys.platform == "win32" or name in sys.modules:
        return None
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, ValueError):  # half removed, or standing in for what is not there
        return None
    return None if spec is None or spec.origin is None else Path(spec.origin)


def open_library(path: Path, visible: bool = False) -> bool:
    """Loads the library at ``path``, ``visible`` to those that are loaded later; whether it was loaded."""
    if not path.is_file():
        return False
    dlopen = ctypes.CDLL(None).dlopen
    dlopen.restype, dlopen.argtypes = ctypes.c_void_p, (ctypes.c_char_p, ctypes.c_int)
    scope = os.RTLD_GLOBAL if visible else os.RTLD_LOCAL
    return bool(dlopen(os.fsencode(path), os.RTLD_NOW | scope))


def open_extension(name: str) -> None:
    """Loads the extension module of the package ``name``; to import it is to initialize it, and says what is wrong.

    It may stand alone (``name.cpython-311-x86_64-linux-gnu.so``) or in a package's folder (``name/name.abi3.so``).
    """
    origin = package_file(name)
    if origin is not None:
        for file in [origin] if origin.suffix == ".so" else sorted(origin.parent.glob(f"{name}*.so")):
            open_library(file)
