"""An object that moves and is photographed once at each moment, each time from another side: as D-NeRF's scenes are."""

import json
from pathlib import Path

import cv2
import numpy as np
from support.builders import blobs, looking_at
from support.layouts.lists import posed_as

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.gaussians import GaussianArrays
from frog_blender.engine.playback.render import draw

IMAGES, VALIDATION, SIZE = 60, 8, 64
_FOCAL, _DISTANCE = 80.0, 4.0


def object_at(time: float) -> GaussianArrays:
    """A speckled body that stands still, and an arm on a hinge that turns by a right angle in the course of time."""
    random = np.random.default_rng(5)
    directions = random.normal(size=(400, 3))
    body = 0.55 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    along = random.uniform(0.5, 1.2, 150)
    arm = np.stack([along, np.zeros(150), np.zeros(150)], axis=1) + random.normal(0, 0.05, (150, 3))
    angle = np.pi / 2 * (time - 0.5)
    turn = np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]])
    colors = np.concatenate(
        [random.uniform(0.1, 0.9, (400, 3)), random.uniform([0.7, 0.3, 0], [1, 0.7, 0.3], (150, 3))]
    )
    scales = np.concatenate([np.full((400, 3), 0.07), np.full((150, 3), 0.06)])
    return blobs(np.concatenate([body, arm @ turn.T]), scales, colors=colors, opacities=0.95)


def camera_at(direction: np.ndarray) -> Camera:
    """Looks at the origin from ``direction`` (3,), y up."""
    eye = _DISTANCE * direction / np.linalg.norm(direction)
    intrinsics = np.array([[_FOCAL, 0, SIZE / 2], [0, _FOCAL, SIZE / 2], [0, 0, 1]])
    return looking_at("camera", eye, (SIZE, SIZE), intrinsics, up=(0.0, 1.0, 0.0))


def write_capture(folder: Path) -> Path:
    """D-NeRF's layout: RGBA images, lists for training and for validation, whose images are all of one camera; returns
    the folder."""
    random = np.random.default_rng(3)
    directions = random.normal(size=(IMAGES, 3)) * (1, 0.5, 1)
    _write(folder, "train", directions, np.linspace(0, 1, IMAGES))
    middles = (np.arange(VALIDATION) + 0.5) / VALIDATION
    _write(folder, "val", np.tile([0.5, 0.4, 1.0], (VALIDATION, 1)), middles)
    return folder


def _write(folder: Path, split: str, directions: np.ndarray, times: np.ndarray) -> None:
    (folder / split).mkdir(parents=True)
    frames = []
    for index, (direction, time) in enumerate(zip(directions, times, strict=True)):
        camera, gaussians = camera_at(direction), object_at(float(time))
        over_black, over_white = (draw(gaussians, camera, (level,) * 3).rgb for level in (0.0, 1.0))
        alpha = 1 - (over_white - over_black).mean(axis=2, keepdims=True).clip(0, 1)
        straight = over_black / np.maximum(alpha, 1e-3)
        image = (255 * np.concatenate([straight[..., ::-1], alpha], axis=2)).round().clip(0, 255).astype(np.uint8)
        assert cv2.imwrite(str(folder / split / f"r_{index}.png"), image)
        frames.append(posed_as(camera, f"./{split}/r_{index}", time=float(time)))
    angle = 2 * np.arctan(SIZE / 2 / _FOCAL)
    text = json.dumps({"camera_angle_x": angle, "frames": frames})
    (folder / f"transforms_{split}.json").write_text(text, encoding="utf-8")
