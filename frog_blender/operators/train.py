"""Train FRoG, pause, continue and cancel a training, and read a capture folder again."""

# Blender reads properties from annotations, which to a type checker are not types.
# mypy: disable-error-code="valid-type"

from functools import partial
from pathlib import Path
from typing import Any

import bpy

from .. import point_cloud
from ..engine.errors import FrogError
from ..properties import switch, whole
from ..scene_import.capture_objects import finder, of_same_capture, stored_path, that_plays
from ..scene_import.create_objects import import_scene
from ..tasks.training import TrainingTask
from ..tasks.training_request import (
    TrainingRequest,
    can_train_longer,
    longer_request,
    output_of,
    request_of,
    steps_done,
)
from ..timeline import playback
from ..ui import capture_reading, capture_summary, torch_environment
from ..unsaved_changes import is_being_edited
from ..viewport import live
from .bases import FrogOperator, TaskOperator


class ResultImporter:
    """Imports a finished file into ``scene`` once, as one undo step: call it with the file's path.

    It adds the capture and changes nothing else: no viewport, no selection, no setting, which the panel offers. It
    returns what the panel is to say besides, "" where all went as one expects. Where the scene is gone or is being
    edited it leaves the file to the panel's *Import*. It may raise FrogError.
    """

    def __init__(self, scene: bpy.types.Scene) -> None:
        self._find = finder(scene)

    def prepare(self) -> None:
        """Makes what any import needs, at another time than the rest; nothing where none would follow."""
        target = self._find()
        if target is not None and not is_being_edited(target):
            point_cloud.prepare()

    def __call__(self, path: Path) -> str:
        target = self._find()
        if target is None:
            return "Not imported automatically: the scene that it was trained for was not open when the training ended."
        if that_plays(target, path):
            playback.refresh(target)
            return ""
        if is_being_edited(target):
            return "Not imported automatically: the scene was being edited when the training ended."
        others = of_same_capture(target, playback.open_scene(path).header.capture_path)
        import_scene(path, target)
        _remember_step()
        if others:
            return f"Imported beside {', '.join(others)} of the same capture. Hide one of them."
        return ""


def _remember_step() -> None:
    """Pushes an undo step, so that one undo reverts the import and nothing else."""
    if bpy.context.window_manager.windows:
        with bpy.context.temp_override(window=bpy.context.window_manager.windows[0]):
            bpy.ops.ed.undo_push(message="Import trained FRoG scene")


def reason_not_to_train(settings: Any) -> str:
    """Why no training can be started with the settings of a scene, as a sentence; empty where one can."""
    if TrainingTask.is_any_running():
        return "A training is already running."
    if not settings.capture_folder:
        return "No capture is selected. Choose the folder with the videos and cameras to train from."
    summary = capture_summary.of(settings)
    if summary.error:
        return summary.error
    if summary.raw_footage:
        return "The cameras have to be calibrated first."
    return torch_environment.torch_needed()


class StartsTraining(FrogOperator):
    """Base of operators that start trainings."""

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        return reason_not_to_train(context.scene.frog)

    def begin(self, settings: Any, request: TrainingRequest) -> None:
        """Starts it; the scene's output becomes that of the request. FrogError if it cannot be started."""
        after = ResultImporter(settings.id_data) if settings.import_when_done else None
        prepare = after.prepare if after is not None else None
        torch_environment.make_torch_importable()
        seen = live.view_of_capture(settings.id_data, capture_summary.of(settings).capture)
        TrainingTask(partial(request.events, live=seen.source), after, live=seen, prepare=prepare).begin()
        if request.output == output_of(settings):
            return
        self.report({"INFO"}, f"{output_of(settings)} already exists. This training writes {request.output.name}.")
        stored = stored_path(request.output)
        if settings.output_path == settings.derived_output:  # another capture still changes it
            settings.derived_output = stored
        settings.output_path = stored


class FROG_OT_train(StartsTraining, bpy.types.Operator):
    """Train a dynamic Gaussian scene from the capture, in the background"""

    bl_label = "Train FRoG"

    resume: switch(
        "Resume",
        "Continue a training that was cancelled or interrupted, with the recipe and settings that it was started with",
        options={"SKIP_SAVE"},
    )

    @classmethod
    def description(cls, _context: bpy.types.Context, properties: Any) -> str:
        if properties.resume:
            return "Go on with the training that was cancelled or interrupted, with the settings that it began with"
        return ""

    def act(self, context: bpy.types.Context) -> None:
        self.begin(context.scene.frog, request_of(context.scene.frog, self.resume))


class FROG_OT_train_longer(StartsTraining, bpy.types.Operator):
    """Go on with the finished training, for more steps. Its scene stays as it is; the new one gets a number"""

    bl_label = "Train Longer"

    steps: whole(
        "Steps in All",
        "Steps that the training has had in the end, with those that it had before",
        min=1,
        options={"SKIP_SAVE"},
    )

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        none = "There is no finished training of this capture to go on with."
        return super().problem(context) or ("" if can_train_longer(context.scene.frog) else none)

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        if not self.properties.is_property_set("steps"):
            self.steps = 2 * steps_done(context.scene.frog)
        return context.window_manager.invoke_props_dialog(self)

    def act(self, context: bpy.types.Context) -> None:
        settings = context.scene.frog
        done = steps_done(settings)
        steps = self.steps if self.properties.is_property_set("steps") else 2 * done
        if steps <= done:
            raise FrogError(f"The training has had {done:,} steps already, expected more than that in all.")
        self.begin(settings, longer_request(settings, steps))


class FROG_OT_dismiss_training(TaskOperator, bpy.types.Operator):
    """Remove the report of the last training from the panel. Its files stay"""

    kind = TrainingTask
    bl_label = "Dismiss"
    applies = staticmethod(lambda task: not task.is_running and not task.waiting)
    otherwise = "There is no report of a training that has ended."
    change = staticmethod(lambda task: task.forget())


def forget_shown_training(*_: Any) -> None:
    """Before another file is opened: the report of a training whose scene is in this one belongs to this one."""
    task = TrainingTask.current()
    if task is None or task.is_running or task.waiting or task.error or task.state.result is None:
        return
    if any(that_plays(scene, task.state.result) for scene in bpy.data.scenes):
        TrainingTask.forget()


class FROG_OT_cancel_training(TaskOperator, bpy.types.Operator):
    """Stop the training. The scene as trained so far is written to the output file"""

    kind = TrainingTask


class FROG_OT_pause_training(TaskOperator, bpy.types.Operator):
    """Pause the training to free the computer for other work. Nothing is lost"""

    kind = TrainingTask
    bl_label = "Pause"
    applies = staticmethod(lambda task: task.is_computing())
    otherwise = "No training is running, or it is paused already."
    change = staticmethod(lambda task: task.control.pause())


class FROG_OT_resume_training(TaskOperator, bpy.types.Operator):
    """Continue the paused training"""

    kind = TrainingTask
    bl_label = "Resume"
    applies = staticmethod(lambda task: task.paused)
    otherwise = "No training is paused."
    change = staticmethod(lambda task: task.control.resume())


class FROG_OT_inspect_capture(FrogOperator, bpy.types.Operator):
    """Read the capture folder again"""

    bl_label = "Check Capture"

    def act(self, context: bpy.types.Context) -> None:
        summary = capture_reading.read(bpy.path.abspath(context.scene.frog.capture_folder))
        if summary is not None and summary.error:
            raise FrogError(summary.error)


HANDLERS = [(bpy.app.handlers.load_pre, forget_shown_training)]
