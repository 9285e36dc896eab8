"""Blender's camera, with all its animation, as a file for ``frog render --cameras``:

    blender -b X.blend --python examples/camera_path.py -- OUT.json [--capture OBJECT]
    python examples/camera_path.py X.blend OUT.json [--capture OBJECT]                       (with the bpy module)
    frog render SCENE.frog --cameras OUT.json -o out/####.exr

For each frame of the scene's range: where its camera (by markers, too) stands before the capture, its lens at the
render's size, and which of the capture's frames the timeline shows. The image of ``frog render`` is that of F12.
"""

from __future__ import annotations

import argparse
import json
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from headless import switch_off, switched_on

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def camera_path(addon: str, scene: bpy.types.Scene, name: str | None) -> list[dict[str, Any]]:
    """The images of a ``transforms.json``, one for each frame of the scene's range.

    Args:
        addon: its module's name.
        name: of the capture's object, if there are several.

    Raises:
        FrogError: for a capture that is not there or stretched, or a camera that ``frog render`` has no images for.
    """
    playback = import_module(f"{addon}.timeline.playback")
    engine_camera = import_module(f"{addon}.cameras").engine_camera
    FrogError = import_module(f"{addon}.engine").FrogError
    captures = [obj for obj in playback.captures(scene.objects) if name in (None, obj.name)]
    if len(captures) != 1:
        known = ", ".join(obj.name for obj in playback.captures(scene.objects)) or "none"
        raise FrogError(f"Found {len(captures)} captures {name or ''} in the scene, expected one of: {known}.")
    capture = captures[0]
    header = playback.open_scene(playback.file_of(capture)).header
    percentage = scene.render.resolution_percentage
    width, height = (side * percentage // 100 for side in (scene.render.resolution_x, scene.render.resolution_y))
    images = []
    for number in range(scene.frame_start, scene.frame_end + 1):
        scene.frame_set(number)
        graph = bpy.context.evaluated_depsgraph_get()
        if scene.camera is None:
            raise FrogError("The scene has no camera.")
        eye = scene.camera.evaluated_get(graph)
        camera = engine_camera(eye, eye.matrix_world, scene.render, width, height)
        stands = np.array(capture.evaluated_get(graph).matrix_world)
        unit = np.linalg.norm(stands[:3, :3], axis=0)
        if np.ptp(unit) > 1e-4 * unit.max():
            raise FrogError(f"{capture.name} is stretched by {unit.round(4).tolist()}, expected one scale.")
        pose = np.linalg.inv(camera.world_to_camera @ stands)
        pose[:3, :3] *= unit.mean()  # a camera has no scale
        pose[:3, 3] = np.array(header.world.origin) + header.world.unit * pose[:3, 3]
        shown = playback.shown_frame(capture, number, capture.evaluated_get(graph))
        k = camera.intrinsics
        images.append(
            {
                "file_path": f"{number:04d}.png",
                "number": number,
                "frame": float(np.clip(shown, 0, header.frame_count - 1)),
                "w": width,
                "h": height,
                "fl_x": k[0, 0],
                "fl_y": k[1, 1],
                "cx": k[0, 2],
                "cy": k[1, 2],
                "transform_matrix": (pose @ OPENGL).tolist(),
            }
        )
    return images


def main() -> int:
    in_blender = "--" in sys.argv
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    if not in_blender:
        parser.add_argument("blend", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--capture", help="its object's name, where there are several")
    options = parser.parse_args(sys.argv[sys.argv.index("--") + 1 :] if in_blender else None)
    addon, is_ours = switched_on()
    try:
        if not in_blender:
            bpy.ops.wm.open_mainfile(filepath=str(options.blend.resolve()))
        images = camera_path(addon.__name__, bpy.context.scene, options.capture)
        options.out.write_text(json.dumps({"frames": images}, indent=1), encoding="utf-8")
    except (import_module(f"{addon.__name__}.engine").FrogError, RuntimeError, OSError) as error:
        print(str(error).strip().splitlines()[0], file=sys.stderr, flush=True)
        return 1
    finally:
        if is_ours:
            switch_off(addon)
    print(f"{options.out}: {len(images)} cameras", flush=True)
    return 0


if __name__ == "__main__":
    if main():
        sys.exit(1)  # and not otherwise: a Blender with a window stays open
