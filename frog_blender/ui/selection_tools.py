"""The tools in a viewport's toolbar that select Gaussians, brush, lasso and box, and the keys that they share."""

from dataclasses import dataclass, field
from typing import Any

import bpy
from gpu_extras.presets import draw_circle_2d

HAND = "frog.select_by_hand"
"""The operator that they are for."""
BRUSH, LASSO, BOX = "frog.brush_select", "frog.lasso_select", "frog.box_select"
SHAPES = {BRUSH: "BRUSH", LASSO: "LASSO", BOX: "BOX"}
"""What each draws."""
LARGEST_BRUSH = 2000  # pixels
KEYMAP = "3D View Tool: Object, Select Gaussians"
"""One for all of them: a key that the user changes is another one in each."""
_AFTER = {"builtin.select_lasso"}
_BLENDERS = "builtin.select_box"  # the tool that a new file of Blender's has


@dataclass(frozen=True)
class Action:
    """What keys do while one of the tools is active.

    Attributes:
        keys: types of Blender's, after what is held: the first is shown.
        repeats: while a key is held.
    """

    label: str
    operator: str
    keys: tuple[str, ...]
    settings: dict[str, Any] = field(default_factory=dict)
    repeats: bool = False


# Every key of Blender's that selects, hides or deletes objects is among them: it must not reach the capture's object.
ACTIONS = (
    Action("Hide", "frog.hide_gaussians", ("X", "DEL", "H", "shift X", "shift DEL"), {"unselected": False}),
    Action("Hide Others", "frog.hide_gaussians", ("shift H",), {"unselected": True}),
    Action("Show All", "frog.restore_gaussians", ("alt H",), {"all": True}),
    Action("All", "frog.select_gaussians_all", ("A",), {"action": "ALL"}),
    Action("None", "frog.select_gaussians_all", ("alt A", "double A"), {"action": "NONE"}),
    Action("Invert", "frog.select_gaussians_all", ("ctrl I",), {"action": "INVERT"}),
    Action(
        "Grow",
        "frog.grow_selection",
        ("PLUS", "EQUAL", "shift EQUAL", "ctrl NUMPAD_PLUS"),
        {"shrink": False},
        repeats=True,
    ),
    Action("Shrink", "frog.grow_selection", ("MINUS", "ctrl NUMPAD_MINUS"), {"shrink": True}, repeats=True),
    Action("Leave Tool", "wm.tool_set_by_id", ("ESC",), {"name": _BLENDERS}),
)
_MOUSE = (
    Action("Select", HAND, ("LEFTMOUSE",), {"mode": "SET"}),
    Action("Add", HAND, ("shift LEFTMOUSE",), {"mode": "EXTEND"}),
    Action("Deselect", HAND, ("ctrl LEFTMOUSE",), {"mode": "SUBTRACT"}),
    Action("Smaller Brush", "frog.resize_selection_brush", ("LEFT_BRACKET",), {"factor": 0.8}, repeats=True),
    Action("Larger Brush", "frog.resize_selection_brush", ("RIGHT_BRACKET",), {"factor": 1.25}, repeats=True),
)


def user_keys(context: bpy.types.Context) -> list[bpy.types.KeyMapItem]:
    """The keys of the tools as the user has them, in the order in which they were made."""
    keymap = context.window_manager.keyconfigs.user.keymaps.get(KEYMAP)
    return [] if keymap is None else sorted(keymap.keymap_items, key=lambda item: item.id)


