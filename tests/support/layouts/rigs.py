"""Standing cameras, as several programs write them. Each writer returns the cameras that a reader must find."""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from support.filmed_scene import FRAMES, HEIGHT, WIDTH, bent_rays, image, rig, still
from support.layouts.colmap import POINTS, write_model
from support.layouts.files import write_films, write_frames, write_image
from support.layouts.lists import opencv_entry, write_opencv
from support.small_captures import llff_rows

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.playback.transform import quaternion_of

Lines = list[str]
FISHEYE = (26.0, (-0.03, 0.01, 0.0, 0.0))
"""Focal length in pixels, and the coefficients of cv2.fisheye, of what the fisheye layouts are filmed with."""


def centred() -> list[Camera]:
    """The rig with square pixels and the principal point in the middle: what LLFF's rows can say."""
    return rig((52.0, 52.0), (WIDTH / 2, HEIGHT / 2))


def named(cameras: Sequence[Camera], pattern: str) -> list[Camera]:
    """The cameras renamed; ``pattern`` may use i (from 0) and one (from 1)."""
    return [replace(camera, name=pattern.format(i=i, one=i + 1)) for i, camera in enumerate(cameras)]


def n3dv_frames(folder: Path) -> list[Camera]:
    """N3DV, its films taken apart into ``cam00/images/0000.png``, as 4DGaussians' script does."""
    cameras = centred()
    write_frames(folder, cameras, "{name}/images/{frame:04d}.png")
    np.save(folder / "poses_bounds.npy", llff_rows(cameras, 2.0, 9.0))
    return cameras


def n3dv_nested(folder: Path) -> list[Camera]:
    """As the archives unpack: one folder deeper."""
    return n3dv_frames(folder / "coffee_martini")


def multipleview(folder: Path) -> list[Camera]:
    """4DGaussians' own data: numbers of images of the model are those of the folders; strays lie about."""
    cameras = named(rig(), "cam{one:02d}")
    write_frames(folder, cameras, "{name}/frame_{one:05d}.png")
    (folder / "cam01" / "camera.db").write_bytes(b"x")
    write_image(folder / "cam02" / "thumbnail.jpg", still("cam00", 0))
    order = [2, 0, 3, 1]
    write_model(folder / "sparse_", [f"image{i + 1}.png" for i in order], [cameras[i] for i in order])
    np.save(folder / "poses_bounds_multipleview.npy", llff_rows(cameras, 2.0, 9.0)[::-1])
    return cameras


def multipleview_rows(folder: Path) -> list[Camera]:
    """Without the model: the rows alone."""
    cameras = named(centred(), "cam{one:02d}")
    write_frames(folder, cameras, "{name}/frame_{one:05d}.png")
    np.save(folder / "poses_bounds_multipleview.npy", llff_rows(cameras, 2.0, 9.0))
    return cameras


def panoptic_sports(folder: Path) -> list[Camera]:
    """The cameras 2, 5, 8 for training and 11 for testing."""
    cameras = [replace(camera, name=str(2 + 3 * i)) for i, camera in enumerate(rig())]
    for file, chosen in (("train_meta.json", (0, 1, 2)), ("test_meta.json", (3,))):
        filming = [cameras[i] for i in chosen]
        meta = {
            "w": WIDTH,
            "h": HEIGHT,
            "k": [[camera.intrinsics.tolist() for camera in filming]] * FRAMES,
            "w2c": [[camera.world_to_camera.tolist() for camera in filming]] * FRAMES,
            "fn": [[f"{camera.name}/{frame:06d}.png" for camera in filming] for frame in range(FRAMES)],
            "cam_id": [[int(camera.name) for camera in filming]] * FRAMES,
        }
        (folder / file).write_text(json.dumps(meta))
    write_frames(folder / "ims", cameras, "{name}/{frame:06d}.png")
    data = np.concatenate([POINTS, np.full((3, 3), 0.5), np.ones((3, 1))], axis=1)
    np.savez(folder / "init_pt_cld.npz", data=data)
    return cameras


def _matrix(key: str, value: np.ndarray) -> Lines:
    numbers = ", ".join(f"{entry:.10f}" for entry in np.ravel(value))
    shape = value.shape
    return [f"{key}: !!opencv-matrix", f"  rows: {shape[0]}", f"  cols: {shape[1]}", "  dt: d", f"  data: [{numbers}]"]


