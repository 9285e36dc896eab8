"""Train FRoG, pause, continue and cancel a training, and read a capture folder again."""

# Blender reads properties from annotations, which to a type checker are not types.
# mypy: disable-error-code="valid-type"

import bpy
from bpy.props import BoolProperty

from ..engine.errors import FrogError
from ..scene_import.capture_objects import stored_path
from ..training_task import runner
from ..training_task.request import output_of, request_of
from ..ui import capture_summary, preferences
from .cancel_operator import CancelsTask
from .training_result import importer


class FROG_OT_train(bpy.types.Operator):
    """Train a dynamic Gaussian scene from the capture, in the background"""

    bl_idname = "frog.train"
    bl_label = "Train FRoG"

    resume: BoolProperty(
        name="Resume",
        description="Continue a training that was cancelled or interrupted, with the recipe and settings that it "
        "was started with",
        default=False,
        options={"SKIP_SAVE"},
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        settings = context.scene.frog
        try:
            request = request_of(settings, self.resume)
            preferences.make_torch_importable()
            after = importer(context.scene) if settings.import_when_done else None
            runner.begin(request.events, after)
        except FrogError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if request.output != output_of(settings):
            self.report({"INFO"}, f"{output_of(settings)} already exists. This training writes {request.output.name}.")
            stored = stored_path(request.output)
            if settings.output_path == settings.derived_output:  # another capture still changes it
                settings.derived_output = stored
            settings.output_path = stored
        return {"FINISHED"}


class FROG_OT_cancel_training(CancelsTask, bpy.types.Operator):
    """Stop the training. The scene as trained so far is written to the output file"""

    bl_idname = "frog.cancel_training"
    bl_label = "Cancel"

    task = staticmethod(runner.current)


class FROG_OT_pause_training(bpy.types.Operator):
    """Pause the training to free the computer for other work. Nothing is lost"""

    bl_idname = "frog.pause_training"
    bl_label = "Pause"

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        return runner.is_running() and not runner.is_paused()

    def execute(self, _context: bpy.types.Context) -> set[str]:
        task = runner.current()
        if task is not None:
            task.control.pause()
        return {"FINISHED"}


class FROG_OT_resume_training(bpy.types.Operator):
    """Continue the paused training"""

    bl_idname = "frog.resume_training"
    bl_label = "Resume"

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        return runner.is_paused()

    def execute(self, _context: bpy.types.Context) -> set[str]:
        task = runner.current()
        if task is not None:
            task.control.resume()
        return {"FINISHED"}


class FROG_OT_inspect_capture(bpy.types.Operator):
    """Read the capture folder again"""

    bl_idname = "frog.inspect_capture"
    bl_label = "Check Capture"

    def execute(self, context: bpy.types.Context) -> set[str]:
        preferences.add_environment()
        summary = capture_summary.inspect(bpy.path.abspath(context.scene.frog.capture_folder))
        if summary.error:
            self.report({"ERROR"}, summary.error)
            return {"CANCELLED"}
        return {"FINISHED"}


_CLASSES = (
    FROG_OT_train,
    FROG_OT_pause_training,
    FROG_OT_resume_training,
    FROG_OT_cancel_training,
    FROG_OT_inspect_capture,
)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
