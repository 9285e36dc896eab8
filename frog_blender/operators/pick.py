"""A click on splats selects what moves their capture, and its deletion leaves nothing of the import."""

from dataclasses import dataclass, replace

import bpy
import numpy as np
from bpy_extras.view3d_utils import region_2d_to_origin_3d, region_2d_to_vector_3d
from mathutils import Matrix

from .. import reported_once
from ..capture_files import is_capture
from ..engine.errors import FrogError
from ..engine.native.options import RasterizeOptions
from ..engine.playback.render import draw
from ..registration import Keys
from ..render.collect_instances import placed, visible_captures
from ..render.viewport import camera_of
from ..scene_import.capture_objects import cameras_of, holders_of, is_as_made, select_capture, select_only
from ..scene_import.scene_setup import start_cube
from ..timeline import playback
from ..timeline.edits import show_as_crops
from ..ui.crop_frames import crop_at
from ..viewport import drawing
from .bases import UNDOABLE, ConfirmedOperator, FrogOperator
from .edit_crops import cropped_with

_REACH = 2  # pixels on each side of the mouse
_SEEN = 0.5  # alpha from which splats are what is seen there
_SURFACES = ("MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME")
_SAME = 1e-4  # of matrices


@dataclass(frozen=True, eq=False)
class Hit:
    """Splats under the mouse: of an object, standing where a matrix says, at a distance along the view."""

    obj: bpy.types.Object
    matrix: np.ndarray
    depth: float


def splats_at(context: bpy.types.Context, x: int, y: int) -> Hit | None:
    """The nearest capture that is seen at a pixel of the context's region, from its lower left corner."""
    region = context.region
    if not (0 <= x < region.width and 0 <= y < region.height):
        return None
    depsgraph = context.evaluated_depsgraph_get()
    camera = camera_of(context, depsgraph)
    left, top = max(0, x - _REACH), max(0, region.height - 1 - y - _REACH)
    right, bottom = min(region.width, x + _REACH + 1), min(region.height, region.height - y + _REACH)
    options = replace(RasterizeOptions(), region=(left, top, right - left, bottom - top))
    hits = []
    for obj, evaluated, matrix in visible_captures(depsgraph, context.space_data):
        try:
            shown = playback.displayed(obj, depsgraph.scene.frame_current_final, evaluated)
            drawn = draw(placed(shown.gaussians(), matrix, obj.name), camera, options=options)
        except FrogError:  # which viewports and the panel tell
            continue
        if drawn.alpha.mean() >= _SEEN and np.isfinite(drawn.median_z).any():
            hits.append(Hit(obj, matrix, float(np.nanmedian(drawn.median_z))))
    return min(hits, key=lambda hit: hit.depth, default=None)


def is_hidden(context: bpy.types.Context, hit: Hit, x: int, y: int) -> bool:
    """Whether a surface lies before the splats at a pixel."""
    region, view = context.region, context.region_data
    origin = region_2d_to_origin_3d(region, view, (x, y))
    direction = region_2d_to_vector_3d(region, view, (x, y))
    depsgraph = context.evaluated_depsgraph_get()
    is_hit, location, _, _, obj, _ = context.scene.ray_cast(depsgraph, origin, direction)
    if not is_hit or is_capture(obj.original) or obj.original == start_cube(context.scene):
        return False
    camera = camera_of(context, depsgraph)
    return float((np.array(location) - camera.center) @ camera.forward) < hit.depth


def select(context: bpy.types.Context, hit: Hit, *, extend: bool = False) -> None:
    """Selects what moves the splats: the capture's root, or the object that instances it."""
    instancer = _instancer(context, hit)
    if instancer is None:
        select_capture(context, hit.obj, extend=extend)
    else:
        select_only(context, instancer, extend=extend)


def _instancer(context: bpy.types.Context, hit: Hit) -> bpy.types.Object | None:
    """The object that shows a capture elsewhere by its collection; None for the capture itself."""
    if hit.obj.name in context.view_layer.objects and np.allclose(hit.matrix, hit.obj.matrix_world, atol=_SAME):
        return None
    for obj in context.view_layer.objects:
        collection = obj.instance_collection if obj.instance_type == "COLLECTION" else None
        if collection is not None and hit.obj.name in collection.all_objects:
            matrix = obj.matrix_world @ Matrix.Translation(-collection.instance_offset) @ hit.obj.matrix_world
            if np.allclose(hit.matrix, matrix, atol=_SAME):
                return obj
    return None


