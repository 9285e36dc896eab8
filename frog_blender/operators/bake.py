"""Bake Playback: the frames that a scene shows of a capture, computed once and kept on disk; and the cache's button."""

# mypy: disable-error-code="valid-type"

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
from bpy.props import StringProperty

from .. import point_cloud
from ..engine.errors import FrogError
from ..scene_import.capture_objects import named_or_chosen
from ..timeline import open_scenes, playback, playback_cache
from ..timeline.retiming import needs_evaluated_time, stretched
from .modal_operator import ModalOperator, has_window


@dataclass
class Baking:
    """A bake on its way: ``steps`` writes it, one moment after the other; closing them leaves nothing behind."""

    path: Path
    total: int
    steps: Generator[int, None, None]


def begin(obj: Any, scene: Any) -> Baking:
    """Baking what ``scene`` shows, over its frame range, of the file that ``obj`` plays; FrogError if it cannot be.

    Other objects of the scene that play the same file from the same bake are in it as well.
    """
    from ..engine.playback.bake import bytes_needed, write_bake

    file, path = playback.file_of(obj), playback.bake_path(obj)
    playable = playback.open_scene(file)
    if not playable.changing:
        raise FrogError(f"{file.name}: nothing moves in this capture, so there is nothing to bake.")
    same = [other for other in playback.captures(scene.objects) if playback.bake_path(other) == path]
    same = [other for other in same if playback.file_of(other) == file]
    times = sorted(_times(scene, same))
    needed, megabytes = bytes_needed(playable, len(times)), obj.frog.bake_megabytes
    if needed > megabytes * playback_cache.MEGABYTE:
        needs = f"{len(times):,} frames need {needed / playback_cache.MEGABYTE:,.0f} MB, allowed are {megabytes:,} MB"
        raise FrogError(f"{path.name}: {needs}; allow more, or shorten the scene's frame range.")
    # On Windows a file that is open cannot be replaced; playback opens it again when it is needed.
    open_scenes.let_go_of_bake(path)
    return Baking(path, len(times), write_bake(path, file, playable, times))


def _times(scene: Any, objects: list[Any]) -> set[float]:
    """The times in [0, 1] that objects show over a scene's frame range."""
    frames = range(scene.frame_start, scene.frame_end + 1)
    if not any(needs_evaluated_time(obj) for obj in objects):
        return {playback.scene_time(obj, stretched(scene, frame)).time for obj in objects for frame in frames}
    stood, layer, found = (scene.frame_current, scene.frame_subframe), scene.view_layers[0], set()
    for frame in frames:
        scene.frame_set(frame)
        layer.update()
        evaluated = [obj.evaluated_get(layer.depsgraph) for obj in objects]
        shown = zip(objects, evaluated, strict=True)
        found |= {playback.scene_time(obj, scene.frame_current_final, each).time for obj, each in shown}
    scene.frame_set(stood[0], subframe=stood[1])
    return found


class _OnCapture:
    """Operators of one capture."""

    object_name: StringProperty(
        name="Capture",
        description="The object that plays the capture; empty for the active one",
        options={"SKIP_SAVE"},
    )

    def capture(self, context: Any) -> Any:
        return named_or_chosen(context, self.object_name)


class FROG_OT_bake(_OnCapture, ModalOperator, bpy.types.Operator):
    """Compute every frame of this capture in the scene's frame range and keep them on disk, so that scrubbing has \
nothing to compute. Esc or the right mouse button stops it"""

    bl_idname = "frog.bake"
    bl_label = "Bake Playback"

    doing = "Baking {done:,} of {total:,} frames"
    slice_seconds = 0.03
    _baking: Baking | None = None

    def execute(self, context: Any) -> set[str]:
        """For scripts: comes back when all is done."""
        return self._bake(context, self.go_through)

    def invoke(self, context: Any, _event: Any) -> set[str]:
        """In a window: a slice of work at a time."""
        return self._bake(context, self.go_on_in_window if has_window(context) else self.go_through)

    def _bake(self, context: Any, go: Callable[..., set[str]]) -> set[str]:
        try:
            self._baking = begin(self.capture(context), context.scene)
        except FrogError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return go(context, self._baking.steps, self._baking.total)

    def restore(self) -> None:
        playback.refresh(bpy.context.scene)  # the bake was let go of; what is shown comes from what there is now

    def finished_sentence(self) -> str:
        assert self._baking is not None
        size = self._baking.path.stat().st_size / playback_cache.MEGABYTE
        return f"Baked {self._baking.total:,} frames to {self._baking.path} ({size:,.0f} MB)."

    def stopped_sentence(self) -> str:
        return "Baking was stopped; nothing was written."


class FROG_OT_clear_bake(_OnCapture, bpy.types.Operator):
    """Delete the baked playback of this capture from the disk; its frames are computed again when they are shown"""

    bl_idname = "frog.clear_bake"
    bl_label = "Clear Bake"

    def invoke(self, context: Any, event: Any) -> set[str]:
        return context.window_manager.invoke_confirm(self, event)

    def execute(self, context: Any) -> set[str]:
        try:
            path = playback.bake_path(self.capture(context))
            open_scenes.let_go_of_bake(path)
            path.unlink()
        except FrogError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        except OSError as error:
            self.report({"ERROR"}, f"{path}: the bake could not be deleted ({error.strerror or error}).")
            return {"CANCELLED"}
        return {"FINISHED"}


class FROG_OT_clear_cache(bpy.types.Operator):
    """Give the memory back that frames of captures take; they are computed again when they are shown"""

    bl_idname = "frog.clear_cache"
    bl_label = "Clear Playback Cache"

    def execute(self, context: Any) -> set[str]:
        playback_cache.clear()
        for obj in playback.captures(bpy.data.objects):
            point_cloud.invalidate(obj.data)
        return {"FINISHED"}


_CLASSES = (FROG_OT_bake, FROG_OT_clear_bake, FROG_OT_clear_cache)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
