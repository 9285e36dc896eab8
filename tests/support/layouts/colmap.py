"""COLMAP's sparse model, written field by field as its documentation lists them."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.playback.transform import quaternion_of

MODELS = {"SIMPLE_PINHOLE": 0, "PINHOLE": 1, "SIMPLE_RADIAL": 2, "RADIAL": 3, "OPENCV": 4, "OPENCV_FISHEYE": 5}
MODELS |= {"FULL_OPENCV": 6, "FOV": 7, "SIMPLE_RADIAL_FISHEYE": 8, "RADIAL_FISHEYE": 9, "THIN_PRISM_FISHEYE": 10}
Lens = tuple[str, Sequence[float]]
POINTS = np.array([[0.1, 0.2, 6.0], [-1.0, 0.4, 6.0], [1.0, -0.5, 4.5]])


def pinhole(camera: Camera) -> Lens:
    k = camera.intrinsics
    return "PINHOLE", (k[0, 0], k[1, 1], k[0, 2], k[1, 2])


def write_model(
    folder: Path,
    names: Sequence[str],
    cameras: Sequence[Camera],
    lenses: Sequence[Lens] | None = None,
    text: bool = False,
) -> Path:
    """A model with one camera for each image, and three points that all of them see.

    Args:
        names: of the images, in the order of the file.
        lenses: COLMAP's model and parameters for each; a pinhole by default.
    """
    folder.mkdir(parents=True, exist_ok=True)
    chosen = list(lenses) if lenses is not None else [pinhole(camera) for camera in cameras]
    (_write_text if text else _write_binary)(folder, names, cameras, chosen)
    return folder


def _write_binary(folder: Path, names: Sequence[str], cameras: Sequence[Camera], lenses: list[Lens]) -> None:
    count = struct.pack("<Q", len(cameras))
    content = count
    for index, (camera, (model, values)) in enumerate(zip(cameras, lenses, strict=True), start=1):
        content += struct.pack("<IiQQ", index, MODELS[model], camera.width, camera.height)
        content += struct.pack(f"<{len(values)}d", *values)
    (folder / "cameras.bin").write_bytes(content)
    content = count
    for index, (camera, name) in enumerate(zip(cameras, names, strict=True), start=1):
        pose = [*quaternion_of(camera.rotation), *camera.world_to_camera[:3, 3]]
        content += struct.pack("<I7dI", 10 + index, *pose, index) + name.encode() + b"\0"
        pixels, _ = camera.project(POINTS)
        content += struct.pack("<Q", len(POINTS))
        content += b"".join(struct.pack("<ddQ", *pixel, k) for k, pixel in enumerate(pixels))
    (folder / "images.bin").write_bytes(content)
    content = struct.pack("<Q", len(POINTS))
    for k, point in enumerate(POINTS):
        content += struct.pack("<Q3d3BdQ", k, *point, 200, 100, 50, 0.3, len(cameras))
        content += b"".join(struct.pack("<II", 10 + index, k) for index in range(1, len(cameras) + 1))
    (folder / "points3D.bin").write_bytes(content)


def _write_text(folder: Path, names: Sequence[str], cameras: Sequence[Camera], lenses: list[Lens]) -> None:
    lines = ["# Camera list with one line of data per camera:", f"# Number of cameras: {len(cameras)}"]
    for index, (camera, (model, values)) in enumerate(zip(cameras, lenses, strict=True), start=1):
        lines.append(f"{index} {model} {camera.width} {camera.height} {' '.join(repr(float(v)) for v in values)}")
    (folder / "cameras.txt").write_text("\n".join(lines) + "\n")
    lines = ["# Image list with two lines of data per image:"]
    for index, (camera, name) in enumerate(zip(cameras, names, strict=True), start=1):
        pose = [*quaternion_of(camera.rotation), *camera.world_to_camera[:3, 3]]
        lines.append(f"{10 + index} {' '.join(repr(float(v)) for v in pose)} {index} {name}")
        pixels, _ = camera.project(POINTS)
        seen = " ".join(f"{x} {y} {k}" for k, (x, y) in enumerate(pixels))
        lines.append(seen if index % 2 else "")  # an image without points has an empty line
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    lines = [f"{k} {x} {y} {z} 200 100 50 0.3 11 {k}" for k, (x, y, z) in enumerate(POINTS)]
    (folder / "points3D.txt").write_text("\n".join(["# 3D point list", *lines]) + "\n")
