"""One moving camera, or two. Each writer returns the cameras that a reader must find."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from support.filmed_scene import HEIGHT, WIDTH, bent_rays, image, moving
from support.layouts.files import write_image
from support.layouts.lists import posed_as
from support.layouts.rigs import FISHEYE, fisheye_rays

from frog_blender.engine.capture.camera import Camera

COUNT = 9


def nerfstudio_fisheye(folder: Path) -> list[Camera]:
    """GoPro images as nerfstudio lists them, with a time each."""
    matrix = np.array([[FISHEYE[0], 0, 32.5], [0, FISHEYE[0], 23.25], [0, 0, 1]])
    cameras, frames = [], []
    for frame, camera in enumerate(moving(COUNT)):
        filmed = replace(camera, name=f"frame_{frame:05d}", intrinsics=matrix)
        write_image(folder / "images" / f"{filmed.name}.png", image(filmed, frame, fisheye_rays(filmed)))
        frames.append(posed_as(filmed, f"images/{filmed.name}.png", time=frame / (COUNT - 1)))
        cameras.append(filmed)
    lens = {"fl_x": FISHEYE[0], "fl_y": FISHEYE[0], "cx": 32.5, "cy": 23.25, "w": WIDTH, "h": HEIGHT}
    lens |= dict(zip(("k1", "k2", "k3", "k4"), FISHEYE[1], strict=True))
    (folder / "transforms.json").write_text(json.dumps({"camera_model": "OPENCV_FISHEYE", **lens, "frames": frames}))
    return cameras


def hypernerf(folder: Path, frames: int = 6, **lens: object) -> list[Camera]:
    """A "vrig": two cameras, left and right, of which one trains and the other judges by turns. Nothing of the lens is
    square or straight; images of half the calibrated size.

    Args:
        lens: of the cameras' files, other than by default.
    """
    values = {"skew": 4.0, "radial_distortion": [-0.2, 0.08, 0.01], "tangential_distortion": [0.01, -0.02], **lens}
    k1, k2, k3 = values["radial_distortion"]
    bent = (k1, k2, *values["tangential_distortion"], k3)
    cameras, metadata = [], {}
    lists: dict[str, list[str]] = {"ids": [], "train_ids": [], "val_ids": []}
    (folder / "camera").mkdir(parents=True)
    for frame, left in enumerate(moving(frames)):
        for side in ("left", "right"):
            camera = replace(left, name=f"{frame + 1:06d}_{side}")
            if side == "right":
                camera = camera.moved(np.zeros(3), np.array([-0.1, 0.0, 0.0]))
            (focal_x, _, center_x), (_, focal_y, center_y), _ = (2 * camera.intrinsics).tolist()
            view = {"orientation": camera.rotation.tolist(), "position": camera.center.tolist(), **values}
            view |= {"focal_length": focal_x, "pixel_aspect_ratio": focal_y / focal_x}
            view |= {"principal_point": [center_x, center_y], "image_size": [2 * WIDTH, 2 * HEIGHT]}
            (folder / "camera" / f"{camera.name}.json").write_text(json.dumps(view))
            stored = image(camera, frame, bent_rays(camera, bent, values["skew"] / 2))
            write_image(folder / "rgb" / "2x" / f"{camera.name}.png", stored)
            metadata[camera.name] = {"warp_id": frame, "appearance_id": frame, "camera_id": int(side == "right")}
            is_train = (side == "left") == (frame % 2 == 0)
            for name in ("ids", "train_ids" if is_train else "val_ids"):
                lists[name].append(camera.name)
            cameras.append(camera)
    (folder / "dataset.json").write_text(json.dumps({"count": len(cameras), **lists}))
    (folder / "metadata.json").write_text(json.dumps(metadata))
    scene = {"scale": 0.5, "center": [1.0, 2.0, 3.0], "near": 0.4, "far": 8.0}
    (folder / "scene.json").write_text(json.dumps(scene))
    return cameras
