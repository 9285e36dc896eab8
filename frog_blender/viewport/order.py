"""The one order of all captures' splats for a view, the farthest first: found at once for a few, in a thread for many.

Nothing here knows Blender. A new request replaces one that has not begun; whoever draws takes what is there, which for
a moment is the order of the view before.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..engine.native.binding import depth_order
from ..worker import Worker
from .projection import NEAR

AT_ONCE = 60_000
"""So many are sorted sooner than a thread is asked and a viewport is drawn once more: a millisecond."""
Plane = tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class Part:
    """One capture's share of what is sorted.

    Attributes:
        points: (N, 3) float32, not to be changed afterwards.
        plane: see ``depth_order``; of all parts in the same unit.
        start: the number of the first Gaussian, from which on they are numbered.
    """

    points: np.ndarray
    plane: Plane
    start: int = 0

    def depths(self) -> np.ndarray:
        """(N,)."""
        plane = np.array(self.plane, np.float32)
        return self.points @ plane[:3] + plane[3]

    def numbers(self) -> np.ndarray:
        """(N,) float32."""
        return (np.arange(len(self.points)) + self.start).astype(np.float32)


@dataclass(frozen=True, eq=False)
class OrderRequest:
    """What to sort.

    Attributes:
        viewport: who wants it: one order is kept for each.
        key: what determines the order.
        parts: the captures.
    """

    viewport: Hashable
    key: Hashable
    parts: tuple[Part, ...]

    @property
    def count(self) -> int:
        """How many are sorted."""
        return sum(len(part.points) for part in self.parts)

    @property
    def starts(self) -> tuple[int, ...]:
        """The first number of each part."""
        return tuple(part.start for part in self.parts)

    def sort(self) -> Order:
        """The order; takes milliseconds."""
        first = self.parts[0]
        if len(self.parts) == 1 and first.start == 0:
            return Order(self.key, depth_order(first.points, first.plane, NEAR), self.starts)
        points = np.zeros((self.count, 3), np.float32)
        np.concatenate([part.depths() for part in self.parts], out=points[:, 2])
        order = depth_order(points, (0.0, 0.0, 1.0, 0.0), NEAR).astype(np.int32)
        return Order(self.key, np.concatenate([part.numbers() for part in self.parts])[order], self.starts)


@dataclass(frozen=True, eq=False)
class Order:
    """(K,) float32 numbers of Gaussians, of what ``key`` determines.

    Attributes:
        starts: of the parts, by which Gaussians are numbered.
    """

    key: Hashable
    numbers: np.ndarray
    starts: tuple[int, ...] = (0,)


class Sorter:
    """Finds orders, more than ``at_once`` splats in a thread."""

    def __init__(self, at_once: int = AT_ONCE) -> None:
        self.at_once = at_once
        self.worker = Worker("FRoG splat order", "splats could not be sorted")  # the order of before goes on being used
        self._found: dict[Hashable, Order] = {}

    def order(self, request: OrderRequest) -> Order:
        """The order of a request, or of an earlier one of its viewport until it is there: then ask again later."""
        order = self._found.get(request.viewport)
        if order is None or order.key == request.key or request.count <= self.at_once or not _fits(order, request):
            return self._sorted(request)
        self.worker.ask({request.viewport: partial(self._sorted, request)})
        return order

    def _sorted(self, request: OrderRequest) -> Order:
        order = self._found.get(request.viewport)
        if order is None or order.key != request.key:  # it may have been asked for again while it was sorted
            order = self._found[request.viewport] = request.sort()
        return order

    def forget(self) -> None:
        """Drops every order."""
        self._found.clear()
        self.worker.ask({}, instead=True)


def _fits(order: Order, request: OrderRequest) -> bool:
    """Whether an earlier order names Gaussians of the request's, which may be of other captures."""
    if order.starts != request.starts:
        return False
    last = request.parts[-1]
    return not len(order.numbers) or order.numbers.max() < last.start + len(last.points)
