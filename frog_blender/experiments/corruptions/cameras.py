"""Captures with fewer cameras, wrong poses, clocks that disagree, or another pace. Images that judge stay as they
are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...engine.capture.camera import Camera
from ...engine.capture.capture import Capture, Shot
from ...engine.errors import FrogError


def fewer_views(capture: Capture, count: int) -> Capture:
    """The ``count`` training cameras that lie farthest apart, beginning with the most central one.

    Raises:
        FrogError: for a capture that has not as many.
    """
    training = [camera for camera in capture.cameras if camera.name not in capture.test_cameras]
    if len(training) < count:
        raise FrogError(f"{capture.path}: {count} views are asked for, found {len(training)} to train on.")
    centers = np.array([camera.center for camera in training])
    chosen = [int(np.linalg.norm(centers - centers.mean(axis=0), axis=1).argmin())]
    while len(chosen) < count:
        distances = np.linalg.norm(centers[:, None] - centers[chosen], axis=2).min(axis=1)
        chosen.append(int(distances.argmax()))
    kept = {training[index].name for index in chosen}
    return capture.without_cameras([camera.name for camera in training if camera.name not in kept])


def wrong_poses(capture: Capture, degrees: float) -> Capture:
    """Training cameras turned about a random axis, and moved by as large a part of the rig's size; ``degrees`` is the
    standard deviation about each axis."""
    random = np.random.default_rng(7)
    centers = np.array([camera.center for camera in capture.cameras])
    size = float(np.median(np.linalg.norm(centers - centers.mean(axis=0), axis=1)))
    angle = np.radians(degrees)

    def moved(camera: Camera) -> Camera:
        turn, step = random.normal(0, angle, 3), random.normal(0, angle * size, 3)
        return camera if camera.name in capture.test_cameras else camera.moved(turn, step)

    return capture.with_cameras(moved(camera) for camera in capture.cameras)


def wrong_clocks(capture: Capture, most: int) -> Capture:
    """Each training camera shows what happened up to ``most`` moments earlier or later; where its film has no such
    image there is none."""
    random = np.random.default_rng(11)
    late = {
        index: 0 if camera.name in capture.test_cameras else int(random.integers(-most, most + 1))
        for index, camera in enumerate(capture.cameras)
    }
    films = {(shot.camera, shot.frame): shot for shot in capture.shots}

    def shown(shot: Shot) -> Shot | None:
        source = films.get((shot.camera, shot.frame + late[shot.camera]))
        return source and replace(shot, path=source.path, index=source.index)

    shots = tuple(found for shot in capture.shots if (found := shown(shot)) is not None)
    return replace(capture, shots=shots)


def faster(capture: Capture, pace: int, count: int) -> Capture:
    """``count`` moments, of which each is ``pace`` moments of the film after the one before."""
    film = capture.segment(0, pace * count)
    shots = tuple(replace(shot, frame=shot.frame // pace) for shot in film.shots if shot.frame % pace == 0)
    frames = frozenset(frame // pace for frame in film.test_frames if frame % pace == 0)
    return replace(film, shots=shots, frame_count=count, test_frames=frames)
