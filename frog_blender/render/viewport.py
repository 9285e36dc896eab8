"""The rendered viewport of the FROG engine: coarse during interaction, sharp when nothing changes.

A viewport keeps its last image. The same view at the same frame is not drawn again. A new one is drawn with as many
pixels as fit the time budget, and at full resolution when nothing has changed for a while.
"""

import math
import time
from dataclasses import dataclass, field
from typing import Any

import bpy
import gpu
import numpy as np
from gpu_extras.presets import draw_texture_2d

from .. import redrawing, reported_once
from ..app_handlers import later
from ..cameras import view_camera
from ..color_spaces import into_working_space
from ..engine.capture.camera import Camera
from ..engine.errors import FrogError
from ..engine.playback import render
from ..engine.playback.passes import combined_pass
from .collect_instances import gather, scene_time, visible_captures
from .world import background_of

MOVING_SECONDS = 0.016  # that an image may take while things move
STILL_AFTER = 0.2  # seconds without a change
COARSEST = 4  # pixels a side that one stands for at most


@dataclass
class ViewportImage:
    """A drawn image: ``pixels`` (H, W, 4) scene-linear premultiplied, rows from the bottom. One pixel covers
    ``step`` x ``step`` of the viewport's. ``texture`` is the same on the graphics card, once it is shown.
    """

    key: Any
    step: int
    pixels: np.ndarray
    texture: Any = None


@dataclass
class Viewport:
    """The state of one viewport.

    Attributes:
        image: the last one.
        changed_at: when its key became another one (of ``time.perf_counter``).
        seconds_per_pixel: of the last drawing, an estimate for the next.
        gathered: what determines the last drawn Gaussians, and these with their background.
        problems: a sentence for each capture that is not among them because it cannot be drawn.
        moving_seconds: that an image may take while things move.
        still_after: seconds without a change until a sharp image is due.
    """

    image: ViewportImage | None = None
    changed_at: float = 0.0
    seconds_per_pixel: float = 1e-7
    gathered: tuple[Any, Any] = (None, (None, None))
    problems: list[str] = field(default_factory=list)
    moving_seconds: float = MOVING_SECONDS
    still_after: float = STILL_AFTER

    def step_for(self, key: Any, width: int, height: int, now: float) -> int:
        """The pixel size of the next image of ``key``; 0 if the last image is still valid."""
        if self.image is not None and self.image.key == key:
            sharp = self.image.step == 1
            return 0 if sharp or now - self.changed_at < self.still_after else 1
        self.changed_at = now
        fits = self.moving_seconds / max(self.seconds_per_pixel, 1e-12)
        return min(COARSEST, max(1, math.ceil(math.sqrt(width * height / fits))))


def error_message(error: Exception) -> str:
    """A sentence for an error in a final render or a viewport."""
    if isinstance(error, MemoryError):
        return f"Out of memory{f' ({error})' if str(error) else ''}. Reduce the image size or hide captures."
    return str(error) if isinstance(error, FrogError) else f"FRoG could not draw: {error!r}."


def draw(engine: bpy.types.RenderEngine, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
    """Draws the captures in a region. Problems are shown in the header while they last, and printed once."""
    size = (context.region.width, context.region.height)
    viewport = engine.viewport = engine.viewport or Viewport()
    try:
        image = image_of(viewport, depsgraph, context.region_data, size, context.space_data)
    except (FrogError, MemoryError) as error:
        show_problems(engine, [error_message(error)])
        return
    show_problems(engine, viewport.problems)
    if image.texture is None:
        height, width = image.pixels.shape[:2]
        buffer = gpu.types.Buffer("FLOAT", width * height * 4, image.pixels.reshape(-1))
        image.texture = gpu.types.GPUTexture((width, height), format="RGBA16F", data=buffer)
    gpu.state.blend_set("ALPHA_PREMULT")
    engine.bind_display_space_shader(depsgraph.scene)
    draw_texture_2d(image.texture, (0, 0), *size)
    engine.unbind_display_space_shader()
    gpu.state.blend_set("NONE")
    if image.step > 1:
        later(redrawing.viewports, STILL_AFTER + 0.05)


def show_problems(engine: bpy.types.RenderEngine, problems: list[str]) -> None:
    """Shows problems in the header of the viewport, or clears it."""
    for problem in problems:
        reported_once.message(problem)
    others = f" ({len(problems) - 1:,} more in the console)" if len(problems) > 1 else ""
    engine.update_stats("FRoG" if problems else "", problems[0] + others if problems else "")


def image_of(
    viewport: Viewport,
    depsgraph: bpy.types.Depsgraph,
    view: bpy.types.RegionView3D,
    size: tuple[int, int],
    space: bpy.types.SpaceView3D | None = None,
) -> ViewportImage:
    """The image of a region of that size with the matrices of ``view``, in the viewport ``space``; drawn again only if
    something has changed. Captures that cannot be drawn are listed in ``viewport.problems``.

    Raises:
        FrogError: for a view that cannot be drawn.
        MemoryError: when memory runs out.
    """
    seen = _seen(depsgraph, space)
    if viewport.gathered[0] != seen:
        problems: list[str] = []
        viewport.gathered = (seen, gather(depsgraph, space, problems))
        viewport.problems = problems
    gaussians, captured = viewport.gathered[1]
    background = background_of(depsgraph.scene, captured)
    matrices = view.view_matrix, view.window_matrix
    behind = None if background is None else background.tobytes()
    ratio = focal_ratio(depsgraph, view, space)
    key = (*(np.array(matrix).tobytes() for matrix in matrices), size, seen, behind, ratio)
    started = time.perf_counter()
    step = viewport.step_for(key, *size, started)
    if step == 0:
        assert viewport.image is not None
        return viewport.image
    width, height = (max(1, -(-length // step)) for length in size)
    drawing = render.draw(gaussians, view_camera(*matrices, width, height, ratio)) if gaussians is not None else None
    combined = into_working_space(combined_pass(drawing, background, width, height))
    viewport.image = ViewportImage(key, step, np.ascontiguousarray(combined[::-1], np.float32))
    viewport.seconds_per_pixel = (time.perf_counter() - started) / (width * height)
    return viewport.image


def camera_of(context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> Camera:
    """The engine camera of a context's viewport."""
    region, view = context.region, context.region_data
    ratio = focal_ratio(depsgraph, view, context.space_data)
    return view_camera(view.view_matrix, view.window_matrix, region.width, region.height, ratio)


def focal_ratio(
    depsgraph: bpy.types.Depsgraph, view: bpy.types.RegionView3D, space: bpy.types.SpaceView3D | None
) -> float:
    """The focal ratio of the camera of a camera view, which Blender's matrices lack; one for other views."""
    if space is None or view.view_perspective != "CAMERA":
        return 1.0
    camera = space.camera if space.use_local_camera else depsgraph.scene.camera
    return camera.data.frog.focal_ratio if camera is not None and camera.type == "CAMERA" else 1.0


def _seen(depsgraph: bpy.types.Depsgraph, space: bpy.types.SpaceView3D | None) -> tuple[Any, ...]:
    """What determines the Gaussians: what the captures show as they are edited, and their matrices."""
    seen: list[tuple[Any, ...]] = []
    for obj, shown, matrix in visible_captures(depsgraph, space):
        try:
            key = scene_time(depsgraph, obj, shown, space).key
        except FrogError as error:
            seen.append((str(error), matrix.tobytes()))
        else:
            seen.append((*key, matrix.tobytes()))
    return tuple(seen)
