"""4DGaussians' multipleview: ``cam01/frame_00001.jpg``, with COLMAP's model of the first frames in ``sparse_``.

An image of the model belongs to the camera folder with its number (``image1.jpg`` to ``cam01``). Without ``sparse_``
the rows of ``poses_bounds_multipleview.npy`` (see ``n3dv``) belong to the folders in their natural order.
(hustvl/4DGaussians, scene/multipleview_dataset.py and multipleviewprogress.sh.)

Times are the numbers of the frames. Nothing is held out: 4DGaussians tests on images it has trained on.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath

from ...errors import found_instead
from ..capture import Capture
from .assembly import matched, standing_cameras, with_points
from .colmap_model import has_model, read_model
from .footage import find_footage
from .n3dv import read_rows

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
    footage = find_footage(path)
    footage = [filmed for filmed in footage if filmed.name.lower().startswith("cam")] or footage
    if not footage:
        raise found_instead(path, "no folder of frames", "cam01, cam02, ... with frame_00001.jpg, ...")
    folder = next((path / name for name in _MODELS if has_model(path / name)), None)
    if folder is None:
        return read_rows(path, _LAYOUT, path / _POSES, footage)[0]
    model = read_model(folder)
    cameras = [model.camera(image, PurePosixPath(image.name).stem) for image in model.images]
    of_films = matched(folder, cameras, footage, named_by_film=True)
    return with_points(standing_cameras(path, _LAYOUT, *of_films), model.points)
