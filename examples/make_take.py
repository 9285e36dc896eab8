"""Films a minute in which nothing is seen twice: a trained scene's room, with a walker, a banner and a ball in it.

    python examples/make_take.py SCENE.frog OUT [--cameras 4] [--frames 1800] [--size 320x240] [--names cam00]

SCENE.frog is a scene of `examples/captures/room` (`frog train examples/captures/room --out room.frog --recipe draft`);
its static Gaussians are the room. What moves are Gaussians on surfaces that are formulas of time, each at a pace of
its own that is no ratio of another's. Needs imageio-ffmpeg. OUT receives ``cam00.mp4`` ... and
``cameras_opencv.json``; a run that was stopped goes on with the videos that are missing.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
from filmed_scene import Size, encode, size_of, write_calibration

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.gaussians import GaussianArrays
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import render_image
from frog_blender.engine.spherical_harmonics import SH_DC

RATE = 30.0
_TURN = 2 * np.pi
_UP = np.array([0.0, 0.0, 1.0])
Surface = tuple[np.ndarray, np.ndarray]
"""Points (N, 3) in metres, z up, and their colours (N, 3)."""


def _wave(seconds: float, period: float, phase: float = 0.0) -> float:
    return float(np.sin(_TURN * (seconds / period + phase)))


def _limb(first: np.ndarray, last: np.ndarray, radius: float, color: tuple[float, float, float]) -> Surface:
    """A striped tube from one joint to the next."""
    rows, columns = max(6, int(np.linalg.norm(last - first) / 0.028)), 12
    along, around = np.meshgrid(np.linspace(0, 1, rows), np.arange(columns) / columns, indexing="ij")
    axis = (last - first) / np.linalg.norm(last - first)
    side = np.cross(axis, [0.3, 0.9, 0.1])
    side /= np.linalg.norm(side)
    ring = np.cos(_TURN * around)[..., None] * side + np.sin(_TURN * around)[..., None] * np.cross(axis, side)
    places = first + along[..., None] * (last - first) + radius * ring
    stripes = 0.65 + 0.35 * (np.floor(along * rows / 3) % 2)
    return places.reshape(-1, 3), (stripes[..., None] * np.array(color)).reshape(-1, 3)


def _ball(center: np.ndarray, radius: float, turn: float, count: int = 700) -> Surface:
    """A beach ball: six segments of two colours, which turn."""
    number = np.arange(count) + 0.5
    height, angle = 1 - 2 * number / count, number * np.pi * (1 + 5**0.5)
    flat = np.sqrt(1 - height**2)
    places = np.stack([flat * np.cos(angle), height, flat * np.sin(angle)], axis=1)
    colors = np.where((np.floor(6 * angle / _TURN) % 2 == 0)[:, None], [0.9, 0.25, 0.1], [0.95, 0.9, 0.75])
    c, s = np.cos(turn), np.sin(turn)
    return center + radius * places @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]).T, colors


def walker(seconds: float) -> Surface:
    """A figure that walks about, swings its arms, and raises one of them now and then."""

    def place(at: float) -> np.ndarray:
        return np.array([-0.35 + 0.62 * _wave(at, 11.3) + 0.2 * _wave(at, 4.7, 0.2), 0.1 + 0.4 * _wave(at, 7.9), 0.0])

    ground, ahead = place(seconds), place(seconds + 0.05) - place(seconds - 0.05)
    ahead = ahead / max(float(np.linalg.norm(ahead)), 1e-6)
    ahead = ahead + np.array([0.0, -0.6, 0.0])  # never quite with its back to the cameras
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, _UP)
    stride = _wave(seconds, 1.17, 0.05 * _wave(seconds, 5.3))
    hip = ground + _UP * (0.82 + 0.02 * abs(stride))
    chest = hip + 0.5 * _UP + 0.05 * ahead * _wave(seconds, 3.1) + 0.05 * right * _wave(seconds, 2.3)
    head = chest + 0.24 * _UP + 0.04 * right * _wave(seconds, 1.9)
    parts = [_limb(hip, chest, 0.15, (0.15, 0.35, 0.75))]
    skull, _ = _ball(head, 0.115, 0.0, 350)
    face = np.where((((skull - head) @ ahead) > 0.03)[:, None], [0.9, 0.7, 0.55], [0.3, 0.18, 0.1])
    parts.append((skull, face))
    for side in (-1.0, 1.0):
        swing = side * stride
        knee = hip + 0.09 * side * right - 0.4 * _UP + 0.2 * swing * ahead
        foot = ground + 0.1 * side * right + (0.03 + 0.08 * max(swing, 0.0)) * _UP + 0.3 * swing * ahead
        parts += [_limb(hip + 0.09 * side * right, knee, 0.075, (0.25, 0.25, 0.3))]
        parts += [_limb(knee, foot, 0.06, (0.75, 0.6, 0.2))]
        raised = max(0.0, _wave(seconds, 6.1 + 2.2 * side, 0.3 * side)) ** 2
        shoulder = chest + 0.2 * side * right - 0.03 * _UP
        elbow = shoulder + side * 0.1 * right + (0.5 * raised - 0.26) * _UP - 0.16 * swing * ahead
        hand = elbow + side * (0.06 + 0.1 * raised) * right + (0.5 * raised - 0.24) * _UP - 0.2 * swing * ahead
        parts += [_limb(shoulder, elbow, 0.055, (0.15, 0.35, 0.75)), _limb(elbow, hand, 0.05, (0.9, 0.7, 0.55))]
    return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])


def banner(seconds: float) -> Surface:
    """A checked cloth that hangs from above, swings and carries waves."""
    down, across = np.meshgrid(np.linspace(0, 1, 44), np.linspace(0, 1, 40), indexing="ij")
    swing, gust = _wave(seconds, 3.7), 0.6 + 0.4 * _wave(seconds, 13.1)
    x = 0.95 + 0.85 * across + 0.14 * swing * down**1.3
    y = 0.55 - 0.22 * gust * down * (0.7 + np.sin(_TURN * (seconds / 1.43 - 0.9 * down - 0.4 * across)))
    z = 2.15 - 0.95 * down + 0.08 * gust * down**2 * np.sin(_TURN * (seconds / 2.9 + across))
    checks = (np.floor(across * 6) + np.floor(down * 7)) % 2
    colors = np.where(checks[..., None] > 0, [0.85, 0.2, 0.25], [0.95, 0.85, 0.5])
    return np.stack([x, y, z], axis=-1).reshape(-1, 3), colors.reshape(-1, 3)


def ball(seconds: float) -> Surface:
    """A ball that bounces, drifts and turns."""
    beat = (seconds / 1.61) % 1.0
    center = np.array(
        [0.8 + 0.3 * _wave(seconds, 8.3), -0.5 + 0.25 * _wave(seconds, 5.9), 0.22 + 2.4 * beat * (1 - beat)]
    )
    return _ball(center, 0.2, _TURN * (seconds / 4.3 + 0.3 * _wave(seconds, 9.7)))


MOVING: tuple[tuple[Callable[[float], Surface], float], ...] = ((walker, 0.016), (banner, 0.014), (ball, 0.014))
"""What moves, and the standard deviation of its Gaussians in metres."""


def room_of(scene: ScenePlayer) -> GaussianArrays[np.ndarray]:
    """The scene's static Gaussians."""
    first = scene.num_dynamic
    return GaussianArrays(*(array[first:] for array in vars(scene.at(0.0)).values()))


