"""A scene as a retiming shows it, for whoever goes through its frames."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from ..gaussians import NumpyGaussians
from ..playback.player import ScenePlayer
from ..scene.header import SceneHeader
from .edited_scene import EditedScene
from .edits import Edits
from .grades import NOTHING
from .timing import Timing


@dataclass(frozen=True)
class RetimedScene:
    """A scene as a retiming shows it; its frames are those of the retiming, counted from 0.

    Attributes:
        scene: what is shown.
        timing: the retiming.
    """

    scene: ScenePlayer
    timing: Timing

    @property
    def header(self) -> SceneHeader:
        """The scene file's header."""
        return self.scene.header

    @property
    def keeps_identity(self) -> bool:
        """See ``ScenePlayer``."""
        return self.scene.keeps_identity

    def at_frame(self, frame: int) -> NumpyGaussians:
        """As many Gaussians in each frame, all of them transparent where nothing is shown."""
        shown = self.timing.frames[frame]
        return self._nothing.at_frame(0) if shown is None else self.scene.at_frame(shown)

    @cached_property
    def _nothing(self) -> ScenePlayer:
        return EditedScene(self.scene, Edits(grades=(NOTHING,)))
