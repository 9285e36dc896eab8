"""Films that cameras and phones write and OpenCV does not: cut without encoding, turned, of varying rate, of HDR."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

import imageio_ffmpeg
import numpy as np

FFMPEG = imageio_ffmpeg.get_ffmpeg_exe()


def ffmpeg(*arguments: object) -> bytes:
    """What ffmpeg writes to its standard output; raises where it fails."""
    return subprocess.run(
        [FFMPEG, "-y", "-v", "error", *map(str, arguments)], capture_output=True, check=True, timeout=120
    ).stdout


def encode(path: Path, images: Sequence[np.ndarray], *options: object, rate: float = 30) -> Path:
    """A film of images (H, W, 3) uint8 RGB of even sides, in H.264."""
    height, width = images[0].shape[:2]
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", rate, "-i", "-"]
    command = [FFMPEG, "-y", "-v", "error", *raw, "-c:v", "libx264", "-crf", "8", "-pix_fmt", "yuv420p", *options, path]
    content = b"".join(np.ascontiguousarray(image).tobytes() for image in images)
    subprocess.run([str(part) for part in command], input=content, check=True, capture_output=True, timeout=120)
    return path


def numbered(count: int, width: int = 64, height: int = 48) -> list[np.ndarray]:
    """Grey images that tell their number by white and black fields at the bottom, with a white bar above."""
    images = []
    for number in range(count):
        image = np.full((height, width, 3), 90, np.uint8)
        image[: height // 4, : width // 2] = 250
        bits = [250 if number >> bit & 1 else 10 for bit in range(8)]
        image[height // 2 :] = np.repeat(bits, width // 8)[None, :, None]
        images.append(image)
    return images


def number_of(image: np.ndarray) -> int:
    """Which of ``numbered`` an image shows."""
    height, width = image.shape[:2]
    row = image[height * 3 // 4, width // 16 :: width // 8].mean(axis=1)
    return sum(1 << bit for bit, value in enumerate(row[:8]) if value > 128)


def high_dynamic_range(path: Path, images: Sequence[np.ndarray], transfer: str) -> Path:
    """A film of 10 bits whose signal the images are, tagged as of BT.2020 and a transfer by ffmpeg's name."""
    tags = f"color_trc={transfer}:color_primaries=bt2020:colorspace=bt2020nc"
    filters = f"scale=out_color_matrix=bt2020:out_range=tv,format=yuv420p10le,setparams={tags}"
    return encode(path, images, "-vf", filters, "-pix_fmt", "yuv420p10le", "-movflags", "write_colr")


def copied(source: Path, path: Path, *options: object) -> Path:
    """The film with options before its input, not encoded again."""
    ffmpeg(*options, "-i", source, "-c", "copy", path)
    return path


def kept(source: Path, path: Path, frames: Sequence[int], *options: object) -> Path:
    """Some frames of a film, each at its own time."""
    chosen = "+".join(f"eq(n\\,{frame})" for frame in frames)
    selecting = ["-vf", f"select='{chosen}'", "-fps_mode", "passthrough", "-c:v", "libx264", "-crf", "8"]
    ffmpeg("-i", source, *selecting, "-pix_fmt", "yuv420p", *options, path)
    return path


def shown(path: Path, width: int, height: int) -> np.ndarray:
    """(N, height, width, 3) uint8 RGB of the frames that ffmpeg shows."""
    raw = ffmpeg("-i", path, "-fps_mode", "passthrough", "-f", "rawvideo", "-pix_fmt", "rgb24", "-")
    return np.frombuffer(raw, np.uint8).reshape(-1, height, width, 3)
