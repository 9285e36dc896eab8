"""NVIDIA's run-time compiler through ctypes: finds the library and turns CUDA C++ into machine code.

Why not a package: the CUDA wheel of torch already brings NVRTC in the version that fits its driver interface, and
a dozen C functions are all there is to call. ``cuda-bindings`` and ``cuda-core`` are well kept, but are 15 MB of
compiled wheels for each Python and CUDA version, which the extension would have to bundle and match to torch's CUDA;
CuPy is larger still; ``torch.cuda._compile_kernel`` is private, wants a CUDA toolkit's headers and passes no structs.
The interface used here has not changed since CUDA 11.1.
"""

import ctypes
import functools
import importlib.util
import os
import re
import sys
from collections.abc import Iterable, Iterator
from ctypes import byref, c_char_p, c_int, c_size_t, c_void_p
from pathlib import Path

from ..errors import FrogError
from .sources import Kernel


def package_folders() -> Iterator[Path]:
    """Where wheels put CUDA's libraries: ``nvidia/*/lib`` (``bin`` on Windows) and ``torch/lib``."""
    for package, patterns in (("nvidia", ("*/lib", "*/bin", "*/bin/x86_64")), ("torch", ("lib",))):
        spec = importlib.util.find_spec(package)
        for root in (spec.submodule_search_locations or ()) if spec else ():
            for pattern in patterns:
                yield from sorted(Path(root).glob(pattern))


def library_candidates(folders: Iterable[Path], cuda_version: str | None) -> list[str]:
    """Paths and names to try, best first: of torch's own CUDA version, then the newest.

    Args:
        folders: searched for the library.
        cuda_version: such as "12.8", that torch was built with; or None.
    """
    if os.environ.get("FROG_NVRTC"):
        return [os.environ["FROG_NVRTC"]]
    name = re.compile(r"nvrtc64_(\d+)0_\d+\.dll" if sys.platform == "win32" else r"libnvrtc\.so\.(\d+)")
    libraries = []
    for folder in folders:
        libraries += [(int(match[1]), str(path)) for path in folder.iterdir() if (match := name.fullmatch(path.name))]
    own = int(cuda_version.split(".")[0]) if cuda_version else None
    libraries.sort(key=lambda entry: (entry[0] != own, -entry[0]))
    pattern = "nvrtc64_{}0_0.dll" if sys.platform == "win32" else "libnvrtc.so.{}"
    plain = [(major, pattern.format(major)) for major in (13, 12)]
    plain.sort(key=lambda entry: entry[0] != own)
    return [path for _, path in [*libraries, *plain]]


def torch_cuda_version() -> str | None:
    """Such as "12.8"; None without torch or CUDA. Does not import torch by itself."""
    return getattr(getattr(sys.modules.get("torch"), "version", None), "cuda", None)


class Compiler:
    """A loaded NVRTC.

    Attributes:
        path: of the library.
        version: such as (12, 9).
        architectures: compute capabilities it compiles for, such as 75 and 90, ascending.
    """

    def __init__(self, path: str) -> None:
        """OSError when the library cannot be loaded or is no NVRTC."""
        self.path = path
        if sys.platform == "win32" and os.path.isabs(path):
            os.add_dll_directory(str(Path(path).parent))  # its built-in functions lie beside it
        # Its functions need no declared types: they are given bytes, ctypes objects and ints, and return a status.
        self._library = ctypes.CDLL(path)
        major, minor, count = c_int(), c_int(), c_int()
        try:
            self._library.nvrtcGetErrorString.restype = c_char_p
            self._check(self._library.nvrtcVersion(byref(major), byref(minor)))
            self._check(self._library.nvrtcGetNumSupportedArchs(byref(count)))
        except AttributeError as error:
            raise OSError(f"{path}: {error}") from error
        self.version = major.value, minor.value
        architectures = (c_int * count.value)()
        self._check(self._library.nvrtcGetSupportedArchs(architectures))
        self.architectures = tuple(sorted(architectures))

    def _check(self, status: int) -> None:
        if status:
            reason = self._library.nvrtcGetErrorString(status).decode()
            raise FrogError(f"{self.path}: the CUDA compiler failed ({reason}).")

    def target(self, capability: int) -> str:
        """``sm_90`` for a GPU of compute capability 9.0; ``compute_..`` (for the driver to finish) if it is too new."""
        if capability in self.architectures:
            return f"sm_{capability}"
        older = [architecture for architecture in self.architectures if architecture < capability]
        if not older:
            own, oldest = (f"{version // 10}.{version % 10}" for version in (capability, self.architectures[0]))
            raise FrogError(f"The GPU has compute capability {own}; this version of CUDA starts at {oldest}.")
        return f"compute_{older[-1]}"

    def build(self, kernel: Kernel, target: str) -> bytes:
        """Machine code (or PTX text for a ``compute_`` target) of one kernel.

        FrogError when it does not compile: one sentence, then the compiler's log.
        """
        texts = kernel.headers
        program = c_void_p()
        contents = (c_char_p * len(texts))(*[text.encode() for text in texts.values()])
        names = (c_char_p * len(texts))(*[name.encode() for name in texts])
        create = self._library.nvrtcCreateProgram
        self._check(
            create(byref(program), kernel.source.encode(), kernel.path.name.encode(), len(texts), contents, names)
        )
        try:
            options = [f"--gpu-architecture={target}", *kernel.options]
            status = self._library.nvrtcCompileProgram(
                program, len(options), (c_char_p * len(options))(*[option.encode() for option in options])
            )
            if status:
                log = self._get(program, "ProgramLog").rstrip(b"\0").decode(errors="replace")
                raise FrogError(f"The CUDA kernel {kernel} did not compile for {target}.") from RuntimeError(log)
            return self._get(program, "CUBIN" if target.startswith("sm_") else "PTX")
        finally:
            self._library.nvrtcDestroyProgram(byref(program))

    def _get(self, program: c_void_p, what: str) -> bytes:
        size = c_size_t()
        self._check(getattr(self._library, f"nvrtcGet{what}Size")(program, byref(size)))
        buffer = ctypes.create_string_buffer(size.value)
        self._check(getattr(self._library, f"nvrtcGet{what}")(program, buffer))
        return buffer.raw


@functools.cache
def compiler() -> Compiler:
    """The first NVRTC that loads; FrogError when there is none."""
    tried = library_candidates(package_folders(), torch_cuda_version())
    for candidate in tried:
        try:
            return Compiler(candidate)
        except OSError:
            continue
    raise FrogError(
        f"NVIDIA's run-time compiler (NVRTC) could not be loaded (tried {', '.join(tried)}); it comes "
        "with the CUDA build of torch, or install nvidia-cuda-nvrtc-cu12."
    )
