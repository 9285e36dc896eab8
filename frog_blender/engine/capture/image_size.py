"""The size of an image from its file's first bytes: captures list hundreds of them, and decoding them takes long."""

from __future__ import annotations

from pathlib import Path

from ..errors import found_instead
from ..io.regular_file import regular_file
from .image_header import size_in_header
from .orientation import is_mirrored, orientation_in_header, quarter_turns, turned_size
from .video import check_image_size, read_image


def image_size(path: Path) -> tuple[int, int]:
    """(width, height) as ``read_image`` decodes them; PNG and JPEG are not decoded for it.

    Raises:
        FrogError: if the file is missing or no image, or one too large to be decoded.
    """
    try:
        with regular_file(path, "an image").open("rb") as file:
            size = size_in_header(file)
            file.seek(0)
            turns = quarter_turns(orientation_in_header(file))
    except OSError as error:
        raise found_instead(path, f"a file that cannot be read ({error.strerror})", "an image") from error
    if size is None or min(size) < 1:
        height, width = read_image(path).shape[:2]
        return width, height
    check_image_size(path, size)
    return turned_size(size, turns)


def image_turns(path: Path) -> int:
    """Quarter turns clockwise by which ``read_image`` turns what the file stores; 0 where it also mirrors it.

    Raises:
        FrogError: if the file is missing or cannot be read.
    """
    try:
        with regular_file(path, "an image").open("rb") as file:
            orientation = orientation_in_header(file)
    except OSError as error:
        raise found_instead(path, f"a file that cannot be read ({error.strerror})", "an image") from error
    return 0 if is_mirrored(orientation) else quarter_turns(orientation)
