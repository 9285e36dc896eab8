"""A board in films: looked for, and then the cameras that saw it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from ...arrays import ImageArray
from ...io.child_process import Progress
from ..readers.film_frames import decode_film
from .board import calibrate_board
from .board_detection import Board, Corners, find_board, find_corners
from .calibration import Calibration
from .films import Film
from .rig_result import CameraFacts

TIMES = 60
"""Common times at which the board is looked at: more of them cost time and win little."""
_IMAGES = 24  # of all films together, in which an unknown board is looked for


def board_in_films(films: Sequence[Film], times: Sequence[float], cancelled: Callable[[], None]) -> Board | None:
    """The board that the films show at capture times in seconds, of unknown size; None where they show none."""
    images: list[ImageArray] = []
    share = max(3, _IMAGES // len(films))
    for film in films:
        chosen = np.unique(np.linspace(0, len(times) - 1, min(share, len(times))).round().astype(int)).tolist()
        images += [image for image in images_at(film, [times[each] for each in chosen], cancelled) if image is not None]
    return find_board(images)


def calibrate_board_films(
    films: Sequence[Film], times: Sequence[float], board: Board, progress: Progress, cancelled: Callable[[], None]
) -> Calibration:
    """The cameras of films that show a board at common capture times in seconds.

    Args:
        cancelled: called before each image; it raises what ends the work.

    Raises:
        CalibrationRefused: see ``board.calibrate_board``.
        FrogError: for a film that cannot be decoded.
    """
    corners: list[list[Corners | None]] = []
    for number, film in enumerate(films):
        progress("board", number, len(films))
        corners.append(list(find_corners(board, images_at(film, times, cancelled))))
    progress("bundle adjustment", 0, 1)
    return calibrate_board([CameraFacts(film.name, *film.size) for film in films], board, corners)


def images_at(film: Film, times: Sequence[float], cancelled: Callable[[], None]) -> Iterator[ImageArray | None]:
    """The images nearest to ascending capture times; None where the film has none."""
    frames = [round(film.frame_at(time)) for time in times]
    wanted = sorted({frame for frame in frames if 0 <= frame < film.facts.frame_count})
    decoded = decode_film(film.path, wanted)
    last, image = -1, None
    for frame in frames:
        cancelled()
        if not 0 <= frame < film.facts.frame_count:
            yield None
            continue
        if frame != last:
            last, image = frame, next(decoded)
        yield image
