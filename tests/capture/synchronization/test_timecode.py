"""What a film's tags say about when it was taken."""

from __future__ import annotations

import pytest

from frog_blender.engine.capture.synchronization.timecode import Note, read_note, window


def test_a_timecode_is_preferred_to_a_creation_time() -> None:
    tags = {"creation_time": "2024-05-06T07:08:09.000000Z"}
    assert read_note(tags | {"timecode": "01:02:03:12"}, 24.0) == Note(3723.5, True)
    assert read_note(tags | {"timecode": "01:02:03;15"}, 30.0) == Note(3723.5, True)
    created = read_note(tags, 24.0)
    assert created is not None and not created.is_timecode


@pytest.mark.parametrize("created", ["", "1904-01-01T00:00:00Z", "2024-15-06T07:08:09Z"])
def test_tags_that_say_nothing(created: str) -> None:
    assert read_note({"timecode": "1:2", "creation_time": created}, 30.0) is None


def test_a_window_is_about_the_difference() -> None:
    low, high = window(Note(100.0, True), Note(103.5, True)) or (0, 0)
    assert low < 3.5 < high and high - low <= 2.0
    low, high = window(Note(86_399.0, True), Note(2.0, True)) or (0, 0)  # across midnight
    assert low < 3.0 < high
    assert window(Note(1.0, True), Note(1.0, False)) is None
    assert window(None, Note(1.0, True)) is None
