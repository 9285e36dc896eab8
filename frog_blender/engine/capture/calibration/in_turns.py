"""Cameras and clocks of films of which neither are known: calibration and synchronisation take turns.

Cameras found by what moves are worth as much as the clocks behind them. Where synchronisation cannot confirm those, the
result is the one that did without them, or a refusal.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..camera import Camera
from ..capture import Distortion
from ..readers.geometry import distortion
from .calibration import Calibration, CalibrationRefused
from .clocks import Clocks, FoundClocks, differ, with_clocks
from .films import Film
from .ways import Way

TIMES = 5  # at which moving points are compared
_ROUNDS = 2  # of synchronisation: calibrated from the background, then from what moves as well

FindClocks = Callable[[Sequence[Film], Mapping[str, tuple[Camera, Distortion | None]]], FoundClocks]
"""The films' clocks by cameras that are known, by name; none where they are not."""


def calibrate_in_turns(way: Way, films: list[Film], find: FindClocks) -> tuple[Calibration, list[Film], FoundClocks]:
    """The cameras by one way, the films with their clocks, and these.

    Raises:
        CalibrationRefused: if the footage does not fix its cameras without clocks, and these cannot be trusted.
    """
    first_films = films
    first, first_clocks, refused = _first(way, films, find)
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
        calibration = way.solve(films, TIMES)
        if all(clock == (0.0, 1.0) for clock in found.clocks.values()):
            break  # in step: nothing that a second look could correct
    return calibration, films, found


def _first(way: Way, films: list[Film], find: FindClocks) -> tuple[Calibration, Clocks, CalibrationRefused | None]:
    """A calibration before clocks are known, the clocks that it used, if it used any, and why the background alone does
    not do, where it does not.

    By the background where the way has use for it, else by films that are taken to be in step, else by clocks that were
    found without cameras.
    """
    refused: CalibrationRefused | None = None
    if not way.needs_step:
        try:
            return way.solve(films, 0), {}, None
        except CalibrationRefused as error:
            refused = error
    together: Clocks = {film.name: (0.0, 1.0) for film in films}
    try:
        return way.solve(films, TIMES), together if way.needs_step else {}, refused
    except CalibrationRefused as error:
        if not way.needs_step:
            raise refused or error from None
        refused = error
    found = find(films, {})
    timed = with_clocks(films, found.clocks)
    if found.refusal is not None or not differ(together, found.clocks, films):
        raise refused
    return way.solve(timed, TIMES), found.clocks, None


def _known(calibration: Calibration) -> dict[str, tuple[Camera, Distortion | None]]:
    return {
        each.camera.name: (each.camera, distortion(np.array([*each.distortion, 0.0, 0.0])))
        for each in calibration.cameras
    }
