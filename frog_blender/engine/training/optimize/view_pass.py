"""A step's views: what is drawn of each, and what its backward pass found."""

from dataclasses import dataclass

import torch

from ...capture.camera import Camera
from ...native.binding import CELL
from .densification import Statistics
from .mattes import Color

Region = tuple[int, int, int, int]
_POSE, _BRIGHTNESS = 12, 6  # numbers of a pose's gradient (3, 4), and of what exposures are found from (2, 3)


@dataclass(frozen=True)
class View:
    """What a step draws.

    Attributes:
        shot, index: of the capture, and of its camera.
        camera: at the size at which it is drawn.
        full_size: whether that is the whole size.
        region: left, top, width and height in pixels, where only a part is drawn.
        background: behind subjects; None where images are whole.
        pose: (3, 4) of the camera, to receive its gradient; None where it is not learned.
    """

    shot: int
    index: int
    camera: Camera
    full_size: bool
    region: Region | None
    background: Color | None
    pose: torch.Tensor | None

    @property
    def drawn(self) -> Region:
        """The region, or the whole image."""
        return self.region or (0, 0, self.camera.width, self.camera.height)

    @property
    def cells(self) -> tuple[int, int]:
        """Rows and columns of cells in what is drawn."""
        return -(-self.drawn[3] // CELL), -(-self.drawn[2] // CELL)


@dataclass(frozen=True)
class ViewPass:
    """What one view's backward pass found besides the gradients of the parameters.

    Attributes:
        loss: ().
        cells: (rows, columns) squared errors.
        pose: (3, 4) the gradient of the view's pose; None where none came.
        brightness: (2, 3) see ``ExposureCompensation.measured``; None where it was not asked for.
    """

    loss: torch.Tensor
    cells: torch.Tensor
    pose: torch.Tensor | None = None
    brightness: torch.Tensor | None = None


class StepSum:
    """The gradients and statistics of one step's views, summed in float64 and rounded once.

    Args:
        parameters: of the model.
        views: of the step.
        count: Gaussians.
    """

    def __init__(self, parameters: list[torch.nn.Parameter], views: list[View], count: int) -> None:
        self._parameters, self._views = parameters, views
        device = parameters[0].device
        self._sizes = [parameter.numel() for parameter in parameters]
        self._gradients = torch.zeros(sum(self._sizes), dtype=torch.float64, device=device)
        self._present = torch.zeros(len(parameters), dtype=torch.float64, device=device)
        self._sums = torch.zeros(2, count, dtype=torch.float64, device=device)
        self._peaks = torch.zeros(2, count, device=device)
        self.collected = Statistics(*self._sums, *self._peaks)
        width = 3 + _POSE + _BRIGHTNESS + max(rows * columns for rows, columns in (view.cells for view in views))
        self._found = torch.zeros(len(views), width, dtype=torch.float64, device=device)

    def add(self, index: int, view_pass: ViewPass) -> None:
        """Adds the pass of the view of that index, takes the parameters' gradients and leaves none."""
        totals = self._gradients.split(self._sizes)
        for position, (parameter, total) in enumerate(zip(self._parameters, totals, strict=True)):
            if parameter.grad is not None:
                total.add_(parameter.grad.flatten())
                self._present[position] = 1
                parameter.grad = None
        row = self._found[index]
        row[0] = view_pass.loss.detach()
        if view_pass.pose is not None:
            row[1] = 1
            row[3 : 3 + _POSE] = view_pass.pose.flatten()
        if view_pass.brightness is not None:
            row[2] = 1
            row[3 + _POSE : 3 + _POSE + _BRIGHTNESS] = view_pass.brightness.flatten()
        cells = view_pass.cells.detach().flatten()
        row[3 + _POSE + _BRIGHTNESS :][: len(cells)] = cells

    def passes(self) -> list[ViewPass]:
        """Of all views, in their order."""
        records, flags = self._found.float(), self._found[:, 1:3].cpu().tolist()
        passes = []
        for view, row, (has_pose, has_brightness) in zip(self._views, records, flags, strict=True):
            rows, columns = view.cells
            pose, brightness, cells = row[3:].split([_POSE, _BRIGHTNESS, records.shape[1] - 3 - _POSE - _BRIGHTNESS])
            passes.append(
                ViewPass(
                    row[0],
                    cells[: rows * columns].view(rows, columns),
                    pose.view(3, 4) if has_pose else None,
                    brightness.view(2, 3) if has_brightness else None,
                )
            )
        return passes

    def put_means(self) -> None:
        """Gives every parameter that any view has a gradient for the mean over the views."""
        present = self._present.cpu().tolist()
        means = (self._gradients / len(self._views)).split(self._sizes)
        for parameter, mean, there in zip(self._parameters, means, present, strict=True):
            if there:
                parameter.grad = mean.to(parameter.dtype).view_as(parameter)
