"""Record3D's export (iPhone): ``metadata.json`` or ``metadata``, and images 0.jpg, 1.jpg, ... in ``rgbd`` or ``rgb``.

``K`` lists a 3 x 3 matrix column by column, for images of ``w`` x ``h`` pixels; ``perFrameIntrinsicCoeffs`` (fx, fy,
cx, cy) replaces it where it is there. ``poses`` are camera to world in OpenGL's axes (x right, y up, looking along
-z): a quaternion x y z w and a position in metres. ``fps`` is the rate. (record3d.app; nerfstudio,
process_data/record3d_utils.py, which moves the principal point to the middle: here it stays.)

Every eighth frame is held out. Depth is not used.
"""

from __future__ import annotations

from pathlib import Path

from ...errors import found_instead
from ..camera import Camera
from ..capture import MAX_IMAGES, Capture
from ..video import find_images
from .assembly import moving_cameras
from .checks import number, numbers, read_json, size
from .geometry import OPENGL_AXES, from_quaternion, intrinsics, pose
from .readings import number_of

_METADATA = ("metadata.json", "metadata")
_IMAGES = ("rgbd", "rgb", "EXR_RGBD/rgb")


def matches(path: Path) -> bool:
    """True if the folder holds the metadata and a folder with images."""
    return bool(_files(path) and _images(path))


def read(path: Path) -> Capture:
    """Open an export.

    Raises:
        FrogError: if no image has a pose, or a value cannot be used.
    """
    file = _files(path)[0]
    data = read_json(file)
    poses = data.get("poses")
    if not isinstance(poses, list) or not poses or len(poses) > MAX_IMAGES:
        raise found_instead(file, "no list of poses", '"poses": [[qx, qy, qz, qw, tx, ty, tz], ...]')
    images = {number_of(image.stem): image for image in _images(path)}
    known = [index for index in range(len(poses)) if index in images]
    if not known:
        raise found_instead(path, f"{len(images)} images and {len(poses)} poses", "0.jpg, 1.jpg, ... for the poses")
    width, height = (size(data.get(side), file, side) for side in ("w", "h"))
    single = numbers(data.get("K"), (9,), file, "K").reshape(3, 3).T
    own = data.get("perFrameIntrinsicCoeffs")
    views = []
    for index in known:
        lens = [single[0, 0], single[1, 1], single[0, 2], single[1, 2]]
        if isinstance(own, list) and index < len(own):
            lens = numbers(own[index], (4,), file, f"perFrameIntrinsicCoeffs of {index}").tolist()
        values = numbers(poses[index], (7,), file, f"pose {index}")
        turn = from_quaternion(values[[3, 0, 1, 2]], file, f"pose {index}")
        world_to_camera = pose(OPENGL_AXES @ turn.T, values[4:])
        camera = Camera(str(index), width, height, intrinsics(*lens), world_to_camera)
        views.append(((camera, None), images[index], index))
    rate = number(data.get("fps", 30.0), file, "fps", positive=True, most=1e6)
    lacking = len(poses) - len(known)
    warnings = [f"{path}: {lacking} of {len(poses)} images are missing; their frames stay gaps."] if lacking else []
    return moving_cameras(path, "record3d", views, warnings, rate)


def _files(path: Path) -> list[Path]:
    return [path / name for name in _METADATA if (path / name).is_file()]


def _images(path: Path) -> list[Path]:
    """The images of the first folder that has some."""
    return next(filter(None, (find_images(path / name) for name in _IMAGES)), [])
