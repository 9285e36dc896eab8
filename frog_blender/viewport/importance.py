"""Which splats to draw while one moves and the card is slow: the most important, found in a thread, once a scene."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ..engine.playback.player import ScenePlayer

FEWEST = 20_000
"""Scenes of fewer splats are never slow because of their number."""


def _ranking(scene: ScenePlayer) -> np.ndarray:
    from ..engine.playback.importance import ranking

    return ranking(scene)


class Ranks:
    """The scenes' Gaussians by importance, as far as they are known.

    Args:
        rank: gives (N,) the Gaussians of a scene, the most important first; takes a second for many.
        fewest: scenes of fewer are drawn whole.
    """

    def __init__(self, rank: Callable[[ScenePlayer], np.ndarray] = _ranking, fewest: int = FEWEST) -> None:
        self._rank, self._fewest = rank, fewest
        self._known: dict[str, np.ndarray | None] = {}
        self._chosen: dict[tuple[str, int], np.ndarray] = {}
        self._lock = threading.Lock()

    def most_important(self, scene: ScenePlayer, share: float) -> np.ndarray | None:
        """(K,) a share of the Gaussians as ascending indices; None for all, also until it is known which."""
        if share >= 1.0 or scene.count < self._fewest:
            return None
        with self._lock:
            if scene.token not in self._known:
                self._known[scene.token] = None
                # A daemon: it ends by itself, and nothing waits for it.
                threading.Thread(target=self._find, args=(scene,), name="FRoG importance", daemon=True).start()
            order = self._known[scene.token]
            if order is None:
                return None
            key = scene.token, max(1, round(share * scene.count))
            if key not in self._chosen:
                self._chosen[key] = np.sort(order[: key[1]])
            return self._chosen[key]

    def keep_only(self, tokens: Iterable[str]) -> None:
        """Drops the other scenes'."""
        wanted = set(tokens)
        with self._lock:
            self._known = {token: order for token, order in self._known.items() if token in wanted}
            self._chosen = {key: kept for key, kept in self._chosen.items() if key[0] in wanted}

    def _find(self, scene: ScenePlayer) -> None:
        try:
            order = self._rank(scene)
        except Exception as error:  # all are drawn, as before
            print(f"FRoG: splats could not be ranked ({type(error).__name__}: {error}).", file=sys.stderr)
            return
        with self._lock:
            if scene.token in self._known:
                self._known[scene.token] = order
