"""What the scripts that render a capture share: images by Cycles, videos of them, the command line.

Needs bpy (Blender as a module), imageio-ffmpeg and OpenCV: ``pip install "frog-blender[blender,capture,train]"``.
OUT receives the N3DV layout: ``cam00.mp4`` .. ``cam11.mp4`` and ``poses_bounds.npy``. Images are kept in OUT/pictures
until the videos are made, so that an interrupted run continues where it stopped. ``--fly`` makes other images, for
``frog eval --cameras OUT/transforms.json``: from nearer, zoomed, from beside and above the rig. Everything is a formula
or a seed: the same Blender renders the same images.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import bpy
import cv2
import imageio_ffmpeg
import numpy as np
from capture_rig import Rig, Surfaces, View
from scene_parts import Scene

FRAMES, RATE = 30, 15
FLY_SHARES = (0.27, 0.43, 0.73)  # of the length: when images from off the rig are rendered
_NEARLY = 0.999  # of the way to a point: what is hit there is the point's own surface


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
        missing = [index for index, camera in enumerate(cameras) if not image_path(folder, camera.name, frame).exists()]
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
            unfinished.rename(image_path(folder, cameras[index].name, frame))
        print(f"frame {frame}: {(time.perf_counter() - started) / len(missing):.2f} s an image", flush=True)


def repeat_with_noise(folder: Path, camera: str, seed: int, noise: float) -> None:
    """Repeats a camera's first image with new Gaussian noise each time; ``noise`` of 255 is its standard deviation."""
    random = np.random.default_rng(seed)
    first = cv2.imread(str(image_path(folder, camera, 0))).astype(np.float32)
    for frame in range(FRAMES):
        noisy = first + random.normal(0, noise, first.shape)
        cv2.imwrite(str(image_path(folder, camera, frame)), noisy.round().clip(0, 255).astype(np.uint8))


def image_path(folder: Path, camera: str, frame: int) -> Path:
    return folder / f"{camera}_{frame:03d}.png"


def encode(folder: Path, video: Path, quality: int, length: int) -> None:
    """H.264 with full colour resolution (halved, the checkers lose 13 dB); readers assume BT.601 at this size."""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error", "-framerate", str(RATE)]
    command += ["-i", str(folder / f"{video.stem}_%03d.png"), "-frames:v", str(length)]
    command += ["-vf", "scale=out_color_matrix=bt601:out_range=tv:flags=lanczos+accurate_rnd+full_chroma_int"]
    command += ["-c:v", "libx264", "-preset", "veryslow", "-crf", str(quality), "-tune", "psnr"]
    command += ["-pix_fmt", "yuv444p", "-threads", "1"]
    command += ["-colorspace", "smpte170m", "-color_range", "tv", "-movflags", "+faststart", "-map_metadata", "-1"]
    subprocess.run([*command, "-fflags", "+bitexact", "-flags:v", "+bitexact", str(video)], check=True)


def compare(folder: Path, video: Path, length: int) -> float:
    """Mean PSNR in dB between the decoded video and the images; raises if the video has another length."""
    reader, ratios = cv2.VideoCapture(str(video)), []
    while (decoded := reader.read())[0]:
        image = cv2.imread(str(image_path(folder, video.stem, len(ratios))))
        if image is None:
            raise RuntimeError(f"{video} decodes to more than {length} frames")
        ratios.append(cv2.PSNR(decoded[1], image))
    if len(ratios) != length:
        raise RuntimeError(f"{video} decodes to {len(ratios)} frames, expected {length}")
    return float(np.mean(ratios))


def fly_views(rig: Rig) -> list[tuple[str, View]]:
    """The cameras off the rig, and the group of each. Beside and above they stand nearer, within the walls."""
    return [
        (name.split("_")[0], rig.view_from(name, direction, nearer, zoom))
        for name, direction, nearer, zoom in (
            ("near2_middle", (0.0, 5.0), 2.0, 1.0),
            ("near2_left", (-17.0, 13.0), 2.0, 1.0),
            ("near3", (0.0, 5.0), 3.0, 1.0),
            ("zoom", rig.directions[3], 1.0, 3.0),  # of cam03, which is trained on
            ("beside_left", (-44.0, 5.0), 1.5, 1.0),  # as far from the rig's edge as that is from its middle
            ("beside_right", (44.0, 5.0), 1.5, 1.0),
            ("above", (0.0, 30.0), 1.5, 1.0),
        )
    ]


