"""The tools in a viewport's toolbar that select Gaussians: brush, lasso and box."""

from typing import Any

import bpy
from gpu_extras.presets import draw_circle_2d

HAND = "frog.select_by_hand"
"""The operator that they are for."""
BRUSH, LASSO, BOX = "frog.brush_select", "frog.lasso_select", "frog.box_select"
LARGEST_BRUSH = 2000  # pixels
_AFTER = {"builtin.select_lasso"}


def _keys(shape: str) -> tuple[Any, ...]:
    return tuple(
        (HAND, {"type": "LEFTMOUSE", "value": "PRESS", **held}, {"properties": [("shape", shape), ("mode", mode)]})
        for held, mode in (({}, "SET"), ({"shift": True}, "EXTEND"), ({"ctrl": True}, "SUBTRACT"))
    )


def _resizing(key: str, factor: float) -> tuple[Any, ...]:
    pressed = {"type": key, "value": "PRESS", "repeat": True}
    return "frog.resize_selection_brush", pressed, {"properties": [("factor", factor)]}


class _Tool:
    """What the tools share."""

    bl_space_type = "VIEW_3D"
    bl_context_mode = "OBJECT"

    @staticmethod
    def draw_settings(_context: bpy.types.Context, layout: bpy.types.UILayout, tool: Any) -> None:
        layout.prop(tool.operator_properties(HAND), "only_visible")


class FROG_TOOL_brush_select(_Tool, bpy.types.WorkSpaceTool):
    """Select Gaussians of the capture by drawing over them. Shift adds, Ctrl deselects, [ and ] resize the brush"""

    bl_idname = BRUSH
    bl_label = "Select Gaussians: Brush"
    bl_icon = "ops.generic.select_circle"
    bl_keymap = (*_keys("BRUSH"), _resizing("LEFT_BRACKET", 0.8), _resizing("RIGHT_BRACKET", 1.25))

    @staticmethod
    def draw_settings(context: bpy.types.Context, layout: bpy.types.UILayout, tool: Any) -> None:
        layout.prop(tool.operator_properties(HAND), "radius")
        _Tool.draw_settings(context, layout, tool)

    @staticmethod
    def draw_cursor(_context: bpy.types.Context, tool: Any, xy: tuple[float, float]) -> None:
        draw_circle_2d(xy, (1.0, 1.0, 1.0, 1.0), tool.operator_properties(HAND).radius, segments=48)


class FROG_TOOL_lasso_select(_Tool, bpy.types.WorkSpaceTool):
    """Select Gaussians of the capture by drawing around them. Shift adds, Ctrl deselects"""

    bl_idname = LASSO
    bl_label = "Select Gaussians: Lasso"
    bl_icon = "ops.generic.select_lasso"
    bl_keymap = _keys("LASSO")


class FROG_TOOL_box_select(_Tool, bpy.types.WorkSpaceTool):
    """Select Gaussians of the capture in a rectangle. Shift adds, Ctrl deselects"""

    bl_idname = BOX
    bl_label = "Select Gaussians: Box"
    bl_icon = "ops.generic.select_box"
    bl_keymap = _keys("BOX")


def brush_in(context: bpy.types.Context) -> Any:  # Any: a WorkSpaceTool; None for another tool
    """The brush that selects Gaussians, if it is the viewport's tool."""
    if context.area is None or context.area.type != "VIEW_3D":
        return None
    tool = context.workspace.tools.from_space_view3d_mode(context.mode, create=False)
    return tool if tool is not None and tool.idname == BRUSH else None


def register() -> None:
    bpy.utils.register_tool(FROG_TOOL_brush_select, after=_AFTER, separator=True, group=True)
    bpy.utils.register_tool(FROG_TOOL_lasso_select, after={BRUSH})
    bpy.utils.register_tool(FROG_TOOL_box_select, after={LASSO})


def unregister() -> None:
    for tool in (FROG_TOOL_box_select, FROG_TOOL_lasso_select, FROG_TOOL_brush_select):
        bpy.utils.unregister_tool(tool)
