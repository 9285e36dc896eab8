"""Timeline frame -> Gaussians: finds captures, evaluates what each shows at a frame, and writes its points.

Nothing is accumulated from frame to frame, so scrubbing, jumping and farm rendering out of order all show the same.
A capture is an object whose ``frog.filepath`` is set; between frames only its properties are kept, never the object.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy

from .. import addon_state, point_cloud, relative_paths, reported_once
from ..app_handlers import later
from ..capture_files import file_of
from ..engine.editing.edits import Edits, uncropped
from ..engine.editing.grades import NOTHING
from ..engine.errors import FrogError
from ..engine.playback.player import ScenePlayer
from . import edits as object_edits
from . import level_of_detail, open_scenes, retiming
from .edited_scenes import EditedScenes
from .edits import edits_of, graded, with_selection
from .playback_cache import SceneTime
from .render_thread import in_main_thread, rendering
from .retiming import BadTiming, capture_frame, needs_evaluated_time

_PLACED_AFTER = 0.1  # seconds until it is looked whether a crop is still transformed


def open_scene(path: Path) -> ScenePlayer:
    """The scene in a file, read once for each version of the file; FrogError with one sentence if it is unusable."""
    # A render's thread must not access bpy.data.
    if path not in open_scenes.paths() and in_main_thread():
        forget_unused()
    return open_scenes.scene(path)


def forget_unused() -> None:
    """Drops the scenes of files that no object plays."""
    open_scenes.forget_all_but({file_of(obj) for obj in captures(bpy.data.objects)})


def captures(objects: Iterable[bpy.types.Object]) -> Iterator[bpy.types.Object]:
    """The objects that play a .frog file, among ``objects`` (a scene's, or all of the file's)."""
    types = point_cloud.TYPES
    for obj in objects:  # capture_files.is_capture inlined, as most objects are no captures
        if obj.type in types and (settings := obj.frog).is_property_set("filepath") and settings.filepath:
            yield obj


def has_captures(scene: bpy.types.Scene) -> bool:
    """Whether a scene has objects of its own that play a .frog file."""
    return next(captures(scene.objects), None) is not None


@dataclass(frozen=True, eq=False)
class Opened:
    """What an object plays, found once for all the frames that are asked for.

    Attributes:
        fewer: what it displays of the scene, see level_of_detail; None for all.
    """

    obj: bpy.types.Object
    scene: ScenePlayer
    fewer: ScenePlayer | None

    def whole(
        self, scene_frame: float, evaluated: bpy.types.Object | None = None, image_frame: float | None = None
    ) -> SceneTime:
        """See ``scene_time``.

        Args:
            image_frame: of the image that this is a sample of, which decides whether the object is there: motion blur
                looks at frames before and after it.
        """
        return self._shown(scene_frame, evaluated, edits_of(self.obj, evaluated), image_frame=image_frame)

    def in_viewport(self, scene_frame: float, evaluated: bpy.types.Object | None = None) -> SceneTime:
        """What a viewport of the FROG engine shows: ``whole``, where selected Gaussians stand out."""
        return self._shown(scene_frame, evaluated, self._in_viewport(scene_frame, evaluated))

    def displayed(self, scene_frame: float, evaluated: bpy.types.Object | None = None) -> SceneTime:
        """See ``displayed``."""
        is_rendered = rendering().has_render_density
        edits = edits_of(self.obj, evaluated) if is_rendered else self._in_viewport(scene_frame, evaluated)
        return self._shown(scene_frame, evaluated, edits, fewer=self.fewer)

    def _in_viewport(self, scene_frame: float, evaluated: bpy.types.Object | None) -> Edits | None:
        """The edits that a viewport shows: selected Gaussians stand out, and so does what a crop will take away that
        the user transforms."""
        edits = with_selection(self.obj, edits_of(self.obj, evaluated))
        if edits is None or not edits.crops or not object_edits.are_crops_transformed(self.obj):
            return edits
        later(_show_transformed, _PLACED_AFTER)
        fitting, _ = edits.fitted(self.scene)
        return uncropped(fitting, self.scene, self._time(scene_frame, evaluated), object_edits.TAKEN_AWAY)

    def _time(self, scene_frame: float, evaluated: bpy.types.Object | None) -> float:
        return self.scene.time_of(capture_frame(self.obj, scene_frame, self.scene.header.frame_count, evaluated))

    def _shown(
        self,
        scene_frame: float,
        evaluated: bpy.types.Object | None,
        edits: Edits | None,
        image_frame: float | None = None,
        fewer: ScenePlayer | None = None,
    ) -> SceneTime:
        """What is left of the scene, or of fewer of its Gaussians, after edits."""
        if not retiming.is_shown(self.obj, scene_frame if image_frame is None else image_frame):  # so nothing moves
            scene_frame, edits = retiming.within_range(self.obj, scene_frame), graded(edits, NOTHING)
        time = self._time(scene_frame, evaluated)
        scene = fewer or self.scene
        if edits is not None:
            scene, problems = addon_state.get(EditedScenes).of(scene, edits)
            for sentence in problems:
                reported_once.message(f"{self.obj.name}: {sentence}")
        return SceneTime(scene, time)


def opened(obj: bpy.types.Object, *, is_thinned: bool = True) -> Opened:
    """What an object plays now; FrogError for an unusable file."""
    scene = open_scene(file_of(obj))
    return Opened(obj, scene, level_of_detail.thinned(obj, scene) if is_thinned else None)


def scene_time(obj: bpy.types.Object, scene_frame: float, evaluated: bpy.types.Object | None = None) -> SceneTime:
    """What an object shows at a frame of the timeline; FrogError for an unusable file.

    Args:
        evaluated: see ``capture_frame``.
    """
    return opened(obj, is_thinned=False).whole(scene_frame, evaluated)


def displayed(obj: bpy.types.Object, scene_frame: float, evaluated: bpy.types.Object | None = None) -> SceneTime:
    """What an object's points show of ``scene_time``: see level_of_detail; selected Gaussians stand out. FrogError for
    an unusable file.
    """
    return opened(obj).displayed(scene_frame, evaluated)


def needs_evaluation(obj: bpy.types.Object) -> bool:
    """Whether what an object shows at a frame depends on Blender's evaluation of the frame: its time, or its edits."""
    return needs_evaluated_time(obj) or object_edits.needs_evaluation(obj)