def describe_fly(folder: Path, rig: Rig, scene: Scene, frames: list[int]) -> None:
    """Writes ``transforms.json`` of the images from off the rig, and beside each what the scene's geometry says of it.

    ``*_depth.npy`` (H, W) float32 is the planar depth in metres, 0 where there is nothing. ``*_mask.png`` is white
    where two or more training cameras see the surface. ``*_source.png`` is there the number, from 1, of the nearest of
    them in ``training_cameras``, and else 0.
    """
    training, entries = rig.views[1:], []  # all but the test view
    for frame in frames:
        scene.pose(frame / FRAMES)
        bpy.context.view_layer.update()
        surfaces = Surfaces()
        for group, view in fly_views(rig):
            x, y = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
            rays = view.rays(x.ravel(), y.ravel())
            depths = surfaces.distances(view.center, rays)
            depths[~np.isfinite(depths)] = 0
            seen, source = seen_by(surfaces, training, view, view.center + depths[:, None] * rays)
            source[(seen < 2) | (depths == 0)] = 0
            image = image_path(folder, view.name, frame)
            mask, depth, numbers = (image.stem + end for end in ("_mask.png", "_depth.npy", "_source.png"))
            np.save(folder / depth, depths.reshape(x.shape).astype(np.float32))
            cv2.imwrite(str(folder / mask), np.where(source.reshape(x.shape), 255, 0).astype(np.uint8))
            cv2.imwrite(str(folder / numbers), source.reshape(x.shape).astype(np.uint8))
            print(f"{image.name}: {(source > 0).mean():.0%} seen by two training cameras", flush=True)
            entry = {"file_path": image.name, "mask_path": mask, "depth_file_path": depth, "source_path": numbers}
            entry |= {"frame": frame, "time": frame / RATE, "group": group}
            entries.append({**entry, "fl_x": view.focal, "transform_matrix": view.matrix.tolist()})
    top = {"camera_model": "PINHOLE", "w": rig.width, "h": rig.height, "fps": RATE}
    top |= {"training_cameras": [view.name for view in training], "frames": entries}
    (folder / "transforms.json").write_text(json.dumps(top, indent=1), encoding="utf-8")


def seen_by(surfaces: Surfaces, training: list[View], view: View, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How many of the training cameras (N,) see points (N, 3), 2 for all from 2 on; and the number, from 1, of the one
    of them that stands nearest to `view`, 0 for none."""
    seen, source = np.zeros(len(points), int), np.zeros(len(points), int)
    nearest = sorted(range(len(training)), key=lambda index: np.linalg.norm(training[index].center - view.center))
    for index in nearest:
        center = training[index].center
        asked = np.flatnonzero((seen < 2) & training[index].shows(points))
        met = asked[surfaces.distances(center, points[asked] - center) > _NEARLY]
        source[met] = np.where(seen[met] == 0, index + 1, source[met])
        seen[met] += 1
    return seen, source


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
    parser.add_argument(
        "--fly", action="store_true", help="instead, images from off the rig, and what they show of the scene"
    )
    options = parser.parse_args()
    folder = options.out if options.fly else options.out / "pictures"
    folder.mkdir(parents=True, exist_ok=True)
    scene = build()
    configure(rig, options.samples, options.threads)
    if options.fly:
        frames = [round(share * length) for share in FLY_SHARES]
        render(folder, scene, [view.add_camera() for _, view in fly_views(rig)], frames)
        describe_fly(folder, rig, scene, frames)
        return
    cameras = [view.add_camera() for view in rig.views]
    bounds = np.empty((FRAMES // 5, len(cameras), 2))
    for step in range(len(bounds)):
        scene.pose(5 * step / FRAMES)
        bpy.context.view_layer.update()
        bounds[step] = rig.measure_depths()
    near, far = bounds[..., 0].min(axis=0), bounds[..., 1].max(axis=0)
    rig.write_poses(options.out / "poses_bounds.npy", np.stack([0.9 * near, 1.05 * far], axis=1))
    everything = list(range(length)) if still_noise is None else [0]
    render(folder, scene, cameras, preview if options.preview else everything)
    if options.preview:
        return
    if still_noise is not None:
        for index, camera in enumerate(cameras):
            repeat_with_noise(folder, camera.name, index, still_noise)
    for camera in cameras:
        video = options.out / f"{camera.name}.mp4"
        encode(folder, video, options.quality, length)
        print(f"{video.name}: {video.stat().st_size / 1e3:.0f} kB, {compare(folder, video, length):.1f} dB", flush=True)
    if not options.keep_pictures:
        shutil.rmtree(folder)
