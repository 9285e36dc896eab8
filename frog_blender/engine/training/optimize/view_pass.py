"""A step's views: what is drawn of each, what its backward pass found, and the processes that share them."""

from dataclasses import dataclass

import torch

from ...capture.camera import Camera
from ...errors import FrogError
from ...native.binding import CELL
from .densification import Statistics
from .mattes import Color


class PeerLost(FrogError):
    """A process of the training has ended, or does not answer any more. What this one has learned is whole."""


class Peers:
    """All processes of a training, each of which holds the whole scene and takes some views of every step; here the
    one process of a plain training.

    Every method that exchanges something has to be called by all of them in the same order.

    Attributes:
        rank: of this one, from 0. Rank 0 alone writes files and tells of the training.
        size: how many there are.
        decodes_first: whether this one is the first on its computer, which decodes the frames for all there.
    """

    rank, size, decodes_first = 0, 1, True

    def add(self, tensor: torch.Tensor) -> None:
        """Makes ``tensor`` the sum over the processes, in place; PeerLost."""

    def maximum(self, tensor: torch.Tensor) -> None:
        """Makes ``tensor`` the largest of each number over the processes, in place; PeerLost."""


ALONE = Peers()


def agreed(peers: Peers, wishes: tuple[bool, ...], facts: tuple[int, ...]) -> tuple[tuple[bool, ...], bool]:
    """What any process wishes, and whether ``facts`` are the same in all of them; PeerLost."""
    numbers = torch.tensor([*wishes, *facts, *(-fact for fact in facts)], dtype=torch.int64, device="cpu")
    peers.maximum(numbers)
    most, least = numbers[len(wishes) :].chunk(2)
    return tuple(bool(wish) for wish in numbers[: len(wishes)]), torch.equal(most, -least)


def shared(peers: Peers, content: bytes | None) -> bytes:
    """The ``content`` of rank 0, which alone has to have one; PeerLost."""
    size = torch.tensor([len(content or b"")], dtype=torch.int64, device="cpu")
    peers.add(size)
    array = torch.zeros(int(size), dtype=torch.uint8, device="cpu")
    if content:
        array.copy_(torch.frombuffer(bytearray(content), dtype=torch.uint8))
    peers.add(array)
    return array.numpy().tobytes()


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
    """The gradients and statistics of one step's views, summed in float64 and rounded once: the same bits come out
    whichever process took which view.

    Args:
        parameters: of the model, in an order that is the same in every process.
        views: of the step, of all processes.
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

    def exchange(self, peers: Peers, seconds: float) -> float:
        """Sums over the processes; returns the ``seconds`` of rank 0."""
        if peers.size == 1:
            return seconds
        clock = torch.full((1,), seconds if peers.rank == 0 else 0.0, dtype=torch.float64, device=self._found.device)
        parts = [self._gradients, self._present, self._sums.view(-1), self._found.view(-1), clock]
        whole = torch.cat(parts)
        peers.add(whole)
        for part, summed in zip(parts, whole.split([len(part) for part in parts]), strict=True):
            part.copy_(summed)  # each is a view of what it is a part of
        peers.maximum(self._peaks)
        return float(clock)

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
