"""Opening a capture folder: which layout is it, and which reader reads it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from ...errors import FrogError
from ..capture import Capture
from . import calibrated_videos, hypernerf, n3dv, technicolor, transforms_json
from .checks import checked
from .local_world import localized

_READERS = {
    "n3dv": n3dv,
    "transforms": transforms_json,
    "hypernerf": hypernerf,
    "technicolor": technicolor,
    "calibrated_videos": calibrated_videos,
}
KNOWN_LAYOUTS = (
    "videos with poses_bounds.npy (N3DV), images with transforms.json, transforms_train.json, "
    "dataset.json and camera (HyperNeRF) or cameras_parameters.txt (Technicolor), "
    "or videos with cameras_opencv.json or *.qca.txt"
)


def detect(path: Path) -> str:
    """Name of the layout of a capture folder: ``"n3dv"``, ``"transforms"``, ``"hypernerf"``, ``"technicolor"`` or
    ``"calibrated_videos"``.

    Raises:
        FrogError: if the folder does not exist, cannot be read or fits no known layout.
    """
    path = Path(path)
    with _readable(path):
        return _detect(path)


def _detect(path: Path) -> str:
    if not path.exists():
        raise FrogError(f"{path}: there is no such folder, expected a capture: {KNOWN_LAYOUTS}.")
    if not path.is_dir():
        raise FrogError(f"{path}: found a file, expected the folder of a capture: {KNOWN_LAYOUTS}.")
    for name, reader in _READERS.items():
        if reader.matches(path):
            return name
    raise FrogError(f"{path}: found {_contents(path)}, expected {KNOWN_LAYOUTS}.")


def open_capture(path: Path, *, pixel_offsets: Mapping[str, tuple[float, float]] | None = None) -> Capture:
    """Open a capture folder of any known layout, without decoding it.

    Args:
        path: the folder.
        pixel_offsets: for cameras by name, the pixel (dx, dy) of the calibrated image at which the video's
            upper left corner lies, for videos that were cropped after calibration.

    Raises:
        FrogError: with one sentence, if the folder cannot be used.
    """
    path = Path(path)
    with _readable(path):
        capture = localized(checked(_READERS[detect(path)].read(path)))
    return capture.with_pixel_offsets(pixel_offsets) if pixel_offsets else capture


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """What the disk refuses is a FrogError: folders without permission, names that are too long."""
    try:
        yield
    except OSError as error:
        where, reason = error.filename or path, error.strerror or error
        raise FrogError(f"{where}: could not be read ({reason}), expected a part of a capture.") from error


def _contents(folder: Path) -> str:
    """What a folder holds, in words: ``3 .mp4 files and 1 folder``."""
    entries = [entry for entry in folder.iterdir() if not entry.name.startswith(".")]
    if not entries:
        return "an empty folder"
    kinds = Counter("folder" if e.is_dir() else f"{e.suffix.lower() or 'nameless'} file" for e in entries)
    parts = [f"{count} {kind}{'s' if count > 1 else ''}" for kind, count in kinds.most_common(4)]
    return " and ".join([", ".join(parts[:-1]), parts[-1]]) if len(parts) > 1 else parts[0]
