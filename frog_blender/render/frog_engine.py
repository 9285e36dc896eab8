"""The FROG render engine: renders images and animations of captures with the engine's own rasterizer, without torch.

The image through an imported camera is the engine's own drawing of that camera: Gaussians are blended in the video's
display-referred colour, as they were trained, and the result is converted to Blender's scene-linear at the end.
"""

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import bpy
import numpy as np

from .. import reported_once
from ..cameras import distance_added
from ..color_spaces import into_working_space
from ..engine.errors import FrogError
from ..engine.gaussians import GaussianArrays
from ..engine.playback.lens import seen_from
from ..engine.playback.passes import Snapshot, combined_pass, depth_pass, vector_pass
from ..timeline.retiming import raw_frame
from . import blur, passes, viewport
from .collect_instances import gather, pass_indices
from .compositing import renders
from .rendered_view import RenderedView, Through
from .world import background_of

Passes = tuple[np.ndarray, np.ndarray, np.ndarray | None]
Gathered = tuple["GaussianArrays | None", np.ndarray]
"""What ``gather`` gives."""


class FrogRenderEngine(bpy.types.RenderEngine):
    """Draws every visible capture of the scene; other objects are not drawn."""

    bl_idname = "FROG"
    bl_label = "FRoG"
    bl_use_preview = False
    bl_use_eevee_viewport = True
    bl_use_postprocess = True

    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        super().__init__(*arguments, **keywords)
        self.viewport: viewport.Viewport | None = None
        self.warned_slow = False

    def update_render_passes(self, scene: bpy.types.Scene = None, renderlayer: bpy.types.ViewLayer = None) -> None:
        self.register_pass(scene, renderlayer, "Combined", 4, "RGBA", "COLOR")
        for name, channels, kind, is_wanted in (
            ("Depth", "Z", "VALUE", renderlayer.use_pass_z),
            ("Vector", "XYZW", "VECTOR", renderlayer.use_pass_vector),
            (passes.INDEX, "X", "VALUE", renderlayer.use_pass_object_index),
        ):
            if is_wanted:
                self.register_pass(scene, renderlayer, name, len(channels), channels, kind)

    def render(self, depsgraph: bpy.types.Depsgraph) -> None:
        scene = depsgraph.scene.original
        try:
            renders.check(scene)
            _go_to(self, scene, raw_frame(renders.leading(scene)))  # Blender copies whole frames only
            for view in self._views(depsgraph):
                self.active_view_set(view)
                drawn = drawn_passes(self, depsgraph)
                if self.test_break():
                    return
                self._write_passes(depsgraph, view, drawn)
        except Exception as error:  # a render must not go on without its captures
            sentence = viewport.error_message(error)
            if not isinstance(error, (FrogError, MemoryError)):
                reported_once.unexpected(f"rendering {scene.name}", error)
            # Not error_set: that neither ends an animation nor makes a script's render call raise.
            self.report({"ERROR"}, sentence)
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

    def _write_passes(self, depsgraph: bpy.types.Depsgraph, view: str, drawn: dict[str, Any] | None) -> None:
        """Writes passes (see ``drawn_passes``) to Blender's result; a striped pattern if there are none.

        FrogError for passes of another size than Blender's image or region has.
        """
        layer = depsgraph.view_layer.name
        result = self.begin_result(0, 0, self.resolution_x, self.resolution_y, layer=layer, view=view)
        size = result.resolution_x, result.resolution_y  # of the region, where there is one
        if drawn is None:
            drawn = {"Combined": passes.refusal_pattern(*size)}
        expected = drawn["Combined"].shape[1::-1]
        if expected != size:
            self.end_result(result, cancel=True)
            raise FrogError(f"{depsgraph.scene.name}: found a render region of {size} pixels, expected {expected}.")
        for render_pass in result.layers[0].passes:
            values = drawn.get(render_pass.name)
            if values is not None:
                render_pass.rect.foreach_set(passes.pass_pixels(values))
        self.end_result(result)

    # The following runs with windows only, in the main thread.

    def view_update(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Called by Blender on changes; ``view_draw`` detects by itself what has changed."""

    def view_draw(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        viewport.draw(self, context, depsgraph)


def _go_to(engine: bpy.types.RenderEngine, scene: bpy.types.Scene, frame: float) -> None:
    """Sets the frame of the scene that is rendered, unless it is there."""
    if raw_frame(scene) != frame:
        engine.frame_set(math.floor(frame), frame % 1.0)  # cameras and roots move as well


@contextmanager
def _restoring_frame(view: RenderedView) -> Iterator[None]:
    """Restores the scene's frame on exit."""
    scene = view.depsgraph.scene
    frame = raw_frame(scene)
    try:
        yield
    finally:
        _go_to(view.engine, scene, frame)


def drawn_passes(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> dict[str, Any]:
    """The passes of the current view, by name; see ``render_frame``."""
    view, scene, layer = RenderedView(engine, depsgraph), depsgraph.scene.original, depsgraph.view_layer
    combined, depth, surface = render_frame(view)
    drawn: dict[str, Any] = {"Combined": combined, "Depth": depth}
    renders.note_drawn(scene, surface is not None)
    if surface is None and scene.frog.composed_with is None:
        engine.report({"WARNING"}, f"Scene {scene.name}: found no visible capture. Only the background is rendered.")
    if layer.use_pass_vector and not engine.test_break():
        drawn["Vector"] = render_vectors(view)
    if layer.use_pass_object_index:
        drawn[passes.INDEX] = passes.index_pass(surface, pass_indices(depsgraph), *depth.shape[::-1])
    return drawn


def render_frame(view: RenderedView) -> Passes:
    """Combined (H, W, 4) scene-linear premultiplied, Depth (H, W) planar in world units, and the index of the Gaussian
    at each pixel's surface (H, W), -1 for none; None instead of the index without captures. Rows from the top, of the
    Render Region only if there is one.

    With motion blur or depth of field, Combined is averaged over their samples; the rest is of the frame itself, from
    the middle of the lens.
    """
    engine, scene = view.engine, view.depsgraph.scene
    lens = blur.lens_of(view.eye, view.depsgraph)
    samples = blur.samples(view.scene, raw_frame(scene), lens)
    gathered = _gathered(view)
    combined, depth, surface = render_instant(view, gathered)
    if not samples:
        return combined, depth, surface
    light, image_frame = np.zeros_like(combined), scene.frame_current_final
    with _restoring_frame(view):
        for index, (frame, point) in enumerate(samples):
            if engine.test_break():
                break
            if frame is not None:
                _go_to(engine, scene, frame)
                gathered = _gathered(view, image_frame)
                lens = blur.lens_of(view.eye, view.depsgraph)
            through = None
            if point is not None and lens is not None:
                through = partial(seen_from, point=point, focus=lens.focus)
            light += render_instant(view, gathered, through)[0]
            engine.update_progress((index + 1) / len(samples))
    return light / len(samples), depth, surface


def render_instant(view: RenderedView, gathered: Gathered, through: Through | None = None) -> Passes:
    """``render_frame`` at the scene's current frame, without blur.

    Args:
        gathered: the captures at that frame.
        through: moves the camera to a point of its lens.
    """
    engine, (gaussians, captured_background) = view.engine, gathered
    rays, size, drawing = view.rays(), view.region[2:], None
    if gaussians is not None and not engine.test_break():
        engine.update_stats("", f"Drawing {len(gaussians.means):,} Gaussians")
        drawing = view.draw(gaussians, rays, through)
        if drawing.notice and not engine.warned_slow:  # once an image, which with motion blur has many samples
            engine.warned_slow = True
            engine.report({"WARNING"}, drawing.notice)
    depth = depth_pass(drawing, *size, distance_added(view.eye.data))
    background = background_of(view.depsgraph.scene, captured_background)
    combined = into_working_space(combined_pass(drawing, background, *size))
    if rays is not None:
        combined[np.isnan(rays).any(axis=-1)] = 0.0  # the lens sees nothing there, not even the background
    return combined, depth, drawing.median_index if drawing is not None else None


def _gathered(view: RenderedView, image_frame: float | None = None) -> Gathered:
    view.engine.update_stats("", "Deforming Gaussians")
    return gather(view.depsgraph, image_frame=image_frame)


def render_vectors(view: RenderedView) -> np.ndarray:
    """The Vector pass of the Render Region, (H, W, 4), rows from the top."""
    if view.is_panoramic:
        raise FrogError("Found a panoramic camera and a Vector pass, expected one of them: vectors lie in a plane.")
    scene, options = view.depsgraph.scene, view.options()
    frame = raw_frame(scene)

    def snapshot_at(offset: int) -> Snapshot:
        _go_to(view.engine, scene, frame + offset)
        return gather(view.depsgraph)[0], view.camera()

    with _restoring_frame(view):
        return vector_pass(snapshot_at, options)


_FOREIGN = re.compile(r"VIEWLAYER_PT_(filter|layer_passes)$|freestyle|gpencil|grease_?pencil|_PT_simplify")
"""Panels that other engines' settings fill with what FROG does not have."""


def _stock_panels() -> list[type[bpy.types.Panel]]:
    panels = bpy.types.Panel.__subclasses__()
    stock = (panel for panel in panels if "BLENDER_RENDER" in getattr(panel, "COMPAT_ENGINES", ()))
    return [panel for panel in stock if not _FOREIGN.search(panel.__name__)]


def register() -> None:
    for panel in _stock_panels():
        panel.COMPAT_ENGINES.add(FrogRenderEngine.bl_idname)


def unregister() -> None:
    for panel in _stock_panels():
        panel.COMPAT_ENGINES.discard(FrogRenderEngine.bl_idname)
