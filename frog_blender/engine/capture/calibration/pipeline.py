"""``frog calibrate``: a folder of raw films to a capture, stage by stage; a second run continues where one ended."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...errors import FrogError
from ..readers.geometry import distortion
from .calibration import Calibration, CalibrationRefused
from .child_process import CalibrationCancelled, Progress
from .clocks import Clocks, FoundClocks, Synchronize, differ, find_clocks, with_clocks
from .films import Film, View, common_times, find_films, is_standing, look, with_groups
from .moving import calibrate_moving, still_images
from .report import write_moving_report, write_report
from .result_files import write_cameras
from .standing import calibrate_standing
from .standing_task import arrays_of, view_of
from .work_folder import NAME, WorkFolder, key_of, key_of_file

_TIMES = 5  # at which moving points are compared
_ROUNDS = 2  # of synchronisation: calibrated from the background, then from what moves as well


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
    """

    out: Path | None = None
    in_step: bool = False
    background_only: bool = False
    clocks: Clocks | None = None


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
        CalibrationCancelled: if ``cancelled`` said so. What is done is kept.
        FrogError: for footage that cannot be used, or a result that cannot be written.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FrogError(f"{folder}: there is no such folder, expected one with a video of each camera.")
    out = options.out or folder
    work = WorkFolder(out / NAME)
    images = still_images(folder)
    if images:
        return _of_moving(images, None, out, work, progress, cancelled)
    films = find_films(folder)
    standing = _standing(films, work, progress, cancelled)
    if not any(standing):
        if len(films) > 1:
            raise FrogError(f"{folder}: several moving cameras cannot be calibrated together yet; give one film alone.")
        return _of_moving([], films[0], out, work, progress, cancelled)
    if not all(standing):
        moving = [film.name for film, stands in zip(films, standing, strict=True) if not stands]
        raise FrogError(
            f"{folder}: found {', '.join(moving)} moving beside standing cameras, expected those, or one that moves."
        )
    calibration, films, clocks = _of_standing(films, options, work, progress, cancelled, synchronize=synchronize)
    warnings = tuple(dict.fromkeys([*calibration.warnings, *clocks.warnings]))
    progress("report", 0, 1)
    calibration = replace(calibration, warnings=warnings)
    cameras = write_cameras(out, calibration, films)
    report, page = write_report(out, calibration, films, _plates(films, work), clocks)
    return Outcome(cameras, report, page, "found" in cameras.stem, warnings)


def _of_moving(
    images: Sequence[Path],
    film: Film | None,
    out: Path,
    work: WorkFolder,
    progress: Progress,
    cancelled: Callable[[], bool],
) -> Outcome:
    """The result for one moving camera."""
    path, result, warnings = calibrate_moving(images, film, out, work, progress, cancelled)
    report, page = write_moving_report(out, result, warnings)
    return Outcome(path, report, page, "found" in path.stem, tuple(warnings))


def _of_standing(
    films: Sequence[Film],
    options: Options,
    work: WorkFolder,
    progress: Progress,
    cancelled: Callable[[], bool],
    *,
    synchronize: Synchronize | None,
) -> tuple[Calibration, list[Film], FoundClocks]:
    """The rig and the films with their clocks. Calibration and synchronisation take turns where clocks are unknown."""
    given = options.clocks or {}
    films = with_clocks(films, given)

    def solved(films: Sequence[Film], count: int) -> Calibration:
        times = common_times(films, count) if count else []
        return calibrate_standing(_views(films, times, work, progress, cancelled), work, progress, cancelled)

    if options.background_only:
        return solved(films, 0), films, FoundClocks(given)
    if options.in_step or given or synchronize is None:
        guess = (
            ()
            if options.in_step or given
            else ("The films were taken to be in step: nothing looked whether they are.",)
        )
        return solved(films, _TIMES), films, FoundClocks(given, warnings=guess)
    calibration = _first(solved, films)
    before: Clocks = {}
    for _ in range(_ROUNDS):
        cameras = {
            each.camera.name: (each.camera, distortion(np.array([*each.distortion, 0.0, 0.0])))
            for each in calibration.cameras
        }
        found = synchronize(films, cameras, progress, cancelled)
        if found.refusal is not None:
            kept = replace(found, warnings=(found.refusal, *found.warnings))
            return calibration, films, kept
        films = with_clocks(films, found.clocks)
        if before and not differ(before, found.clocks, films):
            break
        before = found.clocks
        calibration = solved(films, _TIMES)
        if all(clock == (0.0, 1.0) for clock in found.clocks.values()):
            break  # in step: nothing that a second look could correct
    return calibration, films, found


def _first(solved: Callable[[Sequence[Film], int], Calibration], films: Sequence[Film]) -> Calibration:
    """A calibration before clocks are known: by the background, else by films that are taken to be in step."""
    try:
        return solved(films, 0)
    except CalibrationRefused as refused:
        try:
            return solved(films, _TIMES)
        except FrogError:
            raise refused from None


def _standing(films: Sequence[Film], work: WorkFolder, progress: Progress, cancelled: Callable[[], bool]) -> list[bool]:
    """Which films were taken by cameras that stand."""
    answers = []
    for place, film in enumerate(films):
        progress("films", place, len(films))
        _check(cancelled)
        key = key_of(key_of_file(film.path))
        kept = work.load("standing", key)
        if kept is None:
            kept = {"standing": np.array(is_standing(film))}
            work.keep("standing", key, kept)
        answers.append(bool(kept["standing"]))
    return answers


def _views(
    films: Sequence[Film], times: Sequence[float], work: WorkFolder, progress: Progress, cancelled: Callable[[], bool]
) -> list[View]:
    """What calibration looks at, of an earlier run or new."""
    views = []
    for place, film in enumerate(films):
        progress("images", place, len(films))
        _check(cancelled)
        frames = [round(film.frame_at(time), 4) for time in times]
        key = key_of(key_of_file(film.path), frames)
        kept = work.load("look", key)
        if kept is None:
            kept = arrays_of(look(film, times, lambda: _check(cancelled)))
            work.keep("look", key, kept)
        views.append(view_of({"name": film.name, "size": film.size, "group": 0}, kept))
    return with_groups(views)


def _plates(films: Sequence[Film], work: WorkFolder) -> list[View]:
    """The views once more, for the report."""
    return _views(films, [], work, lambda stage, done, all_: None, lambda: False)


def _check(cancelled: Callable[[], bool]) -> None:
    if cancelled():
        raise CalibrationCancelled
