"""Base classes of importers whose files can be dropped into a window and selected several at a time."""

# mypy: disable-error-code="valid-type"

from pathlib import Path

import bpy
from bpy.props import CollectionProperty, StringProperty
from bpy_extras.io_utils import ImportHelper


class OpensDroppedFile(ImportHelper):
    """A base next to ``bpy.types.Operator``: a dropped file needs no file browser.

    Who has it as a base opens one file, ``filepath``, in ``open_file``.
    """

    # Blender fills them with what was dropped or chosen; its ``invoke_popup`` asks for ``files``.
    directory: StringProperty(subtype="DIR_PATH", options={"HIDDEN", "SKIP_SAVE"})
    files: CollectionProperty(type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if self.filepath and Path(self.filepath).is_file():
            return self.invoke_popup(context)
        return super().invoke(context, event)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Opens every file; one that cannot be opened does not stop the others. The first one sets up the scene."""
        paths = self.paths()
        if len(paths) < 2:
            return self.open_file(context)
        named, sets_up = self.filepath, self.set_up_scene  # type: ignore[has-type]
        opened = False
        try:
            for path in paths:
                self.filepath = str(path)
                if self.open_file(context) == {"FINISHED"}:
                    opened, self.set_up_scene = True, False
        finally:
            self.filepath, self.set_up_scene = named, sets_up
        return {"FINISHED"} if opened else {"CANCELLED"}

    def open_file(self, context: bpy.types.Context) -> set[str]:
        """Opens ``filepath`` and reports the result."""
        raise NotImplementedError

    def paths(self) -> list[Path]:
        """All files that were dropped or selected, if there are several."""
        folder = Path(bpy.path.abspath(self.directory))
        return [folder / file.name for file in self.files if file.name]


class DropsIntoViews:
    """Base of file handlers: files can be dropped into viewports and outliners."""

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        return context.area is not None and context.area.type in {"VIEW_3D", "OUTLINER"}
