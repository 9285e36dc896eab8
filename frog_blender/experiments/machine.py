"""What a result was made on: the machine, the versions, and the number of threads."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from ..engine.errors import FrogError
from ..engine.native import binding


def describe_machine() -> dict[str, Any]:
    """``cpu``, ``cores``, ``instruction_set`` of the native library and ``gpu`` (None without one)."""
    try:
        kernels: str | None = binding.instruction_set()
    except FrogError:
        kernels = None
    return {"cpu": _cpu_name(), "cores": os.cpu_count() or 1, "instruction_set": kernels, "gpu": _gpu_name()}


def describe_versions() -> dict[str, str | None]:
    """Of the project, Python, torch and numpy."""
    versions: dict[str, str | None] = {"python": platform.python_version()}
    for name, package in (("project", "frog-blender"), ("torch", "torch"), ("numpy", "numpy")):
        try:
            versions[name] = version(package)
        except PackageNotFoundError:
            versions[name] = None
    return versions


def _cpu_name() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def _gpu_name() -> str | None:
    import torch

    return torch.cuda.get_device_name() if torch.cuda.is_available() else None


@contextmanager
def limited_threads(count: int) -> Iterator[None]:
    """At most ``count`` threads each for the native library, torch and OpenCV inside the block; 0 changes nothing."""
    if not count:
        yield
        return
    import cv2
    import torch

    before, torch_before = cv2.getNumThreads(), torch.get_num_threads()
    cv2.setNumThreads(count)
    torch.set_num_threads(count)
    binding.set_thread_count(count)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
        torch.set_num_threads(torch_before)
        binding.set_thread_count(0)
