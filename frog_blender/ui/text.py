"""Text in panels: wrapped labels and durations."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import bpy


def duration(seconds: float) -> str:
    """3725 -> "1 h 2 min", 95 -> "1 min 35 s", 8 -> "8 s"."""
    minutes, rest = divmod(round(max(seconds, 0.0)), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"


def wrapped_label(layout: bpy.types.UILayout, text: str, context: bpy.types.Context, icon: str = "NONE") -> None:
    """A label wrapped to the sidebar's width; Blender does not wrap by itself."""
    scale = context.preferences.system.ui_scale
    margin = 3 if icon == "NONE" else 6  # characters
    width = max(int(context.region.width / (7.0 * scale)) - margin, 16) if context.region else 40
    column = layout.column(align=True)
    column.scale_y = 0.8
    for i, line in enumerate(textwrap.wrap(text, width)):
        column.label(text=line, icon=icon if i == 0 or icon == "NONE" else "BLANK1")
