"""``frog calibrate``: a folder of raw films to a capture, stage by stage; a second run continues where one ended."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from ...errors import FrogError
from ...io.child_process import Progress
from ..synchronization import NamedTracks
from .board_detection import Board
from .board_file import read_board
from .board_films import TIMES as BOARD_TIMES
from .board_films import board_in_films
from .calibration import Calibration, CalibrationRefused
from .clocks import Cameras, Clocks, FoundClocks, Synchronize, find_clocks, find_moving_clocks, with_clocks
from .feature_task import arrays_of, view_of
from .films import Film, View, common_times, find_films, is_standing, look, with_groups
from .in_turns import TIMES, calibrate_in_turns
from .landmark_file import landmark_file
from .moving import calibrate_moving, still_images
from .report import write_moving_report, write_report
from .result_files import write_cameras
from .scan import walk_throughs, walks_of
from .standing import calibrate_standing
from .walk import Walk
from .ways import Way, board_beside, board_way, joints_way, points_way, read_points, stopper
from .work_folder import NAME, WorkFolder, key_of, key_of_file

AUTO = Path("auto")
"""A board whose layout is found in the films."""
_ALMOST = 0.01  # of a side, by which films of one kind of camera may differ
_MOST_DECODED = 4  # films at once: of each some dozens of images are held

_Result = TypeVar("_Result")


@dataclass(frozen=True)
class Outcome:
    """What a run wrote.

    Attributes:
        cameras: the calibration, or the list of posed images of a moving camera.
        report: ``calibration_report.json``.
        page: the same with images.
        given_kept: a calibration was there already, so that the new one has another name.
        warnings: one sentence each.
    """

    cameras: Path
    report: Path
    page: Path
    given_kept: bool
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class Options:
    """What a person may decide.

    Attributes:
        out: folder of the result; by default the films' own.
        in_step: the films are known to be in step: nothing is synchronised.
        background_only: what moves is left out, for films that cannot be synchronised.
        clocks: of films whose clocks are known.
        board: its description (``board_file``) or ``AUTO``: the cameras come from it alone.
        points: a file of clicked points (``ways.read_points``): the cameras come from them alone.
    """

    out: Path | None = None
    in_step: bool = False
    background_only: bool = False
    clocks: Clocks | None = None
    board: Path | None = None
    points: Path | None = None


def calibrate(
    folder: Path,
    options: Options,
    progress: Progress,
    cancelled: Callable[[], bool],
    synchronize: Synchronize | None = find_clocks,
) -> Outcome:
    """Finds the cameras of a folder of films and writes them.

    Args:
        progress: told a stage's name, and how much of how much is done.
        cancelled: asked several times a second.
        synchronize: finds the films' clocks; with None films are taken to be in step.

    Raises:
        CalibrationRefused: if the footage does not fix its cameras: why, and what to film next time.
        Stopped: if ``cancelled`` said so. What is done is kept.
        FrogError: for footage that cannot be used, or a result that cannot be written.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FrogError(f"{folder}: there is no such folder, expected one with a video of each camera.")
    out = options.out or folder
    work = WorkFolder(out / NAME)
    stages = _Stages(work, progress, cancelled)
    images = still_images(folder)
    if images:
        return _of_moving(images, FoundClocks({}), out, stages)
    films = with_clocks(find_films(folder), options.clocks or {})
    if any(film.path.is_dir() for film in films) and out.resolve() != folder.resolve():
        raise FrogError(f"{out}: cameras of folders of frames are written beside them, expected {folder}.")
    standing = _standing(films, work, progress, cancelled)
    if not any(standing):
        clocks = FoundClocks({})
        if len(films) > 1 and not (options.in_step or options.clocks) and synchronize is not None:
            clocks = find_moving_clocks(films, progress, cancelled)
        return _of_moving(with_clocks(films, clocks.clocks), clocks, out, stages)
    scans, told = walk_throughs(folder, films, standing)
    films = [film for film in films if film not in scans]
    ways = _ways(folder, films, scans, options, stages)
    calibration, films, clocks = _of_standing(ways, films, options, stages, synchronize)
    warnings = tuple(dict.fromkeys([*told, *calibration.warnings, *clocks.warnings]))
    progress("report", 0, 1)
    calibration = replace(calibration, warnings=warnings)
    cameras = write_cameras(out, calibration, films)
    report, page = write_report(out, calibration, films, _plates(films, work), clocks)
    return Outcome(cameras, report, page, "found" in cameras.stem, warnings)


