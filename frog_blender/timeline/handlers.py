"""Handlers of Blender events that keep every capture showing the current frame."""

import atexit
from typing import Any

import bpy
from bpy.app import handlers as on

from .. import addon_state, app_handlers, capture_files, point_cloud, relative_paths, reported_once
from ..capture_files import file_of
from . import open_scenes, playback, playback_cache, prefetch
from .edited_scenes import EditedScenes
from .render_thread import in_main_thread, is_never_drawn_meanwhile, may_write_points, rendering


def on_frame(scene: bpy.types.Scene, *_: Any) -> None:
    """Writes the points before Blender evaluates the frame, for captures whose time does not depend on evaluation."""
    if not may_write_points(scene):
        if scene.render.engine != "FROG" and not all(obj.frog.laid_over for obj in playback.captures_in(scene)):
            reported_once.message(
                f"{scene.name}: captures do not move in this animation. Enable Render > Lock Interface."
            )
        return
    for obj in playback.captures_in(scene):
        if not playback.needs_evaluation(obj):
            playback.show(obj, scene.frame_current_final)


def on_frame_evaluated(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """Writes the points of the other captures, whose time is driven or in the NLA, or whose edits are animated, once
    that is evaluated.
    """
    if depsgraph.mode == "RENDER" and scene.render.engine == "FROG":
        return  # it draws no points, and writing them makes Blender evaluate again, without the NLA
    if not may_write_points(scene):
        return
    for obj in playback.captures_in(scene):
        if playback.needs_evaluation(obj):
            playback.show(obj, scene.frame_current_final, obj.evaluated_get(depsgraph))


def on_load(*_: Any) -> None:
    """Forgets everything about the previous file."""
    open_scenes.forget()
    addon_state.reset(EditedScenes)
    capture_files.forget()
    reported_once.forget()
    prefetch.forget()
    take_over()


def take_over(*_: Any) -> None:
    """Adopts and shows captures that were loaded, linked or appended."""
    capture_files.adopt()
    playback.refresh_all()


def on_update(_scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """If geometry was changed by anything else, writes all of it again at the next frame; shows captures again whose
    crop objects were moved.
    """
    changed = set()
    for update in depsgraph.updates:
        if update.is_updated_geometry and isinstance(update.id, point_cloud.DATA_TYPES):
            point_cloud.invalidate(update.id.original)
        elif isinstance(update.id, bpy.types.Object):
            changed.add(update.id.original)
    if changed and depsgraph.mode == "VIEWPORT":
        playback.show_cropped(changed, depsgraph.scene.original)


def before_saving(*_: Any) -> None:
    """Removes points: the .frog file has them, and they would add 60 bytes a Gaussian to the .blend. Gives captures a
    volume, so that Blender can manage their paths.
    """
    for obj in playback.captures(bpy.data.objects):
        if obj.library is not None or getattr(obj.data, "is_editmode", False):
            continue  # Blender refuses to change what is being edited
        if open_scenes.version(file_of(obj)) is not None and not open_scenes.problem(file_of(obj)):
            point_cloud.clear(obj)
    capture_files.adopt()


def on_render_begin(scene: bpy.types.Scene, *_: Any) -> None:
    """Shows the render density, if another engine draws the points."""
    rendering().is_under_way = True
    playback.show_for_render(is_never_drawn_meanwhile(scene) and scene.render.engine != "FROG")


def on_render_end(*_: Any) -> None:
    """Shows the viewport density again, and without a window the frame that was skipped during the render."""
    rendering().is_under_way = False
    playback.show_for_render(False)
    if bpy.app.background and in_main_thread():
        playback.refresh_all()


def compute_ahead(scene: bpy.types.Scene, *_: Any) -> None:
    """Prefetches frames during playback and scrubbing, for a user. A render needs all cores for its current frame."""
    if not (bpy.app.background or bpy.app.is_job_running("RENDER")):
        prefetch.prefetch(scene)


HANDLERS: app_handlers.Handlers = [
    (on.load_pre, playback_cache.stop),
    (on.frame_change_pre, on_frame),
    (on.frame_change_post, on_frame_evaluated),
    (on.frame_change_post, compute_ahead),
    (on.depsgraph_update_post, on_update),
    (on.load_post, on_load),
    (on.blend_import_post, relative_paths.on_import_post),
    (on.blend_import_post, take_over),
    (on.save_pre, before_saving),
    (on.save_pre, relative_paths.on_save_pre),  # after it, which looks for the files
    *((functions, relative_paths.on_save_post) for functions in (on.save_post, on.save_post_fail)),
    *((functions, playback.refresh_all) for functions in (on.undo_post, on.redo_post, on.save_post, on.save_post_fail)),
    (on.render_init, on_render_begin),
    *((functions, on_render_end) for functions in (on.render_complete, on.render_cancel)),
]
"""Blender's handler lists and the functions to register in each, in this order."""


def register() -> None:
    app_handlers.later(take_over)  # for a .blend that was opened without the add-on
    atexit.register(playback_cache.stop)


def unregister() -> None:
    atexit.unregister(playback_cache.stop)
    app_handlers.not_later(take_over)
    playback_cache.stop()
    open_scenes.forget()
    capture_files.forget()
