"""``frog calibrate``: a folder of raw films to a capture, stage by stage; a second run continues where one ended.

Cameras come from the first source that leads to them: features, a walk-through, a board. Each is asked with clocks that
are known, or in alternation with synchronization where they are not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path

from ...errors import CaptureRefused, FrogError, UsageError, listed, told_as
from ...io.work_folder import WorkFolder
from ...notices import say
from ...whole_progress import Standing
from ..quality_check import unsaid
from ..readers.pairing import said_of_films
from ..readers.readings import AUTO, CAMERAS, MOMENTS, chosen_layout
from ..synchronization.films import NAME, CalibrationRefused, Clocks, Film, Run, find_films, with_clocks
from ..synchronization.limits import LEAST_FRAMES
from ..synchronization.motion import Cameras
from ..synchronization.synchronization import Synchronization, differ, find_clocks
from . import sequences
from .board import board_in_films, calibrate_board_films
from .board_detection import read_board
from .camera_files import write_cameras, write_transforms
from .checks import check_places
from .model import Calibration
from .placing import place_films, place_moving
from .report import write_moving_report, write_report
from .stages import CalibrationProgress
from .views import STANDING, standing_of

ANY_BOARD = Path(AUTO)
"""A board whose layout is found in the films."""
TIMES = 5
"""Common times at which moving points are compared."""
_ROUNDS = 2  # of synchronization: calibrated from the background, then from what moves as well
_BOARD_FILES = ("charuco.toml", "board.toml", "board.json")  # a board's description beside the films

Find = Callable[[Sequence[Film], Cameras], Synchronization]


@dataclass(frozen=True)
class Options:
    """What a person may decide.

    Attributes:
        out: folder of the result; by default the films' own.
        in_step: the films are known to be in step: nothing is synchronized.
        background_only: what moves is left out, for films that cannot be synchronized.
        clocks: of films whose clocks are known.
        board: its description (``read_board``) or ``ANY_BOARD``: the cameras come from it alone.
        layout: what is known of the footage: "standing" of all films, else of ``readings.LAYOUTS``.
    """

    out: Path | None = None
    in_step: bool = False
    background_only: bool = False
    clocks: Clocks | None = None
    board: Path | None = None
    layout: str = AUTO


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


def calibrate(
    folder: Path, options: Options, progress: Callable[[Standing], None], cancelled: Callable[[], bool]
) -> Outcome:
    """Finds the cameras of a folder of films and writes them.

    Args:
        progress: is told where the calibration is; from any thread.
        cancelled: asked several times a second.

    Raises:
        CalibrationRefused: if the footage does not fix its cameras: why, and what to film next time.
        Stopped: if ``cancelled`` said so. What is done is kept.
        FrogError: for footage that cannot be used, or a result that cannot be written.
    """
    folder = Path(folder)
    out = options.out or (folder if folder.is_dir() else folder.parent)
    stages = CalibrationProgress(progress)
    run = Run(WorkFolder(out / NAME), stages, cancelled)
    read_as = chosen_layout(options.layout if options.layout in (CAMERAS, MOMENTS) else AUTO)
    if options.board is not None and options.board != ANY_BOARD:
        read_board(options.board)  # a damaged one is refused before the films are looked at
    with told_as(CaptureRefused), read_as:
        stills = sequences.find_stills(folder, options.layout) if folder.is_dir() else None
        films = with_clocks(find_films(folder) if stills is None else stills.films(), options.clocks or {})
    if unknown := sorted((options.clocks or {}).keys() - {film.name for film in films}):
        raise UsageError(f"--clock: found {unknown[0]!r}, expected one of {listed([film.name for film in films])}.")
    if any(film.path.is_dir() for film in films) and out.resolve() != folder.resolve():
        raise FrogError(f"{out}: cameras of folders of frames are written beside them, expected {folder}.")
    if _are_in_step(films):
        options = replace(options, in_step=True)
    stages.plan(len(films), in_step=bool(options.in_step or options.clocks or options.background_only))
    _tell_of(folder, films, run)
    if stills is not None and not stills.reading.is_grid:
        options = replace(options, in_step=True, layout=STANDING)
    standing = standing_of(run, films, options.layout)
    if not any(standing):
        return _of_moving(folder, stills, films, out, run)
    connecting, told = sequences.walk_throughs(folder, films, standing)
    films = [film for film in films if film not in connecting]
    calibration, films, clocks = _of_standing(sources(folder, films, connecting, options, run), films, options, run)
    check_places(calibration)
    warnings = tuple(dict.fromkeys([*told, *calibration.warnings, *clocks.warnings]))
    stages("report", 0, 1)
    calibration = replace(calibration, warnings=warnings)
    cameras = write_cameras(out, calibration, films)
    report, page = write_report(out, calibration, films, clocks)
    return Outcome(cameras, report, page, "found" in cameras.stem, warnings)


def _tell_of(folder: Path, films: Sequence[Film], run: Run) -> None:
    """Says what is unusual about films before hours are spent on them."""
    videos = [film.source for film in films if film.source.is_video]
    seen = run.in_threads("films", lambda video: [*unsaid(video.files[0])], videos)
    for sentence in (*(said_of_films(folder, videos) if videos else ()), *chain(*seen)):
        say(sentence)


def _are_in_step(films: Sequence[Film]) -> bool:
    """Whether images belong together by their numbers: those of a moment, and those too few to be synchronized."""
    files = [film.source.files for film in films if not film.source.is_video]
    are_of_moments = any(len({file.parent for file in of_camera}) > 1 for of_camera in files)
    return len(files) == len(films) and (are_of_moments or min(map(len, files), default=0) < LEAST_FRAMES)


def _of_moving(folder: Path, stills: sequences.Stills | None, films: Sequence[Film], out: Path, run: Run) -> Outcome:
    """The result for a moving camera: its images in order, or its film."""
    if len(films) > 1:
        names = ", ".join(film.name for film in films)
        others = ", --layout moments if each holds the images of one moment" if films[0].path.is_dir() else ""
        others = others if stills is None else ", --one-moment if all were taken at once, --moving if one camera moved"
        raise FrogError(
            f"{folder}: found {names} all moving, expected one that moves, or standing cameras: say --standing if they "
            f"stand{others}."
        )
    warnings: list[str] = []
    if stills is None:
        sequence, warnings = sequences.film_images(run, films[0], out)
    else:
        sequence = sequences.still_sequence(stills, out)
    camera = run.in_child(place_moving, sequence, run.work)
    path = write_transforms(out, sequence, camera)
    camera = replace(camera, warnings=(*warnings, *camera.warnings))
    report, page = write_moving_report(out, camera)
    return Outcome(path, report, page, "found" in path.stem, camera.warnings)


def _of_standing(
    tried: Iterator[Source], films: list[Film], options: Options, run: Run
) -> tuple[Calibration, list[Film], Synchronization]:
    """The rig and the films with their clocks, by the first source that leads there."""
    refusals: list[tuple[str, FrogError]] = []
    for source in tried:
        try:
            calibration, timed, clocks = calibrate_by(source, films, options, run)
        except FrogError as error:
            refusals.append((source.name, error))
            continue
        failed = [f"The cameras come from {source.name}, because {name} failed: {why}" for name, why in refusals]
        return replace(calibration, source=source.name, warnings=(*failed, *calibration.warnings)), timed, clocks
    raise _all_failed(refusals)


def _all_failed(refusals: Sequence[tuple[str, FrogError]]) -> FrogError:
    """One error that tells what was tried."""
    (_, first), *others = refusals
    sentences = [str(first), *(f"From {name}: {error}" for name, error in others)]
    if len(sentences) == 1:
        return first
    kind = CalibrationRefused if all(isinstance(error, CalibrationRefused) for _, error in refusals) else FrogError
    return kind(" ".join(sentences))


# --- sources


@dataclass(frozen=True)
class Source:
    """One source of cameras.

    Attributes:
        name: as in "cameras from a board".
        solve: the cameras of films at so many common times; with 0 of what does not move alone.
        needs_step: what it looks at moves, so that the films must be in step.
    """

    name: str
    solve: Callable[[Sequence[Film], int], Calibration]
    needs_step: bool = True


def sources(folder: Path, films: Sequence[Film], walks: Sequence[Film], options: Options, run: Run) -> Iterator[Source]:
    """What to try, one after the other until one finds the cameras: what was asked for alone, else the surest first."""
    if options.board is not None:
        board = read_board(options.board) if options.board != ANY_BOARD else board_in_films(run, films)
        if board is None:
            raise FrogError(f"{folder}: found no board in the films, expected a ChArUco board or a checkerboard.")
        yield Source("a board", partial(calibrate_board_films, run, board))
        return
    beside = next((folder / name for name in _BOARD_FILES if (folder / name).is_file()), None)
    if beside is not None and not options.background_only:
        yield Source("a board", partial(calibrate_board_films, run, read_board(beside)))
    if walks:
        images = sequences.walk_images(run, walks)
        yield Source("a walk-through", partial(place_films, run, images), needs_step=False)
    yield Source("features", partial(place_films, run, ()), needs_step=False)
    if options.background_only:
        return
    if beside is None:
        try:
            board = board_in_films(run, films)
        except FrogError:
            board = None  # the sentence of what was tried before says more
        if board is not None:
            yield Source("a board", partial(calibrate_board_films, run, board))


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
    return alternated(source, films, partial(find_clocks, run))


def alternated(source: Source, films: list[Film], find: Find) -> tuple[Calibration, list[Film], Synchronization]:
    """The same where neither cameras nor clocks are known: calibration and synchronization improve each other.

    Cameras found by what moves are worth as much as the clocks behind them. Where synchronization cannot confirm those,
    the result is the one that did without them, or a refusal.

    Args:
        find: the films' clocks by cameras that are known, by name; none where they are not.
    """
    first_films = films
    first, first_clocks, refused = _first(source, films, find)
    calibration, before = first, first_clocks
    for _ in range(_ROUNDS):
        answer = find(films, calibration.known)
        if answer.refusal is not None:
            if refused is not None:
                raise CalibrationRefused(f"{refused} What moves does not help either. {answer.refusal}")
            kept = replace(answer, warnings=(answer.refusal, *answer.warnings))
            return first, with_clocks(first_films, first_clocks), kept
        films = with_clocks(films, answer.clocks)
        if before and not differ(before, answer.clocks, films):
            break
        before = answer.clocks
        calibration = source.solve(films, TIMES)
        if all(clock == (0.0, 1.0) for clock in answer.clocks.values()):
            break  # in step: nothing that a second look could correct
    return calibration, films, answer


def _first(source: Source, films: list[Film], find: Find) -> tuple[Calibration, Clocks, CalibrationRefused | None]:
    """A calibration before clocks are known, the clocks that it used, if any, and why the background does not do.

    By the background where the source has use for it, else by films that are taken to be in step, else by clocks that
    were found without cameras.
    """
    together: Clocks = {film.name: (0.0, 1.0) for film in films}
    attempts: list[tuple[int, Clocks]] = [(TIMES, together)] if source.needs_step else [(0, {}), (TIMES, {})]
    refused: CalibrationRefused | None = None
    for count, clocks in attempts:
        try:
            return source.solve(films, count), clocks, refused
        except CalibrationRefused as error:
            refused = refused or error
    assert refused is not None
    answer = find(films, {}) if source.needs_step else None
    if answer is None or answer.refusal is not None or not differ(together, answer.clocks, films):
        raise refused
    return source.solve(with_clocks(films, answer.clocks), TIMES), answer.clocks, None
