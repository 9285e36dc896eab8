"""Timeline frame -> Gaussians: handlers that keep every imported capture showing the scene's current moment.

Nothing is accumulated from frame to frame, so scrubbing, jumping and farm rendering out of order all show the same.
A capture is an object whose ``frog.filepath`` is set; between frames only its properties are kept, never the object.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy
from bpy.app.handlers import persistent

from .. import app_handlers, capture_files, point_cloud, relative_paths, reported_once
from ..capture_files import file_of
from ..engine.errors import FrogError
from . import level_of_detail, open_scenes
from .playback_cache import Moment
from .render_thread import in_main_thread, may_write_points
from .retiming import BadTiming, capture_frame, needs_evaluated_time

if TYPE_CHECKING:
    from ..engine.gaussians import GaussianArrays
    from ..engine.playback.bake import Bake
    from ..engine.playback.player import ScenePlayer


def bake_path(obj: Any) -> Path:
    """Where an object's baked playback is, or would be: beside its .frog file, or in the folder chosen for it."""
    file, folder = capture_files.named_file(obj), obj.frog.bake_folder
    return (relative_paths.absolute(obj, folder) if folder else file.parent) / f"{file.stem}.frogbake"


def open_scene(path: Path) -> ScenePlayer:
    """The scene in a file, read once for each version of the file; FrogError with one sentence if it is unusable."""
    # A render's thread must not look at bpy.data.
    if not open_scenes.is_known(path) and in_main_thread():
        open_scenes.forget_all_but({file_of(obj) for obj in captures(bpy.data.objects)})
    return open_scenes.scene(path)


def baked(obj: Any) -> Bake | None:
    """The bake that was used when the object was last shown."""
    return open_scenes.used_bake(bake_path(obj), file_of(obj))


def bake_problem(obj: Any) -> str:
    """Why an object's baked playback is not used, or an empty string."""
    return open_scenes.bake_problem(bake_path(obj), file_of(obj))


def captures(objects: Any) -> Iterator[Any]:
    """The objects that play a .frog file, among ``objects`` (a scene's, or all of the file's)."""
    types = point_cloud.TYPES
    for obj in objects:  # as capture_files.is_capture, without a call for each of the many that are none
        if obj.type in types and (settings := obj.frog).is_property_set("filepath") and settings.filepath:
            yield obj


def gaussians_at(obj: Any, scene_frame: float, evaluated: Any = None) -> GaussianArrays:
    """The Gaussians an object shows at a frame of the timeline (fractions are legal), in the object's own space."""
    return moment(obj, scene_frame, evaluated).gaussians()


def moment(obj: Any, scene_frame: float, evaluated: Any = None) -> Moment:
    """What an object shows at a frame of the timeline; FrogError for an unusable file.

    Args:
        evaluated: see ``capture_frame``.
    """
    scene = open_scene(file_of(obj))
    time = scene.time_of(capture_frame(obj, scene_frame, scene.header.frame_count, evaluated))
    return Moment(scene, time, open_scenes.bake(bake_path(obj), file_of(obj), scene))


def displayed(obj: Any, scene_frame: float, evaluated: Any = None) -> Moment:
    """What an object's points show of ``moment``: see density. FrogError for an unusable file."""
    whole = moment(obj, scene_frame, evaluated)
    fewer = level_of_detail.thinned(obj, whole.scene)
    return whole if fewer is None else Moment(fewer[0], whole.time, whole.bake, fewer[1])


def shown_frame(obj: Any, scene_frame: float, evaluated: Any = None) -> float:
    """Which of its capture's frames an object shows at a frame of the timeline; FrogError for an unusable file."""
    return capture_frame(obj, scene_frame, open_scene(file_of(obj)).header.frame_count, evaluated)


def show(obj: Any, scene_frame: float, evaluated: Any = None) -> None:
    """Put the Gaussians of a frame of the timeline into an object; what cannot be shown leaves it as it is, which is
    said once.

    Geometry that is linked from another .blend cannot be written: such captures are drawn by the FROG engine alone.
    """
    if obj.data.library is not None or obj.data.override_library is not None:
        return
    try:
        shown = displayed(obj, scene_frame, evaluated)
        point_cloud.show(obj, shown.scene, shown.time, shown.part)
    except BadTiming as error:
        reported_once.once(str(error))
    except FrogError:
        return  # said once by open_scene, shown by the panel
    except Exception as error:  # of one capture: the others go on
        reported_once.unforeseen(obj.name, error)


