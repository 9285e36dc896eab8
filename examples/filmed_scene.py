"""What films of a scene have in common: their size, the encoder, and the calibration beside them."""

from __future__ import annotations

import argparse
import json
import subprocess
from collections.abc import Iterable, Sequence
from pathlib import Path

import imageio_ffmpeg
import numpy as np

from frog_blender.engine.capture.camera import Camera

Size = tuple[int, int]


def size_of(text: str) -> Size:
    """Width and height, both even as the encoder wants them."""
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal()) or int(width) < 2 or int(height) < 2:
        raise argparse.ArgumentTypeError(f"{text!r}: expected WIDTHxHEIGHT")
    return int(width) // 2 * 2, int(height) // 2 * 2


def encode(images: Iterable[np.ndarray], camera: Camera, quality: int, options: Sequence[str], video: Path) -> None:
    """Writes images (H, W, 3) uint8 at 30 a second into an H.264 video.

    Args:
        quality: constant rate factor, lower is better.
        options: of ffmpeg, more of them.
    """
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"]
    command += ["-s", f"{camera.width}x{camera.height}", "-r", "30", "-i", "-", "-c:v", "libx264"]
    command += ["-preset", "veryfast", "-crf", str(quality), *options, str(video)]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as encoder:
        assert encoder.stdin is not None
        for image in images:
            encoder.stdin.write(image.data)
    if encoder.returncode:
        raise SystemExit(f"{video}: the encoder failed")


def write_calibration(cameras: Iterable[Camera], folder: Path) -> None:
    """``cameras_opencv.json`` of cameras without distortion."""
    entries = []
    for camera in cameras:
        place = {"R": camera.rotation.tolist(), "t": camera.world_to_camera[:3, 3].tolist()}
        lens = {"K": camera.intrinsics.tolist(), "dist": [0.0, 0.0, 0.0, 0.0]}
        entries.append({"name": camera.name, "width": camera.width, "height": camera.height, **lens, **place})
    (folder / "cameras_opencv.json").write_text(json.dumps({"cameras": entries}), encoding="utf-8")
