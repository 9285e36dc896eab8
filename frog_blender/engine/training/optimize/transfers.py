"""How images get to the device on which a training computes, and numbers back, while nobody waits."""

from collections.abc import Callable, Hashable

import numpy as np
import torch

from ...arrays import ImageArray
from ...capture.camera import Camera
from ...frames.image_coding import Region


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
