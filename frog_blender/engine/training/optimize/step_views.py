"""The views of one step: drawn by this process and its peers, and what they found brought together.

Every process draws the same random numbers and knows all views of the step; it computes its own. Gradients are
averaged over the views, statistics are summed (or the largest is taken) before anything is decided by them, so that all
processes decide the same and none has to be told.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import nn

from ...capture.camera import Camera
from ...native.binding import CELL
from ...rasterizer import RasterizeOptions
from .densification import DensificationStrategy, Observations
from .mattes import Color
from .peers import PeerLost, Peers


@dataclass(frozen=True)
class View:
    """An image, or a part of one, that a step learns from.

    Attributes:
        shot: its index in the capture.
        index: of the camera.
        camera: at the size at which it is drawn.
        options: with the region.
        background: see ``Mattes.random_background``.
        full_size: the camera is not halved.
        learns_pose, observes_exposure: what else is found by drawing it.
    """

    shot: int
    index: int
    camera: Camera
    options: RasterizeOptions
    background: Color
    full_size: bool
    learns_pose: bool
    observes_exposure: bool

    @property
    def region(self) -> tuple[int, int, int, int]:
        """(left, top, width, height), pixels."""
        return self.options.region_of(self.camera)

    @property
    def cells(self) -> tuple[int, int]:
        """Rows and columns of the region's cells."""
        _, _, width, height = self.region
        return -(-height // CELL), -(-width // CELL)


@dataclass(frozen=True)
class Findings:
    """What drawing a view found, besides gradients and what density control reads.

    Attributes:
        loss: ().
        cell_errors: (rows, columns) see ``PhotometricLoss``.
        deforms: whether anything was deformed.
        pose: (3, 4) gradient by the camera's pose; None where that is not learned, or nothing was seen.
        brightness: (2, 3) see ``ExposureCompensation.measure``; None where that is not observed.
    """

    loss: torch.Tensor
    cell_errors: torch.Tensor
    deforms: bool
    pose: torch.Tensor | None
    brightness: torch.Tensor | None

    def packed(self) -> torch.Tensor:
        """(``_packed_size``,) all of it as numbers, zeros for None."""
        zeros = self.loss.new_zeros
        pose = zeros(12) if self.pose is None else self.pose.flatten()
        brightness = zeros(6) if self.brightness is None else self.brightness.flatten()
        flags = torch.tensor([float(self.deforms), float(self.pose is not None)], device=pose.device)
        loss = self.loss.to(pose.device).reshape(1)
        return torch.cat([loss, flags, pose, brightness, self.cell_errors.to(pose.device).flatten()])

    @staticmethod
    def unpacked(numbers: torch.Tensor, view: View) -> Findings:
        """What ``packed`` packed."""
        loss, flags, pose, brightness, cells = numbers.split([1, 2, 12, 6, len(numbers) - 21])
        deforms, has_pose = (bool(flag) for flag in flags.cpu())
        return Findings(
            loss[0],
            cells.reshape(view.cells),
            deforms,
            pose.reshape(3, 4) if has_pose else None,
            brightness.reshape(2, 3) if view.observes_exposure else None,
        )


def _packed_size(view: View) -> int:
    rows, columns = view.cells
    return 21 + rows * columns


Compute = Callable[[View, Observations], Findings]
"""Draws a view, adds its gradients to the parameters' and, to the observations, what density control reads."""


def learn_from(
    views: Sequence[View],
    compute: Compute,
    peers: Peers,
    model: nn.Module,
    density: DensificationStrategy,
) -> list[Findings]:
    """Computes this process's share of the views; returns the findings of all.

    Afterwards the gradients of the model's parameters are the means over all views, all of which ``density`` has
    observed.

    Raises:
        MemoryError: in every process, where one ran out of memory.
        PeerLost: where one is gone, or in the others, where one failed in another way; nothing but gradients has
            changed then.
    """
    seen, parameters = Observations.none(density), list(model.parameters())
    findings: dict[int, Findings] = {}
    failure: Exception | None = None
    try:
        for number in range(peers.rank, len(views), peers.size):
            findings[number] = compute(views[number], seen)
    except Exception as error:
        if peers.size == 1:
            raise
        failure = error
    if peers.size > 1:
        _exchange(views, findings, peers, parameters, seen, failure)
    for parameter in parameters:
        if parameter.grad is not None:
            parameter.grad /= len(views)
    density.add(seen)
    return [findings[number] for number in range(len(views))]


def _exchange(
    views: Sequence[View],
    findings: dict[int, Findings],
    peers: Peers,
    parameters: Sequence[torch.Tensor],
    seen: Observations,
    failure: Exception | None,
) -> None:
    """One sum over the processes of all that is summed, and one maximum: what is another's is zero here."""
    said = torch.zeros(2 + len(parameters), device=seen.seen.device)
    said[0], said[1] = isinstance(failure, MemoryError | torch.OutOfMemoryError), failure is not None
    for number, parameter in enumerate(parameters):
        said[2 + number] = parameter.grad is not None
    gradients = [torch.zeros_like(each) if each.grad is None else each.grad for each in parameters]
    found = [
        findings[number].packed().to(said.device) if number in findings else said.new_zeros(_packed_size(view))
        for number, view in enumerate(views)
    ]
    summed = [said, seen.gradient_sum, seen.seen, *gradients, *found]
    total = torch.cat([array.detach().reshape(-1) for array in summed])
    peers.add_up(total)
    pieces = total.split([array.numel() for array in summed])
    parts = (piece.reshape(array.shape) for piece, array in zip(pieces, summed, strict=True))
    said = next(parts).cpu()
    if said[1]:
        if failure is not None:
            raise failure
        if said[0]:
            raise MemoryError("another process of this training ran out of memory")
        raise PeerLost("Another process of this training failed.")
    seen.gradient_sum, seen.seen = next(parts), next(parts)
    for parameter, has_gradient in zip(parameters, said[2:], strict=True):
        gradient = next(parts)
        parameter.grad = gradient if has_gradient else None
    for number, view in enumerate(views):
        findings[number] = Findings.unpacked(next(parts), view)
    peaks = torch.cat([seen.peak_opacity, seen.peak_weight])
    peers.take_largest(peaks)
    seen.peak_opacity, seen.peak_weight = peaks.split(len(seen.peak_opacity))