def _of_moving(footage: Sequence[Path] | Sequence[Film], clocks: FoundClocks, out: Path, stages: _Stages) -> Outcome:
    """The result for moving cameras."""
    path, result, found = calibrate_moving(footage, out, stages.work, stages.progress, stages.cancelled)
    warnings = [*clocks.warnings, *found]
    report, page = write_moving_report(out, result, warnings)
    return Outcome(path, report, page, "found" in path.stem, tuple(warnings))


@dataclass(frozen=True)
class _Stages:
    """What all stages share: see ``calibrate``."""

    work: WorkFolder
    progress: Progress
    cancelled: Callable[[], bool]


def _ways(
    folder: Path, films: Sequence[Film], scans: Sequence[Film], options: Options, stages: _Stages
) -> Iterator[Way]:
    """What to try, one after the other until one finds the cameras: what was asked for alone, else the surest first."""
    progress, cancelled = stages.progress, stages.cancelled
    if options.points is not None:
        groups = [view.group for view in _of_kinds(films, stages)]
        yield points_way(read_points(options.points, films), groups, progress)
        return
    if options.board is not None:
        board = read_board(options.board) if options.board != AUTO else _board_in(films, stages)
        if board is None:
            raise FrogError(f"{folder}: found no board in the films, expected a ChArUco board or a checkerboard.")
        yield board_way(board, progress, cancelled)
        return
    described = None if options.background_only else board_beside(folder)
    if described is not None:
        yield board_way(read_board(described), progress, cancelled)
    if scans:
        walks = walks_of(scans, stages.work, progress, cancelled)
        yield Way("a walk-through", lambda films, count: _of_features(films, count, stages, walks), needs_step=False)
    yield Way("features", lambda films, count: _of_features(films, count, stages), needs_step=False)
    if options.background_only:
        return
    if described is None:
        try:
            board = _board_in(films, stages)
        except FrogError:
            board = None  # the sentence of what was tried before says more
        if board is not None:
            yield board_way(board, progress, cancelled)
    network = landmark_file()
    if network is not None:
        yield joints_way(network, lambda films: _of_kinds(films, stages), progress, cancelled)


def _board_in(films: Sequence[Film], stages: _Stages) -> Board | None:
    stages.progress("board", 0, 1)
    return board_in_films(films, common_times(films, BOARD_TIMES), stopper(stages.cancelled))


def _of_features(films: Sequence[Film], count: int, stages: _Stages, walks: Sequence[Walk] = ()) -> Calibration:
    times = common_times(films, count) if count else []
    return calibrate_standing(_views(films, times, stages), stages.work, stages.progress, stages.cancelled, walks)


def _of_standing(
    ways: Iterator[Way], films: list[Film], options: Options, stages: _Stages, synchronize: Synchronize | None
) -> tuple[Calibration, list[Film], FoundClocks]:
    """The rig and the films with their clocks, by the first way that leads there."""
    refusals: list[tuple[str, FrogError]] = []
    for way in ways:
        try:
            calibration, timed, clocks = _by(way, films, options, stages, synchronize)
        except FrogError as error:
            refusals.append((way.source, error))
            continue
        tried = [f"The cameras come from {way.source}, because {source} failed: {why}" for source, why in refusals]
        calibration = replace(calibration, source=way.source, warnings=(*tried, *calibration.warnings))
        return calibration, timed, clocks
    raise _no_way(refusals, options)


