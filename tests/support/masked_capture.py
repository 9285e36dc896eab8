"""Masks of the ball in the small recorded scene, in several layouts."""

from pathlib import Path

import cv2
import numpy as np
from support import synthetic_capture as film
from support.small_captures import write_film

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.gaussians import GaussianArrays
from frog_blender.engine.playback.render import draw

_BALL = 12  # Gaussians, the last


def ball_at(frame: int) -> GaussianArrays:
    """The ball alone."""
    return film.gaussians_at(frame).part(slice(-_BALL, None))


def ball_alpha(camera: Camera, frame: int) -> np.ndarray:
    """(H, W) uint8 the ball's share of each pixel; nothing lies before it."""
    return (draw(ball_at(frame), camera).alpha * 255 + 0.5).astype(np.uint8)


def write_masks(folder: Path, layout: str) -> None:
    """Masks of all cameras: "numbered", "numbered from one" or "film"."""
    for camera in film.rig():
        masks = [ball_alpha(camera, frame) for frame in range(film.FRAMES)]
        if layout == "film":
            write_film(folder / f"{camera.name}.mp4", [np.dstack([mask] * 3) for mask in masks], 24.0)
            continue
        (folder / camera.name).mkdir(parents=True, exist_ok=True)
        for index, mask in enumerate(masks, start=int(layout == "numbered from one")):
            cv2.imwrite(str(folder / camera.name / f"{index:04d}.png"), mask)
