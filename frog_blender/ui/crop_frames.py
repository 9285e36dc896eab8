"""Crop objects in viewports: bright frames, faces, handles that move one side, and the frame under the mouse."""

from collections.abc import Iterator
from typing import Any

import bpy
import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader
from mathutils import Matrix, Vector

from .. import addon_state, point_cloud
from ..timeline import playback
from ..timeline.edits import is_crop_object
from .overlay import EDGE, Overlay, distance_to, draw_lines

REACH = 6.0  # pixels from a line in which a click is on it
_MOST_TRIANGLES = 20_000  # of a mesh that is drawn at each redraw; of a larger one, the box around it
_BRIGHT, _CHOSEN, _FACES = (0.1, 0.85, 1.0, 1.0), (1.0, 0.85, 0.1, 1.0), (1.0, 0.85, 0.1, 0.01)
_CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
_EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if (_CORNERS[a] != _CORNERS[b]).sum() == 1]
_SIDES = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
_HALVES = [triangle for a, b, c, d in _SIDES for triangle in ((a, b, c), (a, c, d))]
_STEPS = 32  # of a circle


def crops_in(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The objects that crop captures and are seen in the context's viewport."""
    found: dict[bpy.types.Object, None] = {}
    for capture in playback.captures_in(context.scene):
        for crop in capture.frog_edits.crops:
            if crop.object is not None and is_crop_object(crop.object):
                found[crop.object] = None
    seen = {"view_layer": context.view_layer, "viewport": context.space_data}
    return [obj for obj in found if obj.name in context.view_layer.objects and obj.visible_get(**seen)]


def bounds_of(obj: bpy.types.Object) -> np.ndarray:
    """(2, 3) the least and the largest coordinates of a crop object, in its own space."""
    corners = _CORNERS * obj.empty_display_size if obj.type == "EMPTY" else np.array(obj.bound_box)
    return np.array([corners.min(0), corners.max(0)])


def shape_of(obj: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """Lines (L, 2, 3) and triangles (T, 3, 3) of a crop object, in its own space."""
    if obj.type == "EMPTY" and obj.empty_display_type == "SPHERE":
        return _sphere(obj.empty_display_size)
    if obj.type == "MESH":
        vertices, triangles = point_cloud.triangles_of(obj.data)
        if 0 < len(triangles) <= _MOST_TRIANGLES:
            edges = np.empty(2 * len(obj.data.edges), np.int32)
            obj.data.edges.foreach_get("vertices", edges)
            return vertices[edges.reshape(-1, 2)], vertices[triangles]
    low, high = bounds_of(obj)
    corners = np.where(_CORNERS < 0, low, high)
    return corners[np.array(_EDGES)], corners[np.array(_HALVES)]


def _sphere(radius: float) -> tuple[np.ndarray, np.ndarray]:
    turns = np.linspace(0, 2 * np.pi, _STEPS + 1)
    circle = radius * np.stack([np.cos(turns), np.sin(turns), np.zeros_like(turns)], 1)
    lines = np.concatenate([np.stack([c[:-1], c[1:]], 1) for c in (np.roll(circle, k, 1) for k in range(3))])
    heights = np.linspace(0, np.pi, _STEPS // 2 + 1)[:, None]
    parts = np.sin(heights) * np.cos(turns), np.sin(heights) * np.sin(turns), np.cos(heights) + 0 * turns
    grid = radius * np.stack(parts, 2)
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    return lines, np.stack([a, b, c, a, c, d], 2).reshape(-1, 3, 3)


def crop_at(context: bpy.types.Context, x: float, y: float) -> bpy.types.Object | None:
    """The crop object whose frame is at a pixel of the context's region, from its lower left corner; None for none."""
    if not context.space_data.overlay.show_overlays:
        return None
    nearest, reach = None, REACH * context.preferences.system.pixel_size
    for obj in crops_in(context):
        lines = _transformed(shape_of(obj)[0], obj.matrix_world)
        distance = float(distance_to(_on_screen(lines, context), np.array([x, y])).min(initial=np.inf))
        if distance <= reach:
            nearest, reach = obj, distance
    return nearest


def _transformed(points: np.ndarray, matrix: Any) -> np.ndarray:
    matrix = np.array(matrix, np.float64)
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def _on_screen(lines: np.ndarray, context: bpy.types.Context) -> np.ndarray:
    """(K, 2, 2) of lines (L, 2, 3) in the world: their ends in pixels, as far as they lie before the eye."""
    matrix = np.array(context.region_data.perspective_matrix, np.float64)
    ends = lines @ matrix[:, :3].T + matrix[:, 3]
    near = 1e-4 * max(float(np.abs(ends[..., 3]).max(initial=0.0)), 1e-9)
    ends = ends[(ends[..., 3] > near).any(1)]
    depths = ends[..., 3]
    for here, there in ((0, 1), (1, 0)):
        behind = depths[:, here] < near
        share = (near - depths[behind, here]) / (depths[behind, there] - depths[behind, here])
        ends[behind, here] += share[:, None] * (ends[behind, there] - ends[behind, here])
    size = np.array([context.region.width, context.region.height])
    return (ends[..., :2] / ends[..., 3:] + 1) / 2 * size


class CropOverlay(Overlay):
    """What draws crops into viewports."""


def _draw() -> None:
    context = bpy.context
    if not context.space_data.overlay.show_overlays:
        return
    for obj in crops_in(context):
        lines, faces = (_transformed(part, obj.matrix_world).astype(np.float32) for part in shape_of(obj))
        is_chosen = obj.select_get(view_layer=context.view_layer)
        gpu.state.depth_test_set("NONE")
        if is_chosen:
            gpu.state.blend_set("ALPHA")
            shader = gpu.shader.from_builtin("UNIFORM_COLOR")
            shader.uniform_float("color", _FACES)
            batch_for_shader(shader, "TRIS", {"pos": faces.reshape(-1, 3)}).draw(shader)
        strokes = ((EDGE, 4.0), (_CHOSEN if is_chosen else _BRIGHT, 2.0))
        draw_lines({"LINES": lines.reshape(-1, 3)}, strokes)


def handled_crop(context: bpy.types.Context) -> bpy.types.Object | None:
    """The crop object that has handles: the active one, where nothing else is selected, which would move with it."""
    obj = context.object
    is_alone = obj is not None and context.mode == "OBJECT" and list(context.selected_objects) == [obj]
    return obj if is_alone and obj in crops_in(context) else None


def handles_of(obj: bpy.types.Object) -> Iterator[tuple[int, Vector, Vector]]:
    """The axis of each side of a crop object, the side's middle, and the one of the side across, in the world."""
    bounds = bounds_of(obj)
    for axis in range(3):
        for side in (0, 1):
            ends = [bounds.mean(0), bounds.mean(0)]
            ends[0][axis], ends[1][axis] = bounds[side, axis], bounds[1 - side, axis]
            here, across = (obj.matrix_world @ Vector(end) for end in ends)
            yield axis, here, across


class FROG_GGT_crop_sides(bpy.types.GizmoGroup):
    """Handles on the sides of the active crop: each scales it about the side across, as Blender's own Scale does."""

    bl_label = "Crop Handles"
    bl_space_type, bl_region_type = "VIEW_3D", "WINDOW"
    bl_options = {"3D", "PERSISTENT"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return handled_crop(context) is not None

    def setup(self, _context: bpy.types.Context) -> None:
        self.settings = []
        for _ in range(6):
            handle = self.gizmos.new("GIZMO_GT_arrow_3d")
            handle.draw_style, handle.length = "BOX", 0.35
            handle.color, handle.color_highlight = _CHOSEN[:3], (1.0, 1.0, 1.0)
            handle.alpha = handle.alpha_highlight = 1.0
            self.settings.append(handle.target_set_operator("transform.resize"))

    def draw_prepare(self, context: bpy.types.Context) -> None:
        obj = handled_crop(context)
        if obj is None:
            return
        for handle, settings, (axis, here, across) in zip(self.gizmos, self.settings, handles_of(obj), strict=True):
            turned = (here - across).to_track_quat("Z", "Y").to_matrix().to_4x4()
            handle.matrix_basis = Matrix.Translation(here) @ turned
            settings.orient_type, settings.release_confirm = "LOCAL", True
            settings.constraint_axis = [axis == other for other in range(3)]
            settings.center_override = across


def register() -> None:
    if not bpy.app.background:  # nothing is drawn, and there may be no graphics
        addon_state.get(CropOverlay).draw_by(bpy.types.SpaceView3D, "crops", _draw, "POST_VIEW")


def unregister() -> None:
    addon_state.get(CropOverlay).end()
