"""The one registry of what the add-on remembers."""

from __future__ import annotations

import sys
import threading
import time

import pytest
from support.training_panel import switched_off

from frog_blender import addon_state
from frog_blender.timeline import open_scenes


class Counter:
    """Something to remember, which takes a while to make."""

    made = 0

    def __init__(self, start: int = 0) -> None:
        time.sleep(0.01)
        type(self).made += 1
        self.value = start


@pytest.fixture(autouse=True)
def no_counter():
    Counter.made = 0
    addon_state.reset(Counter)
    yield
    addon_state.reset(Counter)


def test_there_is_one_object_of_a_class_until_it_is_reset_or_replaced():
    first = addon_state.get(Counter)
    first.value = 3
    assert addon_state.get(Counter) is first and Counter.made == 1
    addon_state.reset(Counter)
    assert addon_state.get(Counter).value == 0 and Counter.made == 2
    other = Counter(7)
    addon_state.put(other)
    assert addon_state.get(Counter) is other


def test_threads_that_ask_at_once_get_the_same_one():
    gate, found = threading.Barrier(8), []

    def ask():
        gate.wait()
        found.append(addon_state.get(Counter))

    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        threads = [threading.Thread(target=ask) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        sys.setswitchinterval(before)
    assert len(found) == 8 and len(set(map(id, found))) == 1 and Counter.made == 1


def test_disabling_the_add_on_forgets_everything(addon, static_rig):
    open_scenes.scene(static_rig)
    counter = addon_state.get(Counter)
    with switched_off():
        assert not open_scenes.paths() and addon_state.get(Counter) is not counter
