"""A step's views: what is drawn of each, and what its backward pass found."""

from dataclasses import dataclass

import torch

from ...capture.camera import Camera
from .densification import Statistics
from .mattes import Color

Region = tuple[int, int, int, int]


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
        count: Gaussians.
    """

    def __init__(self, parameters: list[torch.nn.Parameter], count: int) -> None:
        self._gradients: dict[torch.nn.Parameter, torch.Tensor | None] = dict.fromkeys(parameters)
        self._views = 0
        device = parameters[0].device
        sums, peaks = torch.zeros(2, count, dtype=torch.float64, device=device), torch.zeros(2, count, device=device)
        self.collected = Statistics(*sums, *peaks)

    def add(self) -> None:
        """Takes the parameters' gradients, those of one view, and leaves none."""
        self._views += 1
        for parameter, total in self._gradients.items():
            if parameter.grad is not None:
                own = parameter.grad.double()
                self._gradients[parameter] = own if total is None else total.add_(own)
                parameter.grad = None

    def put_means(self) -> None:
        """Gives every parameter that any view has a gradient for the mean over the views."""
        for parameter, total in self._gradients.items():
            if total is not None:
                parameter.grad = (total / self._views).to(parameter.dtype)
