"""Align to Floor: the capture's floor on the grid, its centre at the origin, optionally at its real size."""

# mypy: disable-error-code="valid-type"

import bpy
import numpy as np
from mathutils import Matrix

from ..engine.errors import FrogError
from ..engine.playback.ground_plane import Floor, camera_up, find_floor, min_height, placement, static_points
from ..properties import number, switch
from ..scene_import.capture_objects import active_capture, cameras_of, root_of
from ..timeline import playback
from .bases import UndoableOperator


class FROG_OT_align_to_floor(UndoableOperator, bpy.types.Operator):
    """Rotate and move the capture so that its floor lies on the grid, z points up and its centre is at the origin"""

    bl_label = "Align to Floor"
    needs_capture = True

    use_floor: switch(
        "Find Floor",
        "Look for the floor among the Gaussians. Otherwise the cameras alone determine the up direction",
        True,
    )
    flip: switch("Flip", "Turn the capture upside down, for cameras that were mounted that way")
    use_length: switch(
        "Set Size",
        "Scale the capture to a known distance: between the two selected objects, such as two of its "
        "cameras, or otherwise between its two cameras that are farthest apart",
    )
    length: number("Distance", "The real length of that distance", 1.0, min=1e-4, soft_max=100.0, subtype="DISTANCE")

    def act(self, context: bpy.types.Context) -> str:
        obj = active_capture(context)
        root = root_of(obj)
        context.view_layer.update()  # matrices of objects that were just moved are outdated
        if root.library is not None:
            raise FrogError(f"{root.name} is linked from another file. Append it to move it.")
        scale = self._scale(context, obj)
        matrix, said = aligned(obj, context.scene.frame_current_final, self.use_floor, self.flip)
        # The Gaussians relative to the object that is moved.
        inside = root.matrix_world.inverted_safe() @ obj.matrix_world
        root.matrix_world = Matrix.Scale(scale, 4) @ Matrix(matrix.tolist()) @ inside.inverted_safe()
        return said

    def _scale(self, context: bpy.types.Context, obj: bpy.types.Object) -> float:
        """The capture's scale: scene units per unit of the capture."""
        now = float(np.cbrt(abs(obj.matrix_world.determinant())))
        if not now > 0.0:
            raise FrogError(f"{obj.name}: found a scale of zero, expected a positive one.")
        if not self.use_length:
            return now
        places = [selected.matrix_world.translation for selected in context.selected_objects if selected != obj]
        if len(places) != 2:
            places = [camera.matrix_world.translation for camera in cameras_of(obj)]
        longest = max(((a - b).length for i, a in enumerate(places) for b in places[:i]), default=0.0)
        if not longest > 0.0:
            raise FrogError(f"{obj.name}: found no distance to measure, expected two selected objects or two cameras.")
        return now * self.length / longest


def aligned(obj: bpy.types.Object, scene_frame: float, use_floor: bool, flip: bool) -> tuple[np.ndarray, str]:
    """(4, 4) rigid matrix from a capture's own space to the world, and a sentence about what was found of what its
    edits leave at a frame of the timeline.

    Without cameras, up is where it is now. Raises FrogError if the .frog file cannot be read, or says nothing.
    """
    scene = playback.scene_time(obj, scene_frame).scene
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
        off = f", {floor.tilt:.1f}° from the cameras' up direction" if certain else ""
        return f"{name}: found a floor that holds {floor.share:.0%} of the static Gaussians{off}."
    source = "the cameras' up direction" if certain else "the cameras' images, which may be pitched"
    why = "found no floor among the Gaussians. It" if use_floor else "it"
    return f"{name}: {why} is upright by {source}, with its lowest part on the grid."
