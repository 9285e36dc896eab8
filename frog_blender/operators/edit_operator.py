"""What operators that edit a capture share."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import bpy
import numpy as np

from ..engine.errors import FrogError
from ..scene_import.capture_objects import active_capture
from ..timeline import edits_in_progress, playback
from ..timeline.edits import SETTINGS, marks_of, store_marks

if TYPE_CHECKING:
    from ..engine.playback.player import ScenePlayer


MISSING = {"selection": "Select Gaussians of the capture first.", "hidden": "No Gaussian of the capture is hidden."}
"""By the name of the marks that an operator needs."""


class EditOperator:
    """Base, next to ``bpy.types.Operator``, of operators that edit the active capture."""

    bl_options = {"REGISTER", "UNDO"}
    needs = ""
    """The marks without which there is nothing to do, a key of MISSING."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        obj, say = active_capture(context), cls.poll_message_set  # type: ignore[attr-defined]  # of the Operator
        if obj is None or obj.library is not None:
            say("Select a capture of this file first.")
            return False
        if cls.needs and not getattr(obj.frog_edits, cls.needs).bits:
            say(MISSING[cls.needs])
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            with edits_in_progress.several():
                said = self.edit(context, active_capture(context))
        except FrogError as error:
            self.report({"ERROR"}, str(error))  # type: ignore[attr-defined]
            return {"CANCELLED"}
        playback.refresh(context.scene)
        if said:
            self.report({"INFO"}, said)  # type: ignore[attr-defined]
        return {"FINISHED"}

    def edit(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        """Edits a capture and says what was done; raises FrogError for what cannot be."""
        raise NotImplementedError


def scene_of(obj: bpy.types.Object) -> ScenePlayer:
    """The scene that a capture plays, without edits."""
    return playback.open_scene(playback.file_of(obj))


def remove_crop(obj: bpy.types.Object, index: int) -> None:
    """Removes a crop of a capture, and the empty that hangs on the capture for it unless something else is cropped by
    it. A mesh may be anybody's work, and stays.
    """
    crops = getattr(obj, SETTINGS).crops
    target = crops[index].object
    crops.remove(index)
    if target is None or target.type != "EMPTY" or target.parent != obj:
        return
    if not any(crop.object == target for other in bpy.data.objects for crop in getattr(other, SETTINGS).crops):
        bpy.data.objects.remove(target)


def chosen_in(settings: Any, scene: ScenePlayer) -> np.ndarray:
    """(N,) bool which Gaussians of a scene a group of properties marks; none, if the marks are of another scene."""
    marks = marks_of(settings)
    if marks is None or not marks.fits(scene):
        return np.zeros(scene.file_count, bool)
    return marks.chosen()


def mark(settings: Any, scene: ScenePlayer, chosen: np.ndarray) -> None:
    """Marks Gaussians of a scene in a group of properties."""
    from ..engine.editing.marks import Marks

    store_marks(settings, Marks.of(scene, chosen) if chosen.any() else None)
