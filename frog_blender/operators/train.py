"""Train FRoG, hold it, cancel it, go on with it, and look at a capture folder again."""

# Blender reads properties from annotations, which to a type checker are not types.
# mypy: disable-error-code="valid-type"

import os
from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty

from ..engine.errors import FrogError, found_instead
from ..engine.training.session.output_paths import checkpoint_path, is_of_another, unused_output
from ..scene_import.capture_objects import stored_path
from ..training_task import runner
from ..ui import capture_summary, preferences
from .training_result import importer


class FROG_OT_train(bpy.types.Operator):
    """Train a dynamic Gaussian scene from the capture, in the background"""

    bl_idname = "frog.train"
    bl_label = "Train FRoG"

    resume: BoolProperty(
        name="Resume",
        description="Go on with the training that was cancelled, or that Blender did not survive, "
        "with the recipe and settings that it began with",
        default=False,
        options={"SKIP_SAVE"},
    )

    def execute(self, context: Any) -> set[str]:
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
            self.report({"INFO"}, f"{output_of(settings)} stays: this training writes {request.output.name}.")
            stored = stored_path(request.output)
            if settings.output_path == settings.derived_output:  # another capture still changes it
                settings.derived_output = stored
            settings.output_path = stored
        return {"FINISHED"}


class FROG_OT_cancel_training(bpy.types.Operator):
    """Stop training; what was learned so far is written to the output file"""

    bl_idname = "frog.cancel_training"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, _context: Any) -> bool:
        return runner.is_running()

    def execute(self, _context: Any) -> set[str]:
        if runner.current is not None:
            runner.current.cancel()
        return {"FINISHED"}


class FROG_OT_pause_training(bpy.types.Operator):
    """Hold the training, so that the computer is free for something else; nothing is lost"""

    bl_idname = "frog.pause_training"
    bl_label = "Pause"

    @classmethod
    def poll(cls, _context: Any) -> bool:
        return runner.is_running() and not runner.is_paused()

    def execute(self, _context: Any) -> set[str]:
        assert runner.current is not None
        runner.current.control.pause()
        return {"FINISHED"}


class FROG_OT_resume_training(bpy.types.Operator):
    """Go on with the training that is paused"""

    bl_idname = "frog.resume_training"
    bl_label = "Resume"

    @classmethod
    def poll(cls, _context: Any) -> bool:
        return runner.is_paused()

    def execute(self, _context: Any) -> set[str]:
        assert runner.current is not None
        runner.current.control.resume()
        return {"FINISHED"}


class FROG_OT_inspect_capture(bpy.types.Operator):
    """Look into the capture folder again"""

    bl_idname = "frog.inspect_capture"
    bl_label = "Check Capture"

    def execute(self, context: Any) -> set[str]:
        preferences.add_environment()
        summary = capture_summary.inspect(bpy.path.abspath(context.scene.frog.capture_folder))
        if summary.error:
            self.report({"ERROR"}, summary.error)
            return {"CANCELLED"}
        return {"FINISHED"}


def request_of(settings: Any, resume: bool = False) -> runner.TrainingRequest:
    """What the panel's settings ask for; FrogError if something is missing.

    Unless it is resumed, a training writes what is not there yet: the output gets a number where a scene lies.
    """
    if not settings.capture_folder:
        raise FrogError("No capture is chosen: name the folder with the videos and cameras to train from.")
    capture = Path(bpy.path.abspath(settings.capture_folder))
    if not os.path.isdir(capture):  # false, not an error, where nobody may look
        raise FrogError(f"{capture}: found no such folder, expected a capture to train from.")
    if not settings.output_path:
        raise FrogError("No output is chosen: name the .frog file to write.")
    output = output_of(settings)
    if resume and is_of_another(output, capture):
        raise found_instead(checkpoint_path(output), "a training of another capture", f"one of {capture}")
    return runner.TrainingRequest(
        capture,
        output if resume else unused_output(output),
        settings.recipe,
        settings.capacity,
        steps=settings.steps or None,
        scale=settings.image_scale or None,
        holdout_frames=None if settings.holdout_frames < 0 else settings.holdout_frames,
        device=settings.device,
        preview_camera=settings.preview_camera or None,
        resume=resume,
        overwrite=False,
    )


def output_of(settings: Any) -> Path:
    """The .frog file that the panel's settings name."""
    output = Path(bpy.path.abspath(settings.output_path))
    if not output.name:
        raise found_instead(output, "a folder", "the name of a .frog file to write")
    return output if output.suffix == ".frog" else output.with_name(output.name + ".frog")


def can_resume(settings: Any) -> bool:
    """True when a training of that output left something to go on from, and not another capture's."""
    try:
        output = output_of(settings)
    except FrogError:
        return False
    if not checkpoint_path(output).is_file():
        return False
    return not is_of_another(output, Path(bpy.path.abspath(settings.capture_folder)))


_CLASSES = (
    FROG_OT_train,
    FROG_OT_pause_training,
    FROG_OT_resume_training,
    FROG_OT_cancel_training,
    FROG_OT_inspect_capture,
)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
