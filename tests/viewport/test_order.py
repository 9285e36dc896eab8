"""Orders of splats: at once for a few, later for many, never one that does not fit; the most important ones alone."""

import threading
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from frog_blender.viewport.order import OrderRequest, Part, Ranks, Sorter


def request(key: int, count: int = 1000, place: str = "left", kept: np.ndarray | None = None) -> OrderRequest:
    points = np.random.default_rng(count).normal(0, 3, (count, 3)).astype(np.float32)
    return OrderRequest(place, key, (Part(points, (float(np.cos(key)), 0.0, float(np.sin(key)), 9.0), 0, kept),))


def together(*counts: int, key: int = 0) -> OrderRequest:
    """Captures of so many Gaussians, numbered a thousand apart."""
    parts = [
        replace(request(key, count).parts[0], plane=(0.3, 0.1 * turned, 0.8, 9.0), start=1000 * turned)
        for turned, count in enumerate(counts)
    ]
    return OrderRequest("left", (key, counts), tuple(parts))


@pytest.fixture
def sorter():
    made = Sorter(at_once=100)
    yield made
    made.worker.stop()


def test_few_are_sorted_at_once(sorter: Sorter) -> None:
    for key in range(5):
        asked = request(key, 100)
        found = sorter.order(asked)
        assert found.key == key and np.array_equal(found.numbers, asked.sort().numbers)
        assert sorter.order(asked) is found and sorter.worker.is_idle


def test_the_first_order_is_waited_for_and_later_ones_come_later(sorter: Sorter) -> None:
    first = sorter.order(request(0))
    assert first.key == 0
    assert sorter.order(request(1)) is first, "nobody waits"
    assert sorter.worker.wait(20.0)
    found = sorter.order(request(1))
    assert found.key == 1 and np.array_equal(found.numbers, request(1).sort().numbers)


def test_the_newest_request_is_the_one_that_counts(sorter: Sorter, monkeypatch: pytest.MonkeyPatch) -> None:
    gate, sorted_keys, whole = threading.Event(), [], OrderRequest.sort

    def slow(asked: OrderRequest):
        if threading.current_thread() is not threading.main_thread():
            assert gate.wait(20.0)
        sorted_keys.append(asked.key)
        return whole(asked)

    monkeypatch.setattr(OrderRequest, "sort", slow)
    sorter.order(request(0))
    for key in range(1, 8):
        assert sorter.order(request(key)).key == 0
    gate.set()
    assert sorter.worker.wait(20.0)
    assert sorter.order(request(7)).key == 7 and len(sorted_keys) <= 3 and sorted_keys[-1] == 7


def test_orders_of_another_viewport_and_another_scene_are_not_used(sorter: Sorter) -> None:
    assert sorter.order(request(1, 2000, place="left")).key == 1
    assert sorter.order(request(2, 2000, place="right")).key == 2
    assert sorter.order(request(1, 2000, place="left")).key == 1
    found = sorter.order(request(3, 1000, place="left"))
    assert found.key == 3 and found.numbers.max() < 1000
    sorter.forget()
    assert sorter.order(request(2, 1000)).key == 2


def test_captures_have_one_order() -> None:
    asked = together(300, 200, 100)
    depths, numbers = [], []
    for part in asked.parts:
        depths.append(part.points @ np.array(part.plane[:3]) + part.plane[3])
        numbers.append(part.start + np.arange(len(part.points)))
    expected = np.concatenate(numbers)[np.argsort(-np.concatenate(depths), kind="stable")]
    found = asked.sort()
    assert np.array_equal(found.numbers, expected) and found.starts == (0, 1000, 2000)
    assert len(set(np.sign(np.diff(found.numbers // 1000)))) == 3, "they stand in each other"


def test_splats_that_are_left_out_leave_the_others_in_their_order(sorter: Sorter) -> None:
    asked, kept = together(300, 200), np.arange(0, 300, 7)
    some = replace(asked, parts=(replace(asked.parts[0], kept=kept), asked.parts[1]))
    every, found = asked.sort().numbers, some.sort().numbers
    assert np.array_equal(found, every[(every >= 1000) | np.isin(every, kept)])
    alone, every = sorter.order(request(0, kept=kept)).numbers, request(0).sort().numbers
    assert np.array_equal(alone, every[np.isin(every, kept)])


def test_an_order_of_other_captures_is_not_used(sorter: Sorter) -> None:
    first = sorter.order(together(300, 200))
    assert sorter.order(together(300, 200, key=1)) is first, "of these an earlier view's"
    for counts in ((300,), (300, 200, 50), (300, 150)):
        asked = together(*counts, key=2)
        assert sorter.order(asked).key == asked.key
        assert sorter.worker.wait(20.0)
        sorter.forget()
        sorter.order(together(300, 200))


def test_it_ends(sorter: Sorter) -> None:
    sorter.order(request(0))
    sorter.order(request(1))
    sorter.worker.stop()
    assert not [thread for thread in threading.enumerate() if thread.name == "FRoG splat order" and thread.is_alive()]


def ranked(ranks: Ranks, scene: Any, share: float) -> Any:
    """What is given once the scene is ranked."""
    ranks.most_important(scene, share)
    assert ranks.worker.wait(20.0)
    return ranks.most_important(scene, share)


def test_all_are_drawn_until_the_most_important_are_known() -> None:
    gate = threading.Event()

    def rank(_scene: Any) -> np.ndarray:
        gate.wait(20.0)
        return np.arange(100)[::-1]

    ranks, scene = Ranks(rank, fewest=50), SimpleNamespace(token="a", count=100)
    assert ranks.most_important(SimpleNamespace(token="b", count=49), 0.25) is None, "small ones are never ranked"
    assert ranks.most_important(scene, 0.25) is None
    gate.set()
    found = ranked(ranks, scene, 0.25)
    assert found.tolist() == list(range(75, 100))
    assert ranks.most_important(scene, 0.25) is found
    assert set(found) < set(ranks.most_important(scene, 0.5)), "nothing flickers"
    assert ranks.most_important(scene, 1.0) is None


def test_each_scene_is_ranked_once_and_an_error_leaves_all(capfd: pytest.CaptureFixture[str]) -> None:
    asked = []

    def rank(scene: Any) -> np.ndarray:
        asked.append(scene.token)
        if scene.token == "bad":
            raise MemoryError("too many")
        return np.arange(scene.count)

    ranks = Ranks(rank, fewest=1)
    scenes = {token: SimpleNamespace(token=token, count=8) for token in ("a", "b", "bad")}
    for token in ("a", "b"):
        assert ranked(ranks, scenes[token], 0.5).tolist() == [0, 1, 2, 3]
    ranks.keep_only("b")
    for token in ("a", "b"):
        assert ranked(ranks, scenes[token], 0.25).tolist() == [0, 1]
    assert ranked(ranks, scenes["bad"], 0.5) is None and asked == ["a", "b", "a", "bad"]
    assert "splats could not be ranked (MemoryError: too many)" in capfd.readouterr().err
