"""Films a trained scene with many cameras at any size: a capture as large as a stage's, for tests of what large costs.

    python examples/make_stage.py SCENE.frog OUT [--cameras 20] [--frames 30] [--size 676x507] [--quality 24]

Needs imageio-ffmpeg; frames are drawn by the engine and piped into the encoder, so nothing but the videos needs disk.
The cameras stand on the scene's own arc, evenly; a film longer than the scene plays it to and fro. OUT receives
``cam00.mp4`` ... and ``cameras_opencv.json``. The largest size that was measured is `--frames 300 --size 1352x1014`.
"""

from __future__ import annotations

import argparse
import json
import subprocess
from collections.abc import Iterable
from pathlib import Path

import imageio_ffmpeg
import numpy as np

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import render_image

Size = tuple[int, int]


def size_of(text: str) -> Size:
    """Width and height, both even as the encoder wants them."""
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal()) or int(width) < 2 or int(height) < 2:
        raise argparse.ArgumentTypeError(f"{text!r}: expected WIDTHxHEIGHT")
    return int(width) // 2 * 2, int(height) // 2 * 2


def arc_of(cameras: list[Camera], count: int, size: Size) -> list[Camera]:
    """Cameras evenly along the polyline through the given ones in the order of their angles, each looking at the point
    that the given ones look at."""
    centers = np.array([camera.center for camera in cameras])
    forwards = np.array([camera.forward for camera in cameras])
    across = np.eye(3) - forwards[:, :, None] * forwards[:, None, :]
    focus = np.linalg.lstsq(across.sum(0), np.einsum("nij,nj->i", across, centers), rcond=None)[0]
    right, down = cameras[0].rotation[0], np.mean([camera.rotation[1] for camera in cameras], axis=0)
    middle = centers.mean(axis=0) - focus
    sides = (centers - focus) @ np.stack([right, middle / np.linalg.norm(middle)]).T
    ordered = centers[np.argsort(np.arctan2(sides[:, 0], sides[:, 1]))]
    lengths = np.concatenate([[0.0], np.linalg.norm(np.diff(ordered, axis=0), axis=1).cumsum()])
    places = np.linspace(0, lengths[-1], count)
    lens = cameras[0].resized(*size)
    made = []
    for number, place in enumerate(places):
        center = np.array([np.interp(place, lengths, ordered[:, axis]) for axis in range(3)])
        forward = (focus - center) / np.linalg.norm(focus - center)
        x = np.cross(down, forward)
        x /= np.linalg.norm(x)
        rotation = np.stack([x, np.cross(forward, x), forward])
        pose = np.hstack([rotation, (-rotation @ center)[:, None]])
        made.append(Camera(f"cam{number:02d}", *size, lens.intrinsics, np.eye(4)).with_pose(pose))
    return made


def encode(images: Iterable[np.ndarray], camera: Camera, quality: int, video: Path) -> None:
    """Writes images (H, W, 3) uint8 at 30 a second into an H.264 video of halved colour resolution, as phones and
    webcams make them; ``quality`` is its constant rate factor."""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"]
    command += ["-s", f"{camera.width}x{camera.height}", "-r", "30", "-i", "-", "-c:v", "libx264"]
    command += ["-preset", "veryfast", "-crf", str(quality), "-pix_fmt", "yuv420p", str(video)]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as encoder:
        assert encoder.stdin is not None
        for image in images:
            encoder.stdin.write(image.data)
    if encoder.returncode:
        raise SystemExit(f"{video}: the encoder failed")


def film(scene: ScenePlayer, camera: Camera, frames: int, quality: int, video: Path) -> None:
    """Draws a camera's frames into a video."""
    length = scene.header.frame_count
    drawn = [render_image(scene.at_frame(frame), camera, scene.header.background) for frame in range(length)]
    shown = (frame % max(2 * length - 2, 1) for frame in range(frames))
    images = (drawn[min(place, 2 * length - 2 - place)] for place in shown)
    encode(images, camera, quality, video)


def write_calibration(cameras: Iterable[Camera], folder: Path) -> None:
    """``cameras_opencv.json`` of cameras without distortion."""
    entries = []
    for camera in cameras:
        place = {"R": camera.rotation.tolist(), "t": camera.world_to_camera[:3, 3].tolist()}
        lens = {"K": camera.intrinsics.tolist(), "dist": [0.0, 0.0, 0.0, 0.0]}
        entries.append({"name": camera.name, "width": camera.width, "height": camera.height, **lens, **place})
    (folder / "cameras_opencv.json").write_text(json.dumps({"cameras": entries}), encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("scene", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--cameras", type=int, default=20)
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--size", type=size_of, default=(676, 506))
    parser.add_argument("--quality", type=int, default=24, help="constant rate factor of the videos, lower is better")
    options = parser.parse_args()
    scene = ScenePlayer.load(options.scene)
    if len(scene.header.cameras) < 2 or scene.header.is_moving:
        raise SystemExit(f"{options.scene}: expected a scene of several standing cameras.")
    options.out.mkdir(parents=True, exist_ok=True)
    cameras = arc_of(list(scene.header.cameras), options.cameras, options.size)
    for camera in cameras:
        video = options.out / f"{camera.name}.mp4"
        film(scene, camera, options.frames, options.quality, video)
        print(f"{video.name}: {video.stat().st_size / 1e6:.2f} MB", flush=True)
    write_calibration(cameras, options.out)


if __name__ == "__main__":
    main()
