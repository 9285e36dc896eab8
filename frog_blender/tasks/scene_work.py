"""What is worked out of a scene for an edit, beside Blender's main thread."""

from collections.abc import Callable, Sequence
from typing import Any

from ..engine.io.child_process import Stopped
from ..engine.whole_progress import WholeProgress
from .background_task import BackgroundTask


class SceneWork(BackgroundTask):
    """One piece of such work.

    Args:
        function: does it; is given ``tell(stage, part)``, which ends it where it was cancelled.
        plan: its stages, and the seconds that each is likely to take.
    """

    what = "edit"
    busy = "Another edit is being worked out. Wait for it, or stop it with Esc."

    def __init__(self, function: Callable[[Callable[[str, float], None]], Any], plan: Sequence[tuple[str, float]]):
        super().__init__()
        self._function, self._whole = function, WholeProgress(plan)

    @property
    def kept_at_quit(self) -> str:
        return "The capture stays as it is."

    def work(self) -> Any:
        return self._function(self._tell)

    def _tell(self, stage: str, part: float) -> None:
        if self.stopped.is_set():
            raise Stopped
        self.tell_whole(self._whole.tell(stage, part))
