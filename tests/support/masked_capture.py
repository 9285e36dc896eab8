"""Masks of the ball in the small recorded scene, in several layouts."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from support import synthetic_capture as film

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.gaussians import GaussianArrays
from frog_blender.engine.playback.render import draw

_BALL = 12  # Gaussians, the last


def ball_at(frame: int) -> GaussianArrays:
    """The ball alone."""
    return GaussianArrays(*(array[-_BALL:] for array in vars(film.gaussians_at(frame)).values()))


def ball_alpha(camera: Camera, frame: int) -> np.ndarray:
    """(H, W) uint8 the ball's share of each pixel; nothing lies before it."""
    return (draw(ball_at(frame), camera).alpha * 255 + 0.5).astype(np.uint8)


def write_masks(folder: Path, layout: str) -> None:
    """Masks of all cameras: "numbered", "numbered from one" or "film"."""
    for camera in film.rig():
        masks = [ball_alpha(camera, frame) for frame in range(film.FRAMES)]
        if layout == "film":
            folder.mkdir(exist_ok=True)
            codec = cv2.VideoWriter_fourcc(*"mp4v")
            path = str(folder / f"{camera.name}.mp4")
            writer = cv2.VideoWriter(path, codec, 24.0, (film.WIDTH, film.HEIGHT))
            for mask in masks:
                writer.write(np.dstack([mask] * 3))
            writer.release()
            continue
        (folder / camera.name).mkdir(parents=True, exist_ok=True)
        for number, mask in enumerate(masks, start=int(layout == "numbered from one")):
            cv2.imwrite(str(folder / camera.name / f"{number:04d}.png"), mask)
