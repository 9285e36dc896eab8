"""Renders the demo capture `room`: 12 synchronised films of an inflatable frog, a banner and a ball in a room.

    python examples/make_room.py OUT [--samples 16] [--preview] [--keep-pictures]

Needs bpy (Blender as a module), imageio-ffmpeg and OpenCV: ``pip install "frog-blender[blender,capture,train]"``.
OUT receives the N3DV layout: ``cam00.mp4`` .. ``cam11.mp4`` and ``poses_bounds.npy``. Pictures are kept in OUT/pictures
until the films are made, so an interrupted run goes on where it stopped. Everything is a formula or a seed: the same
Blender makes the same pictures. The scene is in room_scene.py, what moves in room_motion.py, the textures in
room_textures.py.
"""

from __future__ import annotations

import argparse
import math
import shutil
import subprocess
import time
from pathlib import Path

import bpy
import cv2
import imageio_ffmpeg
import numpy as np
from mathutils import Matrix, Vector
from room_scene import Room

WIDTH, HEIGHT, FRAMES, RATE = 320, 240, 30, 15
FOCAL = 300.0  # pixels; square, the principal point in the middle of the picture
TARGET = np.array([0.12, 0.1, 1.10])  # every camera looks at this point
DISTANCE = 4.4
# Azimuth and elevation in degrees, seen from the target. cam00, the test view, lies in the middle of the others.
DIRECTIONS = [
    (0.0, 5.0),
    *[(azimuth, 5.0) for azimuth in (-22.0, -11.0, 11.0, 22.0)],
    *[(azimuth, 13.0) for azimuth in (-17.0, -6.0, 6.0, 17.0)],
    *[(azimuth, -3.0) for azimuth in (-12.0, 0.0, 12.0)],
]


