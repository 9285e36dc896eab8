"""The preferences of the device *Remote*: the command that trains elsewhere, and a folder's two names."""

# Blender reads properties from annotations, which to a type checker or a linter are not types.
# mypy: disable-error-code="valid-type"

from typing import Any

import bpy
from bpy.props import StringProperty

from ..tasks.remote_command import RemoteCommand
from ..tasks.training_request import REMOTE
from . import torch_environment

EXAMPLE = "ssh gpu frog train {capture} --out {output} --events {options}"


class RemotePreferences:
    """A base of the add-on's preferences."""

    remote_command: StringProperty(
        name="Remote Command",
        description="Command that trains on another computer, for the device Remote. {capture}, {output} and "
        f"{{options}} are replaced. It is started without a shell. For example: {EXAMPLE}",
    )
    remote_local_folder: StringProperty(
        name="Local Folder",
        description="A folder that both computers share, as it is called on this one. Empty where captures and outputs "
        "have the same paths on both",
        subtype="DIR_PATH",
    )
    remote_folder: StringProperty(
        name="Remote Folder",
        description="The same folder as it is called on the other computer",
    )

    def draw_remote(self) -> None:
        """Draws the command, and what is wrong with it."""
        layout: bpy.types.UILayout = self.layout  # type: ignore[attr-defined]  # of the preferences
        layout.prop(self, "remote_command")
        if not self.remote_command:
            layout.label(text=EXAMPLE, icon="INFO")
            return
        layout.prop(self, "remote_local_folder")
        layout.prop(self, "remote_folder")
        if problem := remote_command().problem():
            layout.label(text=problem, icon="ERROR")


def remote_command() -> RemoteCommand:
    """The command of the preferences; an empty one where there is none."""
    preferences = torch_environment.addon_preferences()
    if preferences is None:
        return RemoteCommand("")
    local = bpy.path.abspath(preferences.remote_local_folder)
    return RemoteCommand(preferences.remote_command, local, preferences.remote_folder)


def needed(settings: Any) -> str:
    """What is missing to train on the device of ``Scene.frog``, as a sentence; empty where nothing is."""
    return remote_command().problem() if settings.device == REMOTE else torch_environment.torch_needed()
