"""Which films are of one kind of camera: of one size, and by one make and model where the files say so.

Videos say it in their tags, images in EXIF.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from ...errors import found_instead
from ...io.regular_file import regular_file
from ..exif import FOCAL_LENGTH_35MM, MAKE, MODEL, exif_tags
from ..ffmpeg import notes
from ..readers.footage import images_in

_TAG = re.compile(r"^\s*([\w.:\-]+)\s*:\s*(.+?)\s*$", re.MULTILINE)
_KNOWN = {
    "com.apple.quicktime.make": "make",
    "com.apple.quicktime.model": "model",
    "com.apple.quicktime.camera.focal_length.35mm_equivalent": "focal length",
    "com.android.manufacturer": "make",
    "com.android.model": "model",
    "make": "make",
    "model": "model",
    "firmware": "firmware",  # GoPro's begins with its model: HD9.01.01.60.00
}
_EXIF = (MAKE, MODEL, FOCAL_LENGTH_35MM)
_FIRMWARE_MODEL = re.compile(r"[A-Z]+\d+")


def kind_of(path: Path) -> str:
    """Make, model, and the lens where a phone has several, of a video or a folder of frames; "" where it is not said.

    Raises:
        FrogError: if the first frame cannot be read.
    """
    if not path.is_dir():
        return kind_by(notes(path))
    footage = images_in(path)
    return "" if footage is None else kind_in_image(footage.files[0])


def kind_in_image(path: Path) -> str:
    """The same by an image's EXIF; FrogError if the file cannot be read."""
    try:
        with regular_file(path, "an image").open("rb") as file:
            said = exif_tags(file, _EXIF)
    except OSError as error:
        raise found_instead(path, f"a file that cannot be read ({error.strerror})", "an image") from error
    return ", ".join(str(said[tag]) for tag in _EXIF if said.get(tag))


def kind_by(said: str) -> str:
    """The same by ffmpeg's notes on a film."""
    found: dict[str, str] = {}
    for tag, value in _TAG.findall(said):
        name = _KNOWN.get(tag.lower())
        if name is not None:
            found.setdefault(name, value)
    firmware = _FIRMWARE_MODEL.match(found.pop("firmware", ""))
    if firmware is not None:
        found.setdefault("model", firmware[0])
    return ", ".join(found[name] for name in ("make", "model", "focal length") if name in found)


def numbered(kinds: Sequence[tuple[int | tuple[int, int], str]]) -> list[int]:
    """A number for each film: equal for those of one size and kind, which share a focal length."""
    order = sorted(set(kinds))
    return [order.index(kind) for kind in kinds]
