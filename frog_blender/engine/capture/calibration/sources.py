"""What cameras may come from: features, a walk-through, a board, a person's joints, points that a person clicked.

Each source is asked with clocks that are known, or in alternation with synchronisation where they are not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...errors import FrogError
from ..capture import Distortion
from ..synchronization.films import Clocks, Film, with_clocks
from ..synchronization.motion import Cameras
from ..synchronization.run import CalibrationRefused, Run
from ..synchronization.synchronization import Synchronization, differ
from ..synchronization.synchronize import find_clocks
from .board import TIMES as BOARD_TIMES
from .board import board_in_films, calibrate_board, corners_in_films
from .board_detection import Board, read_board
from .calibration import Calibration
from .joint_rig import TIMES as JOINT_TIMES
from .joint_rig import calibrate_joint_films, calibrate_unsynchronised_films
from .landmark_file import landmark_file
from .placing import place_views
from .points import calibrate_clicks, read_points
from .sequences import walk_images
from .views import common_times, facts_of, views_of

AUTO = Path("auto")
"""A board whose layout is found in the films."""
TIMES = 5
"""Common times at which moving points are compared."""
_ROUNDS = 2  # of synchronisation: calibrated from the background, then from what moves as well
_BOARD_FILES = ("charuco.toml", "board.toml", "board.json")  # a board's description beside the films
_ALMOST = 0.01  # of a side, by which films of one kind of camera may differ

Find = Callable[[Sequence[Film], Cameras], Synchronization]


@dataclass(frozen=True)
class Options:
    """What a person may decide.

    Attributes:
        out: folder of the result; by default the films' own.
        in_step: the films are known to be in step: nothing is synchronised.
        background_only: what moves is left out, for films that cannot be synchronised.
        clocks: of films whose clocks are known.
        board: its description (``read_board``) or ``AUTO``: the cameras come from it alone.
        points: a file of clicked points (``points.read_points``): the cameras come from them alone.
    """

    out: Path | None = None
    in_step: bool = False
    background_only: bool = False
    clocks: Clocks | None = None
    board: Path | None = None
    points: Path | None = None

    @property
    def source_is_given(self) -> bool:
        """A person says what the cameras are to come from."""
        return self.board is not None or self.points is not None or self.background_only


@dataclass(frozen=True)
class Source:
    """One source of cameras.

    Attributes:
        name: as in "cameras from a board".
        solve: the cameras of films at so many common times; with 0 of what does not move alone.
        needs_step: what it looks at moves, so that the films must be in step.
        timed: the cameras of films whose clocks are not known, and those; None where cameras and clocks are found in
            alternation.
    """

    name: str
    solve: Callable[[Sequence[Film], int], Calibration]
    needs_step: bool = True
    timed: Callable[[Sequence[Film]], tuple[Calibration, Synchronization]] | None = None


def sources(
    folder: Path, films: Sequence[Film], walk_throughs: Sequence[Film], options: Options, run: Run
) -> Iterator[Source]:
    """What to try, one after the other until one finds the cameras: what was asked for alone, else the surest first."""
    if options.points is not None:
        yield _clicks(films, options.points, run)
        return
    if options.board is not None:
        board = read_board(options.board) if options.board != AUTO else _board_in(films, run)
        if board is None:
            raise FrogError(f"{folder}: found no board in the films, expected a ChArUco board or a checkerboard.")
        yield _board(board, run)
        return
    beside = next((folder / name for name in _BOARD_FILES if (folder / name).is_file()), None)
    if beside is not None and not options.background_only:
        yield _board(read_board(beside), run)
    if walk_throughs:
        yield _features(run, walk_throughs)
    yield _features(run)
    if options.background_only:
        return
    if beside is None:
        try:
            board = _board_in(films, run)
        except FrogError:
            board = None  # the sentence of what was tried before says more
        if board is not None:
            yield _board(board, run)
    network = landmark_file()
    if network is not None:
        yield _joints(network, run)


def calibrate_by(
    source: Source, films: list[Film], options: Options, run: Run
) -> tuple[Calibration, list[Film], Synchronization]:
    """The cameras by one source, the films with their clocks, and how these were found.

    Raises:
        CalibrationRefused: if the footage does not fix its cameras.
    """
    if options.background_only:
        return source.solve(films, 0), films, Synchronization()
    if options.in_step or options.clocks:
        return source.solve(films, TIMES), films, Synchronization()
    if source.timed is not None:
        calibration, found = source.timed(films)
        return calibration, with_clocks(films, found.clocks), found
    return alternated(source, films, lambda films, cameras: find_clocks(run, films, cameras))


def alternated(source: Source, films: list[Film], find: Find) -> tuple[Calibration, list[Film], Synchronization]:
    """The same where neither cameras nor clocks are known: calibration and synchronisation improve each other.

    Cameras found by what moves are worth as much as the clocks behind them. Where synchronisation cannot confirm those,
    the result is the one that did without them, or a refusal.

    Args:
        find: the films' clocks by cameras that are known, by name; none where they are not.
    """
    first_films = films
    first, first_clocks, refused = _first(source, films, find)
    calibration, before = first, first_clocks
    for _ in range(_ROUNDS):
        found = find(films, _known(calibration))
        if found.refusal is not None:
            if refused is not None:
                raise CalibrationRefused(f"{refused} What moves does not help either. {found.refusal}")
            kept = replace(found, warnings=(found.refusal, *found.warnings))
            return first, with_clocks(first_films, first_clocks), kept
        films = with_clocks(films, found.clocks)
        if before and not differ(before, found.clocks, films):
            break
        before = found.clocks
        calibration = source.solve(films, TIMES)
        if all(clock == (0.0, 1.0) for clock in found.clocks.values()):
            break  # in step: nothing that a second look could correct
    return calibration, films, found


def _first(source: Source, films: list[Film], find: Find) -> tuple[Calibration, Clocks, CalibrationRefused | None]:
    """A calibration before clocks are known, the clocks that it used, if any, and why the background does not do.

    By the background where the source has use for it, else by films that are taken to be in step, else by clocks that
    were found without cameras.
    """
    refused: CalibrationRefused | None = None
    if not source.needs_step:
        try:
            return source.solve(films, 0), {}, None
        except CalibrationRefused as error:
            refused = error
    together: Clocks = {film.name: (0.0, 1.0) for film in films}
    try:
        return source.solve(films, TIMES), together if source.needs_step else {}, refused
    except CalibrationRefused as error:
        if not source.needs_step:
            raise refused or error from None
        refused = error
    found = find(films, {})
    if found.refusal is not None or not differ(together, found.clocks, films):
        raise refused
    return source.solve(with_clocks(films, found.clocks), TIMES), found.clocks, None


def _known(calibration: Calibration) -> Cameras:
    return {
        found.camera.name: (found.camera, Distortion(np.array([*found.distortion, 0.0, 0.0])))
        for found in calibration.cameras
    }


def _features(run: Run, walk_throughs: Sequence[Film] = ()) -> Source:
    """By features, which walk-throughs connect."""
    sequences = walk_images(run, walk_throughs)

    def solve(films: Sequence[Film], count: int) -> Calibration:
        return place_views(run, views_of(run, films, common_times(films, count) if count else []), sequences)

    return Source("a walk-through" if sequences else "features", solve, needs_step=False)


def _board_in(films: Sequence[Film], run: Run) -> Board | None:
    run.progress("board", 0, 1)
    return board_in_films(films, common_times(films, BOARD_TIMES), run.check)


def _board(board: Board, run: Run) -> Source:
    """By a board that is held into the views."""

    def solve(films: Sequence[Film], _count: int) -> Calibration:
        corners = corners_in_films(run, films, common_times(films, BOARD_TIMES), board)
        return run.in_child(calibrate_board, facts_of(films), board, corners)

    return Source("a board", solve)


def _clicks(films: Sequence[Film], path: Path, run: Run) -> Source:
    """By points that a person clicked in each camera's image."""
    clicks = read_points(path, {film.name: film.size for film in films})

    def solve(films: Sequence[Film], _count: int) -> Calibration:
        return run.in_child(calibrate_clicks, facts_of(films, _ALMOST), clicks)

    return Source("clicked points", solve, needs_step=False)


def _joints(network: Path, run: Run) -> Source:
    """By the joints of a person who walks about."""

    def solve(films: Sequence[Film], _count: int) -> Calibration:
        times, views = common_times(films, JOINT_TIMES), views_of(run, films, alike=_ALMOST)
        return calibrate_joint_films(run, films, views, times, network)

    def timed(films: Sequence[Film]) -> tuple[Calibration, Synchronization]:
        return calibrate_unsynchronised_films(run, films, views_of(run, films, alike=_ALMOST), network)

    return Source("a person's joints", solve, timed=timed)
