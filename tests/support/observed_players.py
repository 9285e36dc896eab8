"""Players of scene files that tell when they are asked, and fail when they are told to, in place of the add-on's."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from frog_blender import addon_state
from frog_blender.engine.arrays import Array
from frog_blender.engine.gaussians import NumpyGaussians
from frog_blender.engine.playback.frame_delta import FrameDelta
from frog_blender.engine.playback.player import ScenePlayer, select_gaussians
from frog_blender.engine.scene.scene_file import SceneFile, read_scene
from frog_blender.timeline import open_scenes

Observer = Callable[["ObservedPlayer", float], object]


class ObservedPlayer(ScenePlayer):
    """A player with two observers, which are called with it and a time and may raise.

    Attributes:
        path: of the file.

    Args:
        computing: is called before a time's Gaussians are computed.
        giving: is called before they are given to whoever draws them, computed or not.
    """

    def __init__(self, path: Path, scene: SceneFile, computing: Observer, giving: Observer) -> None:
        super().__init__(scene)
        self.path, self.file, self.computing, self.giving = path, scene, computing, giving

    def subset(self, kept: Array) -> ScenePlayer:
        return ObservedPlayer(self.path, select_gaussians(self.file, kept), self.computing, self.giving)

    def at(self, time: float, part: FrameDelta | None = None) -> NumpyGaussians:
        if part is None:
            self.computing(self, time)
        self.giving(self, time)
        return super().at(time, part)

    def delta_at(self, time: float) -> FrameDelta:
        self.computing(self, time)
        return super().delta_at(time)


def _nothing(player: ObservedPlayer, time: float) -> None:
    """Observes nothing."""


@contextmanager
def observed(computing: Observer = _nothing, giving: Observer = _nothing) -> Iterator[None]:
    """Inside, the add-on opens every scene file as an ``ObservedPlayer``."""
    open_scenes.forget()
    addon_state.put(open_scenes.OpenScenes(lambda path: ObservedPlayer(path, read_scene(path), computing, giving)))
    try:
        yield
    finally:
        open_scenes.forget()
        addon_state.reset(open_scenes.OpenScenes)
