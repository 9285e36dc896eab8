"""Which packages training and calibration need on this kind of computer, and how large they are."""

from __future__ import annotations

import os
import platform
import sys
from pathlib import Path


def has_pycolmap_wheel(system: str = sys.platform, machine: str = platform.machine()) -> bool:
    """Whether PyPI has pycolmap for this kind of computer, of names as Python gives them."""
    return (system, machine.lower()) in (("linux", "x86_64"), ("win32", "amd64"), ("darwin", "arm64"))


PYCOLMAP = "4.2.1"
"""Version of pycolmap that calibration was tested with; its interface changes from one to the next."""
_READING = ("opencv-contrib-python-headless", "imageio-ffmpeg")
_CALIBRATION = (f"pycolmap=={PYCOLMAP}",) if has_pycolmap_wheel() else ()
PACKAGES = ("torch", *_READING, *_CALIBRATION)
"""Packages that training, reading captures and calibrating need and Blender's Python lacks."""
CALIBRATION_PACKAGES = (*_CALIBRATION, *_READING)
"""Packages for whoever has torch, or only wants to calibrate."""
SIZES = "about 0.4 GB for the CPU only (1.2 GB on disk), about 3 GB with CUDA (7 GB on disk)"
CALIBRATION_SIZES = "about 0.15 GB (0.4 GB on disk)"
BYTES_NEEDED = 1.7e9  # while the smaller of the two is unpacked
CALIBRATION_BYTES_NEEDED = 0.6e9


def has_nvidia_gpu(system: str = sys.platform) -> bool:
    """Whether this computer has a driver of NVIDIA's, by the files that it brings."""
    if system == "win32":
        drivers = [Path(os.environ.get("SYSTEMROOT", "C:/Windows")) / "System32" / "nvcuda.dll"]
    else:
        drivers = [Path("/proc/driver/nvidia/version"), Path("/usr/lib/wsl/lib/libcuda.so.1")]
    return any(driver.exists() for driver in drivers)


def build_advice(system: str = sys.platform, has_gpu: bool | None = None) -> str:
    """What to do where pip's own index serves a build of torch that does not suit this computer; "" where it does."""
    has_gpu = has_nvidia_gpu(system) if has_gpu is None else has_gpu
    if system == "linux" and not has_gpu:
        return "No NVIDIA GPU: name PyTorch's index for the CPU above, or pip downloads the larger build with CUDA."
    if system == "win32" and has_gpu:
        return "An NVIDIA GPU: name PyTorch's index for CUDA above, or pip downloads the build for the CPU."
    return ""
