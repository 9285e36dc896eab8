"""Corruptions of cameras: fewer views, wrong poses, wrong synchronisation, faster motion.

Held-out images stay as they are.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...engine import Camera, Capture, FrogError, Shot


def fewer_views(capture: Capture, count: int) -> Capture:
    """The ``count`` training cameras that are farthest apart, starting from the most central one.

    Raises:
        FrogError: if the capture has fewer.
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
    """Training cameras with noise in their poses.

    Args:
        degrees: standard deviation of the rotation about each axis. That of the translation along each axis is the
            same angle times the rig's radius.
    """
    random = np.random.default_rng(7)
    centers = np.array([camera.center for camera in capture.cameras])
    size = float(np.median(np.linalg.norm(centers - centers.mean(axis=0), axis=1)))
    angle = np.radians(degrees)

    def moved(camera: Camera) -> Camera:
        turn, step = random.normal(0, angle, 3), random.normal(0, angle * size, 3)
        return camera if camera.name in capture.test_cameras else camera.moved(turn, step)

    return capture.with_cameras(moved(camera) for camera in capture.cameras)


def wrong_clocks(capture: Capture, most: int) -> Capture:
    """Each training camera is out of sync by up to ``most`` frames; frames that its video lacks have no image."""
    random = np.random.default_rng(11)
    late = {
        index: 0 if camera.name in capture.test_cameras else int(random.integers(-most, most + 1))
        for index, camera in enumerate(capture.cameras)
    }
    recorded = {(shot.camera, shot.frame): shot for shot in capture.shots}

    def shown(shot: Shot) -> Shot | None:
        source = recorded.get((shot.camera, shot.frame + late[shot.camera]))
        return source and replace(shot, path=source.path, index=source.index, offset=source.offset)

    shots = tuple(found for shot in capture.shots if (found := shown(shot)) is not None)
    return replace(capture, shots=shots)


def faster(capture: Capture, pace: int, count: int) -> Capture:
    """Every ``pace``-th frame of the capture, ``count`` in all: motion that is ``pace`` times as fast."""
    recorded = capture.segment(0, pace * count)
    kept = (shot for shot in recorded.shots if shot.frame % pace == 0)
    shots = tuple(replace(shot, frame=shot.frame // pace, offset=shot.offset / pace) for shot in kept)
    frames = frozenset(frame // pace for frame in recorded.test_frames if frame % pace == 0)
    return replace(recorded, shots=shots, frame_count=count, test_frames=frames)
