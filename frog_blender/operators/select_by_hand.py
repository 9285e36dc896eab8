"""Selecting Gaussians in a viewport by a brush, a lasso or a box."""

# mypy: disable-error-code="valid-type"

from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np
from bpy.props import CollectionProperty

from ..engine.editing.gestures import GESTURES, OnScreen, drawn
from ..engine.editing.selections import combined
from ..engine.errors import FrogError
from ..properties import choice, number, switch, whole
from ..render.collect_instances import check_placement
from ..render.viewport import camera_of
from ..scene_import.capture_objects import active_capture, select_only
from ..timeline import playback
from ..ui import gesture_overlay
from ..ui.crop_frames import crop_at
from ..ui.selection_tools import BRUSH, HAND, LARGEST_BRUSH, SHAPES, tool_in
from ..ui.sidebar_panel import split
from .bases import EditOperator, FrogOperator, chosen_in, scene_of, select
from .edit_clean import MODES

_SHAPES = (
    ("BRUSH", "Brush", "What the mouse is drawn over"),
    ("LASSO", "Lasso", "What the mouse is drawn around"),
    ("BOX", "Box", "What lies in a rectangle"),
)
_MOVES, _STOPS = ("MOUSEMOVE", "INBETWEEN_MOUSEMOVE"), ("ESC", "RIGHTMOUSE")


@dataclass(frozen=True, eq=False)
class Seen:
    """A capture in a viewport.

    Attributes:
        screen: where its Gaussians are, as they are edited, whatever density is shown.
        rows: (N,) which of the file's these Gaussians are; None for all.
        identity: of the file's scene.
        height: of the region in pixels, from whose lower edge Blender counts.
    """

    screen: OnScreen
    rows: np.ndarray | None
    identity: str
    height: int

    def chosen(self, hit: np.ndarray, file_count: int) -> np.ndarray:
        """(file_count,) bool of what was hit (K,)."""
        chosen = np.zeros(file_count, bool)
        rows = self.screen.rows[hit]
        chosen[rows if self.rows is None else self.rows[rows]] = True
        return chosen


def seen_in(context: bpy.types.Context, obj: bpy.types.Object, only_visible: bool) -> Seen:
    """What the context's viewport shows of a capture now; FrogError if it shows nothing of it."""
    if not obj.visible_get(view_layer=context.view_layer, viewport=context.space_data):
        raise FrogError(f"{obj.name}: found it hidden in this viewport, expected a visible capture.")
    depsgraph = context.evaluated_depsgraph_get()
    evaluated = obj.evaluated_get(depsgraph)
    camera = camera_of(context, depsgraph)
    matrix = np.array(evaluated.matrix_world, np.float64)
    check_placement(matrix, obj.name)
    within = camera.world_to_camera @ matrix  # from the capture's own space, where its Gaussians need not be turned
    within[:3] /= np.cbrt(np.linalg.det(matrix[:3, :3]))
    shown = playback.scene_time(obj, context.scene.frame_current_final, evaluated)
    screen = OnScreen.of(shown.gaussians(), replace(camera, world_to_camera=within), only_visible=only_visible)
    return Seen(screen, shown.scene.rows, shown.scene.identity, context.region.height)


