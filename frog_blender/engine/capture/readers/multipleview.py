"""4DGaussians' multipleview: ``cam01/frame_00001.jpg``, with COLMAP's model of the first frames in ``sparse_``.

An image of the model belongs to the camera folder with its number (``image1.jpg`` to ``cam01``). Without ``sparse_``
the rows of ``poses_bounds_multipleview.npy`` (see ``llff``) belong to the folders in their natural order.
(hustvl/4DGaussians, scene/multipleview_dataset.py and multipleviewprogress.sh.)

Times are the numbers of the frames. Nothing is held out: 4DGaussians tests on images it has trained on.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath

from ...errors import found_instead
from ..capture import Capture
from .assembly import standing_cameras, with_points
from .colmap_model import has_model, read_model
from .footage import Calibrated, Footage, find_footage, natural, of_cameras, on_common_frames
from .llff import read_rows, row_camera

_POSES = "poses_bounds_multipleview.npy"
_MODELS = ("sparse_", "sparse_/0")
_LAYOUT = "multipleview"


def matches(path: Path) -> bool:
    """True if the folder holds ``sparse_`` with a model, or ``poses_bounds_multipleview.npy``."""
    return (path / _POSES).is_file() or any(has_model(path / name) for name in _MODELS)


def read(path: Path) -> Capture:
    """Open a multipleview folder.

    Raises:
        FrogError: if no camera has a folder of frames, or a value cannot be used.
    """
    footage = [each for each in find_footage(path) if each.name.lower().startswith("cam")] or find_footage(path)
    if not footage:
        raise found_instead(path, "no folder of frames", "cam01, cam02, ... with frame_00001.jpg, ...")
    folder = next((path / name for name in _MODELS if has_model(path / name)), None)
    if folder is None:
        return _from_rows(path, footage)
    model = read_model(folder)
    images = {PurePosixPath(image.name).stem: image for image in model.images}
    found, warnings = of_cameras(folder, list(images), footage)
    pairs = sorted(found.items(), key=lambda pair: natural(pair[1].name))
    cameras = [model.camera(images[name], each.name) for name, each in pairs]
    capture = standing_cameras(path, _LAYOUT, cameras, [each for _, each in pairs], warnings)
    return with_points(capture, model.points)


def _from_rows(path: Path, footage: list[Footage]) -> Capture:
    rows = read_rows(path / _POSES)
    if len(rows) != len(footage):
        found = f"{len(rows)} rows for {len(footage)} folders of frames ({footage[0].name} to {footage[-1].name})"
        raise found_instead(path / _POSES, found, "one row for each folder")
    filmed = on_common_frames(path, footage)
    cameras: list[Calibrated] = [
        (row_camera(row, each.name, size, path / _POSES), None)
        for row, each, size in zip(rows, footage, filmed.sizes, strict=True)
    ]
    return standing_cameras(path, _LAYOUT, cameras, footage, filmed=filmed)
