"""What panels share: wrapped labels, durations, and the tab FRoG, which is brought to the front."""

import textwrap
from functools import partial
from typing import Any

import bpy

from .. import redrawing
from ..engine.whole_progress import about
from ..tasks.background_task import BackgroundTask

_EVERY = 0.05  # seconds
_MOST_TRIES = 40  # a sidebar has no tabs until it was drawn, which may take a while in a busy window


class SidebarPanel:
    """Base, next to ``bpy.types.Panel``, of the panels in the 3D viewport's sidebar."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "FRoG"


class SubPanel(SidebarPanel):
    """The same of those within another one."""

    bl_options = {"DEFAULT_CLOSED"}


def split(layout: Any) -> Any:
    """The layout, with names of settings in a column of their own."""
    layout.use_property_split = True
    layout.use_property_decorate = False
    return layout


def duration(seconds: float) -> str:
    """3725 -> "1 h 2 min", 95 -> "1 min 35 s", 8 -> "8 s"."""
    minutes, rest = divmod(round(max(seconds, 0.0)), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"


def draw_progress(layout: bpy.types.UILayout, task: BackgroundTask) -> None:
    """Draws the bar of what runs, and how long that will take as far as it is known."""
    now = task.standing
    state = "Cancelling" if task.is_stopping else f"Paused: {now.stage}" if task.paused else now.stage
    layout.progress(factor=now.fraction, text=state)
    if now.seconds_left > 0 and not task.is_stopping:
        layout.label(text=f"About {about(now.seconds_left)} left", icon="TIME")


def draw_reason(layout: bpy.types.UILayout, operator: str) -> None:
    """Draws why the button of an operator, by the name of its class, is grey; nothing where it is not."""
    wrapped_label(layout, getattr(bpy.types, operator).problem(bpy.context), icon="INFO")


def wrapped_label(layout: bpy.types.UILayout, text: str, icon: str = "NONE") -> None:
    """A label wrapped to the width of the region that is drawn; Blender does not wrap by itself. None for no text."""
    if not text:
        return
    context, width = bpy.context, 1000
    if context.region is not None:  # there is none without a window
        margin = 3 if icon == "NONE" else 6  # characters
        width = max(int(context.region.width / (7.0 * context.preferences.system.ui_scale)) - margin, 16)
    column = layout.column(align=True)
    column.scale_y = 0.8
    for i, line in enumerate(textwrap.wrap(text, width)):
        column.label(text=line, icon=icon if i == 0 or icon == "NONE" else "BLANK1")


def show_tab(area: bpy.types.Area) -> None:
    """Selects the tab as soon as Blender allows it, unless the sidebar was closed again."""
    bpy.app.timers.register(partial(_choose, area.as_pointer(), [_MOST_TRIES]), first_interval=0.0)


def _choose(address: int, tries_left: list[int]) -> float | None:
    """Blender's UI objects cannot be kept: the viewport is looked for by its address, if it still exists."""
    areas = [area for area in redrawing.areas("VIEW_3D") if area.as_pointer() == address]
    region = next((region for area in areas for region in area.regions if region.type == "UI"), None)
    if region is None or not areas[0].spaces.active.show_region_ui:
        return None
    try:
        region.active_panel_category = SidebarPanel.bl_category
        region.tag_redraw()
    except (AttributeError, TypeError):  # read-only, or none of the tabs, until it was drawn with them
        tries_left[0] -= 1
        return _EVERY if tries_left[0] > 0 else None
    return None