def take_at(room: GaussianArrays[np.ndarray], seconds: float) -> GaussianArrays[np.ndarray]:
    """The room and what moves in it."""
    surfaces = [(*surface(seconds), size) for surface, size in MOVING]
    means = np.concatenate([points for points, _, _ in surfaces])
    sizes = np.concatenate([np.full((len(points), 3), size) for points, _, size in surfaces])
    sh = np.zeros((len(means), room.sh.shape[1], 3))
    sh[:, 0] = (np.concatenate([colors for _, colors, _ in surfaces]) - 0.5) / SH_DC
    turned = np.tile([1.0, 0.0, 0.0, 0.0], (len(means), 1))
    moving = (means, turned, sizes, np.full(len(means), 0.92), sh)
    still = vars(room).values()
    joined = (np.concatenate([one, other]).astype(np.float32) for one, other in zip(still, moving, strict=True))
    return GaussianArrays(*joined)


def cameras_of(scene: ScenePlayer, count: int, size: Size) -> list[Camera]:
    """Some of the scene's cameras, evenly from the left to the right, without its held-out ones."""
    known = [camera for camera in scene.header.cameras if camera.name not in scene.header.test_cameras]
    right = known[0].rotation[0]
    ordered = sorted(known, key=lambda camera: float(camera.center @ right))
    chosen = [ordered[round(place)] for place in np.linspace(0, len(ordered) - 1, count)]
    return [camera.resized(*size) for camera in chosen]


def film(room: GaussianArrays[np.ndarray], camera: Camera, frames: int, quality: int, video: Path) -> None:
    """Draws a camera's frames into an H.264 video."""
    unfinished = video.with_name(f"unfinished-{video.name}")
    options = [
        "-threads",
        "1",
        "-vf",
        "scale=out_color_matrix=bt601:out_range=tv:flags=lanczos+accurate_rnd+full_chroma_int",
    ]
    options += ["-colorspace", "smpte170m", "-color_range", "tv", "-pix_fmt", "yuv444p"]
    images = (render_image(take_at(room, frame / RATE), camera) for frame in range(frames))
    encode(images, camera, quality, options, unfinished)
    unfinished.replace(video)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("scene", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--cameras", type=int, default=4)
    parser.add_argument("--names", nargs="+", help="of the scene's cameras, instead of some that are spread evenly")
    parser.add_argument("--frames", type=int, default=1800)
    parser.add_argument("--size", type=size_of, default=(320, 240), help="WIDTHxHEIGHT, both even")
    parser.add_argument("--quality", type=int, default=17, help="constant rate factor of the videos, lower is better")
    options = parser.parse_args()
    scene = ScenePlayer.load(options.scene)
    options.out.mkdir(parents=True, exist_ok=True)
    room = room_of(scene)
    chosen = cameras_of(scene, options.cameras, options.size)
    if options.names:
        chosen = [each.resized(*options.size) for each in scene.header.cameras if each.name in options.names]
    for camera in chosen:
        video = options.out / f"{camera.name}.mp4"
        if not video.exists():
            film(room, camera, options.frames, options.quality, video)
        print(f"{video.name}: {video.stat().st_size / 1e6:.2f} MB", flush=True)
    write_calibration(chosen, options.out)


if __name__ == "__main__":
    main()
