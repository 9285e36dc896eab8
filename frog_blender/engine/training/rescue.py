"""Where a training's results go, and where else when the disk does not take them: nothing that was learned is lost."""

from __future__ import annotations

import tempfile
from collections.abc import Generator, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..capture.frames import default_cache_folder
from ..errors import FrogError
from ..files import SceneFile
from . import events
from .checkpoint import State, checkpoint_path, write_checkpoint
from .events import Event
from .outputs import numbered_names
from .saving import save_scene

if TYPE_CHECKING:
    from .job import TrainingJob
    from .trainer import Trainer


class Checkpoints:
    """The checkpoint beside a scene, as new as the disk allows.

    Args:
        step: at which the training begins or goes on.

    Attributes:
        step: of the checkpoint.
    """

    def __init__(self, job: TrainingJob, step: int) -> None:
        self._path, self.step = checkpoint_path(job.output), step

    def save(self, state: State) -> Iterator[Event]:
        """A disk or a memory that takes no checkpoint is no reason to lose the training: then it says so."""
        try:
            self._write(state)
        except FrogError as error:
            yield events.Warned(f"{error} Training goes on without this checkpoint.")

    def keep(self, state: State) -> None:
        """For a training that ends unforeseen: writes a remembered state that is newer than the last checkpoint."""
        if state[1]["step_count"] > self.step:
            with suppress(FrogError):
                self._write(state)

    def _write(self, state: State) -> None:
        write_checkpoint(self._path, state)
        self.step = state[1]["step_count"]


def save_somewhere(
    job: TrainingJob, trainer: Trainer, scale: float, metrics: dict[str, Any]
) -> Generator[Event, None, tuple[Path, SceneFile]]:
    """Writes the scene where the job wants it, else to a folder that takes it; where it is.

    Raises:
        FrogError: when no folder does.
    """
    try:
        return job.output, save_scene(job, trainer, scale, metrics)
    except FrogError as error:
        first = error
    for folder in _other_folders():
        place = _free_name(folder, job.output)
        try:
            scene = save_scene(replace(job, output=place), trainer, scale, metrics)
        except FrogError:
            continue
        yield events.Warned(f"{first} The scene was saved as {place} instead.")
        return place, scene
    raise first


def _other_folders() -> list[Path]:
    return [default_cache_folder() / "rescued", Path(tempfile.gettempdir())]


def _free_name(folder: Path, wanted: Path) -> Path:
    """``wanted``'s name in ``folder``, numbered where it is taken."""
    return next(place for place in numbered_names(folder / wanted.name, "-") if not place.exists())
