"""Polycam's raw export: ``keyframes/cameras/*.json`` and ``keyframes/images/*.jpg``, or their ``corrected_`` folders.

A file for each image: ``fx``, ``fy``, ``cx``, ``cy`` for ``width`` x ``height`` pixels, and ``t_00`` .. ``t_23``, the
rows of camera to world in OpenGL's axes (x right, y up, looking along -z), in metres. The corrected folders, with
poses that Polycam has optimised, are preferred. (PolyCam/polyform, README; nerfstudio,
process_data/polycam_utils.py.)

Names are times, so that images lie between frames. Every eighth frame is held out. Depth is not used.
"""

from __future__ import annotations

from pathlib import Path

from ...errors import found_instead
from ..camera import Camera
from ..capture import Capture
from ..natural_order import natural
from ..video import with_ending
from .assembly import moving_cameras
from .checks import number, numbers, read_json, rotation, size
from .geometry import OPENGL_AXES, intrinsics, pose
from .readings import numbers_of

_KEYFRAMES = "keyframes"
_FOLDERS = (("corrected_cameras", "corrected_images"), ("cameras", "images"))


def matches(path: Path) -> bool:
    """True if the folder holds ``keyframes/cameras``, or is ``keyframes`` itself."""
    return bool(_folders(path))


def read(path: Path) -> Capture:
    """Open an export.

    Raises:
        FrogError: if no image has a camera, or a value cannot be used.
    """
    cameras, images = _folders(path)[0]
    files = sorted(cameras.glob("*.json"), key=lambda file: natural(file.name))
    files = [file for file in files if not file.name.startswith(".")]
    pairs = [(file, image) for file in files if (image := with_ending(images / file.stem)) is not None]
    if not pairs:
        found = f"{len(files)} cameras in {cameras.name} and no image of theirs in {images.name}"
        raise found_instead(path, found, "both")
    times = numbers_of([file.stem for file, _ in pairs]) or range(len(pairs))
    views = [((_camera(file), None), image, time) for (file, image), time in zip(pairs, times, strict=True)]
    lacking = len(files) - len(pairs)
    warnings = [f"{path}: {lacking} of {len(files)} images are missing and left out."] if lacking else []
    return moving_cameras(path, "polycam", views, warnings)


def _folders(path: Path) -> list[tuple[Path, Path]]:
    """The folders of cameras and images, the preferred ones first."""
    folders = [(base / cameras, base / images) for base in (path / _KEYFRAMES, path) for cameras, images in _FOLDERS]
    return [(cameras, images) for cameras, images in folders if images.is_dir() and any(cameras.glob("*.json"))]


def _camera(file: Path) -> Camera:
    data = read_json(file)
    width, height = (size(data.get(side), file, side) for side in ("width", "height"))
    focal = [number(data.get(key), file, key, positive=True) for key in ("fx", "fy")]
    center = [number(data.get(key), file, key) for key in ("cx", "cy")]
    rows = [[data.get(f"t_{row}{column}") for column in range(4)] for row in range(3)]
    matrix = numbers(rows, (3, 4), file, "t_00 to t_23")
    turn = rotation(matrix[:, :3], file, "t_00 to t_23")
    return Camera(file.stem, width, height, intrinsics(*focal, *center), pose(OPENGL_AXES @ turn.T, matrix[:, 3]))