def shown_frame(obj: bpy.types.Object, scene_frame: float, evaluated: bpy.types.Object | None = None) -> float:
    """Which of its capture's frames an object shows at a frame of the timeline; FrogError for an unusable file."""
    return capture_frame(obj, scene_frame, open_scene(file_of(obj)).header.frame_count, evaluated)


def show(obj: bpy.types.Object, scene_frame: float, evaluated: bpy.types.Object | None = None) -> None:
    """Write the Gaussians of a frame of the timeline to an object. If they cannot be shown, the object stays unchanged
    and a message is printed once.

    Geometry that is linked from another .blend cannot be written: such captures are drawn by the FROG engine alone.
    """
    if obj.data.library is not None or obj.data.override_library is not None:
        return
    try:
        shown = displayed(obj, scene_frame, evaluated)
        if obj.data.users > 1 and _shares_another(obj, shown, scene_frame):
            obj.data = obj.data.copy()
        point_cloud.show(obj, shown.scene, shown.time, shown.part)
    except BadTiming as error:
        reported_once.message(str(error))
    except FrogError:
        return  # printed once by open_scene, shown by the panel
    except Exception as error:  # of one capture; the others still play
        reported_once.unexpected(obj.name, error)


def _shares_another(obj: bpy.types.Object, shown: SceneTime, scene_frame: float) -> bool:
    """Whether an object has its geometry from another capture, of which it is a linked duplicate, that shows something
    else or may do so at another frame."""
    first = next(other for other in captures(bpy.data.objects) if other.data == obj.data)
    if first == obj or obj.mode == "EDIT":
        return False
    return needs_evaluation(obj) or needs_evaluation(first) or displayed(first, scene_frame).key != shown.key


def captures_in(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The captures of a scene, including those in collections that it instances."""
    seen: dict[bpy.types.Object, None] = {}
    groups, collections = [scene.objects], []
    for objects in groups:
        seen |= dict.fromkeys(captures(objects))
        for obj in objects:
            shows_one = obj.type == "EMPTY" and obj.instance_type == "COLLECTION"
            collection = obj.instance_collection if shows_one else None
            if collection is not None and collection not in collections:
                collections.append(collection)
                groups.append(collection.all_objects)
    return list(seen)


def scenes_of_captures() -> dict[bpy.types.Object, bpy.types.Scene]:
    """Every capture and the scene whose frame it shows. If several scenes contain it, a scene that is visible in a
    window wins.
    """
    looked_at = {window.scene for window in bpy.context.window_manager.windows} | {bpy.context.scene}
    scenes = sorted(bpy.data.scenes, key=lambda scene: scene in looked_at)
    return {obj: scene for scene in scenes for obj in captures_in(scene)}


def refresh(scene: bpy.types.Scene) -> None:
    """Make every capture of a scene show its current frame."""
    for obj in captures_in(scene):
        show(obj, scene.frame_current_final)


def on_setting(_settings: Any, context: bpy.types.Context) -> None:
    """Is called by settings of captures when they change: shows it, unless whoever changes several does afterwards."""
    if not (relative_paths.are_being_written()):
        refresh(context.scene)


def refresh_all(*_: Any) -> None:
    """Make every capture show the current frame of its scene; see ``scenes_of_captures``."""
    for obj, scene in scenes_of_captures().items():
        show(obj, scene.frame_current_final)


def _show_transformed() -> float | None:
    """A timer: shows captures cropped again when their crops are no longer transformed."""
    if object_edits.is_transforming():
        return _PLACED_AFTER
    refresh_all()
    return None


def show_for_render(is_shown: bool) -> None:
    """Switches captures between their viewport and render density, and updates those that differ."""
    if is_shown == rendering().has_render_density:
        return
    rendering().has_render_density = is_shown
    for obj, scene in scenes_of_captures().items():
        if obj.frog.density != obj.frog.render_density or object_edits.has_shown_selection(obj):
            show(obj, scene.frame_current_final)


def show_cropped(objects: set[bpy.types.Object], scene: bpy.types.Scene) -> None:
    """Makes the captures of a scene that any of the objects crops show their current frame again."""
    if not addon_state.get(EditedScenes).cropped:
        return  # before all objects of the scene are looked at
    for obj in object_edits.cropped_by(objects, captures_in(scene)):
        show(obj, scene.frame_current_final)
