"""Show what a training made, at a click: it ends in the background, and changes no viewport and no selection."""

# mypy: disable-error-code="valid-type"

from pathlib import Path

import bpy

from .. import point_cloud
from ..engine.errors import FrogError
from ..properties import text
from ..scene_import.capture_objects import cameras_of, root_of, select_capture, that_plays
from ..scene_import.scene_setup import has_camera_of_its_own
from ..viewport import views
from .bases import UndoableOperator

_FIELD = 3.0  # reaches of a capture without cameras that a view is away from it


class FROG_OT_show_result(UndoableOperator, bpy.types.Operator):
    """Select the capture and look at it as its first camera did"""

    bl_label = "Show"

    filepath: text("Scene", "The .frog file that is shown", options={"SKIP_SAVE"})

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        return "" if context.mode == "OBJECT" else "Leave the present mode first."

    def act(self, context: bpy.types.Context) -> None:
        obj = that_plays(context.scene, Path(bpy.path.abspath(self.filepath)))
        if obj is None:
            raise FrogError(f"{self.filepath}: found no capture of this scene that plays it. Import it first.")
        if root_of(obj).name not in context.view_layer.objects:
            sentence = "found its collection excluded from this view layer, expected it to be included."
            raise FrogError(f"{root_of(obj).name}: {sentence}")
        select_capture(context, obj)
        look_at(context, obj)
        views.count_as_untouched()


def look_at(context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """Looks at a capture in the context's viewport: through its first camera where the scene has none of the user's,
    from there otherwise, or from the front where it has no cameras.
    """
    scene, space, cameras = context.scene, context.space_data, cameras_of(obj)
    if cameras and not has_camera_of_its_own(scene):
        scene.camera = cameras[0]
    if not isinstance(space, bpy.types.SpaceView3D):
        return
    view = space.region_3d
    if cameras and scene.camera == cameras[0]:
        view.view_perspective = "CAMERA"
        return
    view.view_perspective = "PERSP"
    if cameras:
        view.view_matrix = cameras[0].matrix_world.inverted_safe()
        return
    _, reach = point_cloud.middle_of(point_cloud.read(obj)["position"])
    view.view_location = root_of(obj).matrix_world.translation
    view.view_distance = max(_FIELD * reach * obj.matrix_world.median_scale, 0.01)