def camera_axes(azimuth: float, elevation: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """World centre and the unit axes right, up, backwards of the camera in a direction (degrees) from the target."""
    a, e = math.radians(azimuth), math.radians(elevation)
    backwards = np.array([math.sin(a) * math.cos(e), -math.cos(a) * math.cos(e), math.sin(e)])
    right = np.cross(np.array([0.0, 0.0, 1.0]), backwards)
    right /= np.linalg.norm(right)
    return TARGET + DISTANCE * backwards, right, np.cross(backwards, right), backwards


def add_cameras() -> list[bpy.types.Object]:
    """The 12 cameras in bpy, in the order of their films."""
    cameras = []
    for index, direction in enumerate(DIRECTIONS):
        center, right, up, backwards = camera_axes(*direction)
        lens = bpy.data.cameras.new(f"cam{index:02d}")
        lens.sensor_fit, lens.sensor_width, lens.lens = "HORIZONTAL", 36.0, FOCAL * 36.0 / WIDTH
        lens.clip_start, lens.clip_end = 0.05, 50.0
        camera = bpy.data.objects.new(lens.name, lens)
        matrix = np.eye(4)
        matrix[:3] = np.stack([right, up, backwards, center], axis=1)
        camera.matrix_world = Matrix(matrix.tolist())
        bpy.context.scene.collection.objects.link(camera)
        cameras.append(camera)
    return cameras


def measure_depths(index: int, step: int = 8) -> tuple[float, float]:
    """Least and greatest planar depth in metres that camera `index` sees now, over a grid of pixels."""
    center, right, up, backwards = camera_axes(*DIRECTIONS[index])
    graph = bpy.context.evaluated_depsgraph_get()
    depths = []
    for y in range(0, HEIGHT + 1, step):
        for x in range(0, WIDTH + 1, step):
            ray = right * (x - WIDTH / 2) / FOCAL - up * (y - HEIGHT / 2) / FOCAL - backwards
            ray /= np.linalg.norm(ray)
            hit, place, *_ = bpy.context.scene.ray_cast(graph, Vector(center), Vector(ray))
            if hit:
                depths.append(float((center - np.array(place)) @ backwards))
    return min(depths), max(depths)


def write_poses(path: Path, bounds: np.ndarray) -> None:
    """The LLFF camera file, (12, 17) float64: axes (down, right, backwards), centre, size and focal, near and far."""
    rows = []
    for direction, (near, far) in zip(DIRECTIONS, bounds, strict=True):
        center, right, up, backwards = camera_axes(*direction)
        matrix = np.stack([-up, right, backwards, center, np.array([HEIGHT, WIDTH, FOCAL])], axis=1)
        rows.append(np.concatenate([matrix.ravel(), [near, far]]))
    np.save(path, np.array(rows, dtype=np.float64))


def configure(samples: int) -> None:
    """Cycles on the processor with the denoiser; the Standard view leaves colours as they were computed."""
    scene = bpy.context.scene
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    render.resolution_x, render.resolution_y, render.resolution_percentage = WIDTH, HEIGHT, 100
    render.use_persistent_data, render.use_motion_blur = True, False
    render.image_settings.file_format, render.image_settings.color_mode = "PNG", "RGB"
    cycles.device, cycles.samples, cycles.use_adaptive_sampling = "CPU", samples, False
    cycles.use_light_tree = False  # two lamps need none
    cycles.use_denoising, cycles.denoiser = True, "OPENIMAGEDENOISE"
    cycles.denoising_quality = "BALANCED"
    cycles.denoising_prefilter = "NONE"  # its guides, albedo and normal, hold no noise without blur
    cycles.max_bounces, cycles.diffuse_bounces, cycles.glossy_bounces = 2, 2, 1
    cycles.caustics_reflective = cycles.caustics_refractive = False
    cycles.sample_clamp_indirect = 4.0
    scene.view_settings.view_transform, scene.view_settings.look = "Standard", "None"


def render(folder: Path, room: Room, cameras: list[bpy.types.Object], frames: list[int]) -> None:
    """Render every missing picture; the geometry moves once per moment, then all cameras look at it."""
    scene = bpy.context.scene
    for frame in frames:
        missing = [index for index in range(len(cameras)) if not picture_path(folder, index, frame).exists()]
        if not missing:
            continue
        started = time.perf_counter()
        room.pose(frame / FRAMES)
        for index in missing:
            scene.camera = cameras[index]
            scene.cycles.seed = index  # the same at every moment: what stands still does not flicker
            unfinished = folder / "unfinished.png"
            scene.render.filepath = str(unfinished)
            bpy.ops.render.render(write_still=True)
            unfinished.rename(picture_path(folder, index, frame))
        print(f"moment {frame}: {(time.perf_counter() - started) / len(missing):.2f} s a picture", flush=True)


def picture_path(folder: Path, camera: int, frame: int) -> Path:
    return folder / f"cam{camera:02d}_{frame:03d}.png"


def encode(folder: Path, film: Path, camera: int, quality: int) -> None:
    """H.264 with full colour resolution (halved, the checkers lose 13 dB); readers assume BT.601 at this size."""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error", "-framerate", str(RATE)]
    command += ["-i", str(folder / f"cam{camera:02d}_%03d.png"), "-frames:v", str(FRAMES)]
    command += ["-vf", "scale=out_color_matrix=bt601:out_range=tv:flags=lanczos+accurate_rnd+full_chroma_int"]
    command += ["-c:v", "libx264", "-preset", "veryslow", "-crf", str(quality), "-tune", "psnr"]
    command += ["-pix_fmt", "yuv444p", "-threads", "1"]
    command += ["-colorspace", "smpte170m", "-color_range", "tv", "-movflags", "+faststart", "-map_metadata", "-1"]
    subprocess.run([*command, "-fflags", "+bitexact", "-flags:v", "+bitexact", str(film)], check=True)


def compare(folder: Path, film: Path, camera: int) -> float:
    """Mean PSNR in dB between the decoded film and the pictures; raises if the film has another length."""
    reader, ratios = cv2.VideoCapture(str(film)), []
    while (decoded := reader.read())[0]:
        picture = cv2.imread(str(picture_path(folder, camera, len(ratios))))
        if picture is None:
            raise RuntimeError(f"{film} decodes to more than {FRAMES} frames")
        ratios.append(cv2.PSNR(decoded[1], picture))
    if len(ratios) != FRAMES:
        raise RuntimeError(f"{film} decodes to {len(ratios)} frames, expected {FRAMES}")
    return float(np.mean(ratios))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--samples", type=int, default=16, help="light paths per pixel")
    parser.add_argument("--quality", type=int, default=13, help="the films' constant rate factor, lower is better")
    parser.add_argument("--preview", action="store_true", help="only two moments, no films")
    parser.add_argument("--keep-pictures", action="store_true", help="leave OUT/pictures where it is")
    options = parser.parse_args()
    folder = options.out / "pictures"
    folder.mkdir(parents=True, exist_ok=True)
    room = Room()
    cameras = add_cameras()
    configure(options.samples)
    bounds = np.empty((FRAMES // 5, len(cameras), 2))
    for step in range(len(bounds)):
        room.pose(5 * step / FRAMES)
        bpy.context.view_layer.update()
        bounds[step] = [measure_depths(index) for index in range(len(cameras))]
    near, far = bounds[..., 0].min(axis=0), bounds[..., 1].max(axis=0)
    write_poses(options.out / "poses_bounds.npy", np.stack([0.9 * near, 1.05 * far], axis=1))
    render(folder, room, cameras, [3, 18] if options.preview else list(range(FRAMES)))
    if options.preview:
        return
    for index in range(len(cameras)):
        film = options.out / f"cam{index:02d}.mp4"
        encode(folder, film, index, options.quality)
        print(f"{film.name}: {film.stat().st_size / 1e3:.0f} kB, {compare(folder, film, index):.1f} dB", flush=True)
    if not options.keep_pictures:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
