"""Bake Playback: computes the frames of a capture that a scene shows once and stores them on disk. Also Clear
Playback Cache.
"""

# mypy: disable-error-code="valid-type"

from contextlib import closing
from pathlib import Path

import bpy

from .. import point_cloud
from ..engine.errors import FrogError, in_words
from ..engine.playback.bake import write_bake
from ..timeline import playback, playback_cache
from ..timeline.frame_timing import evaluated_frames
from ..timeline.retiming import needs_evaluated_time, stretched
from .bases import ConfirmedOperator, FrogOperator, OnCapture
from .modal_operator import ModalOperator, Steps


def begin_bake(obj: bpy.types.Object, scene: bpy.types.Scene) -> tuple[Path, Steps, int]:
    """A bake of the file that ``obj`` plays, over the frame range of ``scene``: its file, and the steps that each write
    a frame; closing them removes the unfinished file. FrogError if it cannot be baked.

    Other objects of the scene that play the same file from the same bake are in it as well.
    """
    file, path = playback.file_of(obj), playback.bake_path(obj)
    playable = playback.open_scene(file)
    if not playable.changing:
        raise FrogError(f"{file.name}: this capture is static, there is nothing to bake.")
    same = [other for other in playback.captures(scene.objects) if playback.bake_path(other) == path]
    same = [other for other in same if playback.file_of(other) == file]
    times = sorted(_times(scene, same))
    needed, megabytes = len(times) * playable.delta_bytes, obj.frog.bake_megabytes
    if needed > megabytes * playback_cache.MEGABYTE:
        needs = f"{len(times):,} frames need {needed / playback_cache.MEGABYTE:,.0f} MB, the limit is {megabytes:,} MB"
        raise FrogError(f"{path.name}: {needs}. Raise the limit or shorten the scene's frame range.")
    return path, write_bake(path, file, playable, times), len(times)


def _times(scene: bpy.types.Scene, objects: list[bpy.types.Object]) -> set[float]:
    """The times in [0, 1] that objects show over a scene's frame range."""
    frames = range(scene.frame_start, scene.frame_end + 1)
    if not any(needs_evaluated_time(obj) for obj in objects):
        return {playback.scene_time(obj, stretched(scene, frame)).time for obj in objects for frame in frames}
    with closing(evaluated_frames(scene, frames)) as depsgraphs:
        return {
            playback.scene_time(obj, scene.frame_current_final, obj.evaluated_get(depsgraph)).time
            for depsgraph in depsgraphs
            for obj in objects
        }


class FROG_OT_bake(OnCapture, ModalOperator, bpy.types.Operator):
    """Compute this capture at every frame of the scene's frame range and store the results on disk, so that scrubbing \
has nothing to compute. Press Esc or the right mouse button to stop"""

    bl_label = "Bake Playback"

    doing = "Baking {done:,} of {total:,} frames"
    stopped = "Baking was stopped. Nothing was written."
    slice_seconds = 0.03
    _path = Path()

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        self.is_interactive = True
        return self.execute(context)

    def begin(self, context: bpy.types.Context) -> tuple[Steps, int]:
        self._path, steps, total = begin_bake(self.capture(context), context.scene)
        return steps, total

    def restore(self) -> None:
        playback.refresh(bpy.context.scene)  # from the new bake

    def finished_message(self) -> str:
        size = self._path.stat().st_size / playback_cache.MEGABYTE
        return f"Baked {self._total:,} frames to {self._path} ({size:,.0f} MB)."


class FROG_OT_clear_bake(OnCapture, ConfirmedOperator, bpy.types.Operator):
    """Delete the baked playback of this capture from disk. Frames are computed again when they are shown"""

    bl_label = "Clear Bake"

    def act(self, context: bpy.types.Context) -> None:
        path = playback.bake_path(self.capture(context))
        with in_words(f"{path}: the bake could not be deleted"):
            path.unlink()
        playback.refresh(context.scene)


class FROG_OT_clear_cache(FrogOperator, bpy.types.Operator):
    """Free the memory used by cached frames. They are computed again when they are shown"""

    bl_label = "Clear Playback Cache"

    def act(self, _context: bpy.types.Context) -> None:
        playback_cache.clear()
        for obj in playback.captures(bpy.data.objects):
            point_cloud.invalidate(obj.data)
