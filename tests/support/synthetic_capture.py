"""A small recorded scene, written by the tests: moving Gaussians, drawn by the project's own rasterizer."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from support.builders import blobs, rotation_of
from support.layouts.lists import posed_as
from support.small_captures import llff_rows, write_film

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.seeds import Seeds
from frog_blender.engine.capture.video import write_image
from frog_blender.engine.gaussians import GaussianArrays
from frog_blender.engine.playback.render import draw, to_uint8
from frog_blender.engine.spherical_harmonics import SH_DC

FRAMES, WIDTH, HEIGHT, FOCAL = 6, 48, 36, 50.0
HELD_OUT, *_ = CAMERAS = ("cam00", "cam01", "cam02", "cam03")
_DISTANCE = 4.0


def rig() -> list[Camera]:
    """Four cameras on an arc around the origin; N3DV holds the first out."""
    intrinsics = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    cameras = []
    for name, angle in zip(CAMERAS, (0.15, -0.35, 0.0, 0.35), strict=True):
        world_to_camera = np.eye(4)
        world_to_camera[:3, :3] = rotation_of((0, 1, 0), angle)
        world_to_camera[2, 3] = _DISTANCE
        cameras.append(Camera(name, WIDTH, HEIGHT, intrinsics, world_to_camera))
    return cameras


def gaussians_at(frame: int) -> GaussianArrays:
    """A static speckled wall, and a bright ball that crosses it."""
    random = np.random.default_rng(11)
    across, down = np.meshgrid(np.linspace(-2.4, 2.4, 13), np.linspace(-1.8, 1.8, 10))
    wall = np.stack([across, down, 1.0 + 0.2 * np.sin(2 * across)], -1).reshape(-1, 3)
    center = np.array([-0.9 + 1.8 * frame / (FRAMES - 1), 0.4 * np.sin(frame), -0.3])
    ball = center + random.normal(0, 0.12, (12, 3))
    colors = np.concatenate([random.uniform(0.15, 0.6, (len(wall), 3)), random.uniform([0.8, 0.5, 0], 1, (12, 3))])
    scales = np.concatenate([np.full((len(wall), 3), 0.22), np.full((12, 3), 0.13)])
    return blobs(np.concatenate([wall, ball]), scales, colors=colors)


def image(camera: Camera, frame: int) -> np.ndarray:
    """(H, W, 3) uint8."""
    return to_uint8(draw(gaussians_at(frame), camera).rgb)


def seeds(count: int = 300) -> Seeds:
    """Points near the true ones of the middle frame, roughly coloured: what ``find_seeds`` would find, at no cost."""
    random = np.random.default_rng(12)
    true = gaussians_at(FRAMES // 2)
    chosen = random.integers(len(true), size=count)
    points = true.means[chosen] + random.normal(0, 0.1, (count, 3))
    colors = true.sh[chosen, 0] * SH_DC + 0.5 + random.normal(0, 0.1, (count, 3))
    return Seeds(points.astype(np.float32), colors.clip(0, 1).astype(np.float32), "the tests")


def write_capture(folder: Path, shown: Sequence[int] = range(FRAMES)) -> Path:
    """An N3DV folder: ``camNN.mp4`` of the frames ``shown`` and ``poses_bounds.npy``; returns it."""
    for camera in rig():
        write_film(folder / f"{camera.name}.mp4", [image(camera, frame) for frame in shown], 24.0)
    np.save(folder / "poses_bounds.npy", llff_rows(rig(), 2.0, 8.0))
    return folder


def write_fly(folder: Path, frame: int, groups: Sequence[str]) -> Path:
    """``transforms.json`` of an image of each group, taken at a frame, ever farther from the first camera; its path."""
    folder.mkdir(parents=True)
    entries = []
    for index, group in enumerate(groups):
        camera = rig()[0].moved(np.zeros(3), np.array([0.2 * index, 0.0, -0.4]))
        write_image(folder / f"{group}.png", image(camera, frame))
        entries.append(posed_as(camera, f"{group}.png", frame=frame, group=group))
    (folder / "transforms.json").write_text(json.dumps({"fl_x": FOCAL, "frames": entries}))
    return folder / "transforms.json"


def longer(capture: Capture, frames: int) -> Capture:
    """The same cameras over more frames."""
    shots = tuple(
        replace(capture.shots[0], camera=camera, frame=frame)
        for camera in range(len(capture.cameras))
        for frame in range(frames)
    )
    return replace(capture, shots=shots, frame_count=frames)
