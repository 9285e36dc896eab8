"""Compares the shadow that a trained room's proxy mesh casts on a plane with that of the true room.

    python benchmarks/proxy_shadows.py SCENE.frog [RESOLUTION]

SCENE.frog is a training of the bundled capture `room`, whose Blender scene is in examples/. A point lamp stands between
the cameras and the frog, a plane behind the frog. Of five frames, the intersection over union of what Cycles renders
darker than half of the bare plane.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import bpy
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "examples"), str(ROOT / "tests")]

from support.exr import pass_of, render_channels  # noqa: E402

import frog_blender  # noqa: E402
from frog_blender.engine.playback.player import ScenePlayer  # noqa: E402
from frog_blender.engine.surfaces.proxy import Proxy, make_proxy  # noqa: E402

FRAMES, FRAME_COUNT = (0, 7, 14, 21, 28), 30
LAMP = (0.9, -3.2, 2.2)
LEFT, RIGHT, LOW, HIGH, BEHIND = -1.5, 1.0, 0.3, 2.6, 1.0  # metres, of the plane
PIXELS_A_METRE = 50


def add_stage() -> bpy.types.Object:
    """The lamp, the plane and a camera that sees the plane alone; nothing else than the lamp gives light."""
    scene, link = bpy.context.scene, bpy.context.scene.collection.objects.link
    for obj in scene.objects:
        obj.visible_camera, obj.visible_shadow, obj.is_shadow_catcher = False, True, False
    mesh = bpy.data.meshes.new("plane")
    corners = [(x, BEHIND, z) for x, z in ((LEFT, LOW), (RIGHT, LOW), (RIGHT, HIGH), (LEFT, HIGH))]
    mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
    plane = bpy.data.objects.new("plane", mesh)
    lamp = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "POINT"))
    lamp.data.energy, lamp.data.shadow_soft_size, lamp.location = 500.0, 0.0, LAMP
    data = bpy.data.cameras.new("camera")
    data.type, data.ortho_scale, data.clip_start = "ORTHO", RIGHT - LEFT, 0.001
    camera = scene.camera = bpy.data.objects.new("camera", data)
    camera.location, camera.rotation_euler = ((LEFT + RIGHT) / 2, -6.0, (LOW + HIGH) / 2), (np.pi / 2, 0, 0)
    for obj in (plane, lamp, camera):
        link(obj)
    scene.world, scene.render.engine = None, "CYCLES"
    scene.cycles.samples, scene.cycles.max_bounces, scene.cycles.use_denoising = 4, 0, False
    scene.render.resolution_x = round((RIGHT - LEFT) * PIXELS_A_METRE)
    scene.render.resolution_y = round((HIGH - LOW) * PIXELS_A_METRE)
    scene.render.resolution_percentage = 100
    return plane


def brightness() -> np.ndarray:
    """(H, W) of the plane now."""
    with tempfile.TemporaryDirectory() as folder:
        channels = render_channels(bpy.context.scene, Path(folder) / "plane.exr")
    return pass_of(channels, "Combined", "RGBA")[..., :3].mean(-1)


def true_shadows() -> list[np.ndarray]:
    """(H, W) brightness under the true room in each frame, and of the bare plane."""
    from room_scene import Room

    room = Room()
    for light in [obj for obj in bpy.data.objects if obj.type == "LIGHT"]:
        bpy.data.objects.remove(light)
    plane, images = add_stage(), []
    for frame in FRAMES:
        room.pose(frame / FRAME_COUNT)
        images.append(brightness())
    for obj in bpy.context.scene.objects:
        obj.hide_render = obj.type == "MESH" and obj != plane
    return [*images, brightness()]


def made_proxy(path: Path, resolution: int) -> Proxy:
    player = ScenePlayer.load(path)
    frames = [lambda frame=frame: player.at_frame(frame) for frame in FRAMES]
    steps, started = make_proxy(frames, player.header.cameras, resolution), time.process_time()
    while True:
        try:
            next(steps)
        except StopIteration as end:
            print(f"{time.process_time() - started:.1f} s of the processor, voxels of {end.value.voxel:.3f} m")
            return end.value


def main() -> None:
    from frog_blender.lighting import proxy
    from frog_blender.scene_import.capture_objects import active_capture

    path, resolution = Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 96
    *truths, bare = true_shadows()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    frog_blender.register()
    bpy.ops.import_scene.frog(filepath=str(path))
    capture = active_capture(bpy.context)
    proxy.place(capture, bpy.context.scene, made_proxy(path, resolution), 1, proxy.SHADOWS)
    capture.hide_render = True
    add_stage()
    for number, (frame, truth) in enumerate(zip(FRAMES, truths, strict=True)):
        bpy.context.scene.frame_set(number + 1)
        lit = bare > 0.02 * bare.max()
        true, found = ((image < 0.5 * bare) & lit for image in (truth, brightness()))
        print(f"frame {frame}: intersection over union {(true & found).sum() / (true | found).sum():.3f}")
    frog_blender.unregister()


if __name__ == "__main__":
    main()
