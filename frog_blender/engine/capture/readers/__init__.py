"""Opening a capture folder: which layout is it, and which reader reads it."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

from ...errors import CaptureRefused, FrogError, brief, found_instead, reason, told_as
from ...notices import say
from ...registry import READERS, guests_named
from ..capture import Capture
from ..masking import EVERY_MASK, MaskSettings
from ..video import find_videos
from .assembly import localized
from .checks import checked
from .footage import find_footage, is_recording
from .mask_files import with_masks
from .near_layouts import not_a_folder, unknown_folder
from .readings import AUTO, chosen_layout

_LOOKED_BELOW = 200  # folders
_WITHOUT_NAMES = frozenset({"hypernerf", "panoptic_sports", "technicolor"})
"""Layouts whose files say which camera and time each image has, so that nobody need say how names are read."""


@told_as(CaptureRefused)
def detect(path: Path) -> str:
    """Name of the layout of a capture folder, such as ``"n3dv"``, or of the only capture one folder deeper.

    Raises:
        FrogError: if the folder does not exist, cannot be read or fits no known layout: one sentence that says what
            it is, or nearly is, and what is missing.
    """
    return _located(Path(path))[1]


def layout_of(path: Path) -> str | None:
    """The layout of this very folder; None if no reader knows it. FrogError if it cannot be read."""
    with _readable(path):
        return next((name for name in READERS if _matches(name, path)), None)


def _located(path: Path) -> tuple[Path, str]:
    """The folder of the capture, ``path`` or the only capture one folder deeper, as archives unpack, and its layout."""
    with _readable(path):
        if not path.is_dir() and not is_recording(path):
            raise not_a_folder(path)
        if layout := layout_of(path):
            return path, layout
        if not path.is_dir() and not find_footage(path):
            raise not_a_folder(path)
        if not path.is_dir() or find_videos(path):  # which somebody wants to use, whatever lies below
            raise unknown_folder(path, [])
        entries = (entry for entry in path.iterdir() if not entry.name.startswith(".") and entry.is_dir())
        below = [(folder, layout) for folder in islice(entries, _LOOKED_BELOW) if (layout := layout_of(folder))]
        if len(below) == 1:
            return below[0]
        raise unknown_folder(path, sorted(folder for folder, _ in below))


def _matches(name: str, path: Path) -> bool:
    """Whether a reader knows a folder. One that cannot say so, of a package that is not ours, stops no other."""
    try:
        return bool(READERS[name].matches(path))
    except FileNotFoundError:  # of a path that names a recording, where no folder is
        return False
    except Exception as error:
        if READERS.is_ours(name) or isinstance(error, OSError | MemoryError):
            raise
        say(f"The reader {name!r} is passed over: {reason(error)}.")
        return False


@told_as(CaptureRefused)
def open_capture(
    path: Path,
    *,
    pixel_offsets: Mapping[str, tuple[float, float]] | None = None,
    masks: MaskSettings = EVERY_MASK,
    layout: str = AUTO,
) -> Capture:
    """Open a capture folder of any known layout, without decoding it.

    Args:
        path: the folder, or one that holds the capture's as the only one.
        pixel_offsets: for cameras by name, the pixel (dx, dy) of the calibrated image at which the video's
            upper left corner lies, for videos that were cropped after calibration.
        masks: what is made of masks and alpha; by default they count.
        layout: which cameras and times the names of images tell, where they can be read in several ways: a value of
            ``readings.CHOSEN``.

    Raises:
        CaptureRefused: with one sentence, if the folder cannot be used.
    """
    folder, reader = _located(Path(path))
    if layout != "auto" and reader in _WITHOUT_NAMES:
        raise found_instead(folder, f"a {reader} capture, whose files say it, and --layout {layout}", "--layout auto")
    with guests_named(), _readable(folder), chosen_layout(layout):
        capture = READERS[reader].read(folder)
        if not isinstance(capture, Capture):
            raise FrogError(f"The reader {reader!r} gave {type(capture).__name__} for {folder}, expected a Capture.")
        capture = with_masks(localized(checked(capture)), masks)
    return capture.with_pixel_offsets(pixel_offsets) if pixel_offsets else capture


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """What the disk refuses is a FrogError: folders without permission, names that are too long."""
    try:
        yield
    except OSError as error:
        where, reason = error.filename or path, error.strerror or error
        raise FrogError(f"{brief(where)}: could not be read ({reason}), expected a part of a capture.") from error
