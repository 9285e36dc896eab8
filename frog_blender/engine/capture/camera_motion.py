"""Whether a capture was filmed by cameras that move: the one definition, for captures and scene headers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def cameras_move(images_per_camera: Iterable[int], training_frames: Sequence[int], *, rig: bool = False) -> bool:
    """Whether each camera stands for one image of a moving camera.

    Args:
        images_per_camera: of every camera.
        training_frames: of every image that may be trained on. Held-out images do not count: of a rig of two cameras
            one may be trained on and the other judge.
        rig: several cameras may have moved together, so that images may share a frame.
    """
    frames = set(training_frames)
    if any(count != 1 for count in images_per_camera) or len(frames) < 2:
        return False
    return rig or len(frames) == len(training_frames)
