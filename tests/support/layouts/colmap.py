"""COLMAP's sparse model, written field by field as its documentation lists them."""

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.playback.transform import quaternion_of

MODELS = {"SIMPLE_PINHOLE": 0, "PINHOLE": 1, "SIMPLE_RADIAL": 2, "RADIAL": 3, "OPENCV": 4, "OPENCV_FISHEYE": 5}
MODELS |= {"FULL_OPENCV": 6, "FOV": 7, "SIMPLE_RADIAL_FISHEYE": 8, "RADIAL_FISHEYE": 9, "THIN_PRISM_FISHEYE": 10}
Lens = tuple[str, Sequence[float]]
Image = tuple[int, str, Camera, Lens, list[float]]
"""Its number, name, camera, lens and pose."""
POINTS = np.array([[0.1, 0.2, 6.0], [-1.0, 0.4, 6.0], [1.0, -0.5, 4.5]])


def pinhole(camera: Camera) -> Lens:
    k = camera.intrinsics
    return "PINHOLE", (k[0, 0], k[1, 1], k[0, 2], k[1, 2])


def write_model(
    folder: Path, names: Sequence[str], cameras: Sequence[Camera], lenses: Sequence[Lens] = (), text: bool = False
) -> Path:
    """A model with one camera for each image, and three points that all of them see.

    Args:
        names: of the images, in the order of the file.
        lenses: COLMAP's model and parameters for each; a pinhole by default.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lenses = lenses or list(map(pinhole, cameras))
    poses = [[*quaternion_of(camera.rotation), *camera.world_to_camera[:3, 3]] for camera in cameras]
    images = list(zip(range(1, 1 + len(cameras)), names, cameras, lenses, poses, strict=True))
    (_write_text if text else _write_binary)(folder, images)
    return folder


def _write_binary(folder: Path, images: list[Image]) -> None:
    lenses = views = struct.pack("<Q", len(images))
    points = struct.pack("<Q", len(POINTS))
    for index, name, camera, (model, values), pose in images:
        size = camera.width, camera.height
        lenses += struct.pack(f"<IiQQ{len(values)}d", index, MODELS[model], *size, *values)
        views += struct.pack("<I7dI", 10 + index, *pose, index) + name.encode() + b"\0"
        views += struct.pack("<Q", len(POINTS))
        views += b"".join(struct.pack("<ddQ", *pixel, k) for k, pixel in enumerate(camera.project(POINTS)[0]))
    for k, point in enumerate(POINTS):
        points += struct.pack("<Q3d3BdQ", k, *point, 200, 100, 50, 0.3, len(images))
        points += b"".join(struct.pack("<II", 10 + index, k) for index, *_ in images)
    for name, content in (("cameras", lenses), ("images", views), ("points3D", points)):
        (folder / f"{name}.bin").write_bytes(content)


def _write_text(folder: Path, images: list[Image]) -> None:
    lenses = ["# Camera list with one line of data per camera:", f"# Number of cameras: {len(images)}"]
    views = ["# Image list with two lines of data per image:"]
    for index, name, camera, (model, values), pose in images:
        lenses.append(f"{index} {model} {camera.width} {camera.height} {' '.join(repr(float(v)) for v in values)}")
        views.append(f"{10 + index} {' '.join(repr(float(v)) for v in pose)} {index} {name}")
        seen = " ".join(f"{x} {y} {k}" for k, (x, y) in enumerate(camera.project(POINTS)[0]))
        views.append(seen if index % 2 else "")  # an image without points has an empty line
    points = ["# 3D point list", *(f"{k} {x} {y} {z} 200 100 50 0.3 11 {k}" for k, (x, y, z) in enumerate(POINTS))]
    for name, lines in (("cameras", lenses), ("images", views), ("points3D", points)):
        (folder / f"{name}.txt").write_text("\n".join(lines) + "\n")