def captures_in(scene: Any) -> list[Any]:
    """The captures that a scene shows, in collections that it instances as well."""
    found: dict[Any, None] = {}
    groups, collections = [scene.objects], []
    for objects in groups:
        found |= dict.fromkeys(captures(objects))
        for obj in objects:
            shows_one = obj.type == "EMPTY" and obj.instance_type == "COLLECTION"
            collection = obj.instance_collection if shows_one else None
            if collection is not None and collection not in collections:
                collections.append(collection)
                groups.append(collection.all_objects)
    return list(found)


def scenes_of_captures() -> dict[Any, Any]:
    """Every capture that a scene shows, and whose frame it is to show: that of the scene that a window looks at, where
    several scenes have it."""
    looked_at = {window.scene for window in bpy.context.window_manager.windows} | {bpy.context.scene}
    scenes = sorted(bpy.data.scenes, key=lambda scene: scene in looked_at)
    return {obj: scene for scene in scenes for obj in captures_in(scene)}


def refresh(scene: Any) -> None:
    """Make every capture of a scene show its current frame."""
    for obj in captures_in(scene):
        show(obj, scene.frame_current_final)


@persistent
def refresh_all(*_: Any) -> None:
    """Make every capture show the current frame of the scene that it is looked at in."""
    for obj, scene in scenes_of_captures().items():
        show(obj, scene.frame_current_final)


@persistent
def _on_frame(scene: Any, *_: Any) -> None:
    if not may_write_points(scene):
        if scene.render.engine != "FROG" and not all(obj.frog.laid_over for obj in captures_in(scene)):
            reported_once.once(
                f"{scene.name}: captures stand still in this animation; switch on Render > Lock Interface."
            )
        return
    for obj in captures_in(scene):
        if not needs_evaluated_time(obj):
            show(obj, scene.frame_current_final)


@persistent
def _on_frame_evaluated(scene: Any, depsgraph: Any) -> None:
    if depsgraph.mode == "RENDER" and scene.render.engine == "FROG":
        return  # it draws no points, and writing them makes Blender evaluate again, without the NLA
    if not may_write_points(scene):
        return
    for obj in captures_in(scene):
        if needs_evaluated_time(obj):
            show(obj, scene.frame_current_final, obj.evaluated_get(depsgraph))


@persistent
def _on_load(*_: Any) -> None:
    open_scenes.forget()
    capture_files.forget()
    reported_once.forget()
    _take_over()


@persistent
def _take_over(*_: Any) -> None:
    """Captures that came from somewhere."""
    capture_files.adopt()
    refresh_all()


@persistent
def _on_update(_scene: Any, depsgraph: Any) -> None:
    """Whoever changed the geometry outside of a frame's change, all of it is written again with the next frame."""
    for update in depsgraph.updates:
        if update.is_updated_geometry and isinstance(update.id, point_cloud.DATA_TYPES):
            point_cloud.invalidate(update.id.original)


@persistent
def _on_save_pre(*_: Any) -> None:
    """Gaussians are in the .frog file; a .blend that repeats them grows by 60 bytes a Gaussian for nothing."""
    for obj in captures(bpy.data.objects):
        if obj.library is not None or getattr(obj.data, "is_editmode", False):
            continue  # Blender refuses to change what is being edited
        if open_scenes.version(file_of(obj)) is not None and not open_scenes.problem(file_of(obj)):
            point_cloud.clear(obj)


@persistent
def _on_save_pre_adopt(*_: Any) -> None:
    capture_files.adopt()  # Blender makes relative, packs and rewrites what it knows


def _handlers() -> app_handlers.Handlers:
    on = bpy.app.handlers
    return [
        (on.frame_change_pre, _on_frame),
        (on.frame_change_post, _on_frame_evaluated),
        (on.depsgraph_update_post, _on_update),
        (on.load_post, _on_load),
        (on.blend_import_post, relative_paths.on_import_post),
        (on.blend_import_post, _take_over),
        (on.undo_post, refresh_all),
        (on.redo_post, refresh_all),
        (on.save_pre, _on_save_pre),
        (on.save_pre, _on_save_pre_adopt),
        (on.save_pre, relative_paths.on_save_pre),  # after them, which look for the files
        (on.save_post, relative_paths.on_save_post),
        (on.save_post, refresh_all),
        (on.save_post_fail, relative_paths.on_save_post),
        (on.save_post_fail, refresh_all),
    ]


def register() -> None:
    app_handlers.add(_handlers())
    bpy.app.timers.register(_take_over, first_interval=0.0)  # for a .blend that was opened without the add-on


def unregister() -> None:
    if bpy.app.timers.is_registered(_take_over):
        bpy.app.timers.unregister(_take_over)
    app_handlers.remove(_handlers())
    open_scenes.forget()
    capture_files.forget()
