"""Run in a Blender with a window by test_in_window.py: splats in its viewport, and writes what was drawn.

    blender --factory-startup --python window_splats.py -- ROOT SCENE RESULT.json

Each step runs from a timer, when Blender has drawn what the one before did.
"""

import sys
from pathlib import Path

import bpy
import gpu
import numpy as np

ROOT, SCENE, RESULT = map(Path, sys.argv[sys.argv.index("--") + 1 :])
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from support.blender_windows import run_steps, viewport  # noqa: E402

import frog_blender  # noqa: E402
from frog_blender import point_cloud  # noqa: E402
from frog_blender.cameras import view_camera  # noqa: E402
from frog_blender.engine.evaluation.metrics import psnr  # noqa: E402
from frog_blender.engine.playback.render import draw  # noqa: E402
from frog_blender.timeline import playback  # noqa: E402
from frog_blender.viewport import drawing  # noqa: E402

frog_blender.register()
bpy.context.preferences.view.show_splash = False
found = {"errors": [], "drawn": {}, "points": {}, "lost": 0}
wanted = []  # what the handler below is to note


def redrawn():
    """Images that were drawn until now; the viewport is drawn again."""
    viewport()["area"].tag_redraw()
    return drawing.state().drawn


def capture():
    return next(iter(playback.captures(bpy.context.scene.objects)))


def note():
    """After the splats: their image, and what the engine draws of the same view."""
    context = bpy.context
    bound = gpu.state.active_framebuffer_get().viewport_get()[2:]
    found["lost"] += tuple(bound) != (context.region.width, context.region.height)
    if not wanted:
        return
    name = wanted.pop()
    picture = drawing.state().pictures[context.region.as_pointer()]
    width, height = picture.canvas.size
    pixels = np.array(picture.canvas.textures[0].read(), np.float32).reshape(height, width, 4)[::-1]
    view = context.region_data
    gaussians = playback.scene_time(capture(), context.scene.frame_current).gaussians()
    expected = draw(gaussians, view_camera(view.view_matrix, view.window_matrix, width, height))
    middle = np.s_[height // 2 - 5 : height // 2 + 5, width // 2 - 5 : width // 2 + 5]
    found[name] = {
        "psnr": psnr(pixels[..., :3], expected.rgb),
        "alpha": [float(pixels[middle][..., 3].mean()), float(expected.alpha[middle].mean())],
        "step": picture.step,
    }


def steps():
    scene, space = bpy.context.scene, viewport()["space_data"]
    for obj in list(scene.objects):
        bpy.data.objects.remove(obj)
    engine = scene.render.engine
    bpy.ops.import_scene.frog("EXEC_DEFAULT", filepath=str(SCENE), set_up_scene=False, use_frog_engine=True)
    yield 1.0
    found["points"]["rendered by FROG"] = point_cloud.is_drawn_in("viewport", capture())
    scene.render.engine, space.shading.type = engine, "SOLID"
    if point_cloud.draws_splats():  # by Blender itself; elsewhere splats are what people get unasked, software or not
        scene.frog.viewport_drawing = "CARD"
    space.region_3d.view_perspective = "PERSP"
    space.region_3d.view_location, space.region_3d.view_distance = (0.0, 0.0, 0.0), 5.0
    for mode in ("SOLID", "WIREFRAME", "MATERIAL"):
        before, space.shading.type = drawing.state().drawn, mode
        yield 1.0
        found["drawn"][mode] = redrawn() - before
    space.shading.type = "SOLID"
    yield 1.0
    found["points"]["splats"] = point_cloud.is_drawn_in("viewport", capture())
    before = redrawn()
    for _ in range(3):
        redrawn()
        yield 0.3
    found["drawn"]["nothing new"] = redrawn() - before
    wanted.append("free")
    redrawn()
    yield 1.0
    scene.frame_set(scene.frame_current + 3)
    yield 1.0
    found["drawn"]["another frame"] = redrawn() - before
    eye = np.array(space.region_3d.view_matrix.inverted())[:3, 3]
    bpy.ops.mesh.primitive_cube_add(size=0.6, location=eye * 0.7)
    yield 1.0
    wanted.append("behind a cube")
    redrawn()
    yield 1.0
    scene.frog.viewport_drawing = "POINTS"
    yield 0.5
    found["points"]["points"] = point_cloud.is_drawn_in("viewport", capture())
    found["failed"] = drawing.state().problem
    frog_blender.unregister()
    frog_blender.register()
    yield 0.5


bpy.types.SpaceView3D.draw_handler_add(note, (), "WINDOW", "POST_VIEW")
run_steps(steps(), found, RESULT)
