"""The loss of a drawing and its gradient on an NVIDIA GPU: one launch, and one more for structural similarity."""

import torch

from ..native.binding import CELL
from . import launch
from .sources import kernel


def compare(
    image: torch.Tensor,
    truth: torch.Tensor,
    weights: tuple[float, float, float],
    state: torch.Tensor | None = None,
) -> tuple[torch.Tensor, torch.Tensor]:
    """The gradient (H, W, 3) of a loss by ``image``, and a report that ``read`` understands, on the device.

    Args:
        image: (H, W, 3) contiguous float32.
        truth: (H, W, 3) uint8, its rows may be part of a larger image's.
        weights: of the mean absolute difference, of the mean squared one, and of the mean similarity.
        state: of the drawing, see ``rasterizer.cuda.CudaPass``; it travels with the report.
    """
    height, width, channels = truth.shape
    if truth.dtype != torch.uint8 or truth.stride()[1:] != (3, 1) or channels != 3:
        raise ValueError(f"expected bytes (H, W, 3), found {truth.dtype} of {tuple(truth.shape)}")
    if image.dtype != torch.float32 or image.shape != truth.shape or not image.is_contiguous():
        raise ValueError(f"expected contiguous float32 of {tuple(truth.shape)}, found {image.dtype} of {image.shape}")
    launcher, cells = launch.launcher_for(image.device), -(-height // CELL) * -(-width // CELL)
    absolute, square, similarity = (float(weight) / image.numel() for weight in weights)
    gradient, report = torch.empty_like(image), image.new_empty(4 + 3 * cells)
    slopes = image.new_empty(9, height, width) if similarity else None
    images = height, width, image, truth, truth.stride(0)
    outputs = state, gradient, report, slopes
    launcher.launch(kernel("loss", SSIM=similarity != 0), cells, *images, absolute, 2 * square, *outputs)
    if slopes is not None:
        launcher.launch(kernel("loss_backward"), cells, *images, slopes, similarity, gradient)
    return gradient, report


def read(report: torch.Tensor, height: int, width: int) -> tuple[list[int], torch.Tensor, list[float]]:
    """What a report says, once it is on the CPU: the drawing's state, (rows, columns) mean squared differences in
    cells, and the image's mean absolute difference, mean squared one and mean similarity."""
    lengths = [
        torch.arange(0, length, CELL, device="cpu").sub(length).neg().clamp(max=CELL) for length in (height, width)
    ]
    numbers = 3 * lengths[0][:, None] * lengths[1]
    squares, absolutes, similarities = report[4:].view(*numbers.shape, 3).unbind(2)
    means = [float(sums.sum(dtype=torch.float64)) / (3 * height * width) for sums in (absolutes, squares, similarities)]
    return report[:4].view(torch.int64).tolist(), squares / numbers, means
