"""What a result was made on: the machine, the versions, and the number of threads."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from ..engine import FrogError, instruction_set


def describe_machine() -> dict[str, Any]:
    """``cpu``, ``cores``, ``instruction_set`` of the native library and ``gpu`` (None without one)."""
    try:
        kernels: str | None = instruction_set()
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
