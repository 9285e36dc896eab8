"""A turntable, or a flight along the rig, as a file for ``frog render --cameras``:

    python examples/ready_path.py X.frog turntable OUT.json [--images 120] [--frame N]
    python examples/ready_path.py X.frog rig OUT.json
    frog render X.frog --cameras OUT.json -o out/####.png

The turntable goes once around what the cameras look at, about its vertical, and starts at the first camera. The flight
goes on a smooth curve through all cameras: as a moving camera went, else always to the nearest that is left. The
capture plays meanwhile, once from its beginning to its end; ``--frame`` holds it.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from frog_blender import engine as frog
from frog_blender.engine.capture.camera import rotation_about
from frog_blender.engine.capture.readers.geometry import pose
from frog_blender.engine.capture.seeding.views import nearest_to_axes
from frog_blender.engine.playback.ground_plane import camera_up
from frog_blender.engine.playback.views import sized
from frog_blender.engine.source_media.clips import camera_path

SMOOTH = np.array([[0, 2, 0, 0], [-1, 0, 1, 0], [2, -5, 4, -1], [-1, 3, -3, 1]]) / 2
"""Catmull and Rom's spline."""
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def turntable(scene: frog.ScenePlayer, count: int) -> list[frog.Camera]:
    """So many cameras around the point nearest to all cameras' axes; where these are parallel, at the median depth of
    what the first camera sees. FrogError for a scene without cameras."""
    cameras = cameras_of(scene)
    up, first = camera_up(cameras)[0], cameras[0]
    middle = nearest_to_axes(cameras)
    if middle is None:
        pixels, depth = first.project(scene.at(0).means)
        inside = (depth > 0) & ((pixels >= 0) & (pixels <= (first.width, first.height))).all(axis=1)
        middle = first.center + first.forward * (np.median(depth[inside]) if inside.any() else 1.0)
    turns = [rotation_about(up * (2 * np.pi * index / count)) for index in range(count)]
    return [first.with_pose(pose(first.rotation @ t.T, middle + t @ (first.center - middle))) for t in turns]


def along_rig(scene: frog.ScenePlayer, count: int) -> list[frog.Camera]:
    """So many cameras at equal distances on the curve, of the first one's size. FrogError for one place of cameras."""
    cameras = cameras_of(scene)
    size = cameras[0].width, cameras[0].height
    ordered = cameras if scene.header.is_moving else [cameras[index] for index in nearest_next(cameras)]
    parts = [np.vstack([camera.center, camera.rotation, sized(camera, *size).intrinsics]) for camera in ordered]
    keys, last = np.array(parts), len(parts) - 1
    gone = np.append(0, np.linalg.norm(np.diff(keys[:, 0], axis=0), axis=1).cumsum())
    if not gone[-1]:
        raise frog.FrogError("Found cameras at a single place, expected two places at least to fly between.")
    path = []
    for place in np.interp(np.linspace(0, gone[-1], count), gone, np.arange(last + 1)):
        before = min(int(place), last - 1)
        weights = (place - before) ** np.arange(4) @ SMOOTH
        mean = np.tensordot(weights, keys[np.clip(np.arange(before - 1, before + 3), 0, last)], 1)
        left, _, right = np.linalg.svd(mean[1:4])
        left[:, 2] *= np.linalg.det(left @ right)  # the nearest rotation
        path.append(frog.Camera("rig", *size, mean[4:], pose(left @ right, mean[0])))
    return path


def nearest_next(cameras: Sequence[frog.Camera]) -> list[int]:
    """Indices of all cameras, from one end of the rig always to the nearest that is left."""
    centers = np.array([camera.center for camera in cameras])
    order = [int(np.linalg.norm(centers - centers.mean(axis=0), axis=1).argmax())]
    while len(order) < len(cameras):
        distances = np.linalg.norm(centers - centers[order[-1]], axis=1)
        distances[order] = np.inf
        order.append(int(distances.argmin()))
    return order


def cameras_of(scene: frog.ScenePlayer) -> list[frog.Camera]:
    header = scene.header
    cameras = [camera for _, camera in camera_path(header)] if header.is_moving else [*header.cameras]
    if not cameras:
        raise frog.FrogError("The scene has no cameras, expected some for a path.")
    return cameras


def listed(scene: frog.ScenePlayer, cameras: Sequence[frog.Camera], frame: float | None) -> dict[str, list[object]]:
    """A ``transforms.json``, in the coordinates of the capture's files, with the frame that each image shows."""
    header, images = scene.header, list[object]()
    shown = np.linspace(0, header.frame_count - 1, len(cameras)) if frame is None else np.full(len(cameras), frame)
    for number, (camera, at) in enumerate(zip(cameras, shown.tolist(), strict=True), 1):
        to_world, k = np.linalg.inv(camera.world_to_camera), camera.intrinsics
        to_world[:3, 3] = np.array(header.world.origin) + header.world.unit * to_world[:3, 3]
        image = {"file_path": f"{number:04d}.png", "number": number, "frame": at, "w": camera.width, "h": camera.height}
        image |= {"fl_x": k[0, 0], "fl_y": k[1, 1], "cx": k[0, 2], "cy": k[1, 2]}
        images.append(image | {"transform_matrix": (to_world @ OPENGL).tolist()})
    return {"frames": images}


def main() -> None:
    paths = {"turntable": turntable, "rig": along_rig}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("path", choices=paths)
    parser.add_argument("out", type=Path)
    parser.add_argument("--images", type=int, default=120)
    parser.add_argument("--frame", type=float, help="of the capture, counted from 0, in all images")
    options = parser.parse_args()
    scene = frog.load_scene(options.scene)
    content = listed(scene, paths[options.path](scene, max(options.images, 1)), options.frame)
    options.out.write_text(json.dumps(content, indent=1), encoding="utf-8")
    print(f"{options.out}: {len(content['frames'])} cameras")


if __name__ == "__main__":
    try:
        main()
    except (frog.FrogError, OSError) as error:
        sys.exit(f"ready_path: {error}")