def draw_keys(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Shows what each key does, by the keys that the user has."""
    keys = user_keys(context)
    for action in ACTIONS:
        for item in keys:
            if item.active and item.idname == action.operator and _has(item.properties, action.settings):
                layout.template_event_from_keymap_item(item, text=action.label)
                break


def _has(properties: Any, settings: dict[str, Any]) -> bool:
    return all(getattr(properties, name) == value for name, value in settings.items())


class _Tool:
    """What the tools share."""

    bl_space_type = "VIEW_3D"
    bl_context_mode = "OBJECT"
    bl_keymap = KEYMAP

    @staticmethod
    def draw_settings(context: bpy.types.Context, layout: bpy.types.UILayout, tool: Any) -> None:
        if tool.idname == BRUSH:
            layout.prop(tool.operator_properties(HAND), "radius")
        layout.prop(tool.operator_properties(HAND), "only_visible")
        if context.region.type == "TOOL_HEADER":
            draw_keys(layout, context)


class FROG_TOOL_brush_select(_Tool, bpy.types.WorkSpaceTool):
    """Select Gaussians of the capture by drawing over them. Shift adds, Ctrl deselects, [ and ] resize the brush"""

    bl_idname = BRUSH
    bl_label = "Select Gaussians: Brush"
    bl_icon = "ops.generic.select_circle"

    @staticmethod
    def draw_cursor(_context: bpy.types.Context, tool: Any, xy: tuple[float, float]) -> None:
        draw_circle_2d(xy, (1.0, 1.0, 1.0, 1.0), tool.operator_properties(HAND).radius, segments=48)


class FROG_TOOL_lasso_select(_Tool, bpy.types.WorkSpaceTool):
    """Select Gaussians of the capture by drawing around them. Shift adds, Ctrl deselects"""

    bl_idname = LASSO
    bl_label = "Select Gaussians: Lasso"
    bl_icon = "ops.generic.select_lasso"


class FROG_TOOL_box_select(_Tool, bpy.types.WorkSpaceTool):
    """Select Gaussians of the capture in a rectangle. Shift adds, Ctrl deselects"""

    bl_idname = BOX
    bl_label = "Select Gaussians: Box"
    bl_icon = "ops.generic.select_box"


def tool_in(context: bpy.types.Context) -> Any:  # Any: a WorkSpaceTool; None for another tool
    """The tool of a viewport, if it is one of these."""
    if context.area is None or context.area.type != "VIEW_3D":
        return None
    return _of_workspace(context)


def _of_workspace(context: bpy.types.Context) -> Any:
    tool = context.workspace.tools.from_space_view3d_mode(context.mode, create=False)
    return tool if tool is not None and tool.idname in SHAPES else None


def _draw_status(self: Any, context: bpy.types.Context) -> None:  # Any: the header, drawn by Blender
    shows_view = any(area.type == "VIEW_3D" for area in context.screen.areas)
    if shows_view and context.workspace is not None and _of_workspace(context) is not None:
        draw_keys(self.layout.row(), context)


def _fill_keymaps() -> None:
    """Makes the keymap where add-ons have theirs, and an empty one of Blender's, over which the user's lies."""
    configurations = bpy.context.window_manager.keyconfigs
    place: dict[str, Any] = {"space_type": "VIEW_3D", "region_type": "WINDOW", "tool": True}
    if configurations.addon is None:  # without a window
        return
    configurations.default.keymaps.new(KEYMAP, **place)
    items = configurations.addon.keymaps.new(KEYMAP, **place).keymap_items
    for action in () if len(items) else (*_MOUSE, *ACTIONS):
        for key in action.keys:
            *held, kind = key.split()
            value = "DOUBLE_CLICK" if "double" in held else "PRESS"
            modifiers = {name: True for name in held if name != "double"}
            item = items.new(action.operator, kind, value, repeat=action.repeats, **modifiers)
            for name, setting in action.settings.items():
                setattr(item.properties, name, setting)


_TOOLS = (FROG_TOOL_brush_select, FROG_TOOL_lasso_select, FROG_TOOL_box_select)


def register() -> None:
    _fill_keymaps()
    bpy.utils.register_tool(FROG_TOOL_brush_select, after=_AFTER, separator=True, group=True)
    bpy.utils.register_tool(FROG_TOOL_lasso_select, after={BRUSH})
    bpy.utils.register_tool(FROG_TOOL_box_select, after={LASSO})
    bpy.types.STATUSBAR_HT_header.prepend(_draw_status)  # beside what the mouse does


def unregister() -> None:
    bpy.types.STATUSBAR_HT_header.remove(_draw_status)
    for tool in reversed(_TOOLS):
        _fill_keymaps()  # each tool takes its keymap with it, and warns where there is none
        bpy.utils.unregister_tool(tool)
