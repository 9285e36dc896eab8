"""What people see of a training: previews, and snapshots of its scene."""

import time
from collections.abc import Iterator

from ...capture.capture import Capture
from ...playback.player import ScenePlayer
from ...playback.render import to_uint8
from ...scene.scene_file import SceneFile
from . import events
from .events import Event
from .export import scene_as_it_stands
from .session import Session


def preview_shot(capture: Capture, camera: str | None = None) -> int | None:
    """The shot that previews show: the named camera's middle frame; by default the first held-out one.

    None for a name that no camera of the capture has.
    """
    if camera:
        shots = [i for i, shot in enumerate(capture.shots) if capture.cameras[shot.camera].name == camera]
        return shots[len(shots) // 2] if shots else None
    return next((i for i, shot in enumerate(capture.shots) if capture.is_test(shot)), 0)


class Previews:
    """Says when a preview is due, and renders it: at once, every ``job.preview_seconds``, and when another camera is
    asked for."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._last, self._camera = float("-inf"), self._wanted
        self._unknown: set[str] = set()

    @property
    def _wanted(self) -> str | None:
        chosen = self._session.cancel.preview_camera
        return self._session.job.preview_camera if chosen is None else chosen

    @property
    def due(self) -> bool:
        """True when one is to be rendered after this step."""
        waited = time.monotonic() - self._last
        return self._wanted != self._camera or waited >= self._session.job.preview_seconds

    def render(self) -> Iterator[Event]:
        """The preview; before it a warning, once, where the capture has no camera of the name that was asked for."""
        self._camera = self._wanted
        capture, trainer = self._session.capture, self._session.trainer
        shot = preview_shot(capture, self._camera)
        if shot is None:
            name = self._camera or ""
            if name not in self._unknown:
                self._unknown.add(name)
                yield events.WarningEvent(f"The capture has no camera {name!r}: previews show another one.")
            shot = preview_shot(capture) or 0
        yield events.Preview(trainer.step_count, to_uint8(trainer.render_image(shot, self._session.job.preview_size)))
        self._last = time.monotonic()


def snapshot(session: Session) -> ScenePlayer:
    """The scene as training stands, to be played by any thread while the training goes on."""
    scene = scene_as_it_stands(session)
    # On the CPU these are the parameters themselves, which the next step changes: the only copy is made here.
    own = session.trainer.device.type == "cpu"
    return ScenePlayer(SceneFile(scene.header, {k: v.copy() if own else v for k, v in scene.arrays.items()}))
