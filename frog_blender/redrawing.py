"""Redraws what shows the state of background work."""

from contextlib import AbstractContextManager, nullcontext

import bpy


def sidebars() -> None:
    """Redraws the sidebars of all viewports; the viewports themselves are expensive."""
    for region in open_regions():
        if region.type == "UI":
            region.tag_redraw()


def viewports() -> None:
    """Redraws all viewports."""
    for area in areas("VIEW_3D"):
        area.tag_redraw()


def preferences() -> None:
    """Redraws the preferences, where a window shows them."""
    for area in areas("PREFERENCES"):
        area.tag_redraw()


def status_bars() -> None:
    """Redraws the status bars of all windows, unless an operator shows its keys there."""
    for window in bpy.context.window_manager.windows:
        if not any(window.modal_operators) and window.workspace is not None:
            with bpy.context.temp_override(window=window):  # a status bar is of no screen: the text redraws it
                window.workspace.status_text_set_internal(None)


def some_window() -> AbstractContextManager[object]:
    """Inside, the context has a window, if there is one: Blender crashes where a workspace's text is set without.

    Timers have none after another timer has opened a file.
    """
    windows = bpy.context.window_manager.windows
    if bpy.context.window is not None or not windows:
        return nullcontext()
    override: AbstractContextManager[object] = bpy.context.temp_override(window=windows[0])
    return override


def open_regions() -> list[bpy.types.Region]:
    """Those of all viewports."""
    return [region for area in areas("VIEW_3D") for region in area.regions]


def areas(kind: str) -> list[bpy.types.Area]:
    """The areas of all windows that show an editor of this kind."""
    windows = bpy.context.window_manager.windows
    return [area for window in windows for area in window.screen.areas if area.type == kind]
