"""The most important splats: found beside the drawing, and the same ones every time."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from frog_blender.viewport.importance import Ranks


def until(condition: Any) -> Any:
    deadline = time.monotonic() + 20.0
    while (found := condition()) is None and time.monotonic() < deadline:
        time.sleep(0.005)
    return found


def test_all_are_drawn_until_the_most_important_are_known() -> None:
    gate = threading.Event()

    def rank(_scene: Any) -> np.ndarray:
        gate.wait(20.0)
        return np.arange(100)[::-1]

    ranks, scene = Ranks(rank, fewest=50), SimpleNamespace(token="a", count=100)
    assert ranks.most_important(scene, 0.25) is None
    gate.set()
    found = until(lambda: ranks.most_important(scene, 0.25))
    assert found.tolist() == list(range(75, 100))
    assert ranks.most_important(scene, 0.25) is found
    assert set(found) < set(ranks.most_important(scene, 0.5)), "nothing flickers"
    assert ranks.most_important(scene, 1.0) is None


def test_small_scenes_are_never_ranked() -> None:
    ranks = Ranks(lambda scene: pytest.fail("ranked"), fewest=50)
    assert ranks.most_important(SimpleNamespace(token="a", count=49), 0.25) is None


def test_each_scene_is_ranked_once_and_forgotten_with_it() -> None:
    ranked = []

    def rank(scene: Any) -> np.ndarray:
        ranked.append(scene.token)
        return np.arange(scene.count)

    ranks = Ranks(rank, fewest=1)
    scenes = [SimpleNamespace(token=token, count=8) for token in "ab"]
    for scene in scenes:
        assert until(lambda scene=scene: ranks.most_important(scene, 0.5)).tolist() == [0, 1, 2, 3]
    ranks.keep_only("b")
    assert until(lambda: ranks.most_important(scenes[0], 0.25)).tolist() == [0, 1]
    assert until(lambda: ranks.most_important(scenes[1], 0.25)).tolist() == [0, 1]
    assert ranked == ["a", "b", "a"]


def test_an_error_leaves_all(capfd: pytest.CaptureFixture[str]) -> None:
    def rank(_scene: Any) -> np.ndarray:
        raise MemoryError("too many")

    ranks, scene = Ranks(rank, fewest=1), SimpleNamespace(token="a", count=8)
    assert ranks.most_important(scene, 0.5) is None
    assert until(lambda: ("could not be ranked" in (said := capfd.readouterr().err) and said) or None)
    assert ranks.most_important(scene, 0.5) is None
