"""Blender's lists of handlers, which keep every capture showing the current frame, whatever is done to a file."""

from __future__ import annotations

import atexit
from typing import Any

import bpy
from bpy.app.handlers import persistent

from .. import app_handlers, capture_files, point_cloud, relative_paths, reported_once
from ..capture_files import file_of
from . import open_scenes, playback, playback_cache, prefetch, render_thread
from .render_thread import in_main_thread, is_never_drawn_meanwhile, may_write_points
from .retiming import needs_evaluated_time


@persistent
def on_frame(scene: Any, *_: Any) -> None:
    """Points are written before Blender evaluates the frame, where only curves decide what they show."""
    if not may_write_points(scene):
        if scene.render.engine != "FROG" and not all(obj.frog.laid_over for obj in playback.captures_in(scene)):
            reported_once.message(
                f"{scene.name}: captures stand still in this animation; switch on Render > Lock Interface."
            )
        return
    for obj in playback.captures_in(scene):
        if not needs_evaluated_time(obj):
            playback.show(obj, scene.frame_current_final)


@persistent
def on_frame_evaluated(scene: Any, depsgraph: Any) -> None:
    """The other captures: drivers or the NLA decide what they show, which is known now."""
    if depsgraph.mode == "RENDER" and scene.render.engine == "FROG":
        return  # it draws no points, and writing them makes Blender evaluate again, without the NLA
    if not may_write_points(scene):
        return
    for obj in playback.captures_in(scene):
        if needs_evaluated_time(obj):
            playback.show(obj, scene.frame_current_final, obj.evaluated_get(depsgraph))


@persistent
def on_load(*_: Any) -> None:
    """Another file: nothing that was known of the last one holds."""
    open_scenes.forget()
    capture_files.forget()
    reported_once.forget()
    prefetch.forget()
    take_over()


@persistent
def take_over(*_: Any) -> None:
    """Captures that came from somewhere."""
    capture_files.adopt()
    playback.refresh_all()


@persistent
def on_update(_scene: Any, depsgraph: Any) -> None:
    """Whoever changed the geometry outside of a frame's change, all of it is written again with the next frame."""
    for update in depsgraph.updates:
        if update.is_updated_geometry and isinstance(update.id, point_cloud.DATA_TYPES):
            point_cloud.invalidate(update.id.original)


@persistent
def drop_points_before_saving(*_: Any) -> None:
    """Gaussians are in the .frog file; a .blend that repeats them grows by 60 bytes a Gaussian for nothing."""
    for obj in playback.captures(bpy.data.objects):
        if obj.library is not None or getattr(obj.data, "is_editmode", False):
            continue  # Blender refuses to change what is being edited
        if open_scenes.version(file_of(obj)) is not None and not open_scenes.problem(file_of(obj)):
            point_cloud.clear(obj)


@persistent
def adopt_before_saving(*_: Any) -> None:
    """Blender makes relative, packs and rewrites the paths that it knows."""
    capture_files.adopt()


@persistent
def refresh_all(*_: Any) -> None:
    """Whatever was done, every capture shows its current frame."""
    playback.refresh_all()


@persistent
def on_render_begin(scene: Any, *_: Any) -> None:
    """Points show what is chosen for renders, if another engine draws them."""
    render_thread.set_rendering(True)
    playback.show_for_render(is_never_drawn_meanwhile(scene) and scene.render.engine != "FROG")


@persistent
def on_render_end(*_: Any) -> None:
    """Without windows the points now show the frame that they were not written for."""
    render_thread.set_rendering(False)
    playback.show_for_render(False)
    if bpy.app.background and in_main_thread():
        playback.refresh_all()


@persistent
def compute_ahead(scene: Any, *_: Any) -> None:
    """Somebody plays or scrubs: the frames to come are computed meanwhile."""
    if prefetch.is_watched():
        prefetch.prefetch(scene)


@persistent
def on_load_pre(*_: Any) -> None:
    """Nothing of a file goes on being computed when another one is opened."""
    playback_cache.stop()


def every_handler() -> app_handlers.Handlers:
    """Blender's lists and what is called from each, in this order."""
    on = bpy.app.handlers
    return [
        (on.load_pre, on_load_pre),
        (on.frame_change_pre, on_frame),
        (on.frame_change_post, on_frame_evaluated),
        (on.frame_change_post, compute_ahead),
        (on.depsgraph_update_post, on_update),
        (on.load_post, on_load),
        (on.blend_import_post, relative_paths.on_import_post),
        (on.blend_import_post, take_over),
        (on.undo_post, refresh_all),
        (on.redo_post, refresh_all),
        (on.save_pre, drop_points_before_saving),
        (on.save_pre, adopt_before_saving),
        (on.save_pre, relative_paths.on_save_pre),  # after them, which look for the files
        (on.save_post, relative_paths.on_save_post),
        (on.save_post, refresh_all),
        (on.save_post_fail, relative_paths.on_save_post),
        (on.save_post_fail, refresh_all),
        (on.render_init, on_render_begin),
        (on.render_complete, on_render_end),
        (on.render_cancel, on_render_end),
    ]


def register() -> None:
    app_handlers.add(every_handler())
    bpy.app.timers.register(take_over, first_interval=0.0)  # for a .blend that was opened without the add-on
    atexit.register(playback_cache.stop)


def unregister() -> None:
    atexit.unregister(playback_cache.stop)
    if bpy.app.timers.is_registered(take_over):
        bpy.app.timers.unregister(take_over)
    app_handlers.remove(every_handler())
    playback_cache.stop()
    open_scenes.forget()  # closes bakes, which Windows would not let anybody replace
    capture_files.forget()
