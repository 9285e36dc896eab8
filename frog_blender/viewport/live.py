"""A training's scene in the viewports while it runs."""

import bpy
import numpy as np

from .. import addon_state
from ..app_handlers import later, not_later
from ..engine.capture.capture import Capture
from ..scene_import.scene_setup import is_untouched
from ..tasks.training import LiveView, TrainingTask, Watchers
from ..timeline.playback_cache import SceneTime
from . import drawing, views
from .picture import Shown

START_FRAME = 1.0
"""Of the timeline, at which a capture's first image is shown, as when it is imported."""
_LOADED = 0.2  # seconds after which the viewports of a file have their sizes


def view_of_capture(scene: bpy.types.Scene, capture: Capture | None) -> LiveView:
    """What is to be seen of a training of a capture, if that is known, that is started in a scene."""
    if capture is None:
        return LiveView(scene)
    cameras, distance = capture.cameras, 1.0
    if capture.near_far is not None:
        distance = sum(capture.near_far) / 2
    elif capture.points is not None and len(capture.points):
        distance = float((np.median(capture.points, axis=0) - cameras[0].center) @ cameras[0].forward)
    elif len(cameras) > 1:
        distance = float(np.ptp([camera.center for camera in cameras], axis=0).max())
    return LiveView(scene, cameras, distance if distance > 0 else 1.0)


def running() -> LiveView | None:
    """What is seen of a training that goes on, here or elsewhere; None where there is none."""
    task = TrainingTask.current()
    return task.live if task is not None and (task.is_running or task.waiting) else None


def seen_in(scene: bpy.types.Scene) -> LiveView | None:
    """The same where a scene's viewports show it."""
    live = running()
    return live if live is not None and scene.frog.show_live and live.scene == scene else None


def shown_in(scene: bpy.types.Scene) -> Shown | None:
    """The running training's scene at the current frame; None for none, and before there is any of it."""
    live = seen_in(scene)
    if live is None or live.player is None:
        return None
    return Shown(SceneTime(live.player, live.player.time_of(scene.frame_current_final - START_FRAME)), np.eye(4))


def elsewhere(scene: bpy.types.Scene) -> str:
    """Where the live scene is if it is not attached to a scene, as a sentence; "" where there is nothing to say."""
    live = running()
    if live is None or live.scene == scene:
        return ""
    where = "no scene that is open" if live.scene is None else f"the scene {live.scene.name}"
    return f"The training goes on. Its live scene belongs to {where}."


def look(area: bpy.types.Area, live: LiveView, camera: str) -> None:
    """Looks at the live scene through a camera of its rig, or the first one, in a viewport."""
    space, seen = area.spaces.active, live.camera(camera)
    region = next((region for region in area.regions if region.type == "WINDOW"), None)
    if seen is not None and region is not None and not space.region_quadviews and region.width > 1 < region.height:
        views.look(space, views.through(seen, live.distance, (region.width, region.height)))


def look_where_untouched() -> None:
    """Looks at the live scene in the viewports of its scene that nobody has moved, once there is a snapshot: before it,
    what stands before the rig's camera, such as the default cube, would be all that is seen.
    """
    for window in bpy.context.window_manager.windows:
        if (live := seen_in(window.scene)) is None or live.player is None:
            continue
        for area in window.screen.areas:
            if area.type == "VIEW_3D" and views.is_untouched(area.spaces.active):
                look(area, live, window.scene.frog.preview_camera)


def on_snapshot() -> None:
    """Draws what there is now, and looks at the first snapshot."""
    drawing.changed()
    live = running()
    if live is not None and live.player is not None and not live.was_looked_at:
        live.was_looked_at = True
        look_where_untouched()


def show_here(scene: bpy.types.Scene) -> None:
    """Attaches the running training's live scene to a scene."""
    if (live := running()) is not None:
        live.attach(scene)
        scene.frog.show_live = True
    drawing.changed()
    look_where_untouched()


def _after_load() -> None:
    """A new file that is as Blender makes it shows the live scene of one that was closed."""
    live, scene = running(), bpy.context.scene
    if live is not None and live.scene is None and is_untouched(scene):
        show_here(scene)
    else:
        look_where_untouched()


def _on_load(*_: object) -> None:
    if running() is not None:
        later(_after_load, _LOADED)


HANDLERS = [(bpy.app.handlers.load_post, _on_load)]


def register() -> None:
    if bpy.app.background:  # nothing is drawn, and there may be no graphics
        return
    drawing.state().source = shown_in
    addon_state.get(Watchers).of_scene.append(on_snapshot)


def unregister() -> None:
    not_later(_after_load)