def easyvolcap(folder: Path) -> list[Camera]:
    """As EasyVolcap's ``write_camera`` writes: two files of OpenCV's YAML, names quoted."""
    cameras = named(rig(), "{i:02d}")
    inner, outer = (["%YAML:1.0", "---", "names:", *(f'  - "{camera.name}"' for camera in cameras)] for _ in range(2))
    for camera in cameras:
        inner += _matrix(f"K_{camera.name}", camera.intrinsics)
        inner += [f"H_{camera.name}: {camera.height:.10f}", f"W_{camera.name}: {camera.width:.10f}"]
        inner += _matrix(f"D_{camera.name}", np.zeros((5, 1)))
        outer += _matrix(f"R_{camera.name}", cv2.Rodrigues(camera.rotation)[0])
        outer += _matrix(f"Rot_{camera.name}", camera.rotation)
        outer += _matrix(f"T_{camera.name}", camera.world_to_camera[:3, 3:])
    (folder / "intri.yml").write_text("\r\n".join(inner) + "\r\n")
    (folder / "extri.yml").write_text("\r\n".join(outer) + "\r\n")
    write_frames(folder / "images", cameras, "{name}/{frame:06d}.png")
    return cameras


def easymocap(folder: Path) -> list[Camera]:
    """As OpenCV's FileStorage itself writes, with films and rotation vectors alone."""
    cameras = named(rig(), "{one}")
    inner = cv2.FileStorage(str(folder / "intri.yml"), cv2.FILE_STORAGE_WRITE)
    outer = cv2.FileStorage(str(folder / "extri.yml"), cv2.FILE_STORAGE_WRITE)
    inner.write("names", [camera.name for camera in cameras])
    for camera in cameras:
        inner.write(f"K_{camera.name}", camera.intrinsics)
        inner.write(f"dist_{camera.name}", np.zeros((1, 5)))
        outer.write(f"R_{camera.name}", cv2.Rodrigues(camera.rotation)[0])
        outer.write(f"T_{camera.name}", camera.world_to_camera[:3, 3:])
    inner.release()
    outer.release()
    write_films(folder / "videos", cameras)
    return cameras


def toml_cameras(
    cameras: Sequence[Camera], header: str, more: str, lens: Sequence[float] = (0.0,) * 5, is_vector: bool = True
) -> str:
    """A table for each camera; ``header`` and ``more`` may use its name and i."""
    text = ""
    for i, camera in enumerate(cameras):
        turn = cv2.Rodrigues(camera.rotation)[0].ravel() if is_vector else camera.rotation
        text += f"[{header.format(name=camera.name, i=i)}]\nsize = [{camera.width}, {camera.height}]\n"
        text += f"matrix = {camera.intrinsics.tolist()}\ndistortions = {list(lens)}\nrotation = {turn.tolist()}\n"
        text += f"translation = {camera.world_to_camera[:3, 3].tolist()}\n{more.format(name=camera.name)}\n"
    return text


def caliscope(folder: Path) -> list[Camera]:
    """``cameras.N`` tables, films ``cam_N``; one camera is ignored, another has no pose."""
    cameras = named(rig(), "{i}")
    text = toml_cameras(cameras, "cameras.{name}", "cam_id = 0", is_vector=False)
    text += "[cameras.7]\nignore = true\nmatrix = [[1.0]]\n[cameras.8]\nsize = [64, 48]\nmatrix = [[1.0]]\n"
    (folder / "camera_array.toml").write_text(text)
    (folder / "charuco.toml").write_text('columns = 4\nrows = 5\ndictionary = "DICT_4X4_1000"\n')
    write_films(folder, rig(), "cam_{camera}.avi")
    return named(rig(), "cam_{i}")


def qualisys(cameras: Sequence[Camera], lens: Sequence[float] = (0.0,) * 5) -> str:
    """Qualisys' file, in which y and z point the other way, with lengths in mm and pixels times 64.

    Args:
        lens: k1 k2 p1 p2 k3 of every camera.
    """
    text = ""
    k1, k2, p1, p2, k3 = (64 * value for value in lens)
    for camera in cameras:
        rows = np.diag([1.0, -1.0, -1.0]) @ camera.rotation
        turn = " ".join(f'r{i + 1}{j + 1}="{float(rows[i, j])!r}"' for i in range(3) for j in range(3))
        center = " ".join(f'{axis}="{1000 * float(at)!r}"' for axis, at in zip("xyz", camera.center, strict=True))
        (fx, _, cx), (_, fy, cy), _ = (64 * camera.intrinsics).tolist()
        inner = f'focalLengthU="{fx}" focalLengthV="{fy}" centerPointU="{cx}" centerPointV="{cy}"'
        inner += f' radialDistortion1="{k1}" radialDistortion2="{k2}" radialDistortion3="{k3}"'
        inner += f' tangentalDistortion1="{p1}" tangentalDistortion2="{p2}"'
        view = f'<fov_video left="0" top="0" right="{camera.width - 1}" bottom="{camera.height - 1}"/>'
        text += f'<camera serial="{camera.name}">{view}<transform {turn} {center}/><intrinsic {inner}/></camera>'
    return f"<calibration><cameras>{text}</cameras></calibration>"


