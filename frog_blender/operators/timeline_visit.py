"""A capture as the timeline plays it, for other programs: found anew at each frame, retimed, and where it stands."""

from collections.abc import Sequence

import bpy
import numpy as np

from ..engine.errors import FrogError
from ..engine.interchange.take import Take, TakeFrame
from ..scene_import.capture_objects import find_by_uid
from ..timeline import playback
from ..timeline.edits import needs_evaluation
from ..timeline.frame_timing import frames_shown
from ..timeline.retiming import frame_rate, is_shown, raw_frame, stretched
from .modal_operator import ModalOperator


class TimelineVisit:
    """Goes through frames of the timeline. Between two of them the .blend may change, so no object of it is kept.

    Args:
        context: of the scene that is gone through.
        obj: plays the capture.
    """

    def __init__(self, context: bpy.types.Context, obj: bpy.types.Object) -> None:
        scene = context.scene
        self._capture, self._name = obj.session_uid, obj.name
        self._scene, self._layer = scene.session_uid, context.view_layer.name
        self._shown = scene.frame_current, scene.frame_subframe

    def found(self) -> tuple[bpy.types.Object, bpy.types.Scene]:
        """The object and the scene as they are now; FrogError if either is gone."""
        obj = find_by_uid(bpy.data.objects, self._capture)
        if obj is None or next(playback.captures([obj]), None) is None:
            raise FrogError(f"{self._name}: this capture is no longer in the file.")
        scene = find_by_uid(bpy.data.scenes, self._scene)
        if scene is None:
            raise FrogError(f"{self._name}: its scene was deleted during the export.")
        return obj, scene

    def at(self, frame: float, *, placed: bool = False) -> TakeFrame:
        """What the capture shows at a frame, to which the scene is moved.

        Args:
            placed: whether to tell where the capture has been placed.
        """
        obj, scene = self.found()
        if frame != raw_frame(scene):
            scene.frame_set(int(frame))  # the empty may be animated
        layer = scene.view_layers.get(self._layer) or scene.view_layers[0]
        layer.update()
        evaluated, now = obj.evaluated_get(layer.depsgraph), scene.frame_current_final
        gaussians = playback.scene_time(obj, now, evaluated).gaussians()
        time = playback.shown_frame(obj, now, evaluated)
        return TakeFrame(frame, time, gaussians, np.array(evaluated.matrix_world) if placed else None)

    def restore(self) -> None:
        """Restores the scene's current frame, if the scene still exists."""
        scene = find_by_uid(bpy.data.scenes, self._scene)
        if scene is not None and (scene.frame_current, scene.frame_subframe) != self._shown:
            scene.frame_set(self._shown[0], subframe=self._shown[1])


class VisitsTimeline(ModalOperator):
    """A base next to ``bpy.types.Operator``: its steps go through frames of the timeline."""

    _visit: TimelineVisit | None = None

    def visiting(self, context: bpy.types.Context, obj: bpy.types.Object) -> TimelineVisit:
        """A visit of the current scene, which shows its present frame again afterwards."""
        self._visit = TimelineVisit(context, obj)
        return self._visit

    def restore(self) -> None:
        if self._visit is not None:
            self._visit.restore()


def timeline_take(visit: TimelineVisit, numbers: Sequence[float], *, placed: bool) -> Take:
    """Frames of the timeline, as a capture shows them; FrogError if its file cannot be played.

    Args:
        visit: finds the capture at each frame.
        placed: whether the Gaussians stand where the capture has been placed; else in the capture's own space.
    """
    obj, scene = visit.found()
    playing = playback.scene_time(obj, numbers[0]).scene
    several = len(numbers) > 1
    appears = len({is_shown(obj, stretched(scene, frame)) for frame in numbers}) > 1
    all_change = needs_evaluation(obj) or appears  # edits that are animated, and where it is not there
    return Take(
        name=obj.parent.name if obj.parent is not None else obj.name,
        header=playing.header,
        num_dynamic=(playing.count if all_change else playing.num_dynamic) if several else 0,
        changing=(playing.columns if all_change else playing.changing) if several else (),
        keeps_identity=playing.keeps_identity,
        rate=frame_rate(scene),
        numbers=numbers,
        shown=frames_shown(obj, scene, [int(frame) for frame in numbers]),
        frames=lambda: (visit.at(frame, placed=placed) for frame in numbers),
    )
