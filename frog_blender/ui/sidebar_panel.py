"""What the panels of the FRoG tab share."""

from __future__ import annotations

from typing import Any


class SidebarPanel:
    """Base, next to ``bpy.types.Panel``, of the panels in the 3D viewport's sidebar."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "FRoG"


def split(layout: Any) -> Any:
    """The layout, with names of settings in a column of their own."""
    layout.use_property_split = True
    layout.use_property_decorate = False
    return layout
