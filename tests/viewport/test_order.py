"""Orders of splats: at once for a few, later for many, never one that does not fit."""

import threading
from dataclasses import replace

import numpy as np
import pytest

from frog_blender.viewport.order import OrderRequest, Part, Sorter


def request(key: int, count: int = 1000, place: str = "left") -> OrderRequest:
    points = np.random.default_rng(count).normal(0, 3, (count, 3)).astype(np.float32)
    return OrderRequest(place, key, (Part(points, (float(np.cos(key)), 0.0, float(np.sin(key)), 9.0)),))


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
