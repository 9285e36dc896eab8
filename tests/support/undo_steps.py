"""Undo and redo of steps."""

from collections.abc import Callable, Sequence

import bpy


def check_undo_and_redo(steps: Sequence[Callable[[], object]], state: Callable[[], object]) -> list[object]:
    """Takes steps, goes back through all states of the file and forth again: each is as it was.

    Args:
        state: what there is now.

    Returns:
        The states, of which the first was before the first step.
    """
    bpy.ops.ed.undo_push(message="before")
    states = [state()]
    for step in steps:
        step()
        bpy.ops.ed.undo_push(message="step")
        states.append(state())
    for before in reversed(states[:-1]):
        bpy.ops.ed.undo()
        assert state() == before
    for after in states[1:]:
        bpy.ops.ed.redo()
        assert state() == after
    return states
