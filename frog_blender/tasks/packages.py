"""Which packages training and calibration need on this kind of computer, and how large they are."""

import platform
import sys

from ..engine.training.session.time_estimate import has_nvidia_gpu


def has_pycolmap_wheel(system: str = sys.platform, machine: str = platform.machine()) -> bool:
    """Whether PyPI has pycolmap for this kind of computer, of names as Python gives them."""
    return (system, machine.lower()) in (("linux", "x86_64"), ("win32", "amd64"), ("darwin", "arm64"))


PYCOLMAP = "4.2.1"
"""Version of pycolmap that calibration was tested with; its interface changes from one to the next."""
_READING = ("opencv-contrib-python-headless", "av", "pillow", "zstandard")
_CALIBRATION = (f"pycolmap=={PYCOLMAP}",) if has_pycolmap_wheel() else ()
PACKAGES = ("torch", *_READING, *_CALIBRATION)
"""Packages that training, reading captures and calibrating need and Blender's Python lacks."""
CALIBRATION_PACKAGES = (*_CALIBRATION, *_READING)
"""Packages for whoever has torch, or only wants to calibrate."""
CPU, CUDA, NO_TORCH = "CPU", "CUDA", "no torch"
"""Builds of torch, and what is installed without it."""
SIZES = {
    CPU: "about 0.4 GB (1.2 GB on disk)",
    CUDA: "about 3 GB (7 GB on disk)",
    NO_TORCH: "about 0.15 GB (0.4 GB on disk)",
}
BYTES_NEEDED = {CPU: 1.7e9, CUDA: 10e9, NO_TORCH: 0.6e9}
"""Of the disk, while a build is unpacked."""


def suitable_build(system: str = sys.platform, has_gpu: bool | None = None) -> str:
    """The build that this computer can use."""
    has_gpu = has_nvidia_gpu() if has_gpu is None else has_gpu
    return CUDA if has_gpu and system != "darwin" else CPU


def served_build(system: str = sys.platform) -> str:
    """The build that pip's own index serves for this kind of computer; the other one is on PyTorch's."""
    return CUDA if system == "linux" else CPU


def index_needed(build: str, system: str = sys.platform) -> str:
    """What to do to get a build that pip's own index does not serve, as a sentence; "" where it does."""
    if build == served_build(system):
        return ""
    what = "for the CPU" if build == CPU else "with CUDA"
    return f"The build {what} comes from PyTorch's own index: its site's Get Started page shows the address."
