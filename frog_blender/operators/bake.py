"""Bake Playback: the frames that a scene shows of a capture, computed once and kept on disk; and the cache's button."""

# mypy: disable-error-code="valid-type"

from __future__ import annotations

import time
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
from bpy.props import StringProperty

from .. import carrier, playback
from ..engine.errors import FrogError
from ..playing import playback_cache
from .imported import named_or_chosen

_SLICE_SECONDS = 0.03  # of work between two looks at the keyboard


@dataclass
class Baking:
    """A bake on its way: ``steps`` writes it, one moment after the other; closing them leaves nothing behind."""

    path: Path
    total: int
    steps: Generator[int, None, None]
    done: int = 0

    def go_on(self, seconds: float) -> bool:
        """Works for that long, one step at least; False once it is finished.  Raises FrogError."""
        deadline = time.perf_counter() + seconds
        for done in self.steps:
            self.done = done
            if time.perf_counter() >= deadline:
                return True
        return False


def begin(obj: Any, scene: Any) -> Baking:
    """Baking what ``scene`` shows, over its frame range, of the file that ``obj`` plays; FrogError if it cannot be.

    Other objects of the scene that play the same file from the same bake are in it as well.
    """
    from ..engine.inference.bake import bytes_needed, write_bake

    file, path = playback.file_of(obj), playback.bake_path(obj)
    playable = playback.open_scene(file)
    if not playable.changing:
        raise FrogError(f"{file.name}: nothing moves in this capture, so there is nothing to bake.")
    same = [other for other in playback.captures(scene.objects) if playback.bake_path(other) == path]
    same = [other for other in same if playback.file_of(other) == file]
    frames = range(scene.frame_start, scene.frame_end + 1)
    times = sorted({playback.moment(other, float(frame)).time for other in same for frame in frames})
    needed, megabytes = bytes_needed(playable, len(times)), obj.frog.bake_megabytes
    if needed > megabytes * playback_cache.MEGABYTE:
        needs = f"{len(times):,} frames need {needed / playback_cache.MEGABYTE:,.0f} MB, allowed are {megabytes:,} MB"
        raise FrogError(f"{path.name}: {needs}; allow more, or shorten the scene's frame range.")
    # On Windows a file that is open cannot be replaced; playback opens it again when it is needed.
    playback.let_go_of_bake(path)
    return Baking(path, len(times), write_bake(path, file, playable, times))


class _OnCapture:
    """Operators of one capture."""

    object_name: StringProperty(
        name="Capture",
        description="The object that plays the capture; empty for the active one",
        options={"SKIP_SAVE"},
    )

    def capture(self, context: Any) -> Any:
        return named_or_chosen(context, self.object_name)


class FROG_OT_bake(_OnCapture, bpy.types.Operator):
    """Compute every frame of this capture in the scene's frame range and keep them on disk, so that scrubbing has \
nothing to compute. Esc stops it"""

    bl_idname = "frog.bake"
    bl_label = "Bake Playback"

    _baking: Baking | None = None
    _timer: Any = None

    def execute(self, context: Any) -> set[str]:
        """For scripts: comes back when all is done."""
        try:
            self._baking = begin(self.capture(context), context.scene)
            while self._baking.go_on(1.0):
                pass
        except FrogError as error:
            return self._fail(context, error)
        return self._finish(context)

    def invoke(self, context: Any, _event: Any) -> set[str]:
        """In a window: a slice of work at a time."""
        if context.window is None or bpy.app.background:
            return self.execute(context)
        try:
            self._baking = begin(self.capture(context), context.scene)
        except FrogError as error:
            return self._fail(context, error)
        manager = context.window_manager
        self._timer = manager.event_timer_add(0.01, window=context.window)
        manager.progress_begin(0, self._baking.total)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> set[str]:
        if event.type == "ESC":
            self.cancel(context)
            self.report({"INFO"}, "Baking was stopped; nothing was written.")
            return {"CANCELLED"}
        if event.type != "TIMER" or self._baking is None:
            return {"PASS_THROUGH"}
        try:
            if not self._baking.go_on(_SLICE_SECONDS):
                return self._finish(context)
        except FrogError as error:
            return self._fail(context, error)
        context.window_manager.progress_update(self._baking.done)
        context.workspace.status_text_set(f"Baking {self._baking.done:,} of {self._baking.total:,} frames | Esc: Stop")
        return {"PASS_THROUGH"}

    def cancel(self, context: Any) -> None:
        """Also called by Blender, when the window or the file is closed."""
        self._clean_up(context)

    def _finish(self, context: Any) -> set[str]:
        assert self._baking is not None
        size = self._baking.path.stat().st_size / playback_cache.MEGABYTE
        self.report({"INFO"}, f"Baked {self._baking.total:,} frames to {self._baking.path} ({size:,.0f} MB).")
        self._clean_up(context)
        playback.refresh(context.scene)
        return {"FINISHED"}

    def _fail(self, context: Any, error: FrogError) -> set[str]:
        self._clean_up(context)
        self.report({"ERROR"}, str(error))
        return {"CANCELLED"}

    def _clean_up(self, context: Any) -> None:
        if self._baking is not None:
            self._baking.steps.close()
            self._baking = None
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            context.window_manager.progress_end()
            context.workspace.status_text_set(None)
            self._timer = None


class FROG_OT_clear_bake(_OnCapture, bpy.types.Operator):
    """Delete the baked playback of this capture from the disk; its frames are computed again when they are shown"""

    bl_idname = "frog.clear_bake"
    bl_label = "Clear Bake"

    def invoke(self, context: Any, event: Any) -> set[str]:
        return context.window_manager.invoke_confirm(self, event)

    def execute(self, context: Any) -> set[str]:
        try:
            path = playback.bake_path(self.capture(context))
            playback.let_go_of_bake(path)
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
            carrier.distrust(obj.data)
        return {"FINISHED"}


_CLASSES = (FROG_OT_bake, FROG_OT_clear_bake, FROG_OT_clear_cache)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
