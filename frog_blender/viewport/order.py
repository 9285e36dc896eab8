"""The one order of all captures' splats for a view, the farthest first: found at once for a few, in a thread for many.

Nothing here knows Blender. A new request replaces one that has not begun; whoever draws takes what is there, which for
a moment is the order of the view before.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np

from ..engine.native.binding import depth_order
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
        kept: (K,) the Gaussians that are to be drawn; None for all.
    """

    points: np.ndarray
    plane: Plane
    start: int = 0
    kept: np.ndarray | None = None

    @property
    def count(self) -> int:
        """How many are sorted."""
        return len(self.points) if self.kept is None else len(self.kept)

    def drawn(self) -> np.ndarray:
        """(K, 3) the points that are sorted."""
        return self.points if self.kept is None else np.ascontiguousarray(self.points[self.kept])

    def numbers(self) -> np.ndarray:
        """(K,) float32 the numbers of the Gaussians that are sorted."""
        own = np.arange(len(self.points)) if self.kept is None else self.kept
        return (own + self.start).astype(np.float32)


@dataclass(frozen=True, eq=False)
class OrderRequest:
    """What to sort.

    Attributes:
        place: who wants it: one order is kept for each.
        key: what determines the order.
        parts: the captures.
    """

    place: Hashable
    key: Hashable
    parts: tuple[Part, ...]

    @property
    def count(self) -> int:
        """How many are sorted."""
        return sum(part.count for part in self.parts)

    @property
    def starts(self) -> tuple[int, ...]:
        """The first number of each part."""
        return tuple(part.start for part in self.parts)

    def sort(self) -> Order:
        """The order; takes milliseconds."""
        if len(self.parts) == 1 and self.parts[0].kept is None and self.parts[0].start == 0:
            return Order(self.key, depth_order(self.parts[0].points, self.parts[0].plane, NEAR), self.starts)
        is_whole = all(part.kept is None for part in self.parts)
        # At their numbers the places found are the numbers. Rows between parts have depth zero, which is never seen.
        last = self.parts[-1]
        points = np.zeros((last.start + last.count if is_whole else self.count, 3), np.float32)
        first = 0
        for part in self.parts:
            first = part.start if is_whole else first
            plane = np.array(part.plane, np.float32)
            points[first : first + part.count, 2] = part.drawn() @ plane[:3] + plane[3]
            first += part.count
        found = depth_order(points, (0.0, 0.0, 1.0, 0.0), NEAR)
        if not is_whole:
            found = np.concatenate([part.numbers() for part in self.parts])[found.astype(np.int32)]
        return Order(self.key, found, self.starts)


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
    """A thread that sorts; it starts with the first request for many and ends with ``stop``."""

    def __init__(self, at_once: int = AT_ONCE) -> None:
        self.at_once = at_once
        self._waiting: dict[Hashable, OrderRequest] = {}
        self._busy: Hashable = None
        self._found: dict[Hashable, Order] = {}
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None

    def order(self, request: OrderRequest) -> Order:
        """The order of a request, or of an earlier one of its place until it is there: then ask again later."""
        with self._changed:
            found = self._found.get(request.place)
            if found is not None and found.key == request.key:
                return found
            if found is not None and request.count > self.at_once and _fits(found, request):
                if self._busy != (request.place, request.key):
                    self._waiting[request.place] = request
                    self._start()
                    self._changed.notify_all()
                return found
        found = request.sort()
        with self._changed:
            self._waiting.pop(request.place, None)
            self._found[request.place] = found
        return found

    @property
    def is_idle(self) -> bool:
        """Whether nothing is being sorted."""
        with self._changed:
            return not self._waiting and self._busy is None

    def wait(self, seconds: float) -> bool:
        """Waits until everything is sorted; False on timeout."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._waiting and self._busy is None, seconds)

    def forget(self) -> None:
        """Drops every order."""
        with self._changed:
            self._found.clear()
            self._waiting.clear()

    def stop(self) -> None:
        """Ends the thread after what it is sorting."""
        with self._changed:
            thread, self._thread = self._thread, None
            self._waiting.clear()
            self._changed.notify_all()
        if thread is not None:
            thread.join()

    def _start(self) -> None:
        if self._thread is None:
            # A daemon, because Python joins other threads before it runs atexit.
            self._thread = threading.Thread(target=self._work, name="FRoG splat order", daemon=True)
            self._thread.start()

    def _work(self) -> None:
        me = threading.current_thread()
        while True:
            with self._changed:
                self._busy = None
                self._changed.notify_all()
                self._changed.wait_for(lambda: self._waiting or self._thread is not me)
                if self._thread is not me:
                    return
                place, request = next(iter(self._waiting.items()))
                del self._waiting[place]
                self._busy = (place, request.key)
            try:
                found = request.sort()
            except Exception as error:  # the order of before goes on being used
                print(f"FRoG: splats could not be sorted ({type(error).__name__}: {error}).", file=sys.stderr)
                continue
            with self._changed:
                self._found[place] = found


def _fits(found: Order, request: OrderRequest) -> bool:
    """Whether an earlier order names Gaussians of the request's, which may be of other captures."""
    if found.starts != request.starts:
        return False
    last = request.parts[-1]
    return not len(found.numbers) or found.numbers.max() < last.start + len(last.points)
