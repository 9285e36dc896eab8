"""The training in Blender's status bar, which is there whatever the sidebar shows."""

from typing import Any

import bpy

from ..tasks.training import TrainingTask
from .sidebar_panel import duration


def _draw(self: Any, _context: bpy.types.Context) -> None:  # Any: the header, drawn by Blender
    task = TrainingTask.current()
    if task is None:
        return
    if not task.is_running:
        self.layout.label(text=ended(task), icon="ERROR" if task.error else "CHECKMARK")
        self.layout.operator("frog.dismiss_training", text="", icon="X", emboss=False)
        return
    row = self.layout.row(align=True)
    row.ui_units_x = 12
    row.progress(factor=task.progress.fraction, text=progress(task))


def progress(task: TrainingTask) -> str:
    """A running training in a few words."""
    if task.paused:
        return "Training is paused"
    if task.progress.stage or not task.state.step:
        return f"Training: {task.progress.stage or 'starting'}"
    return f"Training: {duration(task.state.seconds_left)} left"


def ended(task: TrainingTask) -> str:
    """How a training ended, in a few words; the panel says more."""
    if task.error:
        return "The training stopped with an error: see the FRoG tab"
    if task.is_cancelled:
        return "The training was cancelled"
    return f"{task.result.name} is trained" if task.result is not None else "The training has ended"


MENUS = {"STATUSBAR_HT_header": _draw}
