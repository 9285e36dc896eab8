"""Arguments that several commands take."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from ..engine.capture.pixel_offsets import parse_pixel_offsets
from ..engine.errors import FrogError

if TYPE_CHECKING:
    from ..engine.editing.timing import Timing
    from ..engine.playback.player import ScenePlayer


def positive(kind: Callable[[str], float]) -> Callable[[str], float]:
    """The argument type of positive numbers, ``int`` or ``float``."""

    def parse(text: str) -> float:
        value = kind(text)
        if not 0 < value < float("inf"):
            raise argparse.ArgumentTypeError(f"{text} is not a positive number")
        return value

    return parse


def seed(text: str) -> int:
    """The argument type of a random seed."""
    value = int(text)
    if not 0 <= value < 2**32:
        raise argparse.ArgumentTypeError(f"{text} is not between 0 and {2**32 - 1}")
    return value


def add_offset_argument(parser: argparse.ArgumentParser) -> None:
    """Adds ``--pixel-offset``; see ``offsets_of``."""
    parser.add_argument(
        "--pixel-offset",
        action="append",
        default=[],
        metavar="CAMERA=DX,DY",
        help="pixel of the calibrated image at a cropped video's upper left corner",
    )


def offsets_of(options: argparse.Namespace) -> dict[str, tuple[float, float]] | None:
    """Pixel offsets by camera, None where none were given; FrogError for a malformed one."""
    return parse_pixel_offsets(options.pixel_offset, "--pixel-offset")


def add_mask_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds ``--masks`` and ``--key``."""
    parser.add_argument(
        "--masks",
        choices=["auto", "off"],
        default="auto",
        help="auto: only the subject of images with alpha or masks, off: whole images",
    )
    parser.add_argument(
        "--key",
        metavar="COLOUR[,TOLERANCE]",
        help="backdrop that is not part of the subject: green, blue or #00b140; tolerance from 0 to 0.95, default 0.4",
    )


def add_frames_argument(parser: argparse.ArgumentParser) -> None:
    """Adds ``--frames``; see ``frames_of``."""
    parser.add_argument("--frames", default=None, metavar="A:B", help="frames A to B - 1, counted from 0; default: all")


def frames_of(text: str | None, count: int) -> range:
    """``A:B`` as the frames A to B - 1 of ``count``, either end optional; all of them for None.

    Raises:
        FrogError: for other text, no frame, or frames that the scene does not have.
    """
    try:
        first, last = text.split(":") if text else ("", "")
        frames = range(int(first or 0), int(last or count))
    except ValueError:
        raise FrogError(f"--frames {text}: expected A:B, such as 0:30.") from None
    if not frames or frames[0] < 0 or frames[-1] >= count:
        raise FrogError(f"--frames {text}: expected frames between 0:{count}.")
    return frames


def add_edits_argument(parser: argparse.ArgumentParser) -> None:
    """Adds ``--edits``; see ``edited_scene``."""
    parser.add_argument(
        "--edits", type=Path, default=None, metavar="FILE", help="crops, grades, timing and so on, saved in Blender"
    )


def edited_scene(scene: ScenePlayer, path: Path | None) -> tuple[ScenePlayer, Timing | None]:
    """A scene with the edits in a file, the scene itself without one, and how the file retimes it; warns of what was
    made for another scene.

    Raises:
        FrogError: for a file that holds no edits.
    """
    if path is None:
        return scene, None
    from ..engine.editing.edited_scene import edited
    from ..engine.editing.edits_file import load_edits

    edits = load_edits(path)
    played, dropped = edited(scene, edits)
    for sentence in dropped:
        print(f"warning: {path}: {sentence}", file=sys.stderr)
    return played, edits.timing
