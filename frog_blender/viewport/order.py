"""The one order of all captures' splats for a view, the farthest first: found at once for a few, in a thread for many.

Nothing here knows Blender. A new request replaces one that has not begun; whoever draws takes what is there, which for
a moment is the order of the view before. While one moves and the card is slow, the most important splats alone are
drawn; which they are is found in a thread as well, once a scene.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..engine.native.binding import depth_order
from ..engine.playback.importance import ranking
from ..engine.playback.player import ScenePlayer
from ..worker import Worker
from .projection import NEAR

AT_ONCE = 60_000
"""So many are sorted sooner than a thread is asked and a viewport is drawn once more: a millisecond."""
FEWEST = 20_000
"""Scenes of fewer splats are never slow because of their number."""
Plane = tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class Part:
    """One capture's share of what is sorted.

    Attributes:
        points: (N, 3) float32, not to be changed afterwards.
        plane: see ``depth_order``; of all parts in the same unit.
        start: the number of the first Gaussian, from which on they are numbered.
        kept: (K,) the Gaussians that are to be drawn; None for all.
    """

    points: np.ndarray
    plane: Plane
    start: int = 0
    kept: np.ndarray | None = None

    def depths(self) -> np.ndarray:
        """(K,) of those that are to be drawn."""
        points = self.points if self.kept is None else self.points[self.kept]
        plane = np.array(self.plane, np.float32)
        return points @ plane[:3] + plane[3]

    def numbers(self) -> np.ndarray:
        """(K,) float32 of those that are to be drawn."""
        own = np.arange(len(self.points)) if self.kept is None else self.kept
        return (own + self.start).astype(np.float32)


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
        return sum(len(part.points if part.kept is None else part.kept) for part in self.parts)

    @property
    def starts(self) -> tuple[int, ...]:
        """The first number of each part."""
        return tuple(part.start for part in self.parts)

    def sort(self) -> Order:
        """The order; takes milliseconds."""
        first = self.parts[0]
        if len(self.parts) == 1 and first.kept is None and first.start == 0:
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


class Ranks:
    """The scenes' Gaussians by importance, as far as they are known.

    Args:
        rank: gives (N,) the Gaussians of a scene, the most important first; takes a second for many.
        fewest: scenes of fewer are drawn whole.
    """

    def __init__(self, rank: Callable[[ScenePlayer], np.ndarray] = ranking, fewest: int = FEWEST) -> None:
        self.worker = Worker("FRoG importance", "splats could not be ranked")  # all are drawn, as before
        self._rank, self._fewest = rank, fewest
        self._known: dict[str, np.ndarray | None] = {}
        self._chosen: dict[tuple[str, int], np.ndarray] = {}

    def most_important(self, scene: ScenePlayer, share: float) -> np.ndarray | None:
        """(K,) a share of the Gaussians as ascending indices; None for all, also until it is known which."""
        if share >= 1.0 or scene.count < self._fewest:
            return None
        if scene.token not in self._known:
            self._known[scene.token] = None
            self.worker.ask({scene.token: partial(self._find, scene)})
        order = self._known[scene.token]
        if order is None:
            return None
        key = scene.token, max(1, round(share * scene.count))
        if key not in self._chosen:
            self._chosen[key] = np.sort(order[: key[1]])
        return self._chosen[key]

    def keep_only(self, tokens: Iterable[str]) -> None:
        """Drops the other scenes'."""
        kept = set(tokens)
        self._known = {token: order for token, order in self._known.items() if token in kept}
        self._chosen = {key: chosen for key, chosen in self._chosen.items() if key[0] in kept}

    def _find(self, scene: ScenePlayer) -> None:
        order = self._rank(scene)
        if scene.token in self._known:
            self._known[scene.token] = order
