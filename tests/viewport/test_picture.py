"""How finely a moving viewport is drawn."""

import pytest

picture = pytest.importorskip("frog_blender.viewport.picture", reason="needs bpy")


def test_slow_images_become_coarser_and_quick_ones_finer() -> None:
    pace, now = picture.Pace(), 100.0
    assert pace.changed(now) == 1
    for seconds, expected in ((0.2, 2), (0.2, 4), (0.2, 4), (0.01, 2), (0.01, 1), (0.01, 1), (0.05, 1)):
        now += seconds
        assert pace.changed(now) == expected


def test_images_that_take_long_are_movement_too() -> None:
    pace, now = picture.Pace(), 100.0
    for expected in (1, 2, 4):
        now += 0.05
        assert pace.changed(now) == expected
        now += 2.0
        pace.ended_at = now


def test_a_change_after_a_pause_is_drawn_sharply() -> None:
    pace, now = picture.Pace(), 100.0
    pace.changed(now)
    for _ in range(3):
        now += 0.3
        pace.changed(now)
    assert pace.step == 4
    assert not pace.is_still(now + picture.STILL_AFTER / 2) and pace.is_still(now + picture.STILL_AFTER)
    assert pace.changed(now + 5.0) == 1
