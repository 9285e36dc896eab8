"""Cameras as Nerfies lists them: HyperNeRF's and Nerfies' captures, and Google's Immersive Light Field Video.

``focal_length``, ``principal_point`` and ``pixel_aspect_ratio`` (1 where it is missing) are in pixels,
``orientation`` is the world-to-camera rotation in OpenCV's axes and ``position`` the centre.

**HyperNeRF and Nerfies**: ``dataset.json``, ``metadata.json``, ``camera/ID.json`` and ``rgb/Nx/ID.png``. Every image
has its own camera; lengths in pixels belong to the 1x images, whose corner is (0, 0). ``dataset.json`` says which
images are for training and which are held out. A rig of two cameras ("vrig") has two images a frame: one is for
training and the other is held out, left and right in turn. (google/nerfies, nerfies/camera.py and its README.) Lens
distortion and skew are removed when frames are decoded. World units are the files' own: ``scene.json``'s centre and
scale are not applied.

**Immersive**: ``models.json`` and ``camera_0001.mp4``, or folders of frames. A list of cameras, with ``name``,
``width``, ``height`` and ``radial_distortion``; ``orientation`` is a rotation vector. They are fisheyes unless
``projection_type`` is "perspective": the angle theta to the axis is seen at focal length times theta (1 + k1 theta^2 +
k2 theta^4), which is ``cv2.fisheye``. The first camera, in the rig's middle, is held out, as SpacetimeGaussians does.
(Broxton et al. 2020; oppo-us-research/SpacetimeGaussians, script/pre_immersive_distorted.py.)
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from ...arrays import Float64s
from ...errors import found_instead
from ..camera import Camera
from ..capture import LARGEST_SIDE, Capture, Shot
from ..lenses import FISHEYE
from ..seeding.views import depth_range
from ..video import image_size, with_ending
from .assembly import assembled, matched, standing_cameras
from .checks import frame_span, number, numbers, parsed_json, read_json, read_table, records, size, usable_points
from .footage import Footage
from .geometry import Calibrated, distortion, intrinsics, pose, through_lens, vector_or_matrix
from .pairing import Pairing
from .projects import recorded

_DATASET, _METADATA, _SCENE, _POINTS = "dataset.json", "metadata.json", "scene.json", "points.npy"
_USUAL = "2x"  # the size at which HyperNeRF and later papers evaluate
_MAX_POINTS = 10_000_000
_MAX_TIME = 2**53  # floats are exact integers up to here


def matches(path: Path) -> bool:
    """True if the folder holds ``dataset.json`` and a folder ``camera``."""
    return (path / _DATASET).is_file() and (path / "camera").is_dir()


def read(path: Path) -> Capture:
    """Open a HyperNeRF or Nerfies folder.

    The images of ``rgb/2x`` are taken, as in the papers; without them the largest of at most 1600 pixels a side.
    If ``dataset.json`` holds nothing out, the papers' rule applies: of every four ids the first is for training and the
    third is held out.

    Raises:
        FrogError: if a file is missing, no listed image exists, or a value cannot be used.
    """
    warnings: list[str] = []
    train, held_out = _split(path, warnings)
    images = _images(path, [*train, *held_out], warnings)
    train, held_out = ([name for name in names if name in images] for names in (train, held_out))
    if not train:
        raise found_instead(path / _DATASET, "no image to train on", "train_ids with images in rgb and in camera")
    names = [*train, *held_out]
    frames = _frames(path, names)
    points = usable_points(read_table(path / _POINTS, 3, _MAX_POINTS)) if (path / _POINTS).is_file() else None
    shots = [Shot(index, frames[name], images[name], 0) for index, name in enumerate(names)]
    capture = assembled(
        path,
        "hypernerf",
        [_camera(name, path / "camera" / f"{name}.json") for name in names],
        [Footage.of_image(images[name]) for name in names],
        Pairing(shots, max(frames.values()) + 1, warnings=warnings),
        test_cameras=frozenset(held_out),
        points=points,
    )
    return replace(capture, near_far=_near_far(path, capture.cameras[: len(train)], points))


def _split(path: Path, warnings: list[str]) -> tuple[list[str], list[str]]:
    """Names of the images to train on and of those held out."""
    data = read_json(path / _DATASET)
    listed = {key: _names(data.get(key, []), path / _DATASET, key) for key in ("ids", "train_ids", "val_ids")}
    train, held_out = listed["train_ids"], listed["val_ids"]
    if not held_out:
        ids = listed["ids"] or train
        train, held_out = ids[0::4], ids[2::4]
        if held_out:
            warnings.append(
                f"{path / _DATASET}: val_ids is empty; of every four images the first is trained on, "
                "the third is held out and the others are left out."
            )
    if both := set(train) & set(held_out):
        warnings.append(f"{path / _DATASET}: {len(both)} of the train_ids are also in val_ids and are held out.")
    return [name for name in train if name not in both], held_out


def _names(value: object, path: Path, key: str) -> list[str]:
    """The list of image names under a key, each once."""
    if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
        raise found_instead(path, f"{key} that is not a list of names", f'"{key}": ["000001", ...]')
    for name in value:
        if not name or "\0" in name or "\\" in name or Path(name).name != name:
            raise found_instead(path, f"the image name {name!r} in {key}", "a name without folders")
    return list(dict.fromkeys(value))


def _images(path: Path, names: list[str], warnings: list[str]) -> dict[str, Path]:
    """The image files by name, of those that have one and a camera: those in ``rgb/2x``, or in the folder beside it
    whose images fit best."""
    folders: dict[Path, dict[str, Path]] = {}
    for folder in sorted(path.glob("rgb/*x")):
        if files := {name: file for name in names if (file := with_ending(folder / name)) is not None}:
            folders[folder] = files
    if not folders:
        raise found_instead(path, "none of the listed images", f"them in rgb/{_USUAL} (or rgb/1x, rgb/4x, ...)")
    chosen = path / "rgb" / _USUAL
    if chosen not in folders:
        sides = {folder: max(image_size(next(iter(files.values())))) for folder, files in folders.items()}
        fitting = [folder for folder, side in sides.items() if side <= LARGEST_SIDE]
        chosen = max(fitting, key=sides.__getitem__) if fitting else min(sides, key=sides.__getitem__)
        warnings.append(f"{path}: there are no images in rgb/{_USUAL}, those of rgb/{chosen.name} are taken.")
    usable = {name: file for name, file in folders[chosen].items() if (path / "camera" / f"{name}.json").is_file()}
    if lacking := [name for name in names if name not in usable]:
        warnings.append(
            f"{path}: {len(lacking)} of {len(names)} listed images (the first is {lacking[0]}) lack their file in "
            f"{chosen.name} or in camera and are left out."
        )
    return usable


def _frames(path: Path, names: list[str]) -> dict[str, int]:
    """The frame of each image, counted from 0 in the largest step that divides all differences."""
    file = path / _METADATA
    metadata = read_json(file)
    entries = {name: entry for name in names if isinstance(entry := metadata.get(name), dict)}
    if lacking := [name for name in names if name not in entries]:
        raise found_instead(file, f"nothing about the image {lacking[0]}", '{"warp_id": ...}')
    key = "time_id" if all("time_id" in entry for entry in entries.values()) else "warp_id"
    values = [number(entry.get(key), file, f"{key} of {name}", most=_MAX_TIME) for name, entry in entries.items()]
    whole = np.array(values).round().astype(np.int64)
    if np.abs(whole - values).max() > 1e-6:
        raise found_instead(file, f"a {key} with a fraction", "whole numbers")
    whole -= whole.min()
    whole //= max(int(np.gcd.reduce(whole)), 1)
    frame_span(0, int(whole.max()), file, f"{key}s, counted in their steps,")
    return dict(zip(names, whole.tolist(), strict=True))


def _camera(name: str, file: Path) -> Calibrated:
    """The camera of one image at its 1x size."""
    data = read_json(file)
    sides = numbers(data.get("image_size"), (2,), file, "image_size")
    width, height = (size(side, file, "image_size") for side in sides)
    matrix, world_to_camera = _view(data, file)
    radial = numbers(data.get("radial_distortion", [0.0] * 3), (3,), file, "radial_distortion")
    old_name = data.get("tangential", [0.0] * 2)  # of the first Nerfies captures
    tangential = numbers(data.get("tangential_distortion", old_name), (2,), file, "tangential_distortion")
    skew = number(data.get("skew", 0.0), file, "skew") / matrix[0, 0]
    coefficients = np.array([*radial[:2], *tangential, radial[2]])
    return Camera(name, width, height, matrix, world_to_camera), distortion(coefficients, skew)


def _near_far(path: Path, cameras: Sequence[Camera], points: Float64s | None) -> tuple[float, float] | None:
    """Depth range of the scene in world units: of its points if there are enough, else from ``scene.json``."""
    if points is not None and (measured := depth_range(cameras[:: -(-len(cameras) // 8)], points)):
        return measured
    file, keys = path / _SCENE, ("scale", "near", "far")
    scene = read_json(file) if file.is_file() else {}
    if any(key not in scene for key in keys):
        return None
    scale, near, far = (number(scene[key], file, key, positive=key == "scale") for key in keys)
    if not 0 < near < far:
        raise found_instead(file, f"near = {near:g} and far = {far:g}", "0 < near < far")
    return near / scale, far / scale


def _view(data: Mapping[str, object], file: Path, of: str = "") -> tuple[Float64s, Float64s]:
    """K (3, 3), and the pose (4, 4) from world to camera of a camera.

    Args:
        of: whose they are, for the sentence.

    Raises:
        FrogError: for a value that cannot be used.
    """
    focal = number(data.get("focal_length"), file, f"focal_length{of}", positive=True)
    aspect = number(data.get("pixel_aspect_ratio", 1.0), file, f"pixel_aspect_ratio{of}", positive=True)
    center = numbers(data.get("principal_point"), (2,), file, f"principal_point{of}")
    turn = vector_or_matrix(data.get("orientation"), file, f"orientation{of}")
    position = numbers(data.get("position"), (3,), file, f"position{of}")
    return intrinsics(focal, focal * aspect, *center), pose(turn, position)


def _read_immersive(path: Path) -> Capture:
    """Open a scene of Immersive.

    Raises:
        FrogError: if no camera has a film, or a value cannot be used.
    """
    file = path / "models.json"
    entries = records(parsed_json(file), file, "cameras", '[{"name": "camera_0001", ...}, ...]')
    cameras = [_immersive_camera(entry, file) for entry in entries]
    footage = recorded(path, [camera.name for camera, _ in cameras])
    capture = standing_cameras(path, "immersive", *matched(file, cameras, footage))
    first, *others = (camera.name for camera in capture.cameras)
    return replace(capture, test_cameras=frozenset({first} if others else ()))


def _immersive_camera(entry: dict[str, object], file: Path) -> Calibrated:
    name = entry.get("name")
    if not isinstance(name, str) or not name:
        raise found_instead(file, "a camera without a name", "the name of its film")
    width, height = (size(entry.get(side), file, f"{side} of {name}") for side in ("width", "height"))
    listed = entry.get("radial_distortion", [0.0, 0.0])
    count = len(listed) if isinstance(listed, list) else 0
    if not 1 <= count <= 4:
        raise found_instead(file, f"radial_distortion of {name} that is no list of 1 to 4 numbers", "[k1, k2]")
    radial = np.zeros(4)
    radial[:count] = numbers(listed, (count,), file, f"radial_distortion of {name}")
    camera = Camera(name, width, height, *_view(entry, file, f" of {name}"))
    if (projection := entry.get("projection_type", FISHEYE)) == FISHEYE:
        return through_lens(camera, FISHEYE, radial, file)
    if projection != "perspective":
        raise found_instead(file, f"the projection_type {projection} of {name}", "fisheye or perspective")
    return camera, distortion(np.array([*radial[:2], 0.0, 0.0, radial[2]]))


IMMERSIVE = SimpleNamespace(matches=lambda path: (path / "models.json").is_file(), read=_read_immersive)
