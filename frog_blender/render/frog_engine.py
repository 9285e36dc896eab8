"""The FROG render engine: renders images and animations of captures with the engine's own rasterizer, without torch.

The image through an imported camera is the engine's own drawing of that camera: Gaussians are blended in the video's
display-referred colour, as they were trained, and the result is converted to Blender's scene-linear at the end.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

import bpy
import numpy as np

from .. import reported_once
from ..cameras import distance_added
from ..color_spaces import into_working_space
from ..engine.errors import FrogError
from ..timeline.retiming import raw_frame
from . import blur, exit_status, index_pass, vector_pass, viewport_drawing
from .collect_instances import gather, pass_indices
from .compositing import renders
from .messages import error_message
from .pixel_passes import combined_pass, depth_pass, pass_pixels, refusal_pattern
from .rendered_view import camera_of, eye_of, is_panoramic, options_of, settings_of, settings_scene
from .view_drawing import Through, drawer_of
from .world import background_of

if TYPE_CHECKING:
    from ..engine.gaussians import GaussianArrays
    from ..engine.playback.render import Drawing
    from .viewport import Viewport


class FrogRenderEngine(bpy.types.RenderEngine):
    """Draws every visible capture of the scene; other objects are not drawn."""

    bl_idname = "FROG"
    bl_label = "FRoG"
    bl_use_preview = False
    bl_use_eevee_viewport = True
    bl_use_postprocess = True

    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        super().__init__(*arguments, **keywords)
        self.viewport: Viewport | None = None  # of viewport_drawing
        self.warned_slow = False

    def update_render_passes(self, scene: bpy.types.Scene = None, renderlayer: bpy.types.ViewLayer = None) -> None:
        self.register_pass(scene, renderlayer, "Combined", 4, "RGBA", "COLOR")
        if renderlayer.use_pass_z:
            self.register_pass(scene, renderlayer, "Depth", 1, "Z", "VALUE")
        vector_pass.register_pass(self, scene, renderlayer)
        index_pass.register_pass(self, scene, renderlayer)

    def render(self, depsgraph: bpy.types.Depsgraph) -> None:
        scene = depsgraph.scene.original
        try:
            renders.check(scene)
            _synchronize_frame(self, scene)
            for view in self._views(depsgraph):
                self.active_view_set(view)
                passes = drawn_passes(self, depsgraph)
                if self.test_break():
                    return
                self._write_passes(depsgraph, view, passes)
        except Exception as error:  # a render must not go on without its captures
            sentence = error_message(error)
            if not isinstance(error, (FrogError, MemoryError)):
                reported_once.unexpected(f"rendering {scene.name}", error)
            # Not error_set: that neither ends an animation nor makes a script's render call raise.
            self.report({"ERROR"}, sentence)
            exit_status.note_failure()
            if renders.note_failure(scene, sentence):
                for view in self._views(depsgraph):
                    self._write_passes(depsgraph, view, None)
        self.update_progress(1.0)

    def _views(self, depsgraph: bpy.types.Depsgraph) -> list[str]:
        """The names of the views to render: one for each stereo eye, otherwise one empty name."""
        result = self.begin_result(0, 0, 1, 1, layer=depsgraph.view_layer.name)
        names = [view.name for view in result.views]
        self.end_result(result, cancel=True)
        return names

    def _write_passes(self, depsgraph: bpy.types.Depsgraph, view: str, passes: dict[str, Any] | None) -> None:
        """Writes passes (see ``drawn_passes``) to Blender's result; a striped pattern if there are none.

        FrogError for passes of another size than Blender's image or region has.
        """
        layer = depsgraph.view_layer.name
        result = self.begin_result(0, 0, self.resolution_x, self.resolution_y, layer=layer, view=view)
        size = result.resolution_x, result.resolution_y  # of the region, where there is one
        if passes is None:
            passes = {"Combined": refusal_pattern(*size)}
        drawn = passes["Combined"].shape[1::-1]
        if drawn != size:
            self.end_result(result, cancel=True)
            raise FrogError(f"{depsgraph.scene.name}: found a render region of {size} pixels, expected {drawn}.")
        for render_pass in result.layers[0].passes:
            values = passes.get(render_pass.name)
            if values is not None:
                render_pass.rect.foreach_set(pass_pixels(values))
        self.end_result(result)

    # The following runs with windows only, in the main thread.

    def view_update(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Called by Blender on changes; ``view_draw`` detects by itself what has changed."""

    def view_draw(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        viewport_drawing.draw(self, context, depsgraph)


def _synchronize_frame(engine: bpy.types.RenderEngine, scene: bpy.types.Scene) -> None:
    """Copies the subframe of the leading scene; Blender copies whole frames only."""
    frame = raw_frame(renders.leading(scene))
    if raw_frame(scene) != frame:
        engine.frame_set(math.floor(frame), frame % 1.0)


def drawn_passes(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> dict[str, Any]:
    """The passes of the current view, by name; see ``render_frame``."""
    combined, depth, surface = render_frame(engine, depsgraph)
    scene = depsgraph.scene.original
    renders.note_drawn(scene, surface is not None)
    if surface is None and scene.frog.composed_with is None:
        engine.report({"WARNING"}, f"Scene {scene.name}: found no visible capture. Only the background is rendered.")
    vectors = None
    if depsgraph.view_layer.use_pass_vector and not engine.test_break():
        vectors = render_vectors(engine, depsgraph)
    height, width = depth.shape
    numbers = index_pass.indices(surface, pass_indices(depsgraph), width, height)
    return {"Combined": combined, "Depth": depth, "Vector": vectors, index_pass.NAME: numbers}


Passes = tuple[np.ndarray, np.ndarray, np.ndarray | None]
Gathered = tuple["GaussianArrays | None", np.ndarray]
"""What ``gather`` gives."""


def render_frame(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> Passes:
    """Combined (H, W, 4) scene-linear premultiplied, Depth (H, W) planar in world units, and the index of the Gaussian
    at each pixel's surface (H, W), -1 for none; None instead of the index without captures. Rows from the top, of the
    Render Region only if there is one.

    With motion blur or depth of field, Combined is averaged over their samples; the rest is of the frame itself, from
    the middle of the lens.
    """
    from ..engine.playback.lens import seen_from

    lens = blur.lens_of(eye_of(engine, depsgraph), depsgraph)
    samples = blur.samples(settings_scene(depsgraph), settings_of(depsgraph), raw_frame(depsgraph.scene), lens)
    started = time.perf_counter()
    gathered = _gathered(engine, depsgraph)
    combined, depth, surface = render_instant(engine, depsgraph, gathered)
    blur.note_seconds(time.perf_counter() - started, depth.size)
    if not samples:
        return combined, depth, surface
    light, image_frame = np.zeros_like(combined), depsgraph.scene.frame_current_final
    with _restoring_frame(engine, depsgraph):
        for index, sample in enumerate(samples):
            if engine.test_break():
                break
            if sample.frame is not None:
                engine.frame_set(math.floor(sample.frame), sample.frame % 1.0)  # cameras and roots move as well
                gathered = _gathered(engine, depsgraph, image_frame)
                lens = blur.lens_of(eye_of(engine, depsgraph), depsgraph)
            through = None
            if sample.point is not None and lens is not None:
                through = partial(seen_from, point=sample.point, focus=lens.focus)
            light += render_instant(engine, depsgraph, gathered, through)[0]
            engine.update_progress((index + 1) / len(samples))
    return light / len(samples), depth, surface


@contextmanager
def _restoring_frame(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> Iterator[None]:
    """Restores the scene's frame on exit."""
    frame = raw_frame(depsgraph.scene)
    try:
        yield
    finally:
        if raw_frame(depsgraph.scene) != frame:
            engine.frame_set(math.floor(frame), frame % 1.0)


def render_instant(
    engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph, gathered: Gathered, through: Through | None = None
) -> Passes:
    """``render_frame`` at the scene's current frame, without blur.

    Args:
        gathered: the captures at that frame.
        through: moves the camera to a point of its lens.
    """
    gaussians, captured_background = gathered
    drawer = drawer_of(engine, depsgraph, through)
    drawing = None
    if gaussians is not None and not engine.test_break():
        engine.update_stats("", f"Drawing {len(gaussians.means):,} Gaussians")
        drawing = drawer.draw(gaussians)
        _warn_if_slow(engine, drawing)
    depth = depth_pass(drawing, *drawer.size, distance_added(eye_of(engine, depsgraph).data))
    background = background_of(depsgraph.scene, captured_background)
    combined = into_working_space(combined_pass(drawing, background, *drawer.size))
    if drawer.blind is not None:
        combined[drawer.blind] = 0.0
    return combined, depth, drawing.median_index if drawing is not None else None


def _gathered(
    engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph, image_frame: float | None = None
) -> Gathered:
    engine.update_stats("", "Deforming Gaussians")
    return gather(depsgraph, image_frame=image_frame)


def _warn_if_slow(engine: bpy.types.RenderEngine, drawing: Drawing) -> None:
    """Warns once an image, which with motion blur has many samples."""
    if drawing.notice and not engine.warned_slow:
        engine.warned_slow = True
        engine.report({"WARNING"}, drawing.notice)


def render_vectors(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> np.ndarray:
    """The Vector pass of the Render Region, (H, W, 4), rows from the top; see vector_pass."""
    frame, width, height = raw_frame(depsgraph.scene), engine.resolution_x, engine.resolution_y
    if is_panoramic(eye_of(engine, depsgraph)):
        raise FrogError("Found a panoramic camera and a Vector pass, expected one of them: vectors lie in a plane.")

    def snapshot_at(offset: int) -> vector_pass.Snapshot:
        other = frame + offset
        engine.frame_set(math.floor(other), other % 1.0)
        return gather(depsgraph)[0], camera_of(engine, depsgraph, eye_of(engine, depsgraph))

    options = options_of(depsgraph, eye_of(engine, depsgraph), width, height)
    with _restoring_frame(engine, depsgraph):
        return vector_pass.vectors(snapshot_at, options)


# Panels that other engines' settings fill with what FROG does not have.
_FOREIGN_PANELS = {"VIEWLAYER_PT_filter", "VIEWLAYER_PT_layer_passes"}
_FOREIGN_SUBJECTS = ("freestyle", "gpencil", "grease_pencil", "greasepencil", "_PT_simplify")


def _stock_panels() -> list[type[bpy.types.Panel]]:
    return [
        panel
        for panel in bpy.types.Panel.__subclasses__()
        if "BLENDER_RENDER" in getattr(panel, "COMPAT_ENGINES", ()) and not _is_foreign(panel.__name__)
    ]


def _is_foreign(panel: str) -> bool:
    return panel in _FOREIGN_PANELS or any(subject in panel for subject in _FOREIGN_SUBJECTS)


def register() -> None:
    bpy.utils.register_class(FrogRenderEngine)
    for panel in _stock_panels():
        panel.COMPAT_ENGINES.add(FrogRenderEngine.bl_idname)


def unregister() -> None:
    viewport_drawing.unregister()
    bpy.utils.unregister_class(FrogRenderEngine)
    for panel in _stock_panels():
        panel.COMPAT_ENGINES.discard(FrogRenderEngine.bl_idname)
