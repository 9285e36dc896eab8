"""A person's joints in films of standing cameras, and the cameras from them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...io.child_process import Progress
from .board_films import images_at
from .calibration import Calibration
from .films import Film, View
from .joint_clocks import FilmJoints, JointClocks, calibrate_unsynchronised
from .joints import Joints, calibrate_joints, find_joints
from .landmarks import LandmarkNetwork
from .rig_result import CameraFacts

TIMES = 40
"""Common times at which joints are looked for: 30 are enough, and each costs a quarter of a second a camera."""
_MOST_IMAGES = 80  # of each film, from which clocks are found
_INTERVALS = (1 / 30, 0.1)  # seconds between them: a walking person's joints are known between them


def joints_of_films(
    films: Sequence[Film],
    views: Sequence[View],
    times: Sequence[Sequence[float]],
    network: Path,
    progress: Progress,
    cancelled: Callable[[], None],
) -> list[Joints]:
    """The joints of whoever moves in each film.

    Args:
        views: of the films, for their plates and what moves before them.
        times: ascending capture times in seconds, for each film.
        network: the landmark file (``landmark_file``).
        cancelled: called before each image; it raises what ends the work.

    Raises:
        FrogError: for a film that cannot be decoded, or another file than the network's.
    """
    loaded = LandmarkNetwork(network)
    found = []
    for number, (film, view, wanted) in enumerate(zip(films, views, times, strict=True)):
        progress("joints", number, len(films))
        found.append(find_joints(loaded, images_at(film, wanted, cancelled), view.plate, view.changing))
    return found


def calibrate_joint_films(
    films: Sequence[Film],
    views: Sequence[View],
    times: Sequence[float],
    network: Path,
    progress: Progress,
    cancelled: Callable[[], None],
) -> Calibration:
    """The cameras of films in which one person walks about, from their joints at common capture times in seconds.

    Raises:
        CalibrationRefused: see ``joints.calibrate_joints``.
        FrogError: as of ``joints_of_films``.
    """
    joints = joints_of_films(films, views, [times] * len(films), network, progress, cancelled)
    progress("bundle adjustment", 0, 1)
    facts = [CameraFacts(film.name, *film.size) for film in films]
    return calibrate_joints(facts, [view.group for view in views], joints)


def calibrate_unsynchronised_films(
    films: Sequence[Film],
    views: Sequence[View],
    network: Path,
    progress: Progress,
    cancelled: Callable[[], None],
) -> JointClocks:
    """The cameras and the offsets of films in which one person walks about, began they when they may.

    The films are compared over a few seconds about the middle of the shortest one; offsets of up to half of that are
    found.

    Raises:
        CalibrationRefused: see ``joint_clocks.calibrate_unsynchronised``.
        FrogError: as of ``joints_of_films``.
    """
    shortest = min(float(film.stamps[-1] - film.stamps[0]) for film in films)
    interval = float(np.clip(shortest / _MOST_IMAGES, *_INTERVALS))
    window = min(shortest, _MOST_IMAGES * interval)
    wanted = np.arange(0.0, window + 1e-6, interval) + (shortest - window) / 2
    times = []
    for film in films:
        after = np.searchsorted(film.stamps, film.stamps[0] + wanted - 1e-6)
        times.append(film.stamps[np.unique(np.minimum(after, len(film.stamps) - 1))])
    unplaced = [replace(film, offset=0.0, rate=1.0) for film in films]
    joints = joints_of_films(unplaced, views, [each.tolist() for each in times], network, progress, cancelled)
    progress("bundle adjustment", 0, 1)
    facts = [CameraFacts(film.name, *film.size) for film in films]
    return calibrate_unsynchronised(
        facts,
        [view.group for view in views],
        [
            FilmJoints(each, found, 1 / film.facts.frames_per_second)
            for film, each, found in zip(films, times, joints, strict=True)
        ],
    )
