"""How finely a moving viewport is drawn."""

from __future__ import annotations

from frog_blender.viewport.pace import STILL_AFTER, Pace


def test_slow_images_become_coarser_and_quick_ones_finer() -> None:
    pace, now = Pace(), 100.0
    assert pace.changed(now) == 1
    for expected in (2, 4, 4):
        now += 0.2
        assert pace.changed(now) == expected
    for expected in (2, 1, 1):
        now += 0.01
        assert pace.changed(now) == expected
    now += 0.05
    assert pace.changed(now) == 1, "neither slow nor quick"


def test_images_that_take_long_are_movement_too() -> None:
    pace, now = Pace(), 100.0
    for expected in (1, 2, 4):
        now += 0.05
        assert pace.changed(now) == expected
        now += 2.0
        pace.ended_at = now


def test_a_change_after_a_pause_is_drawn_sharply() -> None:
    pace, now = Pace(), 100.0
    pace.changed(now)
    for _ in range(3):
        now += 0.3
        pace.changed(now)
    assert pace.step == 4 and not pace.is_still(now + STILL_AFTER / 2) and pace.is_still(now + STILL_AFTER)
    assert pace.changed(now + 5.0) == 1
