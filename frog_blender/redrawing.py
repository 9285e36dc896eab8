"""Redraws what shows the state of background work."""

from __future__ import annotations

import bpy


def sidebars() -> None:
    """Redraws the sidebars of all viewports; the viewports themselves are expensive."""
    for region in open_regions():
        if region.type == "UI":
            region.tag_redraw()


def viewports() -> None:
    """Redraws all viewports."""
    for area in viewport_areas():
        area.tag_redraw()


def preferences() -> None:
    """Redraws the preferences, where a window shows them."""
    for area in _areas("PREFERENCES"):
        area.tag_redraw()


def status_bars() -> None:
    """Redraws the status bars of all windows, unless an operator shows its keys there."""
    for window in bpy.context.window_manager.windows:
        if not any(window.modal_operators) and window.workspace is not None:
            window.workspace.status_text_set_internal(None)  # an area of no screen, which has no redraw of its own


def viewport_areas() -> list[bpy.types.Area]:
    """All viewports."""
    return _areas("VIEW_3D")


def open_regions() -> list[bpy.types.Region]:
    """Those of all viewports."""
    return [region for area in viewport_areas() for region in area.regions]


def _areas(kind: str) -> list[bpy.types.Area]:
    windows = bpy.context.window_manager.windows
    return [area for window in windows for area in window.screen.areas if area.type == kind]
