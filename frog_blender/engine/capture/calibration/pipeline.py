"""``frog calibrate``: a folder of raw films to a capture, stage by stage; a second run continues where one ended."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...errors import FrogError
from ...io.child_process import Progress
from ..synchronization.films import Film, find_films, with_clocks
from ..synchronization.run import NAME, CalibrationRefused, Run, WorkFolder, key_of
from ..synchronization.synchronization import Synchronization
from .calibration import Calibration
from .camera_files import write_cameras, write_transforms
from .landmark_file import landmark_file
from .placing import place_moving
from .report import write_moving_report, write_report
from .sequences import film_images, image_files, still_images, walk_throughs
from .sources import AUTO, Options, Source, calibrate_by, sources
from .views import is_standing, views_of

_MOST_DECODED = 4  # films at once
__all__ = ["AUTO", "Options", "Outcome", "calibrate"]


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


def calibrate(folder: Path, options: Options, progress: Progress, cancelled: Callable[[], bool]) -> Outcome:
    """Finds the cameras of a folder of films and writes them.

    Args:
        progress: told a stage's name, and how much of how much is done.
        cancelled: asked several times a second.

    Raises:
        CalibrationRefused: if the footage does not fix its cameras: why, and what to film next time.
        Stopped: if ``cancelled`` said so. What is done is kept.
        FrogError: for footage that cannot be used, or a result that cannot be written.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FrogError(f"{folder}: there is no such folder, expected one with a video of each camera.")
    out = options.out or folder
    run = Run(WorkFolder(out / NAME), progress, cancelled)
    images = still_images(folder)
    if images:
        return _of_moving(images, out, run)
    films = with_clocks(find_films(folder), options.clocks or {})
    if any(film.path.is_dir() for film in films) and out.resolve() != folder.resolve():
        raise FrogError(f"{out}: cameras of folders of frames are written beside them, expected {folder}.")
    standing = run.in_threads("films", lambda film: _is_standing(film, run), films, _MOST_DECODED)
    if not any(standing):
        return _of_moving(films, out, run)
    connecting, told = walk_throughs(folder, films, standing)
    films = [film for film in films if film not in connecting]
    tried = sources(folder, films, connecting, options, run)
    calibration, films, clocks = _of_standing(tried, films, options, run)
    warnings = tuple(dict.fromkeys([*told, *calibration.warnings, *clocks.warnings]))
    progress("report", 0, 1)
    calibration = replace(calibration, warnings=warnings)
    cameras = write_cameras(out, calibration, films)
    quiet = replace(run, progress=lambda *_: None, cancelled=lambda: False)
    views = [view.view(run.work) for view in views_of(quiet, films)]
    report, page = write_report(out, calibration, films, views, clocks)
    return Outcome(cameras, report, page, "found" in cameras.stem, warnings)


def _is_standing(film: Film, run: Run) -> bool:
    """Whether a camera stands that took a film, of an earlier run or new."""
    run.check()
    return bool(
        run.work.kept("standing", key_of(film.state), lambda: {"standing": np.array(is_standing(film))})["standing"]
    )


def _of_moving(footage: Sequence[Path] | Sequence[Film], out: Path, run: Run) -> Outcome:
    """The result for a moving camera: its images in order, or its film."""
    films = [film for film in footage if isinstance(film, Film)]
    if len(films) > 1:
        names = ", ".join(film.name for film in films)
        raise FrogError(
            f"{films[0].path.parent}: found {names} all moving, expected standing cameras, or one that moves."
        )
    if films:
        sequence, times, warnings = film_images(run, films[0], out)
    else:
        sequence, times, warnings = image_files([path for path in footage if isinstance(path, Path)], out)
    found = run.in_child(place_moving, sequence, run.work)
    path = write_transforms(out, sequence, times, found, timed=bool(films))
    found = replace(found, warnings=(*warnings, *found.warnings))
    report, page = write_moving_report(out, found)
    return Outcome(path, report, page, "found" in path.stem, found.warnings)


def _of_standing(
    tried: Iterable[Source], films: list[Film], options: Options, run: Run
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
    raise _all_failed(refusals, options)


def _all_failed(refusals: Sequence[tuple[str, FrogError]], options: Options) -> FrogError:
    """One error that tells what was tried, and what else would help."""
    (_, first), *others = refusals
    sentences = [str(first), *(f"From {name}: {error}" for name, error in others)]
    if not options.source_is_given and landmark_file() is None:
        sentences.append(
            "Or let a person walk about alone where all cameras see them: their joints will do, once the landmark "
            "file is there (Fetch Landmark File in Blender, or frog calibrate --fetch-landmarks)."
        )
    if len(sentences) == 1:
        return first
    kind = CalibrationRefused if all(isinstance(error, CalibrationRefused) for _, error in refusals) else FrogError
    return kind(" ".join(sentences))
