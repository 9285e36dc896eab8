"""Exports of programs on phones: one moving camera, of which every eighth frame is held out. Depth is not used.

**Record3D**: ``metadata.json`` or ``metadata``, and images 0.jpg, 1.jpg, ... in ``rgbd`` or ``rgb``. ``K`` lists a
3 x 3 matrix column by column, for images of ``w`` x ``h`` pixels; ``perFrameIntrinsicCoeffs`` (fx, fy, cx, cy) replaces
it where it is there. ``poses`` are a quaternion x y z w and a position. ``fps`` is the rate. (record3d.app; nerfstudio,
process_data/record3d_utils.py, which moves the principal point to the middle: here it stays.)

**Polycam**'s raw export: ``keyframes/cameras/*.json`` and ``keyframes/images/*.jpg``, or their ``corrected_`` folders,
with poses that Polycam has optimised, which are preferred. A file for each image: ``fx``, ``fy``, ``cx``, ``cy`` for
``width`` x ``height`` pixels, and ``t_00`` .. ``t_23``, the rows of the pose. Names are times, so that images lie
between frames. (PolyCam/polyform, README; nerfstudio, process_data/polycam_utils.py.)

Poses of both are camera to world in OpenGL's axes (x right, y up, looking along -z), in metres.
"""

from pathlib import Path
from types import SimpleNamespace

from ...errors import found_instead
from ..camera import Camera
from ..capture import MAX_IMAGES, Capture
from ..natural_order import natural
from ..video import find_images, with_ending
from .assembly import moving_cameras
from .checks import number, numbers, read_json, rotation, size
from .geometry import OPENGL_AXES, from_quaternion, intrinsics, pose
from .readings import number_of, numbers_of

_METADATA = ("metadata.json", "metadata")
_IMAGES = ("rgbd", "rgb", "EXR_RGBD/rgb")
_KEYFRAMES = "keyframes"
_FOLDERS = (("corrected_cameras", "corrected_images"), ("cameras", "images"))


def _read_record3d(path: Path) -> Capture:
    """Open an export of Record3D.

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


def _read_polycam(path: Path) -> Capture:
    """Open an export of Polycam.

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


RECORD3D = SimpleNamespace(matches=lambda path: _files(path) and _images(path), read=_read_record3d)
POLYCAM = SimpleNamespace(matches=_folders, read=_read_polycam)
