"""PanopticSports as Dynamic 3D Gaussians has it: ``train_meta.json``, ``test_meta.json`` and ``ims``.

The lists are nested by time, then camera: ``fn`` (paths below ``ims``), ``k`` (3 x 3, pixels), ``w2c`` (4 x 4, world
to camera in OpenCV's axes), ``cam_id``; ``w`` and ``h`` are of all images. The cameras of ``test_meta.json`` are held
out. ``data`` in ``init_pt_cld.npz`` (optional) is (N, 6 or more): place, colour, and whether it belongs to what
moves. (JonathonLuiten/Dynamic3DGaussians, train.py.)
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ...arrays import Float64s
from ...errors import found_instead
from ...io.numpy_files import read_npz
from ..camera import Camera
from ..capture import Capture, Shot
from .assembly import assembled
from .checks import frame_span, number, path_inside, pinhole, read_json, rigid, size, usable_points
from .footage import Footage
from .pairing import Pairing

_TRAIN, _TEST, _IMAGES, _POINTS = "train_meta.json", "test_meta.json", "ims", "init_pt_cld.npz"
_KEYS = ("fn", "k", "w2c", "cam_id")
_MOST_POINTS = 2_000_000


@dataclass(frozen=True, eq=False)
class _Entry:
    """A listed image that exists, and its camera, which has the id as its name."""

    frame: int
    image: Path
    camera: Camera


def matches(path: Path) -> bool:
    """True if the folder holds ``train_meta.json``."""
    return (path / _TRAIN).is_file()


def read(path: Path) -> Capture:
    """Open a PanopticSports folder.

    Raises:
        FrogError: if no listed image exists, or a value cannot be used.
    """
    warnings: list[str] = []
    train = _entries(path, path / _TRAIN, warnings)
    if not train:
        raise found_instead(path / _TRAIN, "images of which none exists", f"them in {_IMAGES}")
    entries = [*train, *(_entries(path, path / _TEST, warnings) if (path / _TEST).is_file() else [])]
    names = _names(entries)
    named = list(zip(names, entries, strict=True))[::-1]  # so that the first of several stays
    first, images = dict(named), {(name, entry.frame): entry.image for name, entry in named}
    index = {name: index for index, name in enumerate(dict.fromkeys(names))}
    shots = [Shot(index[name], frame, image, 0) for (name, frame), image in images.items()]
    return assembled(
        path,
        "panoptic_sports",
        [(replace(first[name].camera, name=name), None) for name in index],
        [Footage.of_image(first[name].image) for name in index],
        Pairing(shots, max(entry.frame for entry in entries) + 1, warnings=warnings),
        test_cameras=frozenset(names[len(train) :]) - frozenset(names[: len(train)]),
        points=_points(path / _POINTS),
    )


def _entries(path: Path, file: Path, warnings: list[str]) -> list[_Entry]:
    """The listed images that exist."""
    data = read_json(file)
    width, height = (size(data.get(key), file, key) for key in ("w", "h"))
    entries, listed = [], 0
    times = _together([data.get(key) for key in _KEYS], file, "")
    frame_span(0, len(times) - 1, file, "times")
    for frame, at_time in enumerate(times):
        for name, matrix, pose, camera in _together(at_time, file, f" at time {frame}"):
            listed += 1
            where = f"camera {camera} at time {frame}"
            image = path_inside(path / _IMAGES, name, file, f"fn of {where}")
            if image.is_file():
                intrinsics = pinhole(matrix, file, f"k of {where}")
                world_to_camera = rigid(pose, file, f"w2c of {where}")
                named = f"{number(camera, file, 'cam_id'):g}"
                entries.append(_Entry(frame, image, Camera(named, width, height, intrinsics, world_to_camera)))
    if entries and len(entries) < listed:
        warnings.append(f"{file}: {listed - len(entries)} of {listed} listed images are missing and left out.")
    return entries


def _together(lists: Sequence[object], file: Path, when: str) -> list[tuple[object, ...]]:
    """What lists of one length have at the same places."""
    columns = [values for values in lists if isinstance(values, list)]
    if len(columns) < len(_KEYS) or len({len(column) for column in columns}) > 1 or not columns[0]:
        found = f"no lists {', '.join(_KEYS)} of one length{when}"
        raise found_instead(file, found, "these lists, nested by time and camera")
    return list(zip(*columns, strict=True))


def _names(entries: list[_Entry]) -> list[str]:
    """The name of each image's camera: its id where it stands; else id and time, an image being a camera."""
    cameras = [entry.camera for entry in entries]
    views = {(camera.name, camera.intrinsics.tobytes(), camera.world_to_camera.tobytes()) for camera in cameras}
    if len(views) == len({name for name, _, _ in views}):
        return [entry.camera.name for entry in entries]
    return [f"{entry.camera.name}_{entry.frame:05d}" for entry in entries]


def _points(file: Path) -> Float64s | None:
    """(N, 3) points in world units, None where the capture has none."""
    if not file.is_file():
        return None

    def check(name: str, shape: tuple[int, ...]) -> None:
        if name == "data" and (len(shape) != 2 or shape[1] < 3):
            raise found_instead(file, f"data of shape {shape}", "points of shape (N, 7)")

    arrays = read_npz(file, "points (init_pt_cld.npz)", 7 * _MOST_POINTS, check)
    if "data" not in arrays:
        raise found_instead(file, f"arrays {', '.join(arrays) or 'none'}", "data")
    return usable_points(arrays["data"][:, :3])