class FROG_OT_pick(FrogOperator, bpy.types.Operator):
    """Select the capture whose splats are under the mouse"""

    bl_label = "Select Capture"
    bl_options = {"UNDO", "INTERNAL"}

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        is_viewport = context.region_data is not None and context.region.type == "WINDOW"
        is_seen = not drawing.is_replaced(context.scene) and playback.captures_in(context.scene)
        can_pick = context.mode == "OBJECT" and is_viewport and is_seen
        return "" if can_pick else "Only among captures, in a viewport in Object Mode."

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type != f"{_select_button()}MOUSE":
            return {"PASS_THROUGH"}
        x, y = event.mouse_region_x, event.mouse_region_y
        try:
            if (crop := crop_at(context, x, y)) is not None:
                select_only(context, crop, extend=event.shift)
                return {"FINISHED"}
            hit = splats_at(context, x, y)
            if hit is None or is_hidden(context, hit, x, y):
                return {"PASS_THROUGH"}
        except Exception as error:  # a click must select whatever Blender finds
            reported_once.unexpected("selecting splats", error)
            return {"PASS_THROUGH"}
        if not _picks_a_handle(context, x, y, event.shift):
            select(context, hit, extend=event.shift)
        return {"FINISHED"}


def _select_button() -> str:
    """LEFT or RIGHT: the mouse button that selects."""
    preferences = bpy.context.window_manager.keyconfigs.active.preferences
    return getattr(preferences, "select_mouse", "LEFT")


def _picks_a_handle(context: bpy.types.Context, x: int, y: int, extend: bool) -> bool:
    """Lets Blender select what it draws over everything, such as a light; takes back what it selects besides."""
    before, active = set(context.selected_objects), context.view_layer.objects.active
    bpy.ops.view3d.select(location=(x, y), extend=extend, deselect_all=False)
    chosen = context.view_layer.objects.active
    changed = set(context.selected_objects) != before or chosen != active
    if changed and chosen is not None and chosen.type not in _SURFACES:
        return True
    for obj in context.view_layer.objects:
        if obj.select_get() != (obj in before):
            obj.select_set(obj in before)
    context.view_layer.objects.active = active
    return False


class FROG_OT_delete(ConfirmedOperator, bpy.types.Operator):
    """Delete the selected objects, and with a capture's root all else that its import made"""

    bl_label = "Delete Selected"
    bl_options = UNDOABLE

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        return "" if context.mode == "OBJECT" and _deleted_captures(context) else "Select a capture's root first."

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        # As Blender's own keys: only X asks.
        return self.execute(context) if event.type == "DEL" else super().invoke(context, event)

    def act(self, context: bpy.types.Context) -> None:
        objects = set(context.selected_objects)
        collections: set[bpy.types.Collection] = set()
        crops: set[bpy.types.Object] = set()
        for obj in _deleted_captures(context):
            made = {child for child in (*cameras_of(obj), *holders_of(obj)) if is_as_made(child)}
            crops |= {child for child in obj.children if child.type == "EMPTY" and cropped_with(child) == {obj}}
            objects |= {obj, *made}
            collections |= {holds for part in (obj, *made) for holds in part.users_collection if is_as_made(holds)}
        for deleted in (objects - crops, crops):  # the captures use the crops
            with context.temp_override(selected_objects=list(deleted)):  # hidden ones as well
                bpy.ops.object.delete()
        show_as_crops()
        for collection in sorted(collections, key=lambda of: len(of.children_recursive)):  # inner ones first
            if not (collection.objects or collection.children):
                bpy.data.collections.remove(collection)


def _deleted_captures(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The captures of this file whose roots are selected, those alone on their root."""
    roots = [list(playback.captures(obj.children)) for obj in context.selected_objects if obj.library is None]
    return [hanging[0] for hanging in roots if len(hanging) == 1 and hanging[0].library is None]


KEYMAPS: Keys = [
    ("Object Mode", FROG_OT_pick.bl_idname, button, value, {"shift": shift})
    for button, value in (("LEFTMOUSE", "CLICK"), ("RIGHTMOUSE", "PRESS"))
    for shift in (False, True)
]
KEYMAPS += [("Object Mode", FROG_OT_delete.bl_idname, key, "PRESS", {}) for key in ("X", "DEL")]
