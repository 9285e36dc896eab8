"""Undo and redo of steps that a test has pushed."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import bpy


def check_undo_and_redo(states: Sequence[object], state: Callable[[], object]) -> None:
    """Goes back through all states of the file and forth again: each is as it was.

    Args:
        states: what ``state`` gave before the first step and after each.
        state: what there is now.
    """
    for before in reversed(states[:-1]):
        bpy.ops.ed.undo()
        assert state() == before
    for after in states[1:]:
        bpy.ops.ed.redo()
        assert state() == after
