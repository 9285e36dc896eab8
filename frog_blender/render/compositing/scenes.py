"""Scenes of captures that follow the scene of the user's objects: whatever changes there changes here as well.

*Render With My Objects* makes such a scene (see operators/compose.py). It is brought up to date in the main thread:
when Blender tells of a change, and once more when a render begins.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import bpy
from bpy.app.handlers import persistent

from ... import addon_state, app_handlers, point_cloud
from ...timeline import playback
from . import compositor

Change = Callable[[], object]

_OF_SCENES = ("camera", "world", "frame_start", "frame_end", "frame_step")
_OF_RENDERS = (
    *("resolution_x", "resolution_y", "resolution_percentage", "pixel_aspect_x", "pixel_aspect_y", "fps", "fps_base"),
    *("use_border", "use_crop_to_border", "border_min_x", "border_max_x", "border_min_y", "border_max_y"),
    *("frame_map_old", "frame_map_new", "use_motion_blur", "motion_blur_shutter", "motion_blur_position"),
    *("use_simplify", "simplify_subdivision", "simplify_subdivision_render"),  # which decide the shape of meshes
    *("use_multiview", "views_format"),
)
_PASSES = 8  # until nothing is left to change: what one changes may show what else has to be


class Following:
    """What is known of the scenes that are followed.

    Attributes:
        is_needed: whether there may be something to follow: a scene, or points that are to be drawn again.
        laid: session_uid of scenes that FRoG's images lay over when their captures were last looked for.
        is_busy: while scenes are being brought up to date, which Blender tells of as well.
    """

    def __init__(self) -> None:
        self.is_needed = True
        self.laid: set[int] | None = None
        self.is_busy = False


def followers() -> list[Any]:
    """The scenes of captures that follow another one."""
    return [scene for scene in bpy.data.scenes if scene.frog.composed_with is not None and scene.library is None]


def laid_over(scene: Any) -> Any | None:
    """The scene of captures that follows this one and that its compositor shows; None where it shows none."""
    shown = (each for each in compositor.shown_scenes(scene) if each.frog.composed_with == scene)
    return next(shown, None)


def follow_all(objects_changed: bool = True) -> None:
    """Brings every scene of captures up to date, and decides which engine draws the captures of its scene: the points
    are left out of other engines' renders as long as FRoG's image is laid over them.

    Args:
        objects_changed: whether there may be other captures than before; looking for them takes long among very many
            objects.
    """
    following, found = addon_state.get(Following), followers()
    if following.is_busy or not (found or following.is_needed):
        return
    following.is_busy = True
    try:
        for splats in found:
            follow(splats)
        over = [scene for scene in {splats.frog.composed_with for splats in found} if laid_over(scene) is not None]
        laid = {scene.session_uid for scene in over}
        if objects_changed or laid != following.laid:
            _settle_points(over)
            following.laid = laid
    finally:
        following.is_busy = False
    following.is_needed = bool(found)


def follow(splats: Any) -> None:
    """Makes a scene of captures what its scene is now."""
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


def structural_changes(splats: Any) -> list[Change]:
    """What is to be done so that a scene has the collections and objects of the one that it follows."""
    scene = splats.frog.composed_with
    changes: list[Change] = []
    for mine, theirs in (
        (splats.collection.children, scene.collection.children),
        (splats.collection.objects, scene.collection.objects),
    ):
        before, wanted = set(mine), set(theirs)
        changes += (partial(mine.unlink, item) for item in before - wanted)
        changes += (partial(mine.link, item) for item in wanted - before)
    theirs = [layer.layer_collection for layer in rendered_layers(scene)]
    changes += _layer_changes(splats.view_layers[0].layer_collection, theirs)
    return changes


def rendered_layers(scene: Any) -> list[Any]:
    """The view layers of a scene that F12 renders."""
    return [layer for layer in scene.view_layers if layer.use] or [scene.view_layers[0]]


def _plain_changes(splats: Any, scene: Any) -> Iterator[Change]:
    """What is to be done so that a scene has the settings of the one that it follows."""
    yield from _differing(splats, {name: getattr(scene, name) for name in _OF_SCENES})
    yield from _differing(splats.render, {name: getattr(scene.render, name) for name in _OF_RENDERS})
    yield from _differing(splats.render, {"engine": "FROG", "film_transparent": True})
    yield from _differing(splats.view_layers[0], {"use": True})
    # The timeline switches to the cameras of its markers.
    wanted = [(marker.name, marker.frame, marker.camera) for marker in scene.timeline_markers if marker.camera]
    if [(marker.name, marker.frame, marker.camera) for marker in splats.timeline_markers] != wanted:
        yield partial(_write_markers, splats.timeline_markers, wanted)


def _differing(block: Any, wanted: dict[str, Any]) -> Iterator[Change]:
    for name, value in wanted.items():
        if getattr(block, name) != value:
            yield partial(setattr, block, name, value)


def _write_markers(markers: Any, wanted: list[tuple[str, int, Any]]) -> None:
    markers.clear()
    for name, frame, camera in wanted:
        markers.new(name, frame=frame).camera = camera


def _layer_changes(mine: Any, theirs: list[Any]) -> Iterator[Change]:
    """What is excluded, or holds out, in all view layers that the user renders does so here."""
    known = [{child.collection: child for child in layer.children} for layer in theirs]
    for child in mine.children:
        alike = [children[child.collection] for children in known if child.collection in children]
        if not alike:
            continue
        seen = [each for each in alike if not each.exclude]
        wanted = {"exclude": not seen}
        if seen:
            wanted["holdout"] = all(each.holdout for each in seen)
            wanted["indirect_only"] = all(each.indirect_only for each in seen)
        yield from _differing(child, wanted)
        yield from _layer_changes(child, seen or alike)


def _settle_points(over: list[Any]) -> None:
    """Has every capture drawn once: by FRoG in the scenes that its images lay over, else by the other engine."""
    hidden = {obj for scene in over for obj in playback.captures_in(scene)}
    for obj in playback.captures(bpy.data.objects):
        if obj in hidden or obj.frog.laid_over:
            shown = obj not in hidden
            if obj.frog.laid_over == shown:
                obj.frog.laid_over = not shown
            if point_cloud.is_drawn_in_renders(obj) != shown:
                point_cloud.draw_in_renders(obj, shown)


@persistent
def _on_update(_scene: Any, depsgraph: Any) -> None:
    if not addon_state.get(Following).is_needed or bpy.app.is_job_running("RENDER"):
        return
    objects_changed = depsgraph.id_type_updated("COLLECTION") or any(map(_is_back, depsgraph.updates))
    if objects_changed or any(map(depsgraph.id_type_updated, ("SCENE", "NODETREE"))):
        follow_all(objects_changed)


def _is_back(update: Any) -> bool:
    """Whether someone has switched on the points of a capture that is to be left out."""
    block = update.id
    return (
        isinstance(block, bpy.types.Object) and block.frog.laid_over and point_cloud.is_drawn_in_renders(block.original)
    )


def begin() -> None:
    """Has whatever scenes there are followed from now on."""
    addon_state.get(Following).is_needed = True
    follow_all()


@persistent
def _on_other_file(*_: Any) -> None:
    """What was opened, appended, pasted, undone or redone may be of any age, and was made beside other scenes."""
    begin()


def _handlers() -> app_handlers.Handlers:
    on = bpy.app.handlers
    others = (on.load_post, on.blend_import_post, on.undo_post, on.redo_post)
    return [(on.depsgraph_update_post, _on_update), *((functions, _on_other_file) for functions in others)]


def register() -> None:
    app_handlers.add(_handlers())


def unregister() -> None:
    app_handlers.remove(_handlers())
