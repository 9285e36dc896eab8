"""In the place of a GPU: kernels compiled with g++ run on the CPU, so that their arithmetic is tested anywhere."""

import ctypes
import shutil
import subprocess
import sys
from ctypes import c_char_p, c_int, c_uint, c_void_p
from pathlib import Path
from typing import Any

from frog_blender.engine.cuda.launch import THREADS, as_parameter
from frog_blender.engine.cuda.sources import KERNELS, SHARED, Kernel

HERE = Path(__file__).parent
COMPILER = shutil.which("g++") if sys.platform == "linux" else None  # fibers and sections as glibc and ELF have them
# No contraction: like nvcc with -fmad=false; blending says itself where it fuses. Plain _longjmp between stacks.
ROUNDING = ["-ffp-contract=off", "-fno-strict-aliasing"]
FLAGS = ["-std=c++17", "-O1", *ROUNDING, "-fPIC", "-shared", "-U_FORTIFY_SOURCE", "-w"]
INCLUDE = [f"-I{folder}" for folder in (HERE, KERNELS, SHARED)]


def build(source: Path, target: Path, *options: str) -> ctypes.CDLL:
    """A shared library from one C++ file; AssertionError with the compiler's output when it does not compile."""
    command = [str(COMPILER), *FLAGS, *INCLUDE, *options, str(source), "-o", str(target)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(target))


def _fused() -> list[str]:
    """Fused multiply-add in hardware where the machine has it: in software it is fifty times slower."""
    probe = subprocess.run([str(COMPILER), "-march=native", "-E", "-x", "c++", "/dev/null"], capture_output=True)
    return ["-march=native"] if probe.returncode == 0 else []


class Emulator:
    """As ``launch.Device``; tensors lie on the CPU.

    Attributes:
        folder: where the libraries are built.
        turned: threads run in the opposite order.
        memory: what the pretended device has, bytes.
        launched: kernels so far.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.reset()
        self._machine = _fused()
        self._libraries: dict[Kernel, ctypes.CDLL] = {}

    def reset(self) -> None:
        """As it was made, but for the libraries, which are kept."""
        self.turned, self.memory = False, 8 << 30
        self.launched: list[Kernel] = []

    def launch(self, kernel: Kernel, blocks: int, *arguments: Any) -> None:
        if not blocks:
            return
        self.launched.append(kernel)
        function = self.library(kernel).frog_launch
        function.argtypes, function.restype = [c_void_p, c_uint, c_uint, c_int], c_char_p
        parameters = [as_parameter(argument) for argument in arguments]
        addresses = (c_void_p * len(parameters))(*[ctypes.addressof(parameter) for parameter in parameters])
        problem = function(addresses, blocks, THREADS, self.turned)
        assert problem is None, f"{kernel}: {problem.decode()}"

    def library(self, kernel: Kernel) -> ctypes.CDLL:
        """The kernel, compiled for the CPU when it is first asked for."""
        if kernel not in self._libraries:
            constants = [f"-D{name}={value}" for name, value in kernel.constants]
            options = [*self._machine, f"-DKERNEL={kernel.name}", f'-DKERNEL_FILE="{kernel.path.name}"', *constants]
            name = "_".join([kernel.name, *[value for _, value in kernel.constants]])
            self._libraries[kernel] = build(HERE / "driver.cpp", self.folder / f"{name}.so", *options)
        return self._libraries[kernel]
