"""Bases of operators: what is missing is said beforehand, and an error in one sentence afterwards."""

# mypy: disable-error-code="valid-type"

from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import bpy
import numpy as np
from bpy.props import StringProperty

from .. import redrawing
from ..capture_files import named_file
from ..engine.editing.marks import Marks
from ..engine.errors import FrogError
from ..engine.playback.player import ScenePlayer
from ..relative_paths import being_written
from ..scene_import.capture_objects import active_capture
from ..tasks.background_task import BackgroundTask
from ..timeline import playback
from ..timeline.edits import marks_of, store_marks
from ..ui.selection_tools import tool_in

UNDOABLE = {"REGISTER", "UNDO"}
MISSING = {"selection": "Select Gaussians of the capture first.", "hidden": "No Gaussian of the capture is hidden."}
"""By the name of the marks that an operator needs."""


class FrogOperator:
    """Base of all, next to ``bpy.types.Operator``: ``problem`` says why it cannot be done, ``act`` does it.

    Only what is not in the room ``frog`` has a ``bl_idname`` of its own.
    """

    bl_idname: str
    report: Callable[[set[str], str], None]  # of the Operator
    poll_message_set: Callable[[str], None]

    import_menu = export_menu = ""
    """What it is called in File > Import and in File > Export, if it stands there."""
    needs_capture = False
    """Whether there is nothing to do without an active capture."""

    def __init_subclass__(cls) -> None:
        """Names an operator as its class: FROG_OT_train is ``frog.train``. A file browser shows files of its ending."""
        super().__init_subclass__()
        room, _, name = cls.__name__.partition("_OT_")
        if name and "bl_idname" not in vars(cls):
            cls.bl_idname = f"{room.lower()}.{name}"
        if suffix := vars(cls).get("filename_ext"):
            shown = StringProperty(default=f"*{suffix}", options={"HIDDEN"})
            cls.__annotations__.setdefault("filter_glob", shown)

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        """Why it cannot be done now, as a sentence; empty where it can."""
        is_missing = cls.needs_capture and active_capture(context) is None
        return "Import or select a capture first." if is_missing else ""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        problem = cls.problem(context)
        cls.poll_message_set(problem)
        return not problem

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            said = self.act(context)
        except FrogError as error:
            return self.failed(error)
        if said:
            self.report({"INFO"}, said)
        return {"FINISHED"}

    def act(self, context: bpy.types.Context) -> str | None:
        """Does it and says what was done, if that is not seen; raises FrogError for what cannot be."""
        raise NotImplementedError

    def failed(self, error: FrogError) -> set[str]:
        """Reports an error, after which nothing has changed."""
        self.report({"ERROR"}, str(error))
        return {"CANCELLED"}


class UndoableOperator(FrogOperator):
    """Base of those that change the file, as one undo step, and can be repeated with other settings."""

    bl_options = UNDOABLE


class ConfirmedOperator(FrogOperator):
    """Base of those that ask before they do it."""

    question = ""
    """What is asked besides what it is called."""

    def invoke(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return context.window_manager.invoke_confirm(
            self, event, title=self.bl_label, message=self.question, confirm_text=self.bl_label.split()[0]
        )


class TaskOperator(FrogOperator):
    """Base of those that change what runs in the background: unless they say otherwise, they cancel it."""

    bl_label = "Cancel"
    kind: ClassVar[type[BackgroundTask]]
    """Of what is changed."""
    applies: ClassVar[Any] = staticmethod(lambda task: task.is_running)  # Any: a function of the task, as the next one
    """Whether there is anything to do."""
    change: ClassVar[Any] = staticmethod(lambda task: task.cancel())
    """Does it."""
    otherwise: ClassVar[str] = ""
    """Why there is nothing to do, where that is not that none is running."""

    @classmethod
    def problem(cls, _context: bpy.types.Context) -> str:
        task = cls.kind.current()
        return "" if task is not None and cls.applies(task) else cls.otherwise or f"No {cls.kind.what} is running."

    def act(self, _context: bpy.types.Context) -> None:
        task = self.kind.current()
        if task is not None:
            self.change(task)
        redrawing.status_bars()
        redrawing.sidebars()


class CaptureFileOperator(FrogOperator):
    """Base, before a helper of Blender's for file browsers, of those on a file next to the active capture's."""

    filepath: StringProperty(subtype="FILE_PATH")
    needs_capture = True
    suffix = ""
    """Of the suggested name; empty for ``filename_ext``."""

    def invoke(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if not self.filepath:
            self.filepath = str(named_file(active_capture(context)).with_suffix(self.suffix or self.filename_ext))
        return super().invoke(context, event)  # type: ignore[misc]  # of Blender's helper

    @property
    def path(self) -> Path:
        """The chosen one."""
        return Path(bpy.path.abspath(self.filepath))


class EditOperator(UndoableOperator):
    """Base of those that edit the active capture."""

    needs = ""
    """The marks without which there is nothing to do, a key of MISSING."""

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        missing = no_own_capture(context)
        if not missing and cls.needs and not getattr(active_capture(context).frog_edits, cls.needs).bits:
            return MISSING[cls.needs]
        return missing

    def act(self, context: bpy.types.Context) -> str | None:
        with being_written():
            said = self.edit(context, active_capture(context))
        playback.refresh(context.scene)
        return said

    def edit(self, context: bpy.types.Context, obj: bpy.types.Object) -> str | None:
        """As ``act``, for the active capture."""
        raise NotImplementedError


class KeyedOperator(EditOperator):
    """Base of those with keys in the tools that select Gaussians. A key that can do nothing says why: it must not go on
    to Blender's own operators, which delete and hide objects.
    """

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        takes_key = context.region is not None and context.region.type == "WINDOW" and tool_in(context) is not None
        return "" if takes_key and playback.captures_in(context.scene) else super().problem(context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        if missing := super().problem(context):
            self.report({"WARNING"}, missing)
            return {"CANCELLED"}
        return super().execute(context)


def no_own_capture(context: bpy.types.Context) -> str:
    """Why the active capture cannot be changed, as a sentence; empty where it can."""
    obj = active_capture(context)
    return "Select a capture of this file first." if obj is None or obj.library is not None else ""


def scene_of(obj: bpy.types.Object) -> ScenePlayer:
    """The scene that a capture plays, without edits."""
    return playback.open_scene(playback.file_of(obj))


def chosen_in(settings: Any, scene: ScenePlayer) -> np.ndarray:
    """(N,) bool which Gaussians of a scene a group of properties marks; none, if the marks are of another scene."""
    marks = marks_of(settings)
    if marks is None or not marks.fits(scene):
        return np.zeros(scene.file_count, bool)
    return marks.chosen()


def mark(settings: Any, scene: ScenePlayer, chosen: np.ndarray) -> None:
    """Marks Gaussians of a scene in a group of properties."""
    store_marks(settings, Marks.of(scene, chosen) if chosen.any() else None)


def select(obj: bpy.types.Object, chosen: np.ndarray) -> str:
    """Makes Gaussians (N,) bool of a capture the selected ones, and says how many they are."""
    scene = scene_of(obj)
    mark(obj.frog_edits.selection, scene, chosen)
    return f"{np.count_nonzero(chosen):,} of {scene.count:,} Gaussians are selected."
