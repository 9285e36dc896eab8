"""What cameras may come from: features, a walk-through, a board, a person's joints, points that a person clicked.

Each source is asked with clocks that are known, or in alternation with synchronisation where they are not.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from math import nan
from pathlib import Path
from typing import TypeVar

import numpy as np

from ...errors import FrogError
from ..readers.geometry import distortion
from ..synchronization import NamedTracks
from .board import TIMES as BOARD_TIMES
from .board import board_in_films, corners_in_films
from .board_detection import Board
from .board_file import read_board
from .calibration import Calibration, CalibrationRefused
from .clocks import Cameras, Clocks, FoundClocks, Synchronize, differ, with_clocks
from .films import Film, View, arrays_of, common_times, view_film, view_of, with_groups
from .joint_rig import TIMES as JOINT_TIMES
from .joint_rig import Find, calibrate_joint_films, calibrate_unsynchronised_films
from .landmark_file import landmark_file
from .placing import Run, place_by_board, place_by_clicks, place_views
from .points import CameraFacts, read_points
from .sequences import sharp_images
from .work_folder import key_of, key_of_file

AUTO = Path("auto")
"""A board whose layout is found in the films."""
TIMES = 5
"""Common times at which moving points are compared."""
_ROUNDS = 2  # of synchronisation: calibrated from the background, then from what moves as well
_BOARD_FILES = ("charuco.toml", "board.toml", "board.json")  # a board's description beside the films
_ALMOST = 0.01  # of a side, by which films of one kind of camera may differ
_MOST_DECODED = 4  # films at once: of each some dozens of images are held

_Result = TypeVar("_Result")


@dataclass(frozen=True)
class Options:
    """What a person may decide.

    Attributes:
        out: folder of the result; by default the films' own.
        in_step: the films are known to be in step: nothing is synchronised.
        background_only: what moves is left out, for films that cannot be synchronised.
        clocks: of films whose clocks are known.
        board: its description (``board_file``) or ``AUTO``: the cameras come from it alone.
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
        timed: the cameras of films whose clocks are not known, and those, by what finds clocks; None where cameras and
            clocks are found in alternation.
    """

    name: str
    solve: Callable[[Sequence[Film], int], Calibration]
    needs_step: bool = True
    timed: Callable[[Sequence[Film], Find], tuple[Calibration, FoundClocks]] | None = None


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


def in_threads(run: Run, function: Callable[[Film], _Result], films: Sequence[Film], stage: str) -> list[_Result]:
    """The results in order; OpenCV decodes outside Python's lock."""
    run.progress(stage, 0, len(films))
    results = []
    with ThreadPoolExecutor(min(_MOST_DECODED, os.cpu_count() or 1)) as threads:
        for result in threads.map(function, films):
            results.append(result)
            run.progress(stage, len(results), len(films))
    return results


def views_of(run: Run, films: Sequence[Film], times: Sequence[float] = (), alike: float = 0.0) -> list[View]:
    """The films' backgrounds and what moves at common times, of an earlier run or new.

    Films whose sizes differ by less than ``alike`` share a focal length, which few points leave open otherwise. For
    features, which are exact, the middles of such images lie too far apart.
    """

    def of_film(film: Film) -> View:
        run.check()
        key = key_of(key_of_file(film.path), [round(film.frame_at(time), 4) for time in times])
        kept = run.work.load("look", key)
        if kept is None:
            kept = arrays_of(view_film(film, times, run.check))
            run.work.keep("look", key, kept)
        return view_of({"name": film.name, "size": film.size, "group": 0}, kept)

    return with_groups(in_threads(run, of_film, films, "images"), alike, [film.kind for film in films])


