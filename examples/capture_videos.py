"""What the scripts that render a capture share: images by Cycles, videos of them, the command line.

Needs bpy (Blender as a module), imageio-ffmpeg and OpenCV: ``pip install "frog-blender[blender,capture,train]"``.
OUT receives the N3DV layout: ``cam00.mp4`` .. ``cam11.mp4`` and ``poses_bounds.npy``. Images are kept in OUT/pictures
until the videos are made, so that an interrupted run continues where it stopped. Everything is a formula or a seed: the
same Blender renders the same images.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import bpy
import cv2
import imageio_ffmpeg
import numpy as np
from capture_rig import Rig
from scene_parts import Scene

FRAMES, RATE = 30, 15


def configure(rig: Rig, samples: int, threads: int = 0) -> None:
    """Cycles on the processor with the denoiser; the Standard view leaves colours as they were computed."""
    scene = bpy.context.scene
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    render.resolution_x, render.resolution_y, render.resolution_percentage = rig.width, rig.height, 100
    render.use_persistent_data, render.use_motion_blur = True, False
    render.image_settings.file_format, render.image_settings.color_mode = "PNG", "RGB"
    if threads:
        render.threads_mode, render.threads = "FIXED", threads
    cycles.device, cycles.samples, cycles.use_adaptive_sampling = "CPU", samples, False
    cycles.use_light_tree = False  # two lamps need none
    cycles.use_denoising, cycles.denoiser = True, "OPENIMAGEDENOISE"
    cycles.denoising_quality = "BALANCED"
    cycles.denoising_prefilter = "NONE"  # its guides, albedo and normal, hold no noise without blur
    cycles.max_bounces, cycles.diffuse_bounces, cycles.glossy_bounces = 2, 2, 1
    cycles.caustics_reflective = cycles.caustics_refractive = False
    cycles.sample_clamp_indirect = 4.0
    scene.view_settings.view_transform, scene.view_settings.look = "Standard", "None"


def render(folder: Path, scene: Scene, cameras: list[bpy.types.Object], frames: list[int]) -> None:
    """Render every missing image; the geometry moves once per frame, then all cameras look at it."""
    settings = bpy.context.scene
    for frame in frames:
        missing = [index for index in range(len(cameras)) if not image_path(folder, index, frame).exists()]
        if not missing:
            continue
        started = time.perf_counter()
        scene.pose(frame / FRAMES)
        for index in missing:
            settings.camera = cameras[index]
            settings.cycles.seed = index  # the same at every frame, so that static surfaces do not flicker
            unfinished = folder / "unfinished.png"
            settings.render.filepath = str(unfinished)
            bpy.ops.render.render(write_still=True)
            unfinished.rename(image_path(folder, index, frame))
        print(f"frame {frame}: {(time.perf_counter() - started) / len(missing):.2f} s an image", flush=True)


def repeat_with_noise(folder: Path, camera: int, noise: float) -> None:
    """Repeats a camera's first image with new Gaussian noise each time; ``noise`` of 255 is its standard deviation."""
    random = np.random.default_rng(camera)
    first = cv2.imread(str(image_path(folder, camera, 0))).astype(np.float32)
    for frame in range(FRAMES):
        noisy = first + random.normal(0, noise, first.shape)
        cv2.imwrite(str(image_path(folder, camera, frame)), noisy.round().clip(0, 255).astype(np.uint8))


def image_path(folder: Path, camera: int, frame: int) -> Path:
    return folder / f"cam{camera:02d}_{frame:03d}.png"


def encode(folder: Path, video: Path, camera: int, quality: int, length: int) -> None:
    """H.264 with full colour resolution (halved, the checkers lose 13 dB); readers assume BT.601 at this size."""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error", "-framerate", str(RATE)]
    command += ["-i", str(folder / f"cam{camera:02d}_%03d.png"), "-frames:v", str(length)]
    command += ["-vf", "scale=out_color_matrix=bt601:out_range=tv:flags=lanczos+accurate_rnd+full_chroma_int"]
    command += ["-c:v", "libx264", "-preset", "veryslow", "-crf", str(quality), "-tune", "psnr"]
    command += ["-pix_fmt", "yuv444p", "-threads", "1"]
    command += ["-colorspace", "smpte170m", "-color_range", "tv", "-movflags", "+faststart", "-map_metadata", "-1"]
    subprocess.run([*command, "-fflags", "+bitexact", "-flags:v", "+bitexact", str(video)], check=True)


def compare(folder: Path, video: Path, camera: int, length: int) -> float:
    """Mean PSNR in dB between the decoded video and the images; raises if the video has another length."""
    reader, ratios = cv2.VideoCapture(str(video)), []
    while (decoded := reader.read())[0]:
        image = cv2.imread(str(image_path(folder, camera, len(ratios))))
        if image is None:
            raise RuntimeError(f"{video} decodes to more than {length} frames")
        ratios.append(cv2.PSNR(decoded[1], image))
    if len(ratios) != length:
        raise RuntimeError(f"{video} decodes to {len(ratios)} frames, expected {length}")
    return float(np.mean(ratios))


def make(
    summary: str,
    rig: Rig,
    build: Callable[[], Scene],
    preview: list[int],
    *,
    samples: int = 16,
    quality: int = 13,
    still_noise: float | None = None,
    length: int = FRAMES,
) -> None:
    """The command line of a capture's script: `summary` is its help, `preview` the frames that --preview renders.

    With `still_noise` nothing moves: one image a camera is rendered, and repeated with new noise each time.
    A `length` of more than a loop's FRAMES continues at the same speed.
    """
    parser = argparse.ArgumentParser(description=summary)
    parser.add_argument("out", type=Path)
    parser.add_argument("--samples", type=int, default=samples, help="light paths per pixel")
    parser.add_argument(
        "--quality", type=int, default=quality, help="constant rate factor of the videos, lower is better"
    )
    parser.add_argument("--threads", type=int, default=0, help="processor threads; 0 takes all")
    parser.add_argument("--preview", action="store_true", help="only a few frames, no videos")
    parser.add_argument("--keep-pictures", action="store_true", help="keep the images in OUT/pictures")
    options = parser.parse_args()
    folder = options.out / "pictures"
    folder.mkdir(parents=True, exist_ok=True)
    scene = build()
    cameras = rig.add_cameras()
    configure(rig, options.samples, options.threads)
    bounds = np.empty((FRAMES // 5, len(cameras), 2))
    for step in range(len(bounds)):
        scene.pose(5 * step / FRAMES)
        bpy.context.view_layer.update()
        bounds[step] = [rig.measure_depths(index) for index in range(len(cameras))]
    near, far = bounds[..., 0].min(axis=0), bounds[..., 1].max(axis=0)
    rig.write_poses(options.out / "poses_bounds.npy", np.stack([0.9 * near, 1.05 * far], axis=1))
    everything = list(range(length)) if still_noise is None else [0]
    render(folder, scene, cameras, preview if options.preview else everything)
    if options.preview:
        return
    if still_noise is not None:
        for index in range(len(cameras)):
            repeat_with_noise(folder, index, still_noise)
    for index in range(len(cameras)):
        video = options.out / f"cam{index:02d}.mp4"
        encode(folder, video, index, options.quality, length)
        print(
            f"{video.name}: {video.stat().st_size / 1e3:.0f} kB, {compare(folder, video, index, length):.1f} dB",
            flush=True,
        )
    if not options.keep_pictures:
        shutil.rmtree(folder)