def fisheye_rays(camera: Camera) -> Callable[[np.ndarray], np.ndarray]:
    """What ``image`` needs to draw through the fisheye of ``FISHEYE``."""
    matrix = np.array([[FISHEYE[0], 0, 32.5], [0, FISHEYE[0], 23.25], [0, 0, 1]])

    def rays(pixels: np.ndarray) -> np.ndarray:
        exact = (3, 200, 1e-12)
        undistorted = cv2.fisheye.undistortPoints(pixels[:, None], matrix, np.array(FISHEYE[1]), criteria=exact)
        return undistorted[:, 0]

    return rays


def fisheye_toml(folder: Path) -> list[Camera]:
    """anipose's fisheyes, in tables that give the camera's name; poses alone can be compared, since the pinhole is
    chosen by the reader."""
    cameras = rig((FISHEYE[0],) * 2, (32.5, 23.25))
    text = toml_cameras(cameras, "cam_{i}", 'name = "{name}"\nfisheye = true', FISHEYE[1])
    (folder / "calibration.toml").write_text(f"{text}[metadata]\nadjusted = false\nerror = 0.2\n")
    write_films(folder, cameras, rays=fisheye_rays)
    return cameras


def immersive(folder: Path) -> list[Camera]:
    """Google's ``models.json``, as published but for the size."""
    cameras = named(rig((FISHEYE[0],) * 2, (32.5, 23.25)), "camera_{one:04d}")
    entries = [
        {
            "name": camera.name,
            "width": camera.width,
            "height": camera.height,
            "focal_length": FISHEYE[0],
            "pixel_aspect_ratio": 1.0,
            "principal_point": [32.5, 23.25],
            "orientation": cv2.Rodrigues(camera.rotation)[0].ravel().tolist(),
            "position": camera.center.tolist(),
            "radial_distortion": [*FISHEYE[1][:2], 0.0],
            "projection_type": "fisheye",
        }
        for camera in cameras
    ]
    (folder / "models.json").write_text(json.dumps(entries))
    write_films(folder, cameras, rays=fisheye_rays)
    return cameras


def opencv_frames(folder: Path) -> list[Camera]:
    """``cameras_opencv.json`` beside folders of frames."""
    cameras = rig()
    write_opencv(folder, map(opencv_entry, cameras))
    write_frames(folder, cameras, "{name}/{name}_{frame:08d}.png")
    return cameras


def technicolor(folder: Path, skew: float = 0.0, scene: str = "Birthday") -> list[Camera]:
    """Four cameras of the sixteen, 8 to 11, of images of a thirty-second of the published size; frames from 151 on."""
    size = (64, 34)
    cameras = [replace(camera, name=f"cam{index:02d}", height=size[1]) for index, camera in enumerate(rig() * 3)]
    rows = ["focal cx cy aspect skew qw qx qy qz tx ty tz"]
    for camera in cameras:
        (focal_x, _, center_x), (_, focal_y, center_y), _ = (32 * camera.intrinsics).tolist()
        pose = [*quaternion_of(camera.rotation), *camera.world_to_camera[:3, 3]]
        values = (focal_x, center_x, center_y, focal_y / focal_x, 32 * skew, *pose)
        rows.append(" ".join(f"{value:.12g}" for value in values) + "  ")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cameras_parameters.txt").write_text("\n".join(rows) + "\n\n")
    for index, camera in enumerate(cameras[8:], start=8):
        for frame in range(FRAMES):
            stored = image(camera, frame, bent_rays(camera, [0.0] * 5, skew))
            write_image(folder / f"{scene}_undist_{151 + frame:05d}_{index:02d}.png", stored)
    return cameras[8:]
