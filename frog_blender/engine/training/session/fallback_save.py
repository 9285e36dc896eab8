"""Where a training's results go, and where else when the disk is full or fails: nothing that was learned is lost.

Disk space is reserved for the scene from the first step on, so that whatever fills the disk meanwhile leaves it.
"""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Generator, Iterator
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from ...errors import FrogError
from ...frames.store import FrameStore
from ...io.atomic_files import beginning, write_atomically
from ...io.cache_folder import default_cache_folder
from . import events
from .checkpoint import State, write_checkpoint
from .events import Event
from .output_paths import numbered_names

_MAX_SHARE = 0.25  # of the free space: a nearly full disk is not filled by this


def allocate(file: BinaryIO, size: int, system: str = sys.platform) -> None:
    """Gives the file blocks of its own, which a hole would not have; OSError where the system cannot at once.

    Not os.posix_fallocate: where the file system cannot, the C library writes into every block, for minutes.
    """
    if size <= 0:
        return
    if system != "linux":
        raise OSError(errno.ENOTSUP, "no space can be reserved at once")
    fallocate = ctypes.CDLL(None, use_errno=True).fallocate
    fallocate.argtypes = [ctypes.c_int, ctypes.c_int, ctypes.c_int64, ctypes.c_int64]
    if fallocate(file.fileno(), 0, 0, size):
        raise OSError(ctypes.get_errno(), "no space can be reserved at once")


class DiskReserve:
    """An unnamed file beside ``output``, as large as its scene may become; it vanishes with the process.

    Nothing is reserved where that would mean writing every byte: outside Linux, and on many network disks.

    Args:
        output: the scene.
        size: bytes, at most a quarter of what the disk has.
        allocate: gives a file so many bytes of the disk; OSError where it cannot at once.
    """

    def __init__(self, output: Path, size: int, allocate: Callable[[BinaryIO, int], None] = allocate) -> None:
        self._file: BinaryIO | None = None
        try:
            size = min(size, int(_MAX_SHARE * shutil.disk_usage(output.parent).free))
            self._file = tempfile.TemporaryFile(dir=output.parent, buffering=0)  # noqa: SIM115
            allocate(self._file, size)
        except OSError:  # a disk on which nothing can be reserved may have space at the end all the same
            self.release()

    @property
    def size(self) -> int:
        """Bytes of the disk that are reserved."""
        return 512 * os.fstat(self._file.fileno()).st_blocks if self._file else 0

    def release(self) -> bool:
        """Frees the space; False where none is reserved any more."""
        if self._file is None:
            return False
        self._file.close()
        self._file = None
        return True


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

    def write_emergency(self, state: State, space: SpareSpace) -> None:
        """For a training that ends by an unexpected error: writes a state that is newer than the last checkpoint."""
        if self.is_older(state):
            with suppress(FrogError):
                space.write(self.path, lambda: self._write(state))

    def save_late(self, state: State, space: SpareSpace | None) -> Iterator[Event]:
        """Tries once more after the scene was saved, since the disk may have space now; ``space`` may be given up."""
        if not self.is_older(state):
            return
        with suppress(FrogError):
            how = ""
            if space:
                how = space.write(self.path, lambda: self._write(state))
            else:
                self._write(state)
            yield events.WarningEvent(f"{self.path}: written at the end{how}.")

    def is_older(self, state: State) -> bool:
        """True when the checkpoint lacks steps that the state has."""
        return bool(state[1]["step_count"] > self.step)

    def _write(self, state: State) -> None:
        write_checkpoint(self.path, state)
        self.step = state[1]["step_count"]


class SpareSpace:
    """What can be given up for a scene when a disk is full: space that was reserved for it, then the decoded frames.

    Args:
        output: where the scene is to lie.
        size: its bytes, at most.
        store: the training's frames. Once they are given up no image can be read any more.
    """

    def __init__(self, output: Path, size: int, store: FrameStore) -> None:
        self._output, self._store = output, store
        self._reserve = DiskReserve(output, size)

    def write(self, path: Path, work: Callable[[], None]) -> str:
        """Does ``work``, which writes ``path``, and gives up as much as that takes.

        Returns:
            What was given up, in words; empty where nothing was.

        Raises:
            FrogError: ``work``'s, where nothing is left to give up.
        """
        how = ""
        while True:
            try:
                work()
                return how
            except FrogError as error:
                freed = self._free(path) if is_disk_full(error) else ""
                if not freed:
                    raise
                how = freed

    def release(self) -> None:
        """Frees the reserved space, which is not needed any more."""
        self._reserve.release()

    def _free(self, path: Path) -> str:
        """Gives up the next thing on ``path``'s disk and names it; "" where there is none."""
        if _same_disk(path.parent, self._output.parent) and self._reserve.release():
            return " in the space that was reserved for it"
        if _same_disk(path.parent, self._store.folder) and (freed := self._store.give_up()):
            return f" after {freed / 1e6:,.1f} MB of decoded frames were deleted to free space"
        return ""


def save_with_fallback(output: Path, content: bytes, space: SpareSpace) -> Generator[Event, None, Path]:
    """Writes a scene where it is wanted, else into the first folder that accepts it; warns where that took something.

    Returns:
        Where the scene lies.

    Raises:
        FrogError: when no folder accepts it.
    """
    first: FrogError | None = None
    for place in [output, *_fallback_places(output)]:
        try:
            how = space.write(place, lambda place=place: write_atomically(place, content))  # type: ignore[misc]
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


def is_disk_full(error: FrogError) -> bool:
    """True where a file could not be written because its disk, or the user's quota on it, is full."""
    return isinstance(error.__cause__, OSError) and error.__cause__.errno in (errno.ENOSPC, errno.EDQUOT)


def _fallback_places(output: Path) -> Iterator[Path]:
    """Free names in folders that every computer has: short ones, and at last one that any disk accepts."""
    short = f"{beginning(output.stem, _SHORT_NAME)}.frog"
    for name in dict.fromkeys([short, "rescued.frog"]):
        for folder in (default_cache_folder() / "rescued", Path(tempfile.gettempdir())):
            with suppress(OSError):  # a folder that cannot be looked into
                yield next(place for place in numbered_names(folder / name, "-") if not place.exists())


def _same_disk(one: Path, other: Path) -> bool:
    """False where that is unknown."""
    try:
        return _existing(one).stat().st_dev == _existing(other).stat().st_dev
    except OSError:
        return False


def _existing(folder: Path) -> Path:
    """The folder, or its nearest existing parent, on whose disk it will be made."""
    return next((path for path in (folder, *folder.parents) if path.exists()), folder)
