"""Where a training's results go, and where else when the disk is full or fails: nothing that was learned is lost."""

import errno
import tempfile
from collections.abc import Callable, Generator, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path

from ...errors import FrogError
from ...frames.store import FrameStore
from ...io.atomic_files import beginning, write_atomically
from ...io.cache_folder import default_cache_folder
from . import events
from .checkpoint import State, write_checkpoint
from .events import Event
from .output_paths import numbered_names

_SHORT_NAME = 60  # bytes of a fallback's name: the scene's own may be what the disk refuses


class Checkpoints:
    """The checkpoint beside a scene, as new as the disk allows.

    Args:
        path: of the checkpoint.
        step: at which the training begins or is resumed.

    Attributes:
        path: the same.
        step: of the newest checkpoint that was written.
    """

    def __init__(self, path: Path, step: int) -> None:
        self.path, self.step, self._warned = path, step, ""

    def save(self, state: State) -> Iterator[Event]:
        """Writes the state. Where disk or memory do not allow it, training continues, and a warning says so once."""
        try:
            self._write(state)
            self._warned = ""
        except FrogError as error:
            if str(error) != self._warned:
                self._warned = str(error)
                yield events.WarningEvent(f"{error} Training continues without this checkpoint.")

    def write_last(self, state: State, store: FrameStore | None) -> str:
        """Writes a state that is newer than the last checkpoint where a training ends: by an unexpected error, or after
        the scene was saved, since the disk may have space now. The frames of ``store`` may be given up.

        Returns:
            A sentence where that was done; else empty.
        """
        if state[1]["step_count"] > self.step:
            with suppress(FrogError):
                how = _write_for_frames(store, self.path, lambda: self._write(state))
                return f"{self.path}: written at the end{how}."
        return ""

    def _write(self, state: State) -> None:
        write_checkpoint(self.path, state)
        self.step = state[1]["step_count"]


def _write_for_frames(store: FrameStore | None, path: Path, work: Callable[[], None]) -> str:
    """Does ``work``, which writes ``path``. Where its disk is full, the decoded frames on it are deleted: afterwards no
    image can be read any more.

    Returns:
        What was given up, in words; empty where nothing was.

    Raises:
        FrogError: ``work``'s, where nothing can be given up.
    """
    try:
        work()
        return ""
    except FrogError as error:
        full = isinstance(error.__cause__, OSError) and error.__cause__.errno in (errno.ENOSPC, errno.EDQUOT)
        if not (full and store and _same_disk(path, store.folder) and (freed := store.give_up())):
            raise
    work()
    return f" after {freed / 1e6:,.1f} MB of decoded frames were deleted to free space"


def save_with_fallback(output: Path, content: bytes, store: FrameStore) -> Generator[Event, None, Path]:
    """Writes a scene where it is wanted, else into the first folder that accepts it; warns where that took something.

    Returns:
        Where the scene lies.

    Raises:
        FrogError: when no folder accepts it.
    """
    first: FrogError | None = None
    for path in [output, *_fallback_places(output)]:
        try:
            how = _write_for_frames(store, path, partial(write_atomically, path, content))
        except FrogError as error:
            first = first or error
            continue
        if first:
            yield events.WarningEvent(f"{first} The scene was saved as {path} instead{how}.")
        elif how:
            yield events.WarningEvent(f"{output.parent}: the disk is full; the scene was saved{how}.")
        return path
    assert first is not None
    raise first


def _fallback_places(output: Path) -> Iterator[Path]:
    """Free names in folders that every computer has: short ones, and at last one that any disk accepts."""
    short = f"{beginning(output.stem, _SHORT_NAME)}.frog"
    for name in dict.fromkeys([short, "rescued.frog"]):
        for folder in (default_cache_folder() / "rescued", Path(tempfile.gettempdir())):
            with suppress(OSError):  # a folder that cannot be looked into
                yield next(path for path in numbered_names(folder / name, "-") if not path.exists())


def _same_disk(path: Path, folder: Path) -> bool:
    """Whether a file will lie on the disk of a folder that there is; False where that is unknown."""
    with suppress(OSError):
        existing = next(parent for parent in path.parents if parent.exists())
        return existing.stat().st_dev == folder.stat().st_dev
    return False
