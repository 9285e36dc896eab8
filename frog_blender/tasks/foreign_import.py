"""The conversion of another program's file to a ``.frog``, beside Blender's main thread."""

from __future__ import annotations

import atexit
import sys
import threading
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from .. import addon_state
from ..engine.errors import FrogError, brief
from ..timeline import open_scenes
from .background_task import BackgroundTask, TaskHolder, end_ticking

if TYPE_CHECKING:
    from ..engine.interchange.frame_source import Imported

Converter = Callable[[Callable[[int, int], None]], "Imported"]
"""Is given ``progress(done, of)``, which may raise. Returns what was written, or raises FrogError."""


class Cancelled(Exception):
    """Ends a converter."""


@dataclass(frozen=True)
class _Told:
    """Progress."""

    done: int
    of: int


@dataclass(frozen=True)
class _Ended:
    """The worker's last message."""

    imported: Imported | None = None
    error: str = ""


class ForeignImport(BackgroundTask):
    """One file: ``start()`` it, ``pump()`` it until ``is_running`` is false.

    A cancelled one writes nothing, unless it is writing already: then all of it.

    Attributes:
        share: of the work that is done.
        imported: what was written; None until then, and with ``error``.
        error: a sentence if it failed.
    """

    what = "import"
    quit_seconds = 2.0

    def __init__(self, source: Path, convert: Converter) -> None:
        super().__init__()
        self.source, self.share, self.error = source, 0.0, ""
        self.imported: Imported | None = None
        self._convert = convert
        self._has_ended = False
        self._stop = threading.Event()

    @property
    def is_running(self) -> bool:
        return not self._has_ended

    def cancel(self) -> None:
        self._stop.set()

    def work(self) -> None:
        try:
            imported = self._convert(self._tell)
            if not self._stop.is_set():  # the add-on may be switched off by now
                with suppress(FrogError):  # which the import tells; read here, the main thread does not wait for it
                    open_scenes.scene(imported.path).at(0.0)
            self.put(_Ended(imported))
        except Cancelled:
            self.put(_Ended(error=f"{self.source}: not imported."))
        except FrogError as error:
            self.put(_Ended(error=str(error)))
        except MemoryError:
            self.put(_Ended(error=f"{self.source}: there is not enough memory to import it."))
        except BaseException as error:
            traceback.print_exc(file=sys.stderr)
            reason = f"the import stopped on an unexpected {type(error).__name__} ({brief(error)})"
            self.put(_Ended(error=f"{self.source}: {reason}."))

    def _tell(self, done: int, of: int) -> None:
        if self._stop.is_set():
            raise Cancelled
        self.put(_Told(done, of))

    def apply(self, message: _Told | _Ended) -> None:
        if isinstance(message, _Told):
            self.share = message.done / max(message.of, 1)
            return
        self._has_ended, self.imported, self.error = True, message.imported, message.error

    def death(self) -> _Ended:
        return _Ended(error=f"{self.source}: the import stopped without an error message.")


class CurrentImport(TaskHolder):
    """The only import: two at once could write the same file.

    Attributes:
        is_taken: whether an operator has files left to convert or to add.
    """

    busy = "Another import is running, or has not ended yet. Wait for it, or stop it with Esc."
    task: ForeignImport | None = None
    is_taken = False

    @property
    def is_busy(self) -> bool:
        """Whether no other may begin. A worker that was cancelled may still be writing."""
        return self.is_taken or (self.task is not None and not self.task.join(0.0))

    def convert(self, source: Path, converter: Converter) -> ForeignImport:
        """Begins with a file; FrogError where that cannot be."""
        if self.task is not None:
            self.task.pump_all()  # of one that was cancelled
        self.begin(lambda: ForeignImport(source, converter), tick)
        assert self.task is not None
        return self.task


def current() -> CurrentImport:
    """The add-on's."""
    return addon_state.get(CurrentImport)


def tick() -> float | None:
    """What Blender's timer calls: pumps the import, which may have lost its operator."""
    return current().tick()


def stop() -> None:
    """Cancels the import and waits for it."""
    current().stop()


def register() -> None:
    atexit.register(stop)


def unregister() -> None:
    stop()
    atexit.unregister(stop)
    end_ticking(tick)
