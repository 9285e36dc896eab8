"""A capture set upright: its floor on the grid, its middle at the origin, its size as it was on the day."""

# mypy: disable-error-code="valid-type"

from typing import Any

import bpy
import numpy as np
from bpy.props import BoolProperty, FloatProperty
from mathutils import Matrix

from ..engine.errors import FrogError
from ..engine.playback.ground_plane import Floor, camera_up, find_floor, min_height, placement, static_points
from ..scene_import.capture_objects import cameras_of, chosen, placed_by
from ..timeline import playback


class FROG_OT_align_to_floor(bpy.types.Operator):
    """Turn and move the capture so that its floor lies on the grid, up is up, and it stands at the origin"""

    bl_idname = "frog.align_to_floor"
    bl_label = "Align to Floor"
    bl_options = {"REGISTER", "UNDO"}

    use_floor: BoolProperty(
        name="Find Floor",
        description="Look for the floor among the Gaussians; otherwise only the cameras say where up is",
        default=True,
    )
    flip: BoolProperty(
        name="Flip",
        description="Turn the capture upside down, for cameras that hung that way",
        default=False,
    )
    use_length: BoolProperty(
        name="Set Size",
        description="Scale the capture so that a distance in it is as long as you say: between the two selected "
        "objects, such as two of its cameras, or else between its two cameras that stand farthest apart",
        default=False,
    )
    length: FloatProperty(
        name="Distance",
        description="How long that distance is in truth",
        default=1.0,
        min=1e-4,
        soft_max=100.0,
        subtype="DISTANCE",
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        cls.poll_message_set("Select a capture first.")
        return chosen(context) is not None

    def execute(self, context: Any) -> set[str]:
        obj = chosen(context)
        root = placed_by(obj)
        context.view_layer.update()  # or what was placed just now is measured where it was
        if root.library is not None:
            self.report({"ERROR"}, f"{root.name} is linked from another file; append it to move it.")
            return {"CANCELLED"}
        try:
            scale = self._scale(context, obj)
            matrix, said = aligned(obj, use_floor=self.use_floor, flip=self.flip)
        except FrogError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        inside = root.matrix_world.inverted_safe() @ obj.matrix_world  # where the Gaussians are in what is moved
        root.matrix_world = Matrix.Scale(scale, 4) @ Matrix(matrix.tolist()) @ inside.inverted_safe()
        self.report({"INFO"}, said)
        return {"FINISHED"}

    def _scale(self, context: Any, obj: Any) -> float:
        """Of the capture, in lengths of the scene for each of its own."""
        now = float(np.cbrt(abs(obj.matrix_world.determinant())))
        if not now > 0.0:
            raise FrogError(f"{obj.name}: found a scale of zero, expected a positive one.")
        if not self.use_length:
            return now
        places = [each.matrix_world.translation for each in context.selected_objects if each != obj]
        if len(places) != 2:
            places = [camera.matrix_world.translation for camera in cameras_of(obj)]
        longest = max(((a - b).length for i, a in enumerate(places) for b in places[:i]), default=0.0)
        if not longest > 0.0:
            raise FrogError(f"{obj.name}: found no distance to measure, expected two selected objects or two cameras.")
        return now * self.length / longest


def aligned(obj: Any, *, use_floor: bool = True, flip: bool = False) -> tuple[np.ndarray, str]:
    """(4, 4) rigid matrix from a capture's own space to the world, and a sentence about what was found.

    Without cameras, up is where it is now. Raises FrogError if the .frog file cannot be read, or says nothing.
    """
    scene = playback.open_scene(playback.file_of(obj))
    cameras = scene.header.cameras
    upright = np.array(obj.matrix_world.to_3x3().inverted_safe())[:, 2]
    up, certain = camera_up(cameras) if cameras else (upright / np.linalg.norm(upright), False)
    up = -up if flip else up
    points, weights = static_points(scene)
    if use_floor:
        floor = find_floor(points, weights, up, certain=certain)
    else:
        floor = Floor(up, min_height(points, up), False, 0.0, 0.0)
    return placement(floor, points, cameras), _sentence(obj.name, floor, certain, use_floor)


def _sentence(name: str, floor: Floor, certain: bool, use_floor: bool) -> str:
    if floor.found:
        off = f", {floor.tilt:.1f}° off what the cameras say" if certain else ""
        return f"{name}: found a floor that holds {floor.share:.0%} of what is at rest{off}."
    source = "the cameras' up" if certain else "the cameras' images, which may be pitched"
    why = "found no floor among the Gaussians, so " if use_floor else ""
    return f"{name}: {why}it stands upright by {source}, its lowest part on the grid."


register, unregister = bpy.utils.register_classes_factory((FROG_OT_align_to_floor,))
