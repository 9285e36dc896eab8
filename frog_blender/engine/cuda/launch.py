"""Kernels on the device: the few functions of the CUDA driver that loading and launching take, through ctypes."""

import ctypes
import functools
import sys
import threading
from collections.abc import Callable
from ctypes import byref, c_char_p, c_float, c_int, c_int32, c_void_p
from typing import Any, TypeAlias

import torch

from ..errors import FrogError
from .compile import machine_code
from .sources import Kernel

THREADS = 256  # of every block; THREADS in kernels/common.cuh


def sent(numbers: torch.Tensor, device: torch.device) -> torch.Tensor:
    """A few numbers of the CPU on a device. From pinned memory their copy does not wait for what was queued before."""
    return (numbers.pin_memory() if device.type == "cuda" else numbers).to(device, non_blocking=True)


def blocks_for(threads: int) -> int:
    """Blocks that hold so many threads."""
    return -(-threads // THREADS)


Argument: TypeAlias = torch.Tensor | int | float | ctypes.Structure | None
Parameter: TypeAlias = c_void_p | c_int32 | c_float | ctypes.Structure


def as_parameter(argument: Argument) -> Parameter:
    """The ctypes object for one argument of ``Device.launch``."""
    if isinstance(argument, ctypes.Structure):
        return argument
    if isinstance(argument, int):
        return c_int32(argument)
    if isinstance(argument, float):
        return c_float(argument)
    return c_void_p(None if argument is None else argument.data_ptr())


DRIVER = "nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1"


@functools.cache
def load_driver(name: str = DRIVER) -> ctypes.CDLL:
    """The driver of this name or path; FrogError where it cannot be loaded.

    Its functions need no declared types: they are given bytes, ctypes objects and ints of 32 bits, and return a status.
    """
    try:
        return ctypes.CDLL(name)
    except OSError as error:
        raise FrogError(f"{name}: the CUDA driver could not be loaded ({error}).") from error


def _check(driver: ctypes.CDLL, status: int, action: str) -> None:
    if status:
        text = c_char_p()
        driver.cuGetErrorString(status, byref(text))
        reason = text.value.decode() if text.value else f"error {status}"
        raise FrogError(f"{action}: the CUDA driver refused ({reason}).")


class Device:
    """One GPU, in the context and on the streams that torch uses.

    Kernels are compiled and loaded when they are first launched. Any thread may launch.

    Args:
        index: torch's number of the GPU.
        driver: see ``load_driver``; loaded here by default.
        code: the machine code of a kernel for a compute capability, see ``machine_code``.
        cuda: torch's interface to its GPUs.

    Attributes:
        memory: of the GPU, bytes.
    """

    def __init__(
        self,
        index: int,
        *,
        driver: ctypes.CDLL | None = None,
        code: Callable[[Kernel, int], bytes] = machine_code,
        cuda: Any = torch.cuda,
    ) -> None:
        self._index, self._code, self._cuda = index, code, cuda
        properties = cuda.get_device_properties(index)
        self.memory: int = properties.total_memory
        self._capability = 10 * properties.major + properties.minor
        self._name = properties.name
        self._functions: dict[Kernel, c_void_p] = {}
        self._lock = threading.Lock()
        cuda.current_stream(index).synchronize()  # torch's context exists from here on
        self._driver = driver = driver or load_driver()
        device, self._context = c_int(), c_void_p()
        _check(driver, driver.cuInit(0), self._name)
        _check(driver, driver.cuDeviceGet(byref(device), index), self._name)
        _check(driver, driver.cuDevicePrimaryCtxRetain(byref(self._context), device), self._name)

    def launch(self, kernel: Kernel, blocks: int, *arguments: Argument) -> None:
        """Starts a kernel on ``blocks`` blocks of THREADS threads; nothing where there are none.

        Arguments are tensors (their addresses are passed), None (a null address), ints and floats (32 bits) or ctypes
        structs (by value), in the order of the kernel's parameters. FrogError when it cannot be compiled, loaded or
        launched.
        """
        if not blocks:
            return
        parameters = [as_parameter(argument) for argument in arguments]
        addresses = (c_void_p * len(parameters))(*[ctypes.addressof(parameter) for parameter in parameters])
        stream = c_void_p(self._cuda.current_stream(self._index).cuda_stream)
        driver = self._driver
        # The calling thread may be one of torch's own, on which no context is current yet.
        _check(driver, driver.cuCtxPushCurrent_v2(self._context), self._name)
        try:
            function = self._function(kernel)
            status = driver.cuLaunchKernel(function, blocks, 1, 1, THREADS, 1, 1, 0, stream, addresses, None)
            _check(driver, status, f"{self._name}, {kernel}")
        finally:
            driver.cuCtxPopCurrent_v2(byref(c_void_p()))

    def _function(self, kernel: Kernel) -> c_void_p:
        with self._lock:
            if kernel not in self._functions:
                module, function = c_void_p(), c_void_p()
                code = self._code(kernel, self._capability) + b"\0"  # PTX text ends with a zero
                driver, action = self._driver, f"{self._name}, {kernel}"
                _check(driver, driver.cuModuleLoadData(byref(module), code), action)
                _check(driver, driver.cuModuleGetFunction(byref(function), module, kernel.name.encode()), action)
                self._functions[kernel] = function
            return self._functions[kernel]


_device = functools.cache(Device)


def on_gpu(tensor: torch.Tensor) -> bool:
    """Whether the kernels here compute what concerns a tensor."""
    return tensor.device.type == "cuda"


def launcher_for(device: torch.device) -> Device:
    """The launcher of a CUDA device; ValueError for another device."""
    if device.type != "cuda":
        raise ValueError(f"the kernels compute on a GPU, not on {device}")
    return _device(torch.cuda.current_device() if device.index is None else device.index)
