"""The scene of a training while it runs, for the viewports of the Blender scene that it was started from."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy

from ..engine.training.session.live_scene import LiveScene
from ..timeline import playback_cache

if TYPE_CHECKING:
    from ..engine.playback.player import ScenePlayer


class LiveView:
    """What is seen of one training.

    Args:
        scene: the Blender scene whose viewports show it.

    Attributes:
        source: what the training offers its snapshots to.
        player: the latest one; None until there is one.
        number: of snapshots so far.
    """

    def __init__(self, scene: bpy.types.Scene) -> None:
        self.source = LiveScene(is_wanted=self._is_seen(scene))
        self.player: ScenePlayer | None = None
        self.number = 0
        self._scene_uid = scene.session_uid

    def shown_in(self, scene: bpy.types.Scene) -> ScenePlayer | None:
        """What a scene's viewports show of the training; None for nothing."""
        return self.player if scene.session_uid == self._scene_uid and scene.frog.show_live else None

    def update(self) -> bool:
        """Takes the newest snapshot, and says whether further ones are wanted; true if there was one."""
        scene = next((known for known in bpy.data.scenes if known.session_uid == self._scene_uid), None)
        self.source.is_wanted = scene is not None and self._is_seen(scene)
        newest = self.source.take()
        if newest is None:
            return False
        self.forget()
        self.player = newest
        self.number += 1
        return True

    def forget(self) -> None:
        """Drops what was seen, and what is kept of it elsewhere."""
        if self.player is not None:
            playback_cache.frames().forget(self.player.token)
        self.player = None

    @staticmethod
    def _is_seen(scene: bpy.types.Scene) -> bool:
        return bool(scene.frog.show_live) and not bpy.app.background
