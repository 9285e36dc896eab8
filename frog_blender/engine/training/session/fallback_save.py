"""Where a training's results go, and where else when the disk does not take them: nothing that was learned is lost."""

from __future__ import annotations

import errno
import tempfile
from collections.abc import Callable, Generator, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from ...capture.frames import FrameStore, default_cache_folder
from ...errors import FrogError
from ...io.atomic_files import beginning, write_atomically
from . import events
from .checkpoint import State, checkpoint_path, write_checkpoint
from .disk_reserve import Reserve
from .events import Event
from .output_paths import numbered_names

if TYPE_CHECKING:
    from .job import TrainingJob

_SHORT = 60  # bytes of a rescued scene's name: its own may be what the disk does not take


class Checkpoints:
    """The checkpoint beside a scene, as new as the disk allows.

    Args:
        step: at which the training begins or goes on.

    Attributes:
        step: of the checkpoint.
    """

    def __init__(self, job: TrainingJob, step: int) -> None:
        self._path, self.step, self._said = checkpoint_path(job.output), step, ""

    def save(self, state: State) -> Iterator[Event]:
        """A disk or a memory that takes no checkpoint is no reason to lose the training: then it says so, once."""
        try:
            self._write(state)
            self._said = ""
        except FrogError as error:
            if str(error) != self._said:
                self._said = str(error)
                yield events.WarningEvent(f"{error} Training goes on without this checkpoint.")

    def keep(self, state: State, room: Room) -> None:
        """For a training that ends unforeseen: writes a remembered state that is newer than the last checkpoint."""
        if self.is_older(state):
            with suppress(FrogError):
                room.write(self._path, lambda: self._write(state))

    def save_late(self, state: State, room: Room | None) -> Iterator[Event]:
        """Once more, after the scene was saved: there may be room now. What can be given up for it is in ``room``."""
        if not self.is_older(state):
            return
        with suppress(FrogError):
            how = ""
            if room:
                how = room.write(self._path, lambda: self._write(state))
            else:
                self._write(state)
            yield events.WarningEvent(f"{self._path}: it was written in the end{how}.")

    def is_older(self, state: State) -> bool:
        """True when the checkpoint does not know all that the state does."""
        return state[1]["step_count"] > self.step

    def _write(self, state: State) -> None:
        write_checkpoint(self._path, state)
        self.step = state[1]["step_count"]


class Room:
    """What can be given up for a scene when a disk is full: room that was kept for it, and the decoded frames.

    Args:
        output: where the scene is to lie.
        size: its bytes, at most.
        store: the training's frames. Once they are given up no image can be looked at any more.
    """

    def __init__(self, output: Path, size: int, store: FrameStore) -> None:
        self._output, self._store = output, store
        self._reserve = Reserve(output, size)

    def write(self, path: Path, work: Callable[[], None]) -> str:
        """Does ``work``, which writes ``path``, with as much given up as that takes; says how it was made possible.

        Raises:
            FrogError: ``work``'s, where nothing more can be done.
        """
        how = ""
        while True:
            try:
                work()
                return how
            except FrogError as error:
                made = self._make(path) if is_full(error) else ""
                if not made:
                    raise
                how = made

    def give_back(self) -> None:
        """What was kept is not needed any more."""
        self._reserve.give_back()

    def _make(self, path: Path) -> str:
        """Gives the next thing up that makes room for ``path``, and says what; "" where there is none."""
        if _same_disk(path.parent, self._output.parent) and self._reserve.give_back():
            return " in the room that was kept for it"
        if _same_disk(path.parent, self._store.folder) and (freed := self._store.give_up()):
            return f" after {freed / 1e6:,.1f} MB of decoded frames were deleted to make room"
        return ""


def save_with_fallback(output: Path, content: bytes, room: Room) -> Generator[Event, None, Path]:
    """Writes a scene where it is wanted, else to a folder that takes it; where it is.

    Raises:
        FrogError: when no folder does.
    """
    first: FrogError | None = None
    for place in [output, *_other_places(output)]:
        try:
            how = room.write(place, lambda place=place: write_atomically(place, content))  # type: ignore[misc]
        except FrogError as error:
            first = first or error
            continue
        if first:
            yield events.WarningEvent(f"{first} The scene was saved as {place} instead{how}.")
        elif how:
            yield events.WarningEvent(f"{output.parent}: the disk is full; the scene was saved{how}.")
        return place
    assert first is not None
    raise first


def is_full(error: FrogError) -> bool:
    """True for a file that could not be written since its disk, or its user's part of it, is full."""
    return isinstance(error.__cause__, OSError) and error.__cause__.errno in (errno.ENOSPC, errno.EDQUOT)


def _other_places(output: Path) -> Iterator[Path]:
    """Free names in folders that every computer has; short ones, and at last one that any disk takes."""
    short = f"{beginning(output.stem, _SHORT)}.frog"
    for name in dict.fromkeys([short, "rescued.frog"]):
        for folder in (default_cache_folder() / "rescued", Path(tempfile.gettempdir())):
            with suppress(OSError):  # a folder that cannot be looked into
                yield next(place for place in numbered_names(folder / name, "-") if not place.exists())


def _same_disk(one: Path, other: Path) -> bool:
    """False where that cannot be told."""
    try:
        return _existing(one).stat().st_dev == _existing(other).stat().st_dev
    except OSError:
        return False


def _existing(folder: Path) -> Path:
    """The folder, or the nearest above it that is there: a folder that is still to be made lies on its disk."""
    return next((path for path in (folder, *folder.parents) if path.exists()), folder)
