"""Machine code for kernels, kept on disk: compiled once for each source text, GPU architecture and compiler version.

The compiler is NVRTC through an own binding (``nvrtc.py`` says why).
"""

import hashlib
from contextlib import suppress
from pathlib import Path

from ..errors import FrogError
from ..io.atomic_files import write_atomically
from ..io.cache_folder import default_cache_folder
from . import nvrtc
from .sources import Kernel

_FORMAT = b"frog kernel 1\n"
_DIGEST = hashlib.sha256().digest_size


def machine_code(
    kernel: Kernel, capability: int, folder: Path | None = None, *, compiler: nvrtc.Compiler | None = None
) -> bytes:
    """What the driver loads for one kernel, from disk or freshly compiled.

    Args:
        kernel: which.
        capability: of the GPU, ten times the major plus the minor number (90 for 9.0).
        folder: the cache; by default ``kernels`` in the cache folder of this user.
        compiler: by default the first that loads.

    Raises:
        FrogError: no compiler was found, the GPU is too old, or the kernel does not compile.
    """
    compiler = compiler or nvrtc.compiler()
    target = compiler.target(capability)
    path = (folder or default_cache_folder() / "kernels") / _name(kernel, target, compiler.version)
    code = _read(path)
    if code is None:
        code = compiler.build(kernel, target)
        with suppress(FrogError):  # a folder that cannot be written only costs time at the next start
            write_atomically(path, _FORMAT + hashlib.sha256(code).digest() + code)
    return code


def _name(kernel: Kernel, target: str, version: tuple[int, int]) -> str:
    """A file name that changes with everything that decides the code."""
    parts = [kernel.source, *kernel.options, target, repr(version)]
    for name, text in kernel.headers.items():
        parts += [name, text]
    digest = hashlib.sha256("\0".join(parts).encode()).hexdigest()
    return f"{kernel.name}-{target}-{digest[:32]}.bin"


def _read(path: Path) -> bytes | None:
    """The code in a cache file; None when there is none or it is damaged."""
    try:
        data = path.read_bytes()
    except OSError:
        return None
    start = len(_FORMAT) + _DIGEST
    digest, code = data[len(_FORMAT) : start], data[start:]
    whole = data.startswith(_FORMAT) and code and hashlib.sha256(code).digest() == digest
    return code if whole else None
