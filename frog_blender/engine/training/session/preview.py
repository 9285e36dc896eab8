"""Small images of a training as it stands, for whoever watches it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

from ...capture.capture import Capture
from ...playback.render import to_uint8
from . import events
from .cancel_token import CancelToken
from .events import Event

if TYPE_CHECKING:
    from ..optimize.trainer import Trainer
    from .job import TrainingJob

LARGEST_SIDE = 512  # pixels of a preview, at most: drawing one takes less than a step


def watched_shot(capture: Capture, camera: str | None = None) -> int | None:
    """The image that previews show: of a camera, by name, the middle moment; by default what is held out first.

    None for a name that is no camera of the capture.
    """
    if camera:
        shots = [i for i, shot in enumerate(capture.shots) if capture.cameras[shot.camera].name == camera]
        return shots[len(shots) // 2] if shots else None
    return next((i for i, shot in enumerate(capture.shots) if capture.is_test(shot)), 0)


class Previews:
    """Says when a preview is due, and draws it: at once, every ``job.preview_seconds``, and when another camera is
    asked for."""

    def __init__(self, job: TrainingJob, control: CancelToken) -> None:
        self._job, self._control = job, control
        self._last, self._camera = float("-inf"), self._asked
        self._refused: set[str] = set()

    @property
    def _asked(self) -> str | None:
        chosen = self._control.preview_camera
        return self._job.preview_camera if chosen is None else chosen

    @property
    def due(self) -> bool:
        return self._asked != self._camera or time.monotonic() - self._last >= self._job.preview_seconds

    def draw(self, trainer: Trainer) -> Iterator[Event]:
        """The preview; a sentence first, once, where the camera that was asked for is none of the capture's."""
        self._camera = self._asked
        shot = watched_shot(trainer.capture, self._camera)
        if shot is None:
            name = self._camera or ""
            if name not in self._refused:
                self._refused.add(name)
                yield events.WarningEvent(f"The preview shows no camera {name!r}: the capture has none of this name.")
            shot = watched_shot(trainer.capture) or 0
        yield events.Preview(trainer.step_count, to_uint8(trainer.render_image(shot, LARGEST_SIDE)))
        self._last = time.monotonic()