def calibrate_by(
    source: Source, films: list[Film], options: Options, run: Run, synchronize: Synchronize | None
) -> tuple[Calibration, list[Film], FoundClocks]:
    """The cameras by one source, the films with their clocks, and these.

    Raises:
        CalibrationRefused: if the footage does not fix its cameras.
    """
    given = options.clocks or {}
    if options.background_only:
        return source.solve(films, 0), films, FoundClocks(given)
    if options.in_step or given or synchronize is None:
        guessed = not (options.in_step or given)
        guess = ("The films were taken to be in step: nothing looked whether they are.",) if guessed else ()
        return source.solve(films, TIMES), films, FoundClocks(given, warnings=guess)

    def find(films: Sequence[Film], cameras: Cameras, tracks: Mapping[str, NamedTracks] | None = None) -> FoundClocks:
        return synchronize(films, cameras, tracks, run.work, run.progress, run.cancelled)

    if source.timed is not None:
        calibration, found = source.timed(films, lambda films, tracks: find(films, {}, tracks))
        return calibration, with_clocks(films, found.clocks), found
    return alternated(source, films, find)


def alternated(
    source: Source,
    films: list[Film],
    find: Callable[[Sequence[Film], Cameras], FoundClocks],
) -> tuple[Calibration, list[Film], FoundClocks]:
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
            kept = replace(found, clocks=first_clocks, warnings=(found.refusal, *found.warnings))
            return first, with_clocks(first_films, first_clocks), kept
        films = with_clocks(films, found.clocks)
        if before and not differ(before, found.clocks, films):
            break
        before = found.clocks
        calibration = source.solve(films, TIMES)
        if all(clock == (0.0, 1.0) for clock in found.clocks.values()):
            break  # in step: nothing that a second look could correct
    return calibration, films, found


def _first(
    source: Source,
    films: list[Film],
    find: Callable[[Sequence[Film], Cameras], FoundClocks],
) -> tuple[Calibration, Clocks, CalibrationRefused | None]:
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
        found.camera.name: (found.camera, distortion(np.array([*found.distortion, 0.0, 0.0])))
        for found in calibration.cameras
    }


def _features(run: Run, walk_throughs: Sequence[Film] = ()) -> Source:
    """By features, which walk-throughs connect."""
    sequences = sharp_images(walk_throughs, run.work, run.progress, run.cancelled)

    def solve(films: Sequence[Film], count: int) -> Calibration:
        views = views_of(run, films, common_times(films, count) if count else [])
        return place_views(views, run, sequences)

    return Source("a walk-through" if sequences else "features", solve, needs_step=False)


def _board_in(films: Sequence[Film], run: Run) -> Board | None:
    run.progress("board", 0, 1)
    return board_in_films(films, common_times(films, BOARD_TIMES), run.check)


def _board(board: Board, run: Run) -> Source:
    """By a board that is held into the views."""

    def solve(films: Sequence[Film], _count: int) -> Calibration:
        corners = corners_in_films(films, common_times(films, BOARD_TIMES), board, run.progress, run.check)
        facts = [CameraFacts(film.name, *film.size) for film in films]
        return replace(place_by_board(facts, board, corners, run), halves_apart=nan)

    return Source("a board", solve)


def _clicks(films: Sequence[Film], path: Path, run: Run) -> Source:
    """By points that a person clicked in each camera's image."""
    clicks = read_points(path, {film.name: film.size for film in films})

    def solve(films: Sequence[Film], _count: int) -> Calibration:
        facts = [CameraFacts(film.name, *film.size) for film in films]
        groups = [view.group for view in views_of(run, films, alike=_ALMOST)]
        return replace(place_by_clicks(facts, groups, clicks, run), halves_apart=nan)

    return Source("clicked points", solve, needs_step=False)


def _joints(network: Path, run: Run) -> Source:
    """By the joints of a person who walks about."""

    def solve(films: Sequence[Film], _count: int) -> Calibration:
        times, views = common_times(films, JOINT_TIMES), views_of(run, films, alike=_ALMOST)
        return calibrate_joint_films(films, views, times, network, run)

    def timed(films: Sequence[Film], find: Find) -> tuple[Calibration, FoundClocks]:
        views = views_of(run, films, alike=_ALMOST)
        return calibrate_unsynchronised_films(films, views, network, find, run)

    return Source("a person's joints", solve, timed=timed)
