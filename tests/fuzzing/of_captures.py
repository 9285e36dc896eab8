"""Captures of which one file is damaged or hostile, of every layout."""

import struct
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from support.filmed_scene import moving, rig, still
from support.layouts import moving_rigs, rigs
from support.layouts.colmap import write_model
from support.layouts.files import write_frames, write_image
from support.layouts.lists import opencv_entry, write_opencv
from support.layouts.written import FISHEYES, STANDING
from support.small_captures import write_film

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.errors import FrogError
from fuzzing.worker import Kind


def colmap(folder: Path, text: bool) -> list[Camera]:
    write_frames(folder / "images", rig())
    names = [f"{camera.name}/{frame:04d}.png" for camera in rig() for frame in range(2)]
    lenses = [
        ("PINHOLE", (50.0, 50.0, 32.0, 24.0)),
        ("OPENCV_FISHEYE", (26.0, 26.5, 32.5, 23.0, -0.03, 0.01, -0.002, 0.0003)),
        ("FULL_OPENCV", (52.0, 53.0, 32.5, 23.0, -0.1, 0.02, 0.003, -0.002, 0.01, 0.05, -0.01, 0.004)),
        ("FOV", (30.0, 30.5, 32.5, 23.0, 0.9)),
    ]
    cameras = [camera for camera in rig() for _ in range(2)]
    write_model(folder / "sparse" / "0", names, cameras, [lens for lens in lenses for _ in range(2)], text=text)
    if not text:
        _frames(folder / "sparse" / "0" / "frames.bin")
    return cameras


def _frames(file: Path) -> None:
    content = struct.pack("<Q", 2)
    for frame in range(2):
        content += struct.pack("<II7dI", frame + 1, 1, 1, 0, 0, 0, 0, 0, 0, 4)
        content += b"".join(struct.pack("<iIQ", 0, 1 + 2 * i + frame, 11 + 2 * i + frame) for i in range(4))
    file.write_bytes(content)


def one_moving(folder: Path) -> list[Camera]:
    for index, _ in enumerate(moving(9)):
        write_image(folder / "images" / f"frame_{index}.png", still("cam00", 0))
    write_model(folder / "sparse" / "0", [f"frame_{index}.png" for index in range(9)], moving(9), text=True)
    return moving(9)


def timed_films(folder: Path) -> list[Camera]:
    """Films named by their calibration, each with a clock of its own."""
    entries = []
    for index, camera in enumerate(rig()):
        write_film(folder / "films" / f"{camera.name}.avi", [still(camera.name, frame) for frame in range(2)])
        clock = {"offset": 0.01 * index, "rate": 1.0, "video": f"films/{camera.name}.avi"}
        entries.append(opencv_entry(camera, dist=[-0.1, 0.01, 0, 0, 0], **clock))
    write_opencv(folder, entries, points=[[0.0, 1.0, 4.0]])
    return rig()


def qualisys(folder: Path) -> list[Camera]:
    (folder / "Calib.qca.txt").write_text(rigs.qualisys(rig()[:1]))
    write_film(folder / "cam00.avi", [still("cam00", frame) for frame in range(2)])
    return rig()[:1]


def hypernerf(folder: Path) -> list[Camera]:
    points = np.random.default_rng(0).uniform([-1, -1, 3], [1, 1, 5], (80, 3)).astype(np.float32)
    cameras = moving_rigs.hypernerf(folder)
    np.save(folder / "points.npy", points)
    return cameras


MODEL, PHONE = ("cameras", "images", "points3D"), ("dataset", "metadata", "scene", "camera/000002_left")
LAYOUTS: dict[str, tuple[Callable[[Path], list[Camera]], tuple[str, ...]]] = {
    "colmap_binary": (partial(colmap, text=False), tuple(f"sparse/0/{name}.bin" for name in (*MODEL, "frames"))),
    "colmap_text": (partial(colmap, text=True), tuple(f"sparse/0/{name}.txt" for name in MODEL)),
    "colmap_moving": (one_moving, ("sparse/0/images.txt", "sparse/0/cameras.txt")),
    "timed_films": (timed_films, ("cameras_opencv.json",)),
    "qualisys": (qualisys, ("Calib.qca.txt",)),
    "hypernerf": (hypernerf, (*(f"{name}.json" for name in PHONE), "points.npy")),
    "nerfstudio_fisheye": (moving_rigs.nerfstudio_fisheye, ("transforms.json",)),
    **{name: (write, files) for name, (_, write, files) in {**STANDING, **FISHEYES}.items()},
}


class OfLayout(Kind):
    """A capture of a layout."""

    layout: str

    def __init__(self, folder: Path) -> None:
        write, files = LAYOUTS[self.layout]
        self._folder = folder / "capture"
        self._folder.mkdir()
        write(self._folder)
        self.whole = {self._folder / file: [(self._folder / file).read_bytes()] for file in files}

    def use(self) -> bool:
        try:
            capture = open_capture(self._folder)
        except FrogError as error:
            assert str(error).startswith(str(self._folder)), error
            raise
        for camera in capture.cameras:
            assert np.isfinite(camera.intrinsics).all() and np.isfinite(camera.world_to_camera).all()
            camera.ray_directions(np.array([[0.5, 0.5]]))
        assert capture.points is None or np.isfinite(capture.points).all()
        assert all(0 <= shot.frame < capture.frame_count and abs(shot.offset) <= 0.5 for shot in capture.shots)
        return True


KINDS: dict[str, type[Kind]] = {name: type(name, (OfLayout,), {"layout": name}) for name in LAYOUTS}
