"""What playing and rendering cost inside Blender: the frame handler, the rendered viewport, F12.

    python benchmarks/blender.py        (with the bpy module; F12 and the viewport also by CUDA, where there is a GPU)
    blender -b --factory-startup --python benchmarks/blender.py

Scenes are random; times are medians in milliseconds, a JSON line for each kind. The engine's own work (deformation,
rasterization) stands beside what Blender adds, so that overheads can be told.
"""

from __future__ import annotations

import json
import math
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

import bpy
import numpy as np
from mathutils import Matrix
from support.builders import scene_file

import frog_blender
from frog_blender import app_handlers
from frog_blender.engine.playback.painter import painter
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from frog_blender.engine.scene.scene_file import SceneFile, write_scene
from frog_blender.engine.training.session.time_estimate import has_nvidia_gpu
from frog_blender.render import frog_engine
from frog_blender.render.viewport import COARSEST, Viewport, image_of
from frog_blender.timeline import handlers as timeline_handlers
from frog_blender.timeline import playback


def median_ms(work: Callable[[int], object], times: int = 15) -> float:
    seconds = []
    for number in range(times):
        started = time.perf_counter()
        work(number)
        seconds.append(time.perf_counter() - started)
    return round(1000 * statistics.median(seconds), 2)


def noting(function: Callable[..., Any], seconds: list[float]) -> Callable[..., Any]:
    """The function, which notes how long each of its calls took."""

    def timed(*arguments: Any) -> Any:
        started = time.perf_counter()
        result = function(*arguments)
        seconds.append(time.perf_counter() - started)
        return result

    return timed


def opened(folder: Path, count: int, moving: int, size: tuple[int, int]) -> tuple[bpy.types.Object, Path]:
    """A new file with one random capture of small Gaussians before its first camera."""
    scene = scene_file(count, moving=moving)
    scene.arrays["log_scales"] = scene.arrays["log_scales"] - np.float32(2.5)
    cameras = tuple(camera.resized(*size) for camera in scene.header.cameras)
    path = folder / f"{count}_{moving}.frog"
    write_scene(path, SceneFile(replace(scene.header, cameras=cameras), scene.arrays))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.import_scene.frog(filepath=str(path))
    return next(playback.captures(bpy.context.scene.objects)), path


def handler(folder: Path, count: int, moving: int) -> dict[str, float]:
    """Scrubbing: times that are in the cache, and new ones; what the frame handler takes while Blender changes frames,
    when the attributes it writes are shared with the evaluated copy of the frame before."""
    _, path = opened(folder, count, moving, (160, 120))
    scene, inside = bpy.context.scene, []
    original = app_handlers.guarded(timeline_handlers.on_frame)
    timed = noting(original, inside)
    handlers = bpy.app.handlers.frame_change_pre
    handlers[handlers.index(original)] = timed

    def scrub(frame_of: Callable[[int], float]) -> tuple[float, float]:
        inside.clear()
        whole = median_ms(lambda number: scene.frame_set(int(frame_of(number)), subframe=frame_of(number) % 1), 25)
        return round(1000 * statistics.median(inside), 2), whole

    try:
        scrub(lambda number: 1 + number % 7)
        cached, whole = scrub(lambda number: 1 + number % 7)
        fresh, _ = scrub(lambda number: 1 + number % 5 + 0.013 * (number + 1))
    finally:
        handlers[handlers.index(timed)] = original
    playable = ScenePlayer.load(path)
    return {
        "handler, cached": cached,
        "handler, not cached": fresh,
        "deformation": median_ms(lambda number: playable.at_frame(0.41 * number)),
        "frame_set, cached": whole,
    }


def still(folder: Path) -> dict[str, float]:
    """F12 at 1352 x 1014 with 100,000 Gaussians: everything but deformation and rasterization is overhead."""
    size = (1352, 1014)
    _, path = opened(folder, 100_000, 15_000, size)
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = size
    playable = ScenePlayer.load(path)
    camera = playable.header.cameras[0]
    engine_ms = median_ms(lambda number: draw(playable.at_frame(0.1 * number), camera), 5)
    inside: list[float] = []
    original = frog_engine.render_instant
    frog_engine.render_instant = noting(original, inside)

    def render(number: int) -> None:
        scene.frame_current = 1 + number % 5
        bpy.ops.render.render()

    try:
        whole = median_ms(render, 6)
    finally:
        frog_engine.render_instant = original
    return {
        "deformation and rasterization": engine_ms,
        "in the engine": round(1000 * statistics.median(inside), 2),
        "F12": whole,
    }


def rendered_viewport(folder: Path) -> dict[str, float]:
    """The engine's share of a redraw at 960 x 540 with 50,000 Gaussians: still, orbiting, scrubbing. Blender's drawing
    of the window is not in it."""
    size = (960, 540)
    obj, _ = opened(folder, 50_000, 7_500, size)
    scene, camera = bpy.context.scene, bpy.context.scene.camera
    window_matrix = camera.calc_matrix_camera(bpy.context.evaluated_depsgraph_get(), x=size[0], y=size[1])
    viewport = Viewport()
    inside: list[float] = []
    draw_image = noting(image_of, inside)

    def redraw(angle: float) -> None:
        turned = obj.matrix_world @ Matrix.Rotation(angle, 4, "Z") @ camera.matrix_world
        view = SimpleNamespace(view_matrix=turned.inverted(), window_matrix=window_matrix)
        draw_image(viewport, bpy.context.evaluated_depsgraph_get(), view, size)

    def median(work: Callable[[int], object]) -> float:
        inside.clear()
        for number in range(25):
            work(number)
        return round(1000 * statistics.median(inside[5:]), 2)

    def sharpen(number: int) -> None:
        viewport.changed_at = 0.0  # a while ago
        redraw(0.0)
        viewport.image.step = COARSEST  # type: ignore[union-attr]

    def scrub(number: int) -> None:
        scene.frame_set(1 + number % 7)
        redraw(0.0)

    for number in range(7):  # into the cache
        scene.frame_set(1 + number)
    orbiting = median(lambda number: redraw(0.01 * number))
    return {"orbiting": orbiting, "scrubbing": median(scrub), "still": median(sharpen)}


def drawings(folder: Path, by: str) -> dict[str, dict[str, float]]:
    return {
        f"F12, 100,000 Gaussians, 1352 x 1014, {by}": still(folder),
        f"rendered viewport, 50,000 Gaussians, 960 x 540, {by}": rendered_viewport(folder),
    }


def main() -> None:
    frog_blender.register()
    painter().ask_after(math.inf, int)  # no card takes over by itself
    with tempfile.TemporaryDirectory() as folder:
        found = {
            "scrubbing, 200,000 Gaussians, all moving": handler(Path(folder), 200_000, 200_000),
            "scrubbing, 100,000 Gaussians, 15 % moving": handler(Path(folder), 100_000, 15_000),
            **drawings(Path(folder), "by the processor"),
        }
        if has_nvidia_gpu():
            from frog_blender.engine.training.optimize.device import draw_frames_on

            draw_frames_on("cuda")
            found |= drawings(Path(folder), "by CUDA")
    for name, values in found.items():
        print(json.dumps({"what": name, **values}))


if __name__ == "__main__":
    main()
