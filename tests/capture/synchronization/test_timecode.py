"""What a film's notes say about when it was taken."""

from __future__ import annotations

import pytest

from frog_blender.engine.capture.synchronization.timecode import Note, read_note, window

_NOTES = """  Metadata:
    creation_time   : 2024-05-06T07:08:09.000000Z
  Stream #0:2(eng): Data: none (tmcd / 0x64636D74)
    Metadata:
      timecode        : {code}
"""


def test_a_timecode_is_preferred_to_a_creation_time() -> None:
    note = read_note(_NOTES.format(code="01:02:03:12"), 24.0)
    assert note == Note(3723.5, True)
    assert read_note(_NOTES.format(code="01:02:03;15"), 30.0) == Note(3723.5, True)
    created = read_note(_NOTES.format(code="none"), 24.0)
    assert created is not None and not created.is_timecode


@pytest.mark.parametrize("text", ["", "creation_time : 1904-01-01T00:00:00Z", "creation_time : 2024-15-06T07:08:09Z"])
def test_notes_that_say_nothing(text: str) -> None:
    assert read_note(text, 30.0) is None


def test_a_window_is_about_the_difference() -> None:
    low, high = window(Note(100.0, True), Note(103.5, True)) or (0, 0)
    assert low < 3.5 < high and high - low <= 2.0
    low, high = window(Note(86_399.0, True), Note(2.0, True)) or (0, 0)  # across midnight
    assert low < 3.0 < high
    assert window(Note(1.0, True), Note(1.0, False)) is None
    assert window(None, Note(1.0, True)) is None
