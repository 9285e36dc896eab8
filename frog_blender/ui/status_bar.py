"""The training in Blender's status bar, which is there whatever the sidebar shows."""

from __future__ import annotations

from typing import Any

import bpy

from .. import redrawing
from ..tasks import training
from ..tasks.training_state import TrainingState
from .text import duration


def _draw(self: Any, _context: bpy.types.Context) -> None:  # Any: the header, drawn by Blender
    task = training.current()
    if task is None:
        return
    if not task.state.running:
        self.layout.label(text=ended(task.state), icon="ERROR" if task.state.error else "CHECKMARK")
        self.layout.operator("frog.dismiss_training", text="", icon="X", emboss=False)
        return
    row = self.layout.row(align=True)
    row.ui_units_x = 12
    row.progress(factor=task.state.fraction, text=progress(task.state, task.paused))


def progress(state: TrainingState, is_paused: bool) -> str:
    """A running training in a few words."""
    if is_paused:
        return "Training is paused"
    if state.stage or not state.step:
        return f"Training: {state.stage or 'starting'}"
    return f"Training: {duration(state.seconds_left)} left"


def ended(state: TrainingState) -> str:
    """How a training ended, in a few words; the panel says more."""
    if state.error:
        return "The training stopped with an error: see the FRoG tab"
    if state.cancelled:
        return "The training was cancelled"
    return f"{state.result.name} is trained" if state.result is not None else "The training has ended"


def _on_change(_state: TrainingState) -> None:
    redrawing.status_bars()


def register() -> None:
    bpy.types.STATUSBAR_HT_header.append(_draw)
    training.watch(_on_change)


def unregister() -> None:
    bpy.types.STATUSBAR_HT_header.remove(_draw)
