"""What runs in the background, in Blender's status bar, which is always there; and what quitting would end."""

from typing import Any

import bpy

from ..engine.whole_progress import about
from ..render.compositing import renders
from ..tasks import background_task
from ..tasks.background_task import BackgroundTask
from ..tasks.training import TrainingTask
from .sidebar_panel import wrapped_label


def _draw(self: Any, _context: bpy.types.Context) -> None:  # Any: the header, drawn by Blender
    for task in background_task.running():
        row = self.layout.row(align=True)
        row.ui_units_x = 12
        row.progress(factor=task.standing.fraction, text=progress(task))
    last = TrainingTask.current()
    if last is not None and not last.is_running:
        self.layout.label(text=ended(last), icon="ERROR" if last.error else "CHECKMARK")
        self.layout.operator("frog.dismiss_training", text="", icon="X", emboss=False)
    if film := renders.film():
        self.layout.label(text=film, icon="CHECKMARK")


def _draw_quitting(self: Any, _context: bpy.types.Context) -> None:
    """Behind *Quit*: what that would end."""
    for sentence in background_task.at_quitting():
        wrapped_label(self.layout, sentence, icon="INFO")


def progress(task: BackgroundTask) -> str:
    """What runs, in a few words."""
    what, now = task.what.capitalize(), task.standing
    if task.paused:
        return f"{what}: paused"
    return f"{what}: about {about(now.seconds_left)} left" if now.seconds_left > 0 else f"{what}: {now.stage}"


def ended(task: TrainingTask) -> str:
    """How a training ended, in a few words; the panel says more."""
    if task.error:
        return "The training stopped with an error: see the FRoG tab"
    if task.is_cancelled:
        return "The training was cancelled"
    return f"{task.result.name} is trained" if task.result is not None else "The training has ended"


MENUS = {"STATUSBAR_HT_header": _draw, "TOPBAR_MT_file": _draw_quitting}
