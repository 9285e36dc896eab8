"""Which films are of one kind of camera: of one size, and by one make and model where the files say so.

Videos say it in their tags, images in EXIF.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from ..media import film_tags, read_photograph
from ..readers.footage import images_in

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
_FIRMWARE_MODEL = re.compile(r"[A-Z]+\d+")


def kind_of(path: Path) -> str:
    """Make, model, and the lens where a phone has several, of a video or a folder of frames; "" where it is not said.

    Raises:
        FrogError: if the first frame cannot be read.
    """
    if not path.is_dir():
        return kind_by(film_tags(path))
    footage = images_in(path)
    return "" if footage is None else kind_in_image(footage.files[0])


def kind_in_image(path: Path) -> str:
    """The same by an image's EXIF; FrogError if the file cannot be read."""
    photograph = read_photograph(path)
    return "" if photograph is None else ", ".join(photograph.camera)


def kind_by(tags: Mapping[str, str]) -> str:
    """The same by a film's tags."""
    found: dict[str, str] = {}
    for tag, value in tags.items():
        name = _KNOWN.get(tag)
        if name is not None and value:
            found.setdefault(name, value)
    firmware = _FIRMWARE_MODEL.match(found.pop("firmware", ""))
    if firmware is not None:
        found.setdefault("model", firmware[0])
    return ", ".join(found[name] for name in ("make", "model", "focal length") if name in found)


def numbered(kinds: Sequence[tuple[int | tuple[int, int], str]]) -> list[int]:
    """A number for each film: equal for those of one size and kind, which share a focal length."""
    order = sorted(set(kinds))
    return [order.index(kind) for kind in kinds]
