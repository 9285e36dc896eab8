"""Scenes of captures that follow the user's scene: every relevant change is copied.

*Render With My Objects* makes such a scene (see ``operators/compose.py``). It is brought up to date in the main thread:
when Blender tells of a change, and once more when a render begins.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import bpy
from bpy.app import handlers as on

from ... import addon_state, app_handlers, point_cloud
from ...timeline import playback
from . import compositor

Change = Callable[[], object]

_SCENE_SETTINGS = ("camera", "world", "frame_start", "frame_end", "frame_step")
_RENDER_SETTINGS = (
    *("resolution_x", "resolution_y", "resolution_percentage", "pixel_aspect_x", "pixel_aspect_y", "fps", "fps_base"),
    *("use_border", "use_crop_to_border", "border_min_x", "border_max_x", "border_min_y", "border_max_y"),
    *("frame_map_old", "frame_map_new", "use_motion_blur", "motion_blur_shutter", "motion_blur_position"),
    *("use_simplify", "simplify_subdivision", "simplify_subdivision_render"),  # which decide the shape of meshes
    *("use_multiview", "views_format"),
)
_PASSES = 8  # at most, until nothing changes: one change may require another


class Following:
    """What is known about the followed scenes.

    Attributes:
        is_needed: whether there may be something to follow: a scene, or points that are to be drawn again.
        laid: session_uid and engine of scenes that FRoG's images lay over when their captures were last looked for.
        is_busy: while scenes are being brought up to date, which Blender tells of as well.
    """

    def __init__(self) -> None:
        self.is_needed = True
        self.laid: set[tuple[int, str]] | None = None
        self.is_busy = False


def followers() -> list[bpy.types.Scene]:
    """The scenes of captures that follow another one."""
    return [scene for scene in bpy.data.scenes if scene.frog.composed_with is not None and scene.library is None]


def overlay_of(scene: bpy.types.Scene) -> bpy.types.Scene | None:
    """The scene of captures that follows this scene and is shown by its compositor; None without one."""
    shown = (composed for composed in compositor.shown_scenes(scene) if composed.frog.composed_with == scene)
    return next(shown, None)


def follow_all(objects_changed: bool = True) -> None:
    """Updates every scene of captures and decides which engine draws which capture: points are excluded from other
    engines' renders while FRoG's image is overlaid.

    Args:
        objects_changed: whether there may be other captures than before; looking for them takes long among very many
            objects.
    """
    following, scenes = addon_state.get(Following), followers()
    if following.is_busy or not (scenes or following.is_needed):
        return
    following.is_busy = True
    try:
        for splats in scenes:
            follow(splats)
        over = [scene for scene in {splats.frog.composed_with for splats in scenes} if overlay_of(scene) is not None]
        laid = {(scene.session_uid, scene.render.engine) for scene in over}
        if objects_changed or laid != following.laid:
            _settle_points(over)
            _settle_shadows(over)
            following.laid = laid
    finally:
        following.is_busy = False
    following.is_needed = bool(scenes)


def follow(splats: bpy.types.Scene) -> None:
    """Updates a scene of captures to match the scene that it follows."""
    for _ in range(_PASSES):
        layer = splats.view_layers[0]
        known = layer.layer_collection  # of a new scene not there (Blender 5.3), or empty (5.2), before it is updated
        if known is None or {child.collection for child in known.children} != set(splats.collection.children):
            layer.update()
        changes = [*_plain_changes(splats, splats.frog.composed_with), *structural_changes(splats)]
        for change in changes:
            change()
        if not changes:
            return


def structural_changes(splats: bpy.types.Scene) -> list[Change]:
    """The changes that give a scene the collections and objects of the one that it follows."""
    scene = splats.frog.composed_with
    changes: list[Change] = []
    for mine, theirs in (
        (splats.collection.children, scene.collection.children),
        (splats.collection.objects, scene.collection.objects),
    ):
        before, after = set(mine), set(theirs)
        changes += (partial(mine.unlink, item) for item in before - after)
        changes += (partial(mine.link, item) for item in after - before)
    theirs = [layer.layer_collection for layer in rendered_layers(scene)]
    changes += _layer_changes(splats.view_layers[0].layer_collection, theirs)
    return changes


def rendered_layers(scene: bpy.types.Scene) -> list[bpy.types.ViewLayer]:
    """The view layers of a scene that F12 renders."""
    return [layer for layer in scene.view_layers if layer.use] or [scene.view_layers[0]]


def _plain_changes(splats: bpy.types.Scene, scene: bpy.types.Scene) -> Iterator[Change]:
    """The changes that give a scene the settings of the one that it follows."""
    yield from _differing(splats, {name: getattr(scene, name) for name in _SCENE_SETTINGS})
    yield from _differing(splats.render, {name: getattr(scene.render, name) for name in _RENDER_SETTINGS})
    yield from _differing(splats.render, {"engine": "FROG", "film_transparent": True})
    yield from _differing(splats.view_layers[0], {"use": True})
    # The timeline switches to the cameras of its markers.
    markers = [(marker.name, marker.frame, marker.camera) for marker in scene.timeline_markers if marker.camera]
    if [(marker.name, marker.frame, marker.camera) for marker in splats.timeline_markers] != markers:
        yield partial(_write_markers, splats.timeline_markers, markers)


def _differing(block: bpy.types.bpy_struct, values: dict[str, Any]) -> Iterator[Change]:
    for name, value in values.items():
        if getattr(block, name) != value:
            yield partial(setattr, block, name, value)


def _write_markers(markers: bpy.types.TimelineMarkers, entries: list[tuple[str, int, bpy.types.Object]]) -> None:
    markers.clear()
    for name, frame, camera in entries:
        markers.new(name, frame=frame).camera = camera


def _layer_changes(mine: bpy.types.LayerCollection, theirs: list[bpy.types.LayerCollection]) -> Iterator[Change]:
    """The changes that exclude or hold out what is excluded or holds out in all rendered view layers."""
    known = [{child.collection: child for child in layer.children} for layer in theirs]
    for child in mine.children:
        alike = [children[child.collection] for children in known if child.collection in children]
        if not alike:
            continue
        seen = [layer for layer in alike if not layer.exclude]
        values = {"exclude": not seen}
        if seen:
            values["holdout"] = all(layer.holdout for layer in seen)
            values["indirect_only"] = all(layer.indirect_only for layer in seen)
        yield from _differing(child, values)
        yield from _layer_changes(child, seen or alike)


def _settle_points(over: list[bpy.types.Scene]) -> None:
    """Has every capture drawn by exactly one engine: by FRoG in composed scenes, otherwise by the other engine."""
    hidden = {obj for scene in over for obj in playback.captures_in(scene)}
    for obj in playback.captures(bpy.data.objects):
        if obj in hidden or obj.frog.laid_over:
            shown = obj not in hidden
            if obj.frog.laid_over == shown:
                obj.frog.laid_over = not shown
            if point_cloud.is_drawn_in("render", obj) != shown:
                point_cloud.draw_in("render", obj, shown)


def _settle_shadows(over: list[bpy.types.Scene]) -> None:
    """Has the shadows that proxy meshes catch darken FRoG's image, in all composed scenes that Cycles renders."""
    for scene in over:
        catches = any(obj.frog.is_proxy and obj.is_shadow_catcher for obj in scene.objects)
        if scene.render.engine == "CYCLES" and catches:
            compositor.multiply_shadows(scene)


def _on_update(_scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    if not addon_state.get(Following).is_needed or bpy.app.is_job_running("RENDER"):
        return
    objects_changed = depsgraph.id_type_updated("COLLECTION") or any(map(_matters, depsgraph.updates))
    if objects_changed or any(map(depsgraph.id_type_updated, ("SCENE", "NODETREE"))):
        follow_all(objects_changed)


def _matters(update: bpy.types.DepsgraphUpdate) -> bool:
    """Whether an excluded capture's points were enabled in renders again, or a proxy mesh may catch shadows now."""
    block = update.id
    if not isinstance(block, bpy.types.Object):
        return False
    if block.frog.is_proxy:
        return block.is_shadow_catcher and not update.is_updated_transform
    return block.frog.laid_over and point_cloud.is_drawn_in("render", block.original)


def begin(*_: Any) -> None:
    """Starts following all scenes that there are. What was opened, appended, pasted, undone or redone may be out of
    date.
    """
    addon_state.get(Following).is_needed = True
    follow_all()


HANDLERS: app_handlers.Handlers = [
    (on.depsgraph_update_post, _on_update),
    *((functions, begin) for functions in (on.load_post, on.blend_import_post, on.undo_post, on.redo_post)),
]