def _no_way(refusals: Sequence[tuple[str, FrogError]], options: Options) -> FrogError:
    """One error that tells what was tried, and what else would help."""
    (_, first), *others = refusals
    sentences = [str(first), *(f"From {source}: {error}" for source, error in others)]
    is_own_choice = options.board is not None or options.points is not None or options.background_only
    if not is_own_choice and landmark_file() is None:
        sentences.append(
            "Or let a person walk about alone where all cameras see them: their joints will do, once the landmark "
            "file is there (Fetch Landmark File in Blender, or frog calibrate --fetch-landmarks)."
        )
    if len(sentences) == 1:
        return first
    kind = CalibrationRefused if all(isinstance(error, CalibrationRefused) for _, error in refusals) else FrogError
    return kind(" ".join(sentences))


def _by(
    way: Way, films: list[Film], options: Options, stages: _Stages, synchronize: Synchronize | None
) -> tuple[Calibration, list[Film], FoundClocks]:
    """The same by one way. Calibration and synchronisation take turns where clocks are unknown."""
    given = options.clocks or {}
    if options.background_only:
        return way.solve(films, 0), films, FoundClocks(given)
    if options.in_step or given or synchronize is None:
        guess = (
            ()
            if options.in_step or given
            else ("The films were taken to be in step: nothing looked whether they are.",)
        )
        return way.solve(films, TIMES), films, FoundClocks(given, warnings=guess)

    def find(films: Sequence[Film], cameras: Cameras, tracks: Mapping[str, NamedTracks] | None = None) -> FoundClocks:
        return synchronize(films, cameras, tracks, stages.work, stages.progress, stages.cancelled)

    if way.timed is not None:
        calibration, found = way.timed(films, lambda films, tracks: find(films, {}, tracks))
        return calibration, with_clocks(films, found.clocks), found
    return calibrate_in_turns(way, films, find)


def _standing(films: Sequence[Film], work: WorkFolder, progress: Progress, cancelled: Callable[[], bool]) -> list[bool]:
    """Which films were taken by cameras that stand."""
    check = stopper(cancelled)

    def of_film(film: Film) -> bool:
        check()
        key = key_of(key_of_file(film.path))
        kept = work.load("standing", key)
        if kept is None:
            kept = {"standing": np.array(is_standing(film))}
            work.keep("standing", key, kept)
        return bool(kept["standing"])

    return _in_threads(of_film, films, "films", progress)


def _views(films: Sequence[Film], times: Sequence[float], stages: _Stages) -> list[View]:
    """What calibration looks at, of an earlier run or new."""
    check = stopper(stages.cancelled)

    def of_film(film: Film) -> View:
        check()
        frames = [round(film.frame_at(time), 4) for time in times]
        key = key_of(key_of_file(film.path), frames)
        kept = stages.work.load("look", key)
        if kept is None:
            kept = arrays_of(look(film, times, check))
            stages.work.keep("look", key, kept)
        return view_of({"name": film.name, "size": film.size, "group": 0}, kept)

    views = _in_threads(of_film, films, "images", stages.progress)
    return with_groups(views, kinds=[film.kind for film in films])


def _in_threads(
    function: Callable[[Film], _Result], films: Sequence[Film], stage: str, progress: Progress
) -> list[_Result]:
    """The results in order; OpenCV decodes outside Python's lock."""
    progress(stage, 0, len(films))
    results = []
    with ThreadPoolExecutor(min(_MOST_DECODED, os.cpu_count() or 1)) as threads:
        for result in threads.map(function, films):
            results.append(result)
            progress(stage, len(results), len(films))
    return results


def _of_kinds(films: Sequence[Film], stages: _Stages) -> list[View]:
    """The backgrounds' views. Films of almost one size share a focal length, which few points leave open otherwise.

    For features, which are exact, the middles of such images lie too far apart.
    """
    return with_groups(_views(films, [], stages), _ALMOST, [film.kind for film in films])


def _plates(films: Sequence[Film], work: WorkFolder) -> list[View]:
    """The views once more, for the report."""
    return _views(films, [], _Stages(work, lambda stage, done, all_: None, lambda: False))
