"""Ways to cameras other than features: a board, a person's joints, points that a person clicked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import nan
from pathlib import Path

import numpy as np

from ...arrays import Array
from ...errors import brief, found_instead
from ...io.child_process import Progress, Stopped
from ...io.plain_values import JsonList, UnfitValue, entries, items, number, plain_json
from ...io.regular_file import regular_file
from .board_detection import Board
from .board_films import TIMES as BOARD_TIMES
from .board_films import calibrate_board_films
from .calibration import Calibration
from .clicked_points import calibrate_clicks
from .clocks import FoundClocks
from .films import Film, View, common_times
from .joint_rig import TIMES as JOINT_TIMES
from .joint_rig import Find, calibrate_joint_films, calibrate_unsynchronised_films
from .rig_result import CameraFacts

BOARD_FILES = ("charuco.toml", "board.toml", "board.json")
"""Names under which a board's description may lie beside the films."""
_MOST_BYTES = 2**22
_MOST_POINTS = 10_000


@dataclass(frozen=True)
class Way:
    """One way to cameras.

    Attributes:
        source: what the cameras come from, as in "cameras from a board".
        solve: the cameras of films at so many common times; with 0 of what does not move alone.
        needs_step: what it looks at moves, so that the films must be in step.
        timed: the cameras of films whose clocks are not known, and those, by what finds clocks; None where cameras and
            clocks are found in turns.
    """

    source: str
    solve: Callable[[Sequence[Film], int], Calibration]
    needs_step: bool = True
    timed: Callable[[Sequence[Film], Find], tuple[Calibration, FoundClocks]] | None = None


def board_beside(folder: Path) -> Path | None:
    """A board's description in the films' folder, if there is one."""
    return next((folder / name for name in BOARD_FILES if (folder / name).is_file()), None)


def board_way(board: Board, progress: Progress, cancelled: Callable[[], bool]) -> Way:
    """By a board that is held into the views."""

    def solve(films: Sequence[Film], _count: int) -> Calibration:
        times = common_times(films, BOARD_TIMES)
        return _untested(calibrate_board_films(films, times, board, progress, stopper(cancelled)))

    return Way("a board", solve)


def joints_way(
    network: Path, views: Callable[[Sequence[Film]], list[View]], progress: Progress, cancelled: Callable[[], bool]
) -> Way:
    """By the joints of a person who walks about. ``views`` looks at the films' backgrounds and at what moves."""

    def solve(films: Sequence[Film], _count: int) -> Calibration:
        times = common_times(films, JOINT_TIMES)
        return calibrate_joint_films(films, views(films), times, network, progress, stopper(cancelled))

    def timed(films: Sequence[Film], find: Find) -> tuple[Calibration, FoundClocks]:
        return calibrate_unsynchronised_films(films, views(films), network, find, progress, stopper(cancelled))

    return Way("a person's joints", solve, timed=timed)


def points_way(clicks: Mapping[str, Array], groups: Sequence[int], progress: Progress) -> Way:
    """By points that a person clicked in each camera's image (``read_points``)."""

    def solve(films: Sequence[Film], _count: int) -> Calibration:
        progress("bundle adjustment", 0, 1)
        facts = [CameraFacts(film.name, *film.size) for film in films]
        return _untested(calibrate_clicks(facts, groups, clicks))

    return Way("clicked points", solve, needs_step=False)


def read_points(path: Path, films: Sequence[Film]) -> dict[str, Array]:
    """Clicked points of a JSON file: for each camera's name a list of [x, y] in pixels, or null where it sees none.

    Returns:
        (N, 2) float64 for each camera, NaN for null; pixel centres at +0.5.

    Raises:
        FrogError: if the file cannot be read, names another camera, or holds anything but points of the images.
    """
    regular_file(path, "clicked points")
    sizes = {film.name: film.size for film in films}
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise UnfitValue(f"a file of {path.stat().st_size} bytes", f"at most {_MOST_BYTES}")
        listed = entries(plain_json(path.read_text("utf-8"), "a text"), "clicked points")
        found: dict[str, Array] = {}
        for name, points in listed.items():
            if name not in sizes:
                raise UnfitValue(f"camera {brief(name)}", f"one of {', '.join(sizes)}")
            found[name] = _points(items(points, f"points of {name}", _MOST_POINTS), name, sizes[name])
        counts = {len(points) for points in found.values()}
        if len(counts) != 1 or 0 in counts:
            numbers = ", ".join(f"{len(points)} of {name}" for name, points in found.items()) or "no points"
            raise UnfitValue(numbers, "the same points for each camera, null where it does not see one")
    except (OSError, UnicodeDecodeError) as error:
        raise found_instead(path, f"a file that cannot be read ({brief(error)})", "clicked points") from error
    except UnfitValue as error:
        raise found_instead(path, error.found, error.expected) from error
    return found


def stopper(cancelled: Callable[[], bool]) -> Callable[[], None]:
    """What is called before each image, and ends the work when it was cancelled."""

    def check() -> None:
        if cancelled():
            raise Stopped

    return check


def _points(listed: JsonList, name: str, size: tuple[int, int]) -> Array:
    points = np.full((len(listed), 2), np.nan)
    for row, pair in enumerate(listed):
        if pair is None:
            continue
        what = f"point {row + 1} of {name}"
        if type(pair) is not list or len(pair) != 2:
            raise UnfitValue(f"{what} = {brief(pair)}", "[x, y] or null")
        points[row] = [number(value, what, 0, most) for value, most in zip(pair, size, strict=True)]
    return points


def _untested(found: Calibration) -> Calibration:
    """No two halves were compared, which a zero would hide."""
    return replace(found, halves_apart=nan)
