"""A capture as the timeline plays it, for other programs: retimed, and where its root stands at each frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import bpy
import numpy as np

from ..engine.errors import FrogError
from ..engine.interchange.take import Sound, TakeFrame
from ..scene_import.capture_objects import find_by_uid
from ..timeline import playback
from ..timeline.edits import needs_evaluation
from ..timeline.retiming import raw_frame

if TYPE_CHECKING:
    from ..engine.scene.header import SceneHeader


@dataclass
class TimelineTake:
    """Frames of the timeline as a ``Take``. Between two of them the .blend may change, so no object of it is kept.

    Attributes:
        capture, name: session_uid and name of the object that plays the capture.
        scene, layer: session_uid of the scene that is gone through, and name of its view layer.
        shown: frame and subframe that the scene shows before.
        numbers: frames of the timeline.
        rate: frames a second.
        header, num_dynamic, changing: of the capture (see ``Take``).
        keeps_identity: see ``Take``.
        placed: whether the Gaussians stand where the capture has been placed; else in the capture's own space.
        sound: what plays with it.
    """

    capture: int
    name: str
    scene: int
    layer: str
    shown: tuple[int, float]
    numbers: Sequence[float]
    rate: float
    header: SceneHeader
    num_dynamic: int
    changing: Sequence[str]
    keeps_identity: bool
    placed: bool
    sound: Sound | None = None

    @classmethod
    def of(
        cls, context: bpy.types.Context, obj: bpy.types.Object, numbers: Sequence[float], *, placed: bool
    ) -> TimelineTake:
        """What ``obj`` shows in the current scene; FrogError if its file cannot be played."""
        scene, playing = context.scene, playback.scene_time(obj, numbers[0]).scene
        several, all_change = len(numbers) > 1, needs_evaluation(obj)  # as edits that are animated change them
        return cls(
            capture=obj.session_uid,
            name=obj.parent.name if obj.parent is not None else obj.name,
            scene=scene.session_uid,
            layer=context.view_layer.name,
            shown=(scene.frame_current, scene.frame_subframe),
            numbers=numbers,
            rate=scene.render.fps / scene.render.fps_base,
            header=playing.header,
            num_dynamic=(playing.count if all_change else playing.num_dynamic) if several else 0,
            changing=(playing.columns if all_change else playing.changing) if several else (),
            keeps_identity=playing.keeps_identity,
            placed=placed,
        )

    def frames(self) -> Iterator[TakeFrame]:
        """Each frame, in order; the scene is moved to it."""
        for number in self.numbers:
            obj = find_by_uid(bpy.data.objects, self.capture)
            if obj is None or next(playback.captures([obj]), None) is None:
                raise FrogError(f"{self.name}: this capture is no longer in the file.")
            scene = find_by_uid(bpy.data.scenes, self.scene)
            if scene is None:
                raise FrogError(f"{self.name}: its scene was deleted during the export.")
            if number != raw_frame(scene):
                scene.frame_set(int(number))
            layer = scene.view_layers.get(self.layer) or scene.view_layers[0]
            layer.update()
            evaluated = obj.evaluated_get(layer.depsgraph)
            time = playback.shown_frame(obj, scene.frame_current_final, evaluated)
            gaussians = playback.gaussians_at(obj, scene.frame_current_final, evaluated)
            placement = np.array(evaluated.matrix_world) if self.placed else None
            yield TakeFrame(number, time, gaussians, placement)

    def restore(self) -> None:
        """Restores the scene's current frame, if the scene still exists."""
        scene = find_by_uid(bpy.data.scenes, self.scene)
        if scene is not None and (scene.frame_current, scene.frame_subframe) != self.shown:
            scene.frame_set(self.shown[0], subframe=self.shown[1])
