"""The conversion of another program's file to a ``.frog``, beside Blender's main thread."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Self

from .. import addon_state
from ..engine.errors import FrogError
from ..engine.interchange.imports import Imported
from ..engine.io.child_process import Stopped
from ..timeline import open_scenes
from .background_task import BackgroundTask


class Importing:
    """Two imports at once could write the same file.

    Attributes:
        is_taken: whether an operator has files left to convert or to add.
    """

    is_taken = False


class ForeignImport(BackgroundTask):
    """One file; its result is what was ``Imported``. A cancelled one writes nothing, unless it is writing already:
    then all of it.

    Args:
        convert: writes the file; given ``progress(done, of)``, which may raise.
    """

    what = "import"
    busy = "Another import is running, or has not ended yet. Wait for it, or stop it with Esc."
    quit_seconds = 2.0

    def __init__(self, source: Path, convert: Callable[..., Imported]) -> None:
        super().__init__()
        self.source, self.where, self._convert = source, str(source), convert

    @classmethod
    def is_busy(cls) -> bool:
        """Whether no other may begin. A worker that was cancelled may still be writing."""
        task = cls.current()
        return addon_state.get(Importing).is_taken or (task is not None and not task.join(0.0))

    def begin(self) -> Self:
        last = self.current()
        if last is not None:
            last.pump_all()  # one that was cancelled
        return super().begin()

    def work(self) -> Imported:
        imported = self._convert(progress=self._tell)
        if not self.stopped.is_set():  # the add-on may be switched off by now
            with suppress(FrogError):  # which the import tells; read here, the main thread does not wait for it
                open_scenes.scene(imported.path).at(0.0)
        return imported

    def _tell(self, done: int, of: int) -> None:
        if self.stopped.is_set():
            raise Stopped
        self.tell("importing", done, of)
