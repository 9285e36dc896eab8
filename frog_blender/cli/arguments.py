"""Arguments that several commands take."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from ..engine.errors import FrogError


def positive(kind: Callable[[str], float]) -> Callable[[str], float]:
    """An argument type of ``int`` or ``float`` that takes positive numbers only."""

    def parse(text: str) -> float:
        value = kind(text)
        if not 0 < value < float("inf"):
            raise argparse.ArgumentTypeError(f"{text} is not a positive number")
        return value

    return parse


def seed(text: str) -> int:
    """An argument type: a number that everything random can begin with."""
    value = int(text)
    if not 0 <= value < 2**32:
        raise argparse.ArgumentTypeError(f"{text} is not between 0 and {2**32 - 1}")
    return value


def add_offset_argument(parser: argparse.ArgumentParser) -> None:
    """See ``offsets_of``."""
    parser.add_argument(
        "--pixel-offset",
        action="append",
        default=[],
        metavar="CAMERA=DX,DY",
        help="where a cropped video lies in its calibrated image",
    )


def offsets_of(options: argparse.Namespace) -> dict[str, tuple[float, float]] | None:
    """Pixels by camera, None where none was given; FrogError for what is no offset."""
    offsets = {}
    for text in options.pixel_offset:
        try:
            name, pair = text.split("=")
            dx, dy = pair.split(",")
            offsets[name] = (float(dx), float(dy))
        except ValueError:
            raise FrogError(f"--pixel-offset {text}: expected CAMERA=DX,DY such as cam01=8,0.") from None
    return offsets or None
