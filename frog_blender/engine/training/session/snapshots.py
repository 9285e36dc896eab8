"""Snapshots of a training's scene for whoever shows it: see ``live_scene``."""

from __future__ import annotations

from .. import passive_threads  # noqa: F401

# isort: split
from collections.abc import Iterator

from ...errors import reason
from ...playback.player import ScenePlayer
from ...scene.scene_file import SceneFile
from . import events
from .events import Event
from .export import scene_as_it_stands
from .live_scene import Rest
from .session import Session


class Snapshots:
    """Offers snapshots of a session to its job's live scene, if there is one."""

    def __init__(self, session: Session) -> None:
        self._session, self._live, self._rest = session, session.job.live, Rest()

    @property
    def due(self) -> bool:
        """Whether one is wanted, and the training can spare the time."""
        return self._live is not None and self._live.is_due and self._rest.is_over

    def offer(self) -> Iterator[Event]:
        """Hands one over; where that fails, a warning, and no further ones."""
        if self._live is None:
            return
        try:
            with self._rest.measured():
                self._live.offer(snapshot(self._session))
        except Exception as error:  # the training does not need it
            self._live = None
            yield events.WarningEvent(f"The training cannot be shown while it runs ({reason(error)}).")


def snapshot(session: Session) -> ScenePlayer:
    """The scene as training stands, to be played by any thread while the training goes on."""
    scene = scene_as_it_stands(session)
    # On the CPU these are the parameters themselves, which the next step changes: the only copy is made here.
    own = session.trainer.device.type == "cpu"
    return ScenePlayer(SceneFile(scene.header, {k: v.copy() if own else v for k, v in scene.arrays.items()}))
