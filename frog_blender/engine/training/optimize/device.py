"""Where a training computes and where frames are drawn: the choice between CPU and GPU."""

from .. import passive_threads  # noqa: F401

# isort: split
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

import torch

from ...errors import FrogError
from ...options import OPTIONS
from ...playback.painter import painter
from ...rasterizer.cuda_frame import fill, try_frames
from ...setting import check
from .trial import try_step


def first_gpu() -> torch.device | None:
    """The GPU that torch computes on, if it sees one."""
    return torch.device("cuda", torch.cuda.current_device()) if torch.cuda.is_available() else None


def choose_device(name: str, trial: Callable[[torch.device], object] | None = None) -> tuple[torch.device, str]:
    """The device that ``name`` asks for, and why "auto" left a GPU aside ("" where it did not).

    "auto" is the GPU where torch sees one and its kernels pass the trial, else the CPU.

    Args:
        trial: raises an error where a GPU cannot be used; by default that of a training's step.

    Raises:
        FrogError: an unknown name, or "cuda" where no GPU can be used.
    """
    check("device", name, OPTIONS["device"].kind)
    cpu = torch.device("cpu")
    if name == "cpu":
        return cpu, ""
    try:
        device = first_gpu()
        if device is not None:
            (trial or try_step)(device)
    except Exception as error:  # of the driver, the compiler, the kernels: whatever it is, the CPU can go on
        reason = (str(error).strip() or type(error).__name__).splitlines()[0].rstrip(".")
        if name == "cuda":
            raise FrogError(f"The device 'cuda' cannot be used: {reason}.") from error
        return cpu, f"The GPU is left aside for the CPU: {reason}."
    if device is not None:
        return device, ""
    if name == "cuda":
        raise FrogError("The device 'cuda' cannot be used: this torch sees no NVIDIA GPU.")
    return cpu, ""


def draw_frames_on(name: str) -> str:
    """From now on what is played is drawn on the device that ``name`` asks for; see ``choose_device``, whose second
    result it returns."""
    device, warning = choose_device(name, try_frames)
    painter().gpu = None if device.type == "cpu" else partial(fill, device)
    return warning


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Torch's own CPU threads inside the block.

    A training step keeps them at one: what is left for torch is small, and its idle OpenMP threads spin on the cores
    that the native library's threads want (a step took 1.45 times as long on two cores).
    """
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
