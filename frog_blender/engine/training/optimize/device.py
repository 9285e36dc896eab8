"""Where a training computes: the choice between processor and GPU, and how images get there."""

from .. import passive_threads  # noqa: F401

# isort: split
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from functools import partial

import numpy as np
import torch

from ...arrays import ImageArray
from ...capture.camera import Camera
from ...errors import FrogError
from ...frames.image_coding import Region
from ...options import OPTIONS
from ...playback.painter import painter
from ...rasterizer import GaussianArrays, rasterize
from ...rasterizer.cuda_frame import fill, try_frames
from ...setting import check


def try_rasterizer(device: torch.device) -> None:
    """Compiles and runs the kernels once, forward and backward; FrogError when the image or a gradient is wrong."""
    grey = [[0.0, 0.0, 2.0]], [[1.0, 0.0, 0.0, 0.0]], [[100.0, 100.0, 100.0]], [0.6], [[[0.0, 0.0, 0.0]]]
    leaves = (torch.tensor(values, dtype=torch.float32, device=device, requires_grad=True) for values in grey)
    gaussians = GaussianArrays(*leaves)
    camera = Camera("trial", 16, 16, np.array([[16.0, 0, 8], [0, 16, 8], [0, 0, 1]]), np.eye(4))
    rgb = rasterize(gaussians, camera).rgb
    rgb.mean().backward()
    by_opacity = gaussians.opacities.grad
    assert by_opacity is not None
    color, slope = float(rgb.detach().mean()), float(by_opacity)
    if not (abs(color - 0.3) < 1e-3 and abs(slope - 0.5) < 1e-3):
        raise FrogError(f"The CUDA rasterizer found {color:.4f} and {slope:.4f}, expected 0.3 and 0.5.")


def first_gpu() -> torch.device | None:
    """The GPU that torch computes on, if it sees one."""
    return torch.device("cuda", torch.cuda.current_device()) if torch.cuda.is_available() else None


def choose_device(name: str, trial: Callable[[torch.device], object] | None = None) -> tuple[torch.device, str]:
    """The device that ``name`` asks for, and why "auto" left a GPU aside ("" where it did not).

    "auto" is the GPU where torch sees one and the CUDA rasterizer passes the trial on it, else the CPU.

    Args:
        trial: raises an error where a GPU cannot be used; by default ``try_rasterizer``.

    Raises:
        FrogError: an unknown name, or "cuda" where nothing can be drawn on a GPU.
    """
    check("device", name, OPTIONS["device"].kind)
    cpu = torch.device("cpu")
    if name == "cpu":
        return cpu, ""
    try:
        device = first_gpu()
        if device is not None:
            (trial or try_rasterizer)(device)
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


class OnItsWay:
    """A tensor's numbers, asked for without waiting: on a GPU the copy is queued behind what was asked of it before."""

    def __init__(self, tensor: torch.Tensor) -> None:
        self._copy = tensor.detach().to("cpu", non_blocking=True)
        on_gpu = tensor.device.type == "cuda"
        self._arrived = torch.cuda.current_stream(tensor.device).record_event() if on_gpu else None

    def here(self) -> torch.Tensor:
        """The tensor on the CPU, once it is there."""
        if self._arrived is not None:
            self._arrived.synchronize()
        return self._copy


def bytes_on(device: torch.device, pixels: ImageArray) -> torch.Tensor:
    """A copy of bytes on ``device``, or a view of them where that is the CPU and they may be written to."""
    if device.type == "cpu":
        return torch.from_numpy(np.require(pixels, requirements="W"))
    # From pinned memory nobody waits for them: torch gives the buffer out again only when the copy is done.
    staged = torch.empty(pixels.shape, dtype=torch.uint8, device="cpu", pin_memory=device.type == "cuda")
    staged.numpy()[...] = pixels
    return staged.to(device, non_blocking=True)


class KeptImages:
    """Images on a GPU, whole once they were asked for, as long as there is room; none of them is ever removed. Of
    others a part is uploaded each time.

    Args:
        device: where to.
        room: bytes; None for half of what a GPU has free, and for none on the CPU, where the frame store keeps them.
    """

    def __init__(self, device: torch.device, room: int | None = None) -> None:
        if room is None:
            room = torch.cuda.mem_get_info(device)[0] // 2 if device.type == "cuda" else 0
        self._device, self._room = device, room
        self._kept: dict[Hashable, torch.Tensor] = {}

    def missing(self, key: Hashable, camera: Camera, region: Region) -> Region | None:
        """What of an image would have to be read: nothing, all of it, or the region (left, top, width, height)."""
        if key in self._kept:
            return None
        has_room = 3 * camera.width * camera.height <= self._room
        return (0, 0, camera.width, camera.height) if has_room else region

    def part(self, key: Hashable, camera: Camera, region: Region, read: Callable[[Region], ImageArray]) -> torch.Tensor:
        """A region of a camera's image on the device, uint8, perhaps a view: not to be written to.

        Args:
            key: of the image.
            read: gives a region of it.
        """
        missing = self.missing(key, camera, region)
        if missing is not None:
            image = bytes_on(self._device, read(missing))
            if missing is region:
                return image
            self._kept[key], self._room = image, self._room - image.nbytes
        left, top, width, height = region
        return self._kept[key][top : top + height, left : left + width]
