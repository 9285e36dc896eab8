"""The FROG render engine: renders images and animations of captures with the engine's own rasterizer, without torch.

The image through an imported camera is the engine's own drawing of that camera: Gaussians are blended in the video's
display-referred colour, as they were trained, and the result is converted to Blender's scene-linear at the end.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import bpy
import numpy as np

from .. import reported_once
from ..cameras import distance_added, engine_camera
from ..color_spaces import into_working_space
from ..engine.errors import FrogError
from ..timeline.retiming import raw_frame
from . import index_pass, vector_pass, viewport_drawing
from .collect_instances import gather, pass_indices
from .compositing import renders
from .holdout import draw_before, limits_of_objects
from .messages import error_message
from .pixel_passes import combined_pass, depth_pass, pass_pixels, refusal_pattern
from .region import rendered_part
from .world import background_of

if TYPE_CHECKING:
    from ..engine.capture.camera import Camera
    from ..engine.native.options import RasterizeOptions
    from ..engine.playback.render import Drawing
    from .viewport import Viewport

SHUTTER_SAMPLES = 16  # frames that motion blur averages, unless the scene says otherwise


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


def render_frame(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> Passes:
    """Combined (H, W, 4) scene-linear premultiplied, Depth (H, W) planar in world units, and the index of the Gaussian
    at each pixel's surface (H, W), -1 for none; None instead of the index without captures. Rows from the top, of the
    Render Region only if there is one.

    With motion blur, Combined is averaged over frames spread over the shutter time; the rest is of the frame itself.
    """
    combined, depth, surface = render_instant(engine, depsgraph)
    render, frame = _settings(depsgraph), raw_frame(depsgraph.scene)
    if not render.use_motion_blur or render.motion_blur_shutter <= 0:
        return combined, depth, surface
    number = _settings_scene(depsgraph).frog.motion_samples
    samples = shutter_frames(frame, render.motion_blur_shutter, render.motion_blur_position, number)
    light = np.zeros_like(combined)
    with _restoring_frame(engine, depsgraph):
        for number, sample in enumerate(samples):
            if engine.test_break():
                break
            engine.frame_set(math.floor(sample), sample % 1.0)  # cameras and roots move as well
            light += render_instant(engine, depsgraph)[0]
            engine.update_progress((number + 1) / len(samples))
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


def shutter_frames(frame: float, shutter: float, position: str, samples: int = SHUTTER_SAMPLES) -> list[float]:
    """The frames sampled while a shutter is open for ``shutter`` frames, placed by Blender's "START", "CENTER" or
    "END" of the frame.
    """
    first = frame + {"START": 0.0, "CENTER": -0.5, "END": -1.0}[position] * shutter
    return [first + shutter * (number + 0.5) / samples for number in range(samples)]


def render_instant(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> Passes:
    """``render_frame`` at the scene's current frame, without motion blur."""
    scene = depsgraph.scene
    width, height = engine.resolution_x, engine.resolution_y
    eye = _eye(engine, depsgraph)
    options = _options(depsgraph, eye, width, height)
    camera = _camera(engine, depsgraph, eye)
    engine.update_stats("", "Deforming Gaussians")
    gaussians, captured_background = gather(depsgraph)
    if gaussians is None or engine.test_break():
        drawing = None
    else:
        engine.update_stats("", f"Drawing {len(gaussians.means):,} Gaussians")
        limits = limits_of_objects(depsgraph, camera, options) if scene.frog.hold_out else None
        drawing = draw_before(limits, gaussians, camera, options)
        _warn_if_slow(engine, drawing)
    size = options.region_of(camera)[2:]
    depth = depth_pass(drawing, *size, distance_added(eye.data))
    combined = into_working_space(combined_pass(drawing, background_of(scene, captured_background), *size))
    return combined, depth, drawing.median_index if drawing is not None else None


def _warn_if_slow(engine: bpy.types.RenderEngine, drawing: Drawing) -> None:
    """Warns once an image, which with motion blur has many samples."""
    if drawing.notice and not engine.warned_slow:
        engine.warned_slow = True
        engine.report({"WARNING"}, drawing.notice)


def _options(depsgraph: bpy.types.Depsgraph, eye: bpy.types.Object, width: int, height: int) -> RasterizeOptions:
    """Options for the Render Region, with the near plane at Blender's camera even if the engine's is further back."""
    from ..engine.native.options import RasterizeOptions

    region = rendered_part(renders.leading(depsgraph.scene.original).render, width, height)
    return RasterizeOptions(region=region, near_plane=RasterizeOptions.near_plane + distance_added(eye.data))


def _settings(depsgraph: bpy.types.Depsgraph) -> bpy.types.RenderSettings:
    """The render settings in effect."""
    return _settings_scene(depsgraph).render


def _settings_scene(depsgraph: bpy.types.Depsgraph) -> bpy.types.Scene:
    """The scene whose render settings are in effect: the followed one while that is rendered."""
    scene = depsgraph.scene
    first = renders.leading(scene.original)
    return first if scene.original.frog.composed_with == first else scene


def _eye(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> bpy.types.Object:
    """The evaluated active camera: of the scene, of a sequencer strip or of a stereo eye; while the followed scene
    is rendered, the camera of that scene.
    """
    scene = depsgraph.scene.original
    camera = engine.camera_override or scene.camera
    first = renders.leading(scene)
    if scene.frog.composed_with == first != scene and first.camera != scene.camera:
        camera = first.camera
    if camera is None:
        raise FrogError(f"Scene {scene.name}: found no active camera, expected one to render through.")
    evaluated = camera.evaluated_get(depsgraph)
    if not evaluated.is_evaluated:
        raise FrogError(f"{camera.name} is not in any collection that {scene.name} renders.")
    return evaluated


def _camera(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph, eye: bpy.types.Object) -> Camera:
    """The engine camera of the rendered view."""
    render, width, height = _settings(depsgraph), engine.resolution_x, engine.resolution_y
    if not render.use_multiview:
        return engine_camera(eye, eye.matrix_world, render, width, height)
    matrix = engine.camera_model_matrix(eye)
    return engine_camera(eye, matrix, render, width, height, shift_x=engine.camera_shift_x(eye))


def render_vectors(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> np.ndarray:
    """The Vector pass of the Render Region, (H, W, 4), rows from the top; see vector_pass."""
    frame, width, height = raw_frame(depsgraph.scene), engine.resolution_x, engine.resolution_y

    def snapshot_at(offset: int) -> vector_pass.Snapshot:
        other = frame + offset
        engine.frame_set(math.floor(other), other % 1.0)
        return gather(depsgraph)[0], _camera(engine, depsgraph, _eye(engine, depsgraph))

    options = _options(depsgraph, _eye(engine, depsgraph), width, height)
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