class FROG_OT_select_by_hand(EditOperator, bpy.types.Operator):
    """Select Gaussians of the capture where they are shown now, for all times. Shift adds, Ctrl deselects"""

    bl_label = "Select Gaussians by Hand"

    shape: choice("Shape", "What is drawn with the mouse. A tool draws its own", _SHAPES, "BRUSH")
    mode: choice("Mode", "What to do with those selected before", MODES, "SET")
    radius: whole("Radius", "The brush's radius in pixels", 25, min=1, max=LARGEST_BRUSH, soft_max=200, subtype="PIXEL")
    only_visible: switch("Only Visible", "Leave out what lies behind other Gaussians of the capture")
    path: CollectionProperty(
        type=bpy.types.OperatorMousePath,
        description="Where the mouse went, in pixels from the viewport's lower left corner",
        options={"HIDDEN", "SKIP_SAVE"},
    )

    # Any: a Seen and a Gesture during a gesture, which Blender would take for properties it cannot read.
    _seen: Any = None
    _gesture: Any = None

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        is_viewport = context.region_data is not None and context.region.type == "WINDOW"
        here = "" if context.mode == "OBJECT" and is_viewport else "Only in a 3D viewport in Object Mode."
        return super().problem(context) or here

    def draw(self, _context: bpy.types.Context) -> None:
        layout = split(self.layout)
        for name in ("shape", "mode", "only_visible"):
            layout.prop(self, name)
        if self.shape == "BRUSH":
            layout.prop(self, "radius")

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        try:
            self._seen = seen_in(context, active_capture(context), self.only_visible)
        except FrogError as error:
            return self.failed(error)
        if (tool := tool_in(context)) is not None:  # the last gesture's shape may be another tool's
            self.shape = SHAPES[tool.idname]
        self._gesture = GESTURES[self.shape](self._seen.screen, self.radius)
        gesture_overlay.begin(self._seen.screen, self._gesture, self.shape, self.radius, context.region)
        self._move(event)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        try:
            if event.type in _MOVES:
                self._move(event)
                if context.area is not None:
                    context.area.tag_redraw()
            elif event.type in _STOPS and event.value == "PRESS":
                self.cancel(context)
                return {"CANCELLED"}
            elif event.type == "LEFTMOUSE" and event.value == "RELEASE":
                if self._clicked_crop(context, event):
                    self.cancel(context)
                    return {"CANCELLED"}
                for x, y in self._gesture.path:
                    self.path.add().loc = x, self._seen.height - y
                ended = self.execute(context)
                self.cancel(context)
                return ended
        except Exception:  # Blender ends the operator then, but not its drawing
            self.cancel(context)
            raise
        return {"RUNNING_MODAL"}

    def _clicked_crop(self, context: bpy.types.Context, event: bpy.types.Event) -> bool:
        """Selects the crop whose frame was clicked on, as an undo step of its own, unless the mouse was drawn."""
        path = np.array(self._gesture.path)
        is_click = np.abs(path - path[0]).max() <= context.preferences.inputs.drag_threshold_mouse
        crop = crop_at(context, event.mouse_region_x, event.mouse_region_y) if is_click else None
        if crop is None:
            return False
        select_only(context, crop, extend=self.mode == "EXTEND")
        bpy.ops.ed.undo_push(message="Select Crop")
        return True

    def cancel(self, context: bpy.types.Context) -> None:
        """Ends drawing; also called by Blender when the window or the file is closed."""
        gesture_overlay.end()
        self._seen = self._gesture = None
        if context.area is not None:
            context.area.tag_redraw()

    def edit(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        scene = scene_of(obj)
        if self._gesture is None:
            self._replay(context, obj)
        elif self._seen.identity != scene.identity:
            raise FrogError(f"{obj.name}: found another training than at the beginning of the gesture; draw it again.")
        these = self._seen.chosen(self._gesture.hit, scene.file_count)
        self._seen = self._gesture = None
        return select(obj, combined(chosen_in(obj.frog_edits.selection, scene), these, self.mode))

    def _replay(self, context: bpy.types.Context, obj: bpy.types.Object) -> None:
        """A gesture made again with other settings, or by a script."""
        if not len(self.path):
            raise FrogError("Found no path of the mouse, expected the places it went through.")
        self._seen = seen_in(context, obj, self.only_visible)
        stroke = [(point.loc[0], self._seen.height - point.loc[1]) for point in self.path]
        self._gesture = drawn(self.shape, self._seen.screen, stroke, self.radius)

    def _move(self, event: bpy.types.Event) -> None:
        self._gesture.move((event.mouse_region_x + 0.5, self._seen.height - event.mouse_region_y - 0.5))


class FROG_OT_resize_selection_brush(FrogOperator, bpy.types.Operator):
    """Make the brush that selects Gaussians larger or smaller"""

    bl_label = "Resize Selection Brush"
    bl_options = {"INTERNAL"}

    factor: number("Factor", "Of the brush's radius", 1.25, min=0.1, max=10.0)

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        tool = tool_in(context)
        return "" if tool is not None and tool.idname == BRUSH else "Only with the brush that selects Gaussians."

    def act(self, context: bpy.types.Context) -> None:
        settings = tool_in(context).operator_properties(HAND)
        step = 1 if self.factor > 1 else -1
        radius = round(settings.radius * self.factor)
        settings.radius = min(max(radius if radius != settings.radius else radius + step, 1), LARGEST_BRUSH)
        context.area.tag_redraw()
