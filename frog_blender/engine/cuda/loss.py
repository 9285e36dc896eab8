"""The loss of a drawing and its gradients on an NVIDIA GPU: one launch, and one more for structural similarity."""

from ctypes import Structure, c_float, c_int32, c_void_p

import torch

from ..native.binding import CELL
from ..native.structs import address
from . import launch
from .sources import kernel


class _Matte(Structure):
    _fields_ = (
        *((name, c_void_p) for name in ("alpha", "ignored", "drawn", "gradient")),
        *(("row", c_int32), ("by_alpha", c_float), ("empty_weight", c_float)),
    )


def compare(
    images: tuple[torch.Tensor, torch.Tensor],
    alphas: tuple[torch.Tensor, torch.Tensor | None],
    ignored: torch.Tensor | None,
    weights: tuple[float, float, float, float],
    empty_weight: float = 1.0,
    state: torch.Tensor | None = None,
) -> tuple[torch.Tensor, torch.Tensor | None, torch.Tensor]:
    """The gradients of a loss by a drawing (H, W, 3) and, where that counts, by its alpha (H, W), and a report that
    ``read`` understands, on the device.

    Args:
        images: (H, W, 3) a drawing, contiguous float32, and what it should be, uint8, whose rows may be part of a
            larger image's.
        alphas: (H, W) of both; None where that does not count.
        ignored: (H, W) bool, pixels that do not count, where the truth is black; None where all do.
        weights: of the mean absolute difference, the mean squared one, the mean similarity, and alpha's mean absolute
            difference.
        empty_weight: of gradients where the true alpha is zero.
        state: of the drawing, see ``RasterPass``; it travels with the report.
    """
    (image, truth), (drawn, alpha) = images, alphas
    height, width, _ = image.shape
    for own, size in ((truth, image.shape), *([] if alpha is None else [(alpha, image.shape[:2])])):
        if own.dtype != torch.uint8 or own.shape != size or not own[0].is_contiguous():
            raise ValueError(f"expected bytes of {tuple(size)} in rows, found {own.dtype} of {tuple(own.shape)}")
    if image.dtype != torch.float32 or not image.is_contiguous():
        raise ValueError(f"expected contiguous float32, found {image.dtype}")
    launcher, cells = launch.launcher_for(image.device), -(-height // CELL) * -(-width // CELL)
    absolute, square, similarity = (float(weight) / image.numel() for weight in weights[:3])
    gradient, report = torch.empty_like(image), image.new_empty(4 + 4 * cells)
    slopes = image.new_empty(9, height, width) if similarity else None
    by_alpha = None if alpha is None else image.new_empty(height, width)
    drawn, ignored = drawn.contiguous(), None if ignored is None else ignored.contiguous()
    addresses = [address(array) for array in (alpha, ignored, drawn, by_alpha)]
    row = 0 if alpha is None else alpha.stride(0)
    matte = _Matte(*addresses, row, weights[3] / (height * width), empty_weight)
    given = height, width, image, truth, truth.stride(0), matte
    launcher.launch(
        kernel("loss", SSIM=similarity != 0), cells, *given, absolute, 2 * square, state, gradient, report, slopes
    )
    if slopes is not None:
        launcher.launch(kernel("loss_backward"), cells, *given, slopes, similarity, gradient)
    return gradient, by_alpha, report


def read(report: torch.Tensor, height: int, width: int) -> tuple[list[int], torch.Tensor, list[float]]:
    """What a report says, once it is on the CPU: the drawing's state, (rows, columns) mean squared differences in
    cells, and the image's mean absolute difference, mean squared one, mean similarity, and alpha's mean absolute
    difference."""
    sides = [
        torch.tensor([min(CELL, length - at) for at in range(0, length, CELL)], device="cpu")
        for length in (height, width)
    ]
    pixels = sides[0][:, None] * sides[1]
    sums = report[4:].view(*pixels.shape, 4)
    squares, absolute, similarity, alpha = (sums.sum((0, 1), dtype=torch.float64) / (height * width)).tolist()
    means = [absolute / 3, squares / 3, similarity / 3, alpha]
    return report[:4].view(torch.int64).tolist(), sums[..., 0] / (3 * pixels), means
