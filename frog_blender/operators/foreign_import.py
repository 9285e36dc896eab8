"""The conversion of another program's file to a ``.frog``, beside Blender's main thread."""

from __future__ import annotations

import sys
import threading
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..background_task import BackgroundTask
from ..engine.errors import FrogError, brief
from ..timeline import open_scenes

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
            with suppress(FrogError):  # which the import tells; read here, the main thread does not stand still for it
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
